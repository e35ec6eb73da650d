"""A history row that the device finds by itself says what NumPy finds of the same points."""

import numpy as np
import pytest
import warp as wp

from explicit.solver import ExplicitSolver
from mpm.body import build
from mpm.devices import start_warp
from mpm.load import load_scene
from mpm.seed import seed
from mpm.watch import look

start_warp()

ROUND_OFF = {"float64": 1e-14, "float32": 2e-7}
BOX = "geometry.walls={x_min='roller', x_max='fixed', y_min='free', y_max='roller', z_min='roller'}"
GEOSTATIC = ("loads.initial_stress=geostatic", "material.dilatancy_angle=10.0")


@pytest.fixture(autouse=True)
def blocks(monkeypatch):
    """Kernels that ask for blocks of threads get them: 32 fibers a block."""
    monkeypatch.setattr(wp.config, "enable_cpu_blocks", True)


def solver_at(scene, settings, precision, place=lambda x: x):
    """A solver that looks at its points on the device, which are where `place` puts the seeds of a scene."""
    scene = load_scene(scene, ["grid.cell=0.25", *settings, f"explicit.precision={precision}"])
    seeds = seed(scene.geometry, scene.grid.cell)
    return ExplicitSolver(build(scene, seeds._replace(x=place(seeds.x))), fused=True)


def scattered(x):
    return x + np.random.default_rng(1).uniform(-0.05, 0.05, x.shape)


def below_the_base(x):
    x = scattered(x)
    x[17, 2] = -0.1
    return x


def beyond_a_side(x):
    x = scattered(x)
    x[40, 0] = x[:, 0].max() + 0.3
    return x


def one_far_off(x):
    return np.vstack([scattered(x), [[5.0, -7.0, 2.0]]])


PLACES = {
    "lattice, of equal distances and heights": ("column_small", (), lambda x: x),
    "column": ("column_small", (), scattered),
    "below the base": ("column_small", (), below_the_base),
    "detached point": ("column_small", (), one_far_off),
    "one point": ("column_small", (), lambda x: x[:1]),
    "two points": ("column_small", (), lambda x: x[3:5]),
    "all in one place": ("column_small", (), lambda x: 0 * x + 0.3),
    "box beyond its walls": ("self_weight", (BOX,), beyond_a_side),
    "strained from the start": ("column_small", GEOSTATIC, scattered),
}


@pytest.mark.parametrize("precision", ROUND_OFF)
@pytest.mark.parametrize("place", PLACES)
def test_the_device_sees_what_numpy_sees(place, precision):
    scene, settings, moved = PLACES[place]
    solver = solver_at(scene, settings, precision, moved)
    rng = np.random.default_rng(2)
    for array in (solver.theta, solver.dilated):
        array.assign(array.numpy() + rng.uniform(-0.1, 0.1, array.shape).astype(array.numpy().dtype))
    found, right = solver.look(), look(solver.x.numpy(), solver.volume_ratio, solver.body)
    assert found.front == pytest.approx(right.front, rel=ROUND_OFF[precision], abs=ROUND_OFF[precision])
    assert found.volume_ratio == pytest.approx(right.volume_ratio, rel=10 * ROUND_OFF[precision])
    assert (found.beyond.cells, found.beyond.point) == (right.beyond.cells, right.beyond.point)
    np.testing.assert_array_equal(found.beyond.x, right.beyond.x)


def test_known_figures_of_four_points():
    """Distances 3, 4, 5 and 13 m: 99.5 % of the way from the first to the last is 0.985 of that from 5 to 13."""
    x = np.array([[5.0, 12.0, 0.5], [3.0, 0.0, 0.25], [0.0, 4.0, 0.75], [3.0, 4.0, -0.5]])
    solver = solver_at("column_small", (), "float64", lambda _: x)
    measure, seen = solver.body.measure, solver.look()
    assert seen.front["R_995"] == pytest.approx(measure.runout(5.0 + 0.985 * 8.0), rel=1e-14)
    assert seen.front["R_max"] == pytest.approx(measure.runout(13.0 + 0.0625), rel=1e-14)
    assert seen.front["height"] == 0.8125
    assert (seen.beyond.point, seen.beyond.cells) == (3, 2.0)


def test_the_host_reads_once_a_row_and_no_more_of_a_larger_body(monkeypatch):
    as_numpy, sizes = wp.array.numpy, []
    for cell in (0.25, 0.125):
        solver = solver_at("column_small", (f"grid.cell={cell}",), "float64")
        solver.observe()
        with monkeypatch.context() as watched:
            watched.setattr(wp.array, "numpy", lambda array: sizes.append(array.size) or as_numpy(array))
            solver.observe()
    assert len(sizes) == 2
    assert sizes[0] == sizes[1] == solver.figures.array.size


def test_energies_and_look_are_those_of_the_row():
    solver = solver_at("column_small", (), "float64")
    solver.advance_to(0.1)
    energies, seen = solver.observe()
    assert energies == solver.energies()
    assert energies["KE_points"] > 0
    assert solver.look().front == seen.front


def test_a_run_that_looks_on_the_host_keeps_nothing_for_a_device():
    body = solver_at("column_small", (), "float32").body
    phases, fused = ExplicitSolver(body), ExplicitSolver(body, fused=True)
    assert phases.device_look is None
    assert phases.figures.array.size == phases.figures.size
    # Twice a key and a number for each point.
    arrays = fused._node_arrays()
    nodes = sum(array.capacity for array in arrays)
    assert fused.bytes - nodes - fused.grid.bytes == fused.points * (fused.bytes_per_point + 16)
