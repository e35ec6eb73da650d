"""Runs of the implicit solver: a history row a step, rest judged by the balance of forces and the front."""

import math
import time
from dataclasses import asdict

import numpy as np

from implicit._dolfinx import libraries
from implicit.pseudo_time import REST_UNBALANCED, Regularisation, Rest
from implicit.solver import ImplicitSolver
from mpm.body import Body, build
from mpm.devices import start_warp
from mpm.errors import NumericalError, SceneError
from mpm.law_state import variables
from mpm.precheck import refuse
from mpm.provenance import decisive, provenance
from mpm.ranks import world
from mpm.results import Results
from mpm.run import Run, body_of, reopen
from mpm.scene import Scene

KEPT = "regularisation_"  # before the names of `Regularisation` in a run's provenance


def run(
    scene: Scene, directory, device="cpu", force=False, monitor=None, regularisation: Regularisation = Regularisation()
) -> dict:
    """Run a scene into `directory`; return the summary.

    `monitor`, if given, has `start(run)`, `row(run, row)` and `stop(run)`, called with this run's `ImplicitRun`.
    Raises SceneError (bad input, a scene or device that the solver cannot run, folder in use), NumericalError (the
    message names the last checkpoint), Interrupted (Ctrl-C, after a checkpoint).
    """
    started = time.perf_counter()
    start(device)
    body = build(scene)
    refuse(body, ImplicitRun.mode)
    solver = solver_of(body, regularisation)
    described = provenance(ImplicitRun.device, ImplicitRun.precision)
    described |= libraries() | decisive(ImplicitRun.mode, scene)
    described |= {KEPT + name: value for name, value in asdict(regularisation).items()}
    this = ImplicitRun(body, Results.create(directory, scene, described, force), solver)
    this.begin()
    return this.go(started, monitor)


def resume(directory, device=None, monitor=None) -> dict:
    """Go on with a run from its checkpoint, with the regularisation it was started with; return the summary.

    The end is bitwise that of an uninterrupted run. Raises as `run`, and SceneError when there is no checkpoint or
    the run has ended.
    """
    started = time.perf_counter()
    results = reopen(directory)
    start(device or ImplicitRun.device)
    kept = {name: value for name, value in results.provenance.items() if name.startswith(KEPT)}
    regularisation = Regularisation(**{name.removeprefix(KEPT): value for name, value in kept.items()})
    body = body_of(results)
    this = ImplicitRun(body, results, solver_of(body, regularisation))
    this.restore(results.read_checkpoint())
    return this.go(started, monitor)


def start(device: str):
    """Initialise what the solver computes with. Raises SceneError for any device but the CPU."""
    if device != ImplicitRun.device:
        raise SceneError(f"--device {device}: the implicit solver runs on the CPU")
    start_warp()


def solver_of(body: Body, regularisation: Regularisation):
    """The solver on the ranks that the program was started on."""
    if (comm := world()) is None:
        return ImplicitSolver(body, regularisation)
    from implicit.ranks import RankedSolver

    return RankedSolver(body, regularisation, comm)


class ImplicitRun(Run):
    """A run of the implicit solver: a history row after each step."""

    mode, device, precision = "implicit", "cpu", "float64"

    def __init__(self, body: Body, results: Results, solver: ImplicitSolver):
        super().__init__(body, results, solver)
        self.rest = Rest(body.time_scale)
        self.max_steps = body.scene.implicit.max_steps
        self.most_unbalanced = 0.0

    @property
    def x(self) -> np.ndarray:
        """Positions (n, 3) [m] of the points."""
        return self.solver.x

    @property
    def progress(self) -> tuple[float, float]:
        """How far what is out of balance has fallen on its way to that of rest, of 1: in logarithms, in which it falls
        evenly; or the share of `max_steps`, where that is more."""
        now, most = min(self.solver.unbalanced_ratio, self.most_unbalanced), self.most_unbalanced
        fallen = math.log(most / now) / math.log(most / REST_UNBALANCED) if most > REST_UNBALANCED else 0.0
        return min(max(fallen, self.solver.steps / self.max_steps), 1.0), 1.0

    def first_row(self):
        """The history row before any step."""
        self._write_row(newton=0, failed=0)

    def advance(self) -> dict[str, float]:
        """One step and its history row, a snapshot and a checkpoint if due. Sets `stop_reason` at the end."""
        solver = self.solver
        self.refuse_invalid(solver.find_invalid(self.farthest))  # a step of a spoilt state might crash
        newton, failed = solver.newton_iterations, solver.failed_steps
        solver.advance()
        row = self._write_row(solver.newton_iterations - newton, solver.failed_steps - failed)
        loaded = solver.load_share == 1.0
        if loaded and self.rest(solver.time, row["R_995"], solver.unbalanced_ratio):
            self.stop_reason = "rest"
        elif solver.steps >= self.max_steps:
            self.stop_reason = "max_steps"
        self.output_when_due()
        return row

    def _write_row(self, newton: int, failed: int) -> dict[str, float]:
        """`newton`: iterations of the step; `failed`: tries in it that Newton could not solve."""
        solver = self.solver
        row = {"time": solver.time, "step": solver.steps, "dt": solver.time_step}
        seen = solver.look()
        row |= seen.front
        row |= {"unbalanced": solver.unbalanced_ratio, "newton": newton, "failed": failed}
        if np.isfinite(solver.unbalanced_ratio):
            self.most_unbalanced = max(self.most_unbalanced, solver.unbalanced_ratio)
        row["volume_ratio"] = seen.volume_ratio
        self.add_row(row)
        if wrong := self.misplaced(seen.beyond, row["volume_ratio"]):
            raise NumericalError(f"diverged at step {solver.steps}: {wrong}")
        return row

    def own_fields(self) -> dict:
        """For each of the point fields that the solver knows itself, a function that gives it."""
        solver, points = self.solver, self.solver.material_points
        own = {
            "velocity": points.v.numpy,
            "stress": lambda: points.sigma(solver.material),
            "volume_ratio": points.jacobian.numpy,
        }
        return own | (variables(points.law_state) if self.body.constants.plastic else {})

    def state(self) -> dict:
        """What a checkpoint holds beside what every run has."""
        return self.solver.state() | {"recent": np.array(self.rest.recent).reshape(-1, 2)}

    def restore(self, state: dict):
        """Take over a checkpoint, and drop outputs written after it."""
        super().restore(state)
        self.rest.recent = [tuple(row) for row in state["recent"]]
        unbalanced = self.results.history()["unbalanced"]
        self.most_unbalanced = float(max(unbalanced[np.isfinite(unbalanced)], default=0.0))

    def state_is_whole(self, _error: NumericalError) -> bool:
        """Points move only once Newton has succeeded; where they ended may be no result."""
        seen = self.solver.look()  # a run that goes on may fail before it has a row
        return not self.misplaced(seen.beyond, seen.volume_ratio)

    def write_grid(self):
        """vtk/background.xdmf: the background mesh and the last step's displacement increment."""
        self.solver.write_grid(self.results.directory / "vtk" / "background.xdmf")

    def figures(self) -> dict:
        """What the implicit solver adds to the summary."""
        solver, used = self.solver, self.solver.body.constants
        names = ("newton_iterations", "linear_iterations", "failed_steps", "unbalanced_ratio")
        return {
            **{name: getattr(solver, name) for name in names},
            "regularisation": asdict(solver.regularisation),
            "young_used": used.young,
            "bulk_used": used.bulk,
            "nodes_stored_start": solver.nodes_solved_start,
            "nodes_stored_max": solver.nodes_solved_max,
        }
