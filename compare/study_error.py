"""Speed against error: wall time and memory of both solvers over resolution, precision, step and stiffness."""

from dataclasses import replace
from pathlib import Path

from compare.batch import Job, Outcome, run_all
from mpm.config import Column, load_scene
from mpm.errors import SceneError

DAMPING = 0.4  # of the explicit runs: the quasistatic collapse that the implicit solver follows
REPEATS = 3  # runs a point is the median of
REPEAT_BELOW = 300.0  # [s] a longer run is made once: it averages the machine's noise itself
STIFFER = (1, 10, 100)  # times the scene's Young's modulus
CFL = (0.25, 1.0)  # beside the scene's own
REACH = (0.15, 0.6)  # cells that points may go in an implicit step, beside the default of 0.3


def ladder(reference: str, settings: list[str], cells: list[float], finer: list[float], device: str) -> list[Job]:
    """One job of each point of the study, the longest first.

    Resolutions `cells` (per r0) of both solvers and precisions, and `finer` ones of the explicit solver alone; at the
    second of `cells` stiffer material, at the third other steps. Raises SceneError where a resolution does not fit.
    """
    scene = load_scene(reference, settings)
    if not isinstance(scene.geometry, Column):
        raise SceneError(f"{scene.name}: speed against error is measured on a column")
    if len(cells) < 3:
        raise SceneError("--cells: three resolutions at least, to extrapolate from")
    common = [*settings, f"explicit.damping={DAMPING}", "explicit.until=rest", "output.vtk=false", "output.every=2.0"]
    common.append("output.fields=['displacement', 'eps_p_eqv', 'volume']")

    def job(mode, count, label="", *more, **named):
        sized = (*common, f"grid.cell={scene.geometry.radius / count!r}", *more)
        return Job(f"{mode}-{count:g}{label}", reference, sized, mode, device if mode == "explicit" else "cpu", **named)

    cells = sorted(cells)
    jobs = [job("explicit", count) for count in [*cells, *finer]]
    jobs += [job("explicit", count, "-float32", "explicit.precision=float32") for count in cells]
    jobs += [job("implicit", count) for count in cells]
    for factor in STIFFER[1:]:
        young = f"material.young={scene.material.young * factor!r}"
        jobs += [job(mode, cells[1], f"-E{factor}", young) for mode in ("explicit", "implicit")]
    jobs += [job("explicit", cells[2], f"-cfl{cfl}", f"explicit.cfl={cfl}") for cfl in CFL]
    jobs += [job("implicit", cells[2], f"-reach{reach}", regularisation={"reach": reach}) for reach in REACH]
    # Resolving every scene here tells one that does not fit before hours of runs.
    return sorted(jobs, key=lambda one: one.scene.material.young**0.5 / one.scene.grid.cell**4, reverse=True)


def measure(jobs: list[Job], directory: Path, workers: int, force: bool, monitor) -> list[list[Outcome]]:
    """Run the jobs, those of under five minutes `REPEATS` times; the outcomes of each."""
    first = run_all(jobs, directory, workers, force, monitor)
    short = [one for one in first if one.done and one.summary["wall_s"] < REPEAT_BELOW]
    again = [replace(one.job, name=f"{one.job.name}-r{n}", repeat=n) for one in short for n in range(2, REPEATS + 1)]
    repeated = run_all(again, directory, workers, force, monitor)
    outcomes = {id(one): [one] for one in first}
    for number, one in enumerate(short):
        outcomes[id(one)] += repeated[number * (REPEATS - 1) : (number + 1) * (REPEATS - 1)]
    return [outcomes[id(one)] for one in first]
