"""What stands must stand: quiet bodies, deposits that have come to rest, and material that hardly touches a cell."""

import numpy as np
from scipy.sparse import bsr_matrix

from compare.hard.case import Finding, hard_case
from compare.hard.collapse import DAMPED, FIFTH, LOW, MIDDLE, QUARTER, STANDING, finish
from explicit.solver import STILL, ExplicitSolver
from mpm.body import build
from mpm.devices import find_device
from mpm.load import load_scene
from mpm.run import Run
from mpm.runout import front
from mpm.seed import seed

CONFINED = (
    "material.model=drucker_prager",
    "material.friction_angle=37.55",
    "geometry.size=[0.5,0.5,0.5]",
    "grid.cell=0.125",
)
# Two bodies in equilibrium: a cohesive column under its critical height, and sand without cohesion between rollers.
QUIET = {"cohesive column": (LOW, QUARTER, STANDING), "sand between rollers": ("self_weight", *CONFINED)}
SETTLED, WATCHED = 5, 20  # free-fall times sqrt(2 h0/g): what moves is measured between the two
# Limits of the top's drift over h0: a body in equilibrium stays, once it has settled elastically, by 6e-4 h0.
DRIFT, DRIFT_REASON = 5e-5, "a tenth of the elastic settlement: a body in equilibrium stays, once it has settled"
DRIFT_IMPLICIT = 1e-7
DRIFT_IMPLICIT_REASON = "a body in equilibrium stays, once it has settled: ten times what Newton's tolerance leaves"


def free_fall(body) -> float:
    """sqrt(2 h0/g) [s]."""
    return float(np.sqrt(2.0) * body.time_scale)


def top(x, body) -> float:
    """Height of the body's top over h0."""
    return front(x, body.measure)["height"] / body.height


@hard_case("quiet column")
def quiet_column():
    """Gravity comes suddenly; after the elastic settlement nothing moves, at D = 0.4."""
    for name, (scene, *settings) in QUIET.items():
        find_device("cpu")
        solver = ExplicitSolver(build(load_scene(scene, [*settings, DAMPED])))
        body = solver.body
        tops, kinetic = [], []
        for quarter in range(1, 4 * WATCHED + 1):
            solver.advance_to(quarter / 4 * free_fall(body))
            tops.append(top(solver.x.numpy(), body))
            kinetic.append(solver.energies()["KE_grid"])
        late = slice(4 * SETTLED - 1, None)
        note = f"settled by {1.0 - tops[-1]:.2e} h0"
        yield Finding(f"{name}: drift of the top", "explicit", float(np.ptp(tops[late])), DRIFT, DRIFT_REASON, note)
        # Local damping leaves speeds below this alone (explicit.solver.STILL), so no body comes to rest below it.
        still = 0.5 * body.point_mass * solver.points * STILL**2 * body.scene.loads.gravity * body.height
        yield Finding(
            f"{name}: grid kinetic energy, over that of the speed that D leaves alone",
            "explicit",
            max(kinetic[late]) / still,
            1.0,
            "it falls until damping lets go, at 3e-4 sqrt(g h0)",
            f"{max(kinetic[late]) / max(kinetic):.2g} of its peak",
        )


@hard_case("quiet column, implicit", on_ranks=True)
def quiet_column_implicit():
    """The column from its geostatic state, the sand with all of its weight put on at once."""
    for name, (scene, *settings) in QUIET.items():
        run = finish("implicit", scene, *settings, "implicit.load_steps=1", "implicit.max_steps=30")
        note = f"{run.stop_reason}, {run.solver.newton_iterations} Newton iterations"
        yield Finding(
            f"{name}: steps to rest", "implicit", run.solver.steps, 8, "equilibrium, and three steps to see it", note
        )
        tops, body = [], run.body
        for time in np.arange(SETTLED, WATCHED + 1) * free_fall(body):
            run.solver.advance_to(time)
            tops.append(top(run.x, body))
        note = f"settled by {1.0 - tops[-1]:.2e} h0"
        yield Finding(
            f"{name}: drift of the top", "implicit", float(np.ptp(tops)), DRIFT_IMPLICIT, DRIFT_IMPLICIT_REASON, note
        )


CREEP_REASON = "at rest is at rest; over R, not 1 + R, since R is what is compared with theory"


