"""Repose in Python: a scene, a run by either solver, its results as arrays and figures, and the two compared.

    import repose

    scene = repose.load_scene("column_small", explicit={"damping": 0.4})
    result = repose.run(scene)
    result.summary["R_995"], result.history["time"], result.points
    result.plot_profile()

Lengths in m, times in s, stresses in Pa, tension positive.
"""

from __future__ import annotations

import tempfile
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from mpm.errors import NumericalError, SceneError

if TYPE_CHECKING:  # figures, arrays and Warp take a second to import: only what is called for is
    import numpy as np
    import pyvista
    from matplotlib.figure import Figure

    from explicit.solver import ExplicitSolver
    from implicit.solver import ImplicitSolver
    from mpm.scene import Scene

__all__ = ["Comparison", "NumericalError", "Result", "SceneError", "Solver", "compare", "load_scene", "open_run", "run"]
__version__ = metadata.version("repose")

Mode = Literal["explicit", "implicit"]


def load_scene(scene: str | Path, **sections: Any) -> Scene:
    """The validated scene of a file or of a preset (`repose scenes` lists them), with keys changed section by section.

    `load_scene("column_1", grid={"cell": 0.1}, explicit={"damping": 0.4})`. Raises SceneError with every problem found:
    key, value, accepted range and unit.
    """
    from mpm.load import load_scene as load

    return load(str(scene), sections=sections)


def run(
    scene: Scene | str | Path,
    directory: str | Path | None = None,
    mode: Mode = "explicit",
    device: str = "cpu",
    force: bool = False,
    progress: bool = True,
    ranks: int | Literal["all"] = 1,
) -> Result:
    """Compute a scene to its end; the results.

    `directory`: where they are kept; None: in a temporary folder that goes with the returned object. A folder that
    holds the finished run of this very scene, solver, device and code is opened and nothing is computed, so that a
    notebook's cell can be run again; another run in it is replaced only with `force`. `mode`: the solver. `device`:
    "cpu", "cuda:0" or, on ranks, "cuda": a GPU for each; of the explicit solver. `progress`: show a bar. `ranks`: MPI
    ranks that compute it, "all": one a core, or a GPU; they are started for this run, and show lines in place of a bar.

    Raises SceneError for bad input (all problems at once), a folder in use, and where there is no MPI for ranks;
    NumericalError where a run diverges (its message names the last checkpoint); KeyboardInterrupt after Ctrl-C, once a
    checkpoint is saved; ChildProcessError where a rank was killed: `repose resume` goes on from the last checkpoint.
    """
    from compare.launch import call, count_of, refuse_nested, refuse_ranks
    from compare.solvers import refuse_mode

    refuse_nested("repose.run")
    refuse_mode(mode)
    if (many := count_of(ranks, device)) > 1:
        refuse_ranks(device, many)
    scene, temporary = _resolved(scene), None
    if directory is None:
        temporary = tempfile.TemporaryDirectory(prefix=f"{scene.name}-{mode}-")
        directory = temporary.name
    if force or not _finished(Path(directory), scene, mode, device):
        asked = (scene, directory, mode, device, force, progress)
        call(many, _compute, *asked) if many > 1 else _compute(*asked)
    return Result(directory, temporary)


def open_run(directory: str | Path) -> Result:
    """The results of a run in `directory`, also of one that has not ended. Raises SceneError where there is none."""
    return Result(directory)


