"""The step in four launches, as a GPU takes it, on the CPU by Warp's block runtime: the step of the nine phases."""

import numpy as np
import pytest
import warp as wp

from explicit.fused import FusedStep
from explicit.kernels import layout as K
from explicit.phases import time_phases
from explicit.solver import POINT_ARRAYS, ExplicitSolver
from mpm.body import build
from mpm.devices import start_warp
from mpm.errors import NumericalError, StepRefused
from mpm.gimp import HALF_LENGTH_IN_CELLS
from mpm.load import load_scene
from mpm.seed import seed

start_warp()

STEPS = 100
# Relative to the greatest number of an array: round-off of 100 steps whose sums run in another order.
ROUND_OFF = {"float64": 1e-12, "float32": 1e-5}
PRECISIONS = pytest.mark.parametrize("precision", ["float64", "float32"])
SCENES = {
    "column": ("column_small", ("grid.cell=0.1", "explicit.damping=0.05", "material.dilatancy_angle=10.0")),
    "ramped": ("column_small", ("grid.cell=0.2", "loads.ramp=1.0")),
    "bar between rollers": ("elastic_bar", ()),
    "fixed box": ("self_weight", ("geometry.size=[0.5,0.5,0.5]", "grid.cell=0.125", "explicit.damping=0.0",
                                  "geometry.walls={x_min='fixed', x_max='roller', y_max='fixed', z_min='roller'}")),
}  # fmt: skip


@pytest.fixture(autouse=True)
def blocks(monkeypatch):
    """Kernels that ask for blocks of threads get them: 32 fibers a block."""
    monkeypatch.setattr(wp.config, "enable_cpu_blocks", True)


def body_of(scene, settings, more=(), order=None):
    """A scene's body with `more` points (n, 3) [m], its points in the order that `order(x)` gives."""
    scene = load_scene(scene, list(settings))
    seeds = seed(scene.geometry, scene.grid.cell)
    x = np.vstack([seeds.x, np.reshape(more, (-1, 3))])
    return build(scene, seeds._replace(x=x[order(x)] if order else x))


def pair(body, time=0.1):
    """The solver by phases at `time` [s], and one that takes fused steps on from its state."""
    phases, fused = ExplicitSolver(body), ExplicitSolver(body, fused=True)
    phases.set_target(10.0)
    while phases.time < time:
        phases.advance(time)
    phases.fit_grid()
    fused.restore(phases.state())
    return phases, fused


def march(solver, steps=STEPS, batch=20):
    """Steps in batches; the stored nodes follow the points between them."""
    for taken in range(0, steps, batch):
        if taken:
            solver.fit_grid()
        solver._take(batch)


def numbers(solver, name):
    """An array of a solver; positions with what float32 leaves out of them, which is nothing to compare by itself."""
    values = getattr(solver, name).numpy().astype(float)
    return values + solver.lost.numpy() if name == "x" and solver.lost.size else values


def difference(one, other) -> float:
    """Greatest difference of two solvers' points, ledgers and clocks, each relative to the array's greatest number."""
    worst = 0.0
    for name in (*POINT_ARRAYS, "ledger", "clock", "speed"):
        if name == "lost":
            continue
        a, b = (numbers(solver, name) for solver in (one, other))
        assert np.isfinite(b).all(), name
        if a.size:
            worst = max(worst, float(np.abs(a - b).max() / (np.abs(a).max() or 1.0)))
    return worst


@PRECISIONS
@pytest.mark.parametrize("scene", SCENES)
def test_a_fused_step_is_the_step(scene, precision):
    name, settings = SCENES[scene]
    phases, fused = pair(body_of(name, (*settings, f"explicit.precision={precision}")))
    march(phases)
    march(fused)
    assert phases.steps == fused.steps >= STEPS
    assert np.abs(phases.v.numpy()).max() > 1e-3
    assert difference(phases, fused) < ROUND_OFF[precision]
    one, other = phases.energies(), fused.energies()
    largest = max(map(abs, one.values()))
    assert other == pytest.approx(one, rel=0, abs=ROUND_OFF[precision] * largest)
    assert fused.grid_mass() == pytest.approx(phases.grid_mass(), rel=ROUND_OFF[precision])


