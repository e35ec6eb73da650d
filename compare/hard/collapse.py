"""Collapses that strain a solver, and changes that must not matter to one. R is R_995 (`mpm.runout`) throughout.

Columns are coarse, so that all of it is affordable; explicit runs at D = 0.05 unless the finding says otherwise.
"""

import time
from dataclasses import replace
from functools import cache
from tempfile import TemporaryDirectory

import numpy as np

from compare.hard.case import Finding, hard_case
from explicit.run import ExplicitRun, solver_of
from mpm.body import build
from mpm.devices import find_device
from mpm.errors import NumericalError
from mpm.load import load_scene
from mpm.results import Results
from mpm.run import Run
from mpm.theory import theory

DYNAMIC, DAMPED = "explicit.damping=0.05", "explicit.damping=0.4"
LOW, MIDDLE = "column_small", "column_1"  # lambda0 = 0.5 and 1
QUARTER, FIFTH, SIXTH, EIGHTH = (f"grid.cell={1 / cells!r}" for cells in (4, 5, 6, 8))
SHORT = "explicit.until=3.19"  # 10 sqrt(h0/g) of the middle column: its front has all but stopped
SECTORS = 6  # of the full circle, as run-outs of experiments are read in six directions

STEP_LENGTHS = "steps of another length move run-outs by 1.5 % either way; twice that in all"


def finish(
    mode: str, scene: str, *settings: str, turned=0.0, shifted=(0.0, 0.0, 0.0), device="cpu", **regularisation: float
) -> Run:
    """A run of `scene` with `settings` to its end, its folder gone; points turned by `turned` [degrees] about the axis,
    then moved by `shifted` [m].

    Raises NumericalError where it diverges, SceneError where the mode is implicit and dolfinx is missing.
    """
    resolved = load_scene(scene, [*settings, "output.every=1000.0", "output.vtk=false"])
    find_device(device)
    body = build(resolved)
    body = replace(body, x=_turned(body.x, turned) + np.array(shifted))
    with TemporaryDirectory() as folder:
        results = Results.create(folder, resolved, {})
        if mode == "explicit":
            run: Run = ExplicitRun(body, results, solver_of(body, device))
        else:
            run = _implicit_run(body, results, regularisation)
        run.begin()
        run.stepping_since = time.perf_counter()
        while run.stop_reason is None:
            run.advance()
    return run


collapse = cache(finish)  # for runs that are only looked at: cases share them


def _implicit_run(body, results, regularisation) -> Run:
    from implicit.pseudo_time import Regularisation
    from implicit.run import ImplicitRun, solver_of  # here: the explicit half works without dolfinx

    return ImplicitRun(body, results, solver_of(body, Regularisation(**regularisation)))


def _turned(x, degrees: float):
    if not degrees:
        return x
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.stack([c * x[:, 0] - s * x[:, 1], s * x[:, 0] + c * x[:, 1], x[:, 2]], axis=1)


def runout(run: Run) -> float:
    """R_995 at the end of the run."""
    return run.last_row["R_995"]


def apart(run: Run, base: Run) -> float:
    """Difference of two run-outs over the second."""
    return abs(runout(run) / runout(base) - 1.0)


def story(*runs: Run) -> str:
    """Run-outs and how the runs ended, for a note."""
    return "; ".join(f"R {runout(run):.4f} ({run.stop_reason}, {run.solver.time:.3g} s)" for run in runs)


def same(what: str, run: Run, base: Run, limit: float, reason: str, more: str = "") -> Finding:
    """The finding that two run-outs are one, within `limit` of the second."""
    return Finding(f"{what}: R", run.mode, apart(run, base), limit, reason, story(run, base) + more, run)


def not_finite(run: Run) -> int:
    """How many numbers of the state that a restart needs are not finite."""
    return sum(int((~np.isfinite(value)).sum()) for value in run.state().values())


def mass_error(run: Run) -> float:
    """What the nodes miss of the points' mass, over it."""
    return abs(run.solver.grid_mass() / (run.body.point_mass * run.solver.points) - 1.0)


def pressure(run: Run) -> np.ndarray:
    """Pressure (n,) [Pa] of the points."""
    return run.field_makers()["pressure"]()