def compare(
    scene: Scene | str | Path,
    directory: str | Path | None = None,
    device: str = "cpu",
    force: bool = False,
    ranks: int | Literal["all"] = 1,
) -> Comparison:
    """Both solvers (the explicit one with D = 0.4) on the scene's grid and on a coarser one, against Eq. 4.

    `directory`: where runs and report are kept; None: in a temporary folder that goes with the returned object. Runs
    that are there already are not computed again; another study's report is replaced only with `force`. `ranks`: as in
    `run`. Raises SceneError as `run`, and where dolfinx is missing.
    """
    from compare.cli.terminal import BatchMonitor
    from compare.comparison import compare_solvers, keep_scene
    from compare.launch import count_of, refuse_nested
    from compare.report.page import write_report

    refuse_nested("repose.compare")
    many, temporary = count_of(ranks, device), None
    if directory is None:
        temporary = tempfile.TemporaryDirectory(prefix=f"{_resolved(scene).name}-compare-")
        directory = temporary.name
    directory = Path(directory)
    reference = str(scene if isinstance(scene, str | Path) else keep_scene(scene, directory, device, force))
    asked = f"repose.compare({reference!r})"
    report = compare_solvers(directory, force, BatchMonitor(), asked, reference, [], device, many)
    write_report(report, directory)
    return Comparison(directory, report, temporary)


class Result:
    """Results of one run: `directory`, `scene` (validated, typed) and what the properties give."""

    def __init__(self, directory: str | Path, temporary: tempfile.TemporaryDirectory | None = None):
        """Raises SceneError where `directory` holds no run. `temporary`: removed with this object."""
        from mpm.results import Results

        self._results, self._temporary = Results.open(directory), temporary
        self.directory = Path(directory)
        self.scene: Scene = self._results.scene

    def __repr__(self) -> str:
        summary = self.summary
        if not summary:
            return f"<{self.scene.name}: not at its end, {len(self.times)} snapshots in {self.directory}>"
        ended = f"{summary['stop_reason']} at t = {summary['sim_time']:.4g} s"
        return f"<{self.scene.name}, {summary['mode']}: R_995 = {summary['R_995']:.4f}, {ended}>"

    @property
    def summary(self) -> dict[str, Any]:
        """The figures of summary.json: run-outs [-], heights [m], counts, ...; empty where the run has not ended."""
        return self._results.summary() or {}

    @property
    def history(self) -> dict[str, np.ndarray]:
        """Columns over time, float64 (rows,): "time" [s], "R_995" [-], energies [J] (explicit), "unbalanced" [-] ..."""
        return self._results.history()

    @property
    def times(self) -> np.ndarray:
        """Times [s] of the snapshots."""
        return self._results.times

    def snapshot(self, index: int = -1) -> dict[str, Any]:
        """Fields of a snapshot by name, each with the point as its first axis: "x" (n, 3) [m] and those that the scene
        asks for in output.fields; and "time" [s], "step". Raises SceneError for one that is not there."""
        return self._results.snapshot(index)

    @property
    def points(self) -> np.ndarray:
        """Positions (n, 3) [m] of the last snapshot."""
        return self._results.snapshot(-1, ["x"])["x"]

    def to_pyvista(self, index: int = -1) -> pyvista.PolyData:
        """A snapshot as a cloud of points with its fields. Raises SceneError where pyvista is not installed."""
        try:
            import pyvista
        except ImportError:
            raise SceneError("to_pyvista needs pyvista, which is not installed: pip install pyvista") from None
        fields = self.snapshot(index)
        cloud = pyvista.PolyData(fields.pop("x"))
        cloud.field_data["time"] = [fields.pop("time")]
        del fields["step"]
        for name, values in fields.items():
            cloud.point_data[name] = values
        return cloud

    def plot_profile(self) -> Figure:
        """Height over the radius against Eq. 4's solid. Raises SceneError for a scene that is not a column."""
        from compare.plots.run import plot_profile

        return plot_profile(self._results)

    def plot_morphology(self) -> Figure:
        """The deposit in 3D and in section, coloured by plastic strain, as in Fig. 9 of Wyser et al. 2023."""
        from compare.plots.run import plot_morphology

        return plot_morphology(self._results)

    def plot_history(self) -> Figure:
        """Run-outs over time, beside them energies (explicit) or balance and Newton iterations (implicit)."""
        from compare.plots.run import plot_history

        return plot_history(self._results)