@hard_case("creep after rest", on_ranks=True)
def creep_after_rest():
    """4 sqrt(h0/g) more after a collapse at D = 0.4 has ended."""
    for scene in (MIDDLE, LOW):
        yield _creep(finish("explicit", scene, FIFTH, DAMPED))


@hard_case("creep after rest, implicit", on_ranks=True)
def creep_after_rest_implicit():
    """Likewise in pseudo-time."""
    for scene in (MIDDLE, LOW):
        yield _creep(finish("implicit", scene, FIFTH))


def _creep(run: Run) -> Finding:
    end, before, window = run.solver.time, run.last_row["R_995"], 4.0 * run.body.time_scale
    run.solver.advance_to(end + window)
    after, passed = front(run.x, run.body.measure)["R_995"], run.solver.time - end
    note = f"R {before:.4f} to {after:.4f} in {passed:.3g} s after {run.stop_reason} at {end:.3g} s"
    what = f"lambda0 = {run.body.scene.geometry.aspect_ratio:g}: R in another 4 sqrt(h0/g)"
    # An implicit step at rest is longer than that, and passes it by what is left of it.
    return Finding(what, run.mode, abs(after / before - 1.0) * window / passed, 0.005, CREEP_REASON, note, run)


BLOCK = ("geometry.size=[0.5,0.5,0.5]", "geometry.walls={z_min='fixed'}", "grid.cell=0.25")
STEP = 0.05  # [s] of the collapse step whose matrix is looked at


@hard_case("small cut, implicit")
def small_cut():
    """An elastic block of 2 x 2 x 2 cells under its weight, shifted along x and y over one cell in steps of 1 %.

    And by 1e-6 to 1e-3 cells: nodes then carry as little as 1e-12 of a point's mass.
    """
    shifts = np.concatenate([np.arange(100) / 100, [1e-6, 1e-5, 1e-4, 1e-3]])
    iterations, settled, static, moving = np.array([_shifted(shift) for shift in shifts]).T
    count = f"{len(shifts)} positions"
    yield Finding("Newton iterations, at the most", "implicit", iterations.max(), 10, "an elastic step", count)
    yield Finding(
        "settlement of the top, (max - min)/mean",
        "implicit",
        float(np.ptp(settled) / settled.mean()),
        0.005,
        "a block settles alike wherever it stands",
        f"{settled.mean():.4e} m",
    )
    for what, numbers, limit, reason in (
        ("the load step", static, 1e6, "ten times what the ghost springs leave: ten digits of sixteen remain"),
        ("a collapse step", moving, 1.5e5, "eight times what the ghost springs leave; without them it passes 1e15"),
    ):
        note = f"{numbers.min():.2g} to {numbers.max():.2g}"
        yield Finding(f"condition number of {what}, at the most", "implicit", numbers.max(), limit, reason, note)


def _shifted(shift: float) -> tuple[float, float, float, float]:
    """Newton iterations, settlement of the top [m], condition numbers of the load step and of a collapse step."""
    from implicit.pseudo_time import Regularisation
    from implicit.solver import ImplicitSolver

    find_device("cpu")
    scene = load_scene("self_weight", [*BLOCK, "implicit.load_steps=1"])
    seeds = seed(scene.geometry, scene.grid.cell)
    body = build(scene, seeds._replace(x=seeds.x + shift * scene.grid.cell * np.array([1.0, 1.0, 0.0])))
    solver = ImplicitSolver(body)
    solver.system.set_regularisation(**Regularisation().of_step(body, STEP))
    moving = condition(solver.system)
    solver.advance()
    highest = body.x[:, 2] == body.x[:, 2].max()
    settled = float((body.x - solver.x)[highest, 2].mean())
    return solver.newton_iterations, settled, condition(solver.system), moving


def condition(system) -> float:
    """Condition number [-] of the whole tangent of an `implicit.system.System` on one rank: block rows and coupling."""
    size = 3 * system.count
    blocks = system.tangent(np.zeros((system.count, 3))), system.indices, system.indptr
    coupling = np.stack([system.coupling(column) for column in np.eye(size)], axis=1)
    return float(np.linalg.cond(bsr_matrix(blocks, shape=(size, size)).toarray() + coupling))