def roughness(run: Run) -> float:
    """Mean distance of a point's pressure from the mean of its cell's points, over their mean pressure.

    Over the cells whose mean pressure exceeds 1 % of rho g h0. 7/4 where one point of eight bears all of it.
    """
    body, p = run.body, pressure(run)
    cells = np.floor(run.x / body.scene.grid.cell).astype(int)
    cell, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)[1:]
    cell = np.ravel(cell)
    mean = (np.bincount(cell, p) / count)[cell]
    loaded = mean > 0.01 * body.overburden
    return float(np.abs(p - mean)[loaded].mean() / p[loaded].mean())


def sector_spread(run: Run) -> str:
    """Run-outs of a full column in six sectors, for a note: (max - min)/mean of their R_995."""
    measure, x = run.body.measure, run.x
    sector = (np.degrees(np.arctan2(x[:, 1], x[:, 0])) % 360.0 // (360.0 / SECTORS)).astype(int)
    reach = [measure.runout(np.quantile(measure.distance(x[sector == k]), 0.995)) for k in range(SECTORS)]
    return f"six sectors: (max - min)/mean {np.ptp(reach) / np.mean(reach):.3f}"


def sound(run: Run, name: str):
    """Every number finite, and all of the mass on the grid."""
    yield Finding(f"{name}: numbers not finite", run.mode, not_finite(run), 0, "a state is finite", story(run), run)
    yield Finding(f"{name}: mass", run.mode, mass_error(run), 1e-12, "weights sum to 1, but for round-off")


@hard_case("tall", on_ranks=True)
def tall():
    """lambda0 = 8 and 16: falls of 8 and 16 r0, thousands of steps, points that fly far ahead."""
    for aspect, cell in ((8, QUARTER), (16, f"grid.cell={1 / 3!r}")):
        run = collapse("explicit", MIDDLE, f"geometry.aspect_ratio={aspect}.0", cell, DYNAMIC)
        yield from sound(run, f"lambda0 = {aspect}")
        ratio = runout(run) / theory(run.body.scene)["eq45"]
        outside = max(0.8 - ratio, ratio - 1.3, 0.0)
        yield Finding(
            f"lambda0 = {aspect}: R over Eq. 4+5, outside 0.8 to 1.3", "explicit", outside, 0.0,
            "at lambda0 up to 4 and 20 cells per r0 the ratio is 1.03 to 1.16",
            f"ratio {ratio:.3f}; {story(run)}",
        )  # fmt: skip


STIFF_REASON = "elastic strains are of a thousandth: the deposit rests on friction and volume, whatever E"
SOFT_REASON = "six times what E x 0.1 does: what is stiffer is followed with E of 600 rho g h0"


@hard_case("stiffness", on_ranks=True)
def stiffness():
    """E from a tenth to a hundred times the paper's: explicit steps a tenth as long."""
    yield from _stiffness("explicit", (0.1, 10, 100), 0.12, STIFF_REASON, MIDDLE, FIFTH, DYNAMIC, SHORT)


@hard_case("stiffness, implicit", on_ranks=True)
def stiffness_implicit():
    """Likewise, but for a hundred times: a cohesionless material is followed with E of at most 600 rho g h0, here 1.01
    times the paper's, so that E x 10 and all that is stiffer are one computation. It costs no more."""
    yield from _stiffness("implicit", (0.1, 10), 0.03, SOFT_REASON, LOW, SIXTH)


def _stiffness(mode, factors, limit, reason, *scene):
    base = collapse(mode, *scene)
    for factor in factors:
        run = collapse(mode, *scene, f"material.young={5.84e6 * factor}")
        yield same(f"E x {factor:g}", run, base, limit, reason)
        if mode == "implicit":
            needed, usual = run.solver.newton_iterations, base.solver.newton_iterations
            yield Finding(
                f"E x {factor:g}: Newton iterations, times as many", mode, needed / usual, 2.0,
                "the method must not pay for stiffness that the deposit does not show",
                f"{needed} against {usual}, {run.solver.failed_steps} failed steps",
            )  # fmt: skip


ANGLES = (5, 20, 30, 45, 60)


@hard_case("friction", on_ranks=True)
def friction():
    """From a slippery 5 degrees to 60, where ep2's return map would never leave tension."""
    # At D = 0.05 the sheet that runs out at phi = 5 is thinner than a cell: its ledger misses 8 % at 6 cells per r0.
    yield from _friction("explicit", SIXTH, DAMPED)


@hard_case("friction, implicit", slow=True, on_ranks=True)
def friction_implicit():
    """Likewise: at 5 degrees the front creeps through hundreds of steps."""
    yield from _friction("implicit", QUARTER)


def _friction(mode, *settings):
    runs = [collapse(mode, LOW, f"material.friction_angle={angle}", *settings) for angle in ANGLES]
    for angle, run in zip(ANGLES, runs, strict=True):
        what = f"phi = {angle}: numbers not finite"
        yield Finding(what, mode, not_finite(run), 0, "a state is finite", story(run), run)
    reach = np.array([runout(run) for run in runs])
    yield Finding(
        "largest rise of R from one phi to the next", mode, float(np.diff(reach).max()), 0.0,
        "more friction, less run-out", "R " + ", ".join(f"{one:.3f}" for one in reach),
    )  # fmt: skip


STANDING = "material.cohesion=2000.0"  # the low column stands: 3.83 c/(rho g) tan(45 + phi/2) = 0.79 m, h0 = 0.5 m
ROUGH_REASON = (
    "a standing column's pressure varies over a cell with depth, whatever nu: by second-order elements 1.28 times as "
    "much at 0.499 as at 0.3; what K alone makes, 20 to 200 times as large, is the grid's"
)
NU_REASON = "run-out is a matter of friction and volume, and psi = 0 keeps the volume at any nu"


@hard_case("near-incompressible", on_ranks=True)
def near_incompressible():
    """nu = 0.49 and 0.499: K is 20 and 200 times as large as at 0.3, 8 points to a cell of first-order hexahedra."""
    yield from _checkerboard("explicit", "explicit.until=2.0")
    yield from _incompressible_collapse("explicit", MIDDLE, FIFTH, DYNAMIC, SHORT)


@hard_case("near-incompressible, damped", slow=True, on_ranks=True)
def near_incompressible_damped():
    """Likewise at D = 0.4, to rest or 60 sqrt(h0/g)."""
    yield from _incompressible_collapse("explicit", LOW, FIFTH, DAMPED)


@hard_case("near-incompressible, implicit", on_ranks=True)
def near_incompressible_implicit():
    """The standing column alone: collapses take minutes."""
    yield from _checkerboard("implicit", "loads.initial_stress=none", "implicit.load_steps=5")


@hard_case("near-incompressible collapse, implicit", slow=True, on_ranks=True)
def near_incompressible_collapse_implicit():
    """Collapses of the implicit solver, which needs several times as many iterations for them."""
    yield from _incompressible_collapse("implicit", LOW, SIXTH)


def _checkerboard(mode, *settings):
    base, *runs = (collapse(mode, LOW, QUARTER, STANDING, *settings, _poisson(nu)) for nu in (0.3, 0.49, 0.499))
    for nu, run in zip((0.49, 0.499), runs, strict=True):
        yield Finding(
            f"nu = {nu}: pressure scatter in a cell of a standing column, times that at 0.3", mode,
            roughness(run) / roughness(base), 2.0, ROUGH_REASON,
            f"{roughness(run):.3f} against {roughness(base):.3f} of the mean pressure", run,
        )  # fmt: skip
    finer = collapse(mode, LOW, EIGHTH, STANDING, *settings, _poisson(0.499))
    yield Finding(
        "nu = 0.499: pressure scatter in a cell of half the size, times that of the whole", mode,
        roughness(finer) / roughness(runs[-1]), 0.6,
        "what varies smoothly does so half as much over half a cell; a checkerboard stays as it is",
        f"{roughness(finer):.3f} against {roughness(runs[-1]):.3f} of the mean pressure", finer,
    )  # fmt: skip


def _incompressible_collapse(mode, *scene):
    base = collapse(mode, *scene)
    for nu in (0.49, 0.499):
        yield same(f"nu = {nu}", collapse(mode, *scene, _poisson(nu)), base, 0.10, NU_REASON)


def _poisson(nu: float) -> str:
    return f"material.poisson={nu}"


@hard_case("coarse", on_ranks=True)
def coarse():
    """2, 3 and 4 cells per r0: 26, 84 and 208 points: a sound result, or none and the reason."""
    yield from _coarse("explicit", DYNAMIC)


@hard_case("coarse, implicit", on_ranks=True)
def coarse_implicit():
    """Likewise."""
    yield from _coarse("implicit")


def _coarse(mode, *settings):
    for cells in (2, 3, 4):
        name = f"{cells} cells per r0"
        try:
            yield from sound(collapse(mode, LOW, f"grid.cell={1 / cells!r}", *settings), name)
        except NumericalError as error:
            refused = "no result: " in str(error)
            yield Finding(f"{name}: stops without a reason", mode, float(not refused), 0.0, "exit code 3", str(error))


@hard_case("precision", on_ranks=True)
def precision():
    """float32 against float64, and a run against the same run."""
    scene = ("explicit", MIDDLE, FIFTH, DYNAMIC)
    base = collapse(*scene)
    yield from _single("5 cells per r0", *scene)
    again = finish(*scene)
    scatter = max(float(np.abs(again.state()[name] - base.state()[name]).max()) for name in ("x", "v", "tau"))
    yield Finding("equal runs: largest difference of x, v, tau", "explicit", scatter, 0.0, "one thread, one order")


@hard_case("precision, finer", slow=True, on_ranks=True)
def precision_finer():
    """float32 against float64 at 8 cells per r0."""
    yield from _single("8 cells per r0", "explicit", MIDDLE, EIGHTH, DYNAMIC)


# Of R_995 at D = 0.05 and lambda0 = 1, from random starts: 5e-5 at most on 5 cells per r0, 1.1e-4 on 8
# (benchmarks/results/ensembles_cpu.csv).
SINGLE_REASON = "round-off is all that differs: five times what it does to starts at random"


def _single(name, *scene):
    single = collapse(*scene, "explicit.precision=float32")
    yield same(f"float32, {name}", single, collapse(*scene), 6e-4, SINGLE_REASON)


@hard_case("time step", on_ranks=True)
def time_step():
    """A half and a quarter of the default Courant number."""
    yield from _time_step(MIDDLE, FIFTH, DYNAMIC)


@hard_case("time step, damped", slow=True, on_ranks=True)
def time_step_damped():
    """Likewise at D = 0.4."""
    yield from _time_step(MIDDLE, FIFTH, DAMPED)


def _time_step(*scene):
    base = collapse("explicit", *scene)
    for cfl in (0.25, 0.125):
        yield same(f"cfl = {cfl}", collapse("explicit", *scene, f"explicit.cfl={cfl}"), base, 0.03, STEP_LENGTHS)


@hard_case("time step, implicit", on_ranks=True)
def time_step_implicit():
    """Steps of the pseudo-time in which points may go half and twice as far, and half as long at the longest."""
    base = collapse("implicit", LOW, SIXTH)
    for name, factor in (("reach", 0.5), ("reach", 2), ("cap", 0.5)):
        changed = {name: factor * getattr(base.solver.regularisation, name)}
        run = collapse("implicit", LOW, SIXTH, **changed)
        steps = f"; {run.solver.steps} against {base.solver.steps} steps"
        yield same(f"{name} x {factor:g}", run, base, 0.03, STEP_LENGTHS, steps)


@hard_case("symmetry", on_ranks=True)
def symmetry():
    """Quarter, half and full column, and the full one turned by 45 degrees against the grid."""
    scene = ("explicit", MIDDLE, FIFTH, DYNAMIC, SHORT)
    full = collapse(*scene, "geometry.symmetry=full")
    for part, run in (("quarter", collapse(*scene)), ("half", collapse(*scene, "geometry.symmetry=half"))):
        yield same(f"{part} against full column", run, full, 0.02, "the same points and forces, but for round-off")
    speed = np.sqrt(full.body.scene.loads.gravity * full.body.height)
    drift = float(np.linalg.norm(full.solver.v.numpy()[:, :2].mean(axis=0)) / speed)
    yield Finding(
        "full column: horizontal momentum over mass sqrt(g h0)", "explicit", drift, 1e-6,
        "zero by symmetry; round-off grown for 2000 steps remains, a lost mirror leaves 1e-3",
        sector_spread(full),
    )  # fmt: skip
    turned = collapse(*scene, "geometry.symmetry=full", turned=45.0)
    spread = f"; {sector_spread(turned)}"
    yield same("turned by 45 degrees", turned, full, 0.02, "a grid has no say in where a column comes to rest", spread)