class Comparison:
    """What `compare` found: `report` (the content of report.json), `page` (report.html) and the runs."""

    def __init__(self, directory: Path, report: dict[str, Any], temporary: tempfile.TemporaryDirectory | None):
        self.directory, self.report, self._temporary = directory, report, temporary

    def __repr__(self) -> str:
        return f"<{self.report['title']}. {self.verdict}>"

    @property
    def page(self) -> Path:
        """The report as one HTML file with its figures inside."""
        return self.directory / "report.html"

    @property
    def verdict(self) -> str:
        """How many checks hold, and which do not, by how much."""
        return self.report["verdict"]["sentence"]

    @property
    def runs(self) -> dict[str, dict[str, Any]]:
        """For each run by its label its summary, or why it failed."""
        return self.report["runs"]


class Solver:
    """A solver to step by hand: `Solver(scene).advance_to(0.5)`.

    `time` [s] (implicit: pseudo-time), `steps`, `x` (n, 3) [m], `arrays`; `state` and `restore` for a restart.
    """

    def __init__(self, scene: Scene | str | Path, mode: Mode = "explicit", device: str = "cpu"):
        """Raises SceneError with every reason why the solver would not take its first step."""
        from compare.solvers import refuse_mode
        from mpm.body import build
        from mpm.devices import find_device
        from mpm.precheck import refuse

        refuse_mode(mode)
        if mode == "explicit":
            from explicit.solver import ExplicitSolver

            place = find_device(device)
        else:
            from implicit.run import start
            from implicit.solver import ImplicitSolver

            start(device)
        self.body = build(_resolved(scene))
        refuse(self.body, mode)
        self._solver: ExplicitSolver | ImplicitSolver = (
            ExplicitSolver(self.body, place) if mode == "explicit" else ImplicitSolver(self.body)
        )

    def advance_to(self, time: float) -> None:
        """Step to `time` [s], the implicit solver by less than a step beyond. NumericalError where it diverges."""
        self._solver.advance_to(time)

    @property
    def time(self) -> float:
        """Time, or pseudo-time, so far [s]."""
        return self._solver.time

    @property
    def steps(self) -> int:
        """Steps so far."""
        return self._solver.steps

    @property
    def x(self) -> np.ndarray:
        """Positions (n, 3) [m]."""
        return self.arrays["x"]

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """The points' state by name, each (n, ...): copies. See `ExplicitSolver` and `implicit.points.Points`."""
        count = len(self.body.x)
        return {name: its for name, its in self.state().items() if getattr(its, "shape", ())[:1] == (count,)}

    def state(self) -> dict[str, Any]:
        """Everything a restart needs."""
        return self._solver.state()

    def restore(self, state: dict[str, Any]) -> None:
        """Go back to what `state` gave."""
        self._solver.restore(state)


def _compute(scene: Scene, directory: str | Path, mode: Mode, device: str, force: bool, progress: bool) -> None:
    """Run a scene into `directory`."""
    from compare.cli.terminal import Monitor
    from compare.solvers import runs_of

    monitor = Monitor(banner=False) if progress else None
    runs_of(mode).run(scene, directory, device, force=force, monitor=monitor)


def _resolved(scene: Scene | str | Path) -> Scene:
    return load_scene(scene) if isinstance(scene, str | Path) else scene


def _finished(directory: Path, scene: Scene, mode: str, device: str) -> bool:
    """Whether `directory` holds the finished run of this scene by this solver, both as they are now, on this device.

    Raises SceneError for a mesh file that is gone.
    """
    from mpm.provenance import decisive
    from mpm.results import RESULTS, SUMMARY, Results

    if not ((directory / RESULTS).is_file() and (directory / SUMMARY).is_file()):
        return False
    here, made = Results.open(directory), {"device": device} | decisive(mode, scene)
    same_run = all(here.provenance.get(key) == value for key, value in made.items())
    return same_run and here.scene == scene