def by_cell(x):
    return np.lexsort((x // 0.1).T[::-1])


def shuffled(x):
    return np.random.default_rng(3).permutation(len(x))


@PRECISIONS
@pytest.mark.parametrize("order", [by_cell, shuffled])
def test_the_order_of_points_does_not_matter(order, precision):
    name, settings = SCENES["column"]
    settings = (*settings, f"explicit.precision={precision}")
    phases, fused = pair(body_of(name, settings, order=order))
    march(phases)
    march(fused)
    assert difference(phases, fused) < ROUND_OFF[precision]


@PRECISIONS
def test_points_need_not_be_sorted(monkeypatch, precision):
    """Where those of a warp come from anywhere, few of them share their nodes."""
    kept = []  # graphs copy from it

    def shuffle(step):
        kept.append(wp.array(shuffled(step.solver.x), dtype=wp.int32, device="cpu"))
        wp.copy(step.order, kept[-1])

    monkeypatch.setattr(FusedStep, "sort", shuffle)
    name, settings = SCENES["column"]
    phases, fused = pair(body_of(name, (*settings, f"explicit.precision={precision}")))
    march(phases)
    march(fused)
    assert difference(phases, fused) < ROUND_OFF[precision]


def test_points_are_sorted_by_cell_and_put_back():
    """At each fit by x, y, then z of the node that their stencils start at, and as in the body within a cell; after a
    batch each is at its place in the body, where a fault finds it."""
    body = body_of(*SCENES["column"], more=[[0.35, 0.35, 2.05]], order=shuffled)
    lone = int(np.argmax(body.x[:, 2]))
    phases, fused = pair(body)
    cell = np.floor(fused.x.numpy() / 0.1 - HALF_LENGTH_IN_CELLS)
    order = fused.fused_step.order.numpy()
    np.testing.assert_array_equal(order, np.lexsort((np.arange(len(cell)), *cell.T[::-1])))
    assert order[lone] != lone
    assert phases.bytes_per_point == 144 and fused.bytes_per_point == 2 * 144 + 16  # 18 numbers; what sorts them
    march(phases, 5)
    march(fused, 5)
    assert np.linalg.norm(fused.v.numpy() - phases.v.numpy(), axis=1).max() < 1e-12
    for solver in (phases, fused):
        v = solver.v.numpy().copy()
        v[lone] = np.nan
        solver.v.assign(v)
        with pytest.raises(NumericalError, match=rf"point {lone}: its velocity is not finite"):
            solver.advance_to(1.0)


@PRECISIONS
def test_a_point_alone_in_the_air_falls_freely(precision):
    """D = 0: v = -g t for a point that no other shares a node with, and the heap below is that of the phases."""
    settings = ("grid.cell=0.2", "explicit.damping=0.0", f"explicit.precision={precision}")
    body = body_of("column_small", settings, more=[[0.35, 0.35, 2.05]])
    phases, fused = pair(body, time=0.0)
    march(phases)
    march(fused)
    assert difference(phases, fused) < ROUND_OFF[precision]
    assert fused.v.numpy()[-1] == pytest.approx([0.0, 0.0, -9.81 * fused.time], abs=1e-4 * 9.81 * fused.time)


@PRECISIONS
def test_a_restarted_fused_run_goes_on_to_the_bit(precision):
    name, settings = SCENES["column"]
    _, one = pair(body_of(name, (*settings, f"explicit.precision={precision}")))
    one.set_target(10.0)
    march(one, 40)
    other = ExplicitSolver(one.body, fused=True)
    other.restore(one.state())
    one.fit_grid()
    for solver in (one, other):
        march(solver, 60)
    for array in (*POINT_ARRAYS, "ledger"):
        np.testing.assert_array_equal(getattr(other, array).numpy(), getattr(one, array).numpy(), err_msg=array)


def test_a_batch_ends_where_the_target_is_met():
    """In mid-batch, and with the nodes of the last step that was taken."""
    phases, fused = pair(body_of(*SCENES["column"]))
    target = phases.time + 12.5 * phases.time_step
    for solver in (phases, fused):
        solver.set_target(target)
        solver._take(40)
        assert solver.time == target
    assert difference(phases, fused) < ROUND_OFF["float64"]
    assert fused.energies()["KE_grid"] == pytest.approx(phases.energies()["KE_grid"], rel=1e-12)


@PRECISIONS
@pytest.mark.parametrize("stride", [1, 10])
def test_the_stored_nodes_follow_within_a_batch(stride, precision, monkeypatch):
    """The run of the phases, whose nodes follow by the host: over several fits, and where there is no room for more
    nodes, which the host then makes."""
    name, settings = SCENES["column"]
    phases, fused = pair(body_of(name, (*settings, f"explicit.precision={precision}")), time=0.25)
    capacities, most = {fused.grid.capacity}, fused.steps + 300
    looks, as_numpy = [], wp.array.numpy
    monkeypatch.setattr(wp.array, "numpy", lambda array: looks.append(array) or as_numpy(array))
    batches = 0
    while fused.steps < most:
        looks.clear()
        fused.fused_step.take(most - fused.steps, stride=stride)
        assert not looks
        fused.dials.forget()
        batches += 1
        if fused.dials.seen.clock[K.TRAVEL] >= K.OUT_OF_NODES:
            fused.fit_grid()
            capacities.add(fused.grid.capacity)
    assert 2 <= len(capacities) <= batches <= 4
    followed = 0
    while phases.steps < most:
        phases._take(1)
        phases.dials.forget()
        seen = phases.dials.seen
        if seen.clock[K.TRAVEL] + seen.speed[K.CARRIED] * seen.clock[K.DT] > 0.5 * phases.setup.margin:
            phases.fit_grid()
            followed += 1
    assert followed >= 4
    if stride == 1:  # else the nodes follow some steps later
        np.testing.assert_array_equal(*(solver.grid.pencils() for solver in (phases, fused)))
    for solver in (phases, fused):
        solver.fit_grid()  # and the distance travelled since is none
    assert difference(phases, fused) < ROUND_OFF[precision]


def test_where_a_graph_has_no_branches_a_batch_ends_before_points_outrun_the_stored_nodes():
    phases, fused = pair(body_of(*SCENES["column"]), time=0.25)
    fused.fused_step.branches = False
    for solver in (phases, fused):
        solver._take(400)
        assert solver.setup.margin < solver.clock.numpy()[K.TRAVEL] < K.OUT_OF_NODES
    assert phases.steps == fused.steps
    assert difference(phases, fused) < ROUND_OFF["float64"]
    fused.advance_to(fused.time + 1e-3)
    assert fused.steps > phases.steps


def test_a_batch_ends_with_the_step_that_passes_its_end():
    """However many it was given; the points are those of the phases, and the nodes those of the last step."""
    phases, fused = pair(body_of(*SCENES["column"]))
    until = phases.time + 12.5 * phases.time_step
    fused.fused_step.take(40, until)
    phases._take(13)
    assert fused.steps == phases.steps
    assert fused.time - fused.time_step < until < fused.time
    for solver in (phases, fused):  # a step without length: clocks differ by the one that followed the end
        solver.set_target(solver.time)
    phases.step()
    assert difference(phases, fused) < ROUND_OFF["float64"]
    assert fused.energies()["KE_grid"] == pytest.approx(phases.energies()["KE_grid"], rel=1e-12)


def test_faults_stop_a_fused_run():
    _, fused = pair(body_of(*SCENES["column"]))
    v = fused.v.numpy().copy()
    v[7] = np.nan
    fused.v.assign(v)
    with pytest.raises(NumericalError, match=r"point \d+: its velocity is not finite"):
        fused.advance_to(1.0)
    before = fused.steps
    fused._take(20)
    assert fused.steps == before

    _, fused = pair(body_of(*SCENES["column"]))
    x, clock = fused.x.numpy().copy(), fused.clock.numpy().copy()
    x[7, 2], clock[K.TRAVEL] = 1e30, 0.9 * fused.setup.margin  # the stored nodes must follow a point that has none
    fused.x.assign(x)
    fused.clock.assign(clock)
    with pytest.raises(NumericalError, match="point 7: it has left the stored grid"):
        fused.advance_to(1.0)

    name, settings = SCENES["column"]
    fast = ExplicitSolver(body_of(name, (*settings, "explicit.time_step=0.00158")), fused=True)  # h/c = 1.595 ms
    with pytest.raises(StepRefused):
        fast.advance_to(0.5)


def test_a_step_is_four_launches():
    _, fused = pair(body_of(*SCENES["ramped"]))
    assert [launch.block_dim for launch in fused.fused_step.phases] == [32] * 4
    assert set(time_phases(fused, 2)) == {"update_nodes", "g2p2g", "strain_to_nodes", "stress_to_nodes"}


# The comparison above would see what a fused step can get wrong.


def test_a_dropped_node_is_caught():
    """What one node of some thousand was handed is lost, in one step of a hundred."""
    phases, fused = pair(body_of(*SCENES["column"]))
    march(phases)
    lost = int(np.flatnonzero(phases.node_momentum.numpy()[:, 0])[100])
    march(fused, 80)
    fused.fit_grid()
    fused.fused_step.start()
    for launch in fused.fused_step.phases:
        launch.launch()
        if "g2p2g" in launch.kernel.key:
            mapped = fused.node_mapped.numpy()
            assert np.abs(mapped[lost, :3]).max() > 0
            mapped[lost, :3] = 0.0
    fused.fused_step.finish()
    for _ in range(19):
        fused.step()
    assert phases.steps == fused.steps
    assert difference(phases, fused) > 1e3 * ROUND_OFF["float64"]


def test_a_race_is_caught():
    """The plan of the next step in the clock of this one: the first thread writes what the others read."""
    phases, fused = pair(body_of(*SCENES["column"]))
    fused.plan = fused.clock
    fused._record_step()
    march(phases, 20)
    march(fused, 20)
    assert difference(phases, fused) > 1e3 * ROUND_OFF["float64"]
