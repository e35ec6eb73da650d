"""Hard cases of what passes between points and grid: crossing cells, flying alone, hardly touching a node."""

import numpy as np
from scipy.ndimage import convolve1d

from compare.hard.case import Finding, hard_case
from explicit.solver import ExplicitSolver
from mpm.body import Body, build
from mpm.devices import start_warp
from mpm.gimp import HALF_LENGTH_IN_CELLS, NODES_PER_AXIS
from mpm.load import load_scene
from mpm.seed import seed

CELL = 0.125  # [m] of the blocks
BLOCK = (f"grid.cell={CELL}", "geometry.size=[0.5, 0.5, 0.5]", "explicit.damping=0.0")
FREE = ("geometry.walls={z_min='free'}", "loads.gravity=0.0", "explicit.until=1.0", "output.history_every=1.0")
SAND = ("material.model='drucker_prager'", "material.friction_angle=37.55")
FLIGHT = np.array([2.0, -1.0, 0.5])  # [m/s]
CELLS_CROSSED = 10
# Steps of a 64th of a cell along x, all numbers of the flight are binary fractions: points land on faces exactly.
ON_FACES = (f"explicit.time_step={CELL / 64 / FLIGHT[0]}",)
NO_BINARY_FRACTION = np.array([0.1, 1.0 / 3.0, 1000.0 / 7.0])  # [m]

COLUMN = ("grid.cell=0.25", "explicit.damping=0.0", "explicit.cfl=0.25")
# Thrown from above the column, apart from each other: where above its top [m], and how fast [m/s].
THROWN = ((0.5, 0.5, 2.0), (4.0, 0.5, 3.5), (0.5, 4.0, 2.0))
THROWS = ((5.0, 1.0, 5.0), (2.0, 5.0, 2.0), (1.0, 3.0, 6.0))
LONGEST_FLIGHT, SHORTEST_FLIGHT = 1.5, 0.8  # [s]
STRESS_AT_START = -1e4  # [Pa] what they are torn off with

LIGHT = 1e-9  # mass of the lightest node, over that of a point
STRAY_SPEED = 3.0  # [m/s]


def body_of(scene: str, overrides, shift=0.0, more=()) -> Body:
    """The body of a scene with its points moved by `shift` [m], and with `more` points (n, 3) [m]."""
    start_warp()
    resolved = load_scene(scene, list(overrides))
    seeds = seed(resolved.geometry, resolved.grid.cell)
    return build(resolved, seeds._replace(x=np.vstack([seeds.x + shift, np.reshape(more, (-1, 3))])))


@hard_case("cell crossing")
def cell_crossing():
    """A block without stress flies over ten cells: no point may tell that it crosses faces."""
    unity = "round-off: a point's weights sum to one and their gradients to zero on either side of a face"
    starts = (
        ("points between faces", 0.0, ()),
        ("points on faces", HALF_LENGTH_IN_CELLS * CELL, ON_FACES),
        ("origin no binary fraction", NO_BINARY_FRACTION, ()),
    )
    for what, shift, more in starts:
        body = body_of("self_weight", (*BLOCK, *FREE, *more), shift)
        solver = ExplicitSolver(body)
        solver.v.assign(np.tile(FLIGHT, (solver.points, 1)))
        end = CELLS_CROSSED * CELL / FLIGHT[0]
        solver.advance_to(end)
        stress = np.abs(solver.sigma).max() / body.scene.material.young
        drift = np.linalg.norm(solver.v.numpy() - FLIGHT, axis=1).max() / np.linalg.norm(FLIGHT)
        note = f"{solver.steps} steps, {CELLS_CROSSED} cells along x"
        yield Finding(f"stress over E, {what}", "explicit", float(stress), 1e-10, unity, note)
        limit = f"{solver.steps} steps of some 30 roundings each, 2e-16 all of one sign: 5e-12; they are of both"
        yield Finding(f"velocity error over speed, {what}", "explicit", float(drift), 1e-12, limit, note)


@hard_case("flying alone")
def flying_alone():
    """Points thrown clear of a collapsing column, D = 0: nothing but gravity may act on them until they touch."""
    body = body_of("column_2", COLUMN)
    thrown = np.array([0.0, 0.0, body.height]) + THROWN
    body = body_of("column_2", COLUMN, more=thrown)
    solver = ExplicitSolver(body)
    flyers = solver.points - len(thrown) + np.arange(len(thrown))
    v = np.zeros((solver.points, 3))
    v[flyers] = THROWS
    solver.v.assign(v)
    sigma = np.zeros((solver.points, 6))
    sigma[flyers, :3] = STRESS_AT_START
    solver.tau.assign(sigma)
    solver.set_target(LONGEST_FLIGHT)
    x0, v0 = solver.x.numpy()[flyers].copy(), v[flyers].copy()
    ended, gained, missed, path = np.zeros(len(flyers)), np.zeros(len(flyers)), np.zeros(len(flyers)), 0.0
    last = x0
    while solver.time < LONGEST_FLIGHT:
        free = _alone(solver)[flyers] & (ended == solver.time)
        solver.advance(solver.time)  # one step
        free &= _alone(solver)[flyers]
        t, x = solver.time, solver.x.numpy()[flyers]
        fall = np.array([0.0, 0.0, -body.scene.loads.gravity * t])
        path = path + np.linalg.norm(x - last, axis=1)
        last = x.copy()
        error = np.linalg.norm(solver.v.numpy()[flyers] - v0 - fall, axis=1) / np.linalg.norm(fall)
        gained = np.where(free, np.maximum(gained, error), gained)
        error = np.linalg.norm(x - x0 - v0 * t - 0.5 * t * fall, axis=1) / path
        missed, ended = np.where(free, error, missed), np.where(free, t, ended)
    lengths = f"{len(flyers)} points alone for {', '.join(f'{t:.2f}' for t in ended)} s"
    if ended.min() < SHORTEST_FLIGHT:
        gained = missed = np.full(len(flyers), np.nan)
    late = 0.5 * body.scene.loads.gravity * solver.time_step * ended.max()
    yield Finding(
        "velocity gained beside g t, over g t",
        "explicit",
        float(gained.max()),
        1e-10,
        "round-off: alone, a point takes back from the grid what it gave, whatever stress it left with",
        lengths,
    )
    yield Finding(
        "distance from the parabola at the end of the flight, over the path",
        "explicit",
        float(missed.max()),
        1e-3,
        "the step is of first order: g t dt/2",
        f"{lengths}; g t dt/2 = {1e3 * late:.1f} mm of at least {path.min():.1f} m",
    )


