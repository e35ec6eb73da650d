"""float32 positions far from the origin move as far as they should, however slowly."""

import numpy as np
import pytest
import warp as wp

from explicit.run import ExplicitRun, solver_of
from explicit.solver import ExplicitSolver
from mpm.body import build
from mpm.devices import start_warp
from mpm.load import load_scene
from mpm.results import Results
from mpm.seed import seed

start_warp()

CELL = 0.25
FREE = "geometry.walls={x_min='free', y_min='free', z_min='free'}"
SETTINGS = ["geometry.size=[0.5,0.5,0.5]", f"grid.cell={CELL}", FREE, "loads.gravity=0.0", "explicit.damping=0.0",
            "explicit.until=1.0", "output.history_every=1.0"]  # fmt: skip


def drifting(precision, fused=False) -> tuple[ExplicitSolver, np.ndarray]:
    """A free block 100 cells from the origin along each axis, with 1e-5 c along each, and its velocity (3,) [m/s]."""
    scene = load_scene("self_weight", [*SETTINGS, f"explicit.precision={precision}"])
    seeds = seed(scene.geometry, CELL)
    solver = ExplicitSolver(
        build(scene, seeds._replace(x=seeds.x + np.array([100.0, -100.0, 100.0]) * CELL)), fused=fused
    )
    velocity = 1e-5 * solver.setup.wave * np.array([1.0, 1.0, -1.0])
    solver.v.assign(np.tile(velocity, (solver.points, 1)).astype(solver.v.numpy().dtype))
    solver.set_target(1e9)
    return solver, velocity


@pytest.mark.parametrize("fused", [False, True], ids=["phases", "fused"])
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_a_slow_body_far_from_the_origin_moves_as_far_as_it_should(precision, fused, monkeypatch):
    monkeypatch.setattr(wp.config, "enable_cpu_blocks", True)
    solver, velocity = drifting(precision, fused)
    start = solver.x.numpy().astype(float)
    for _ in range(10):
        solver._take(100)
    solver.dials.forget()
    assert solver.steps == 1000
    gone = solver.x.numpy().astype(float) - start
    right = velocity * solver.time
    assert np.abs(right[0]) < 1e-2 * CELL
    np.testing.assert_allclose(gone, np.broadcast_to(right, gone.shape), rtol=1e-2)


def test_only_float32_keeps_what_it_loses():
    single, double = drifting("float32")[0], drifting("float64")[0]
    assert single.lost.shape == (single.points,)
    assert double.lost.shape == (0,)


def test_a_restart_goes_on_with_what_was_lost():
    one, _ = drifting("float32")
    one._take(50)
    assert np.abs(one.lost.numpy()).max() > 0
    other, _ = drifting("float32")
    other.restore(one.state())
    one.fit_grid()
    for solver in (one, other):
        solver._take(50)
    for name in ("x", "lost", "v"):
        np.testing.assert_array_equal(getattr(other, name).numpy(), getattr(one, name).numpy())


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_a_checkpoint_of_an_earlier_version_is_taken_over(tmp_path, precision):
    """It has no such array: its points start anew with nothing lost."""
    scene = load_scene("column_1", ["grid.cell=0.25", f"explicit.precision={precision}"])
    results = Results.create(tmp_path / "run", scene, {"device": "cpu", "device_name": "-"})
    body = build(scene)
    run = ExplicitRun(body, results, solver_of(body, "cpu"))
    run.begin()
    state = results.read_checkpoint()
    del state["lost"]
    run.restore(state)
    assert not run.solver.lost.numpy().any()