def _alone(solver) -> np.ndarray:
    """Mask (n,) of the points whose stencil shares no node with another point or with a wall."""
    base = np.floor(solver.x.numpy() / solver.body.scene.grid.cell - HALF_LENGTH_IN_CELLS).astype(int)
    low = base.min(axis=0)
    count = np.zeros(base.max(axis=0) - low + 1)
    np.add.at(count, tuple((base - low).T), 1)
    for axis in range(3):
        count = convolve1d(count, np.ones(2 * NODES_PER_AXIS - 1), axis=axis, mode="constant")
    return (count[tuple((base - low).T)] < 1.5) & (base > np.array(solver.body.walls.low)).all(axis=1)


@hard_case("node with hardly any mass")
def light_node():
    """A stray point reaches a node by a sliver, then hits a block of sand: nothing may outrun the input.

    Its domain ends a sliver d beyond a node's plane, weight d^2 (across a face), or that of three planes, weight d^6
    (at a corner): a billionth of its mass.
    """
    kinds = ("points", "points are carried", "grid, from which strain is taken", "grid, after the forces")
    worst, notes = dict.fromkeys(kinds, 0.0), dict.fromkeys(kinds, "")
    for place, corner in (("across a face", False), ("at a corner", True)):
        body = body_of("self_weight", (*BLOCK, *SAND), more=_stray(4, corner, CELL))
        solver = ExplicitSolver(body)
        v = np.zeros((solver.points, 3))
        v[-1] = STRAY_SPEED * (np.array([-1.0, -1.0, -1.0]) / np.sqrt(3.0) if corner else np.array([0.0, 0.0, -1.0]))
        solver.v.assign(v)
        end, lightest = 0.3, 1.0
        solver.set_target(end)
        while solver.time < end:
            solver.advance(solver.time)  # one step
            node = solver.node_momentum.numpy()
            there = node[:, 0] > 0
            velocities = (
                solver.v.numpy(),
                solver.carry.numpy(),
                solver.node_mapped.numpy()[there, :3],
                node[there, 1:],
            )
            lightest = min(lightest, node[there, 0].min() / body.point_mass)
            allowed = STRAY_SPEED + body.scene.loads.gravity * solver.time
            for kind, velocity in zip(kinds, velocities, strict=True):
                share = float(np.linalg.norm(velocity, axis=1).max()) / allowed
                if not share <= worst[kind]:
                    worst[kind] = share
                    notes[kind] = f"{place}, t = {solver.time:.3g} s; lightest node {lightest:.0e} of a point"
    bound = "sliding and plastic impact take energy away: no velocity above the stray's own plus g t, but for round-off"
    for kind in kinds:
        yield Finding(f"speed over the input's, {kind}", "explicit", worst[kind], 1.0 + 1e-9, bound, notes[kind])
    yield from _light_node_implicit()


def _stray(node: int, corner: bool, cell: float) -> np.ndarray:
    """A point whose domain reaches a sliver past the plane after node `node`: along z, or along x, y and z."""
    sliver = LIGHT ** (1.0 / 6.0) if corner else LIGHT**0.5
    past = (node + 1 - HALF_LENGTH_IN_CELLS + sliver) * cell
    beside = (node / 2 + HALF_LENGTH_IN_CELLS) * cell
    return np.full(3, past) if corner else np.array([beside, beside, past])


def _light_node_implicit():
    """The same beside a column that starts to collapse: steps of the implicit solver."""
    from implicit.solver import ImplicitSolver

    cell, moved, nodes, notes = 0.25, 0.0, 0.0, ["", ""]
    for place, corner in (("across a face", False), ("at a corner", True)):
        stray = _stray(2, corner, cell) + (np.array([2.0, 0.0, 0.0]) * cell if corner else 0.0)
        solver = ImplicitSolver(body_of("column_small", (f"grid.cell={cell}",), more=stray))
        for step in range(8):
            dt = solver.time_step
            solver.advance()
            points = float(np.linalg.norm(solver.material_points.moved.numpy(), axis=1).max())
            ratio = float(np.linalg.norm(solver.system.u.numpy(), axis=1).max()) / points
            lightest = solver.system.node_mass.min() / solver.body.point_mass
            where = f"{place}, step {step + 1}; lightest node {lightest:.0e} of a point"
            if not points / (solver.gravity * dt**2) <= moved:
                moved, notes[0] = points / (solver.gravity * dt**2), where
            if not ratio <= nodes:
                nodes, notes[1] = ratio, where
    yield Finding(
        "points' way in a step, over g dt^2",
        "implicit",
        moved,
        1.0,
        "no momentum is carried over: nothing moves farther in a step than in free fall",
        notes[0],
    )
    yield Finding(
        "nodes' way in a step, over the points'",
        "implicit",
        nodes,
        5.0,
        "the ghost penalty lets linear motions pass: from -1 to 1 across a cell is 5 two cells on",
        notes[1],
    )
