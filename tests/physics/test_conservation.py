"""Free bodies: momentum, free fall, damping and the gravity ramp have closed forms."""

import numpy as np
import pytest

FREE = "geometry.walls={z_min='free'}"
BLOCK = (FREE, "geometry.size=[0.5,0.5,0.5]", "grid.cell=0.125")
NO_GRAVITY = ("loads.gravity=0.0", "explicit.until=1.0", "output.history_every=1.0")


def shake(solver, seed=0):
    """Random velocities [m/s] for the points of a solver."""
    v = np.random.default_rng(seed).normal(0.0, 1.0, (solver.points, 3))
    solver.v.assign(v)
    return v


def test_free_body_keeps_its_momentum(solver_of, run_to):
    solver = solver_of("self_weight", *BLOCK, *NO_GRAVITY, "explicit.damping=0.0")
    before = shake(solver).sum(axis=0)
    list(run_to(solver, 0.3))
    after = solver.v.numpy().sum(axis=0)
    assert solver.steps > 300
    assert np.abs(solver.sigma).max() > 1e3  # the block did deform
    assert np.all(np.abs(after - before) < 1e-12 * solver.points)


def test_mass_on_the_grid_is_the_mass_of_the_points(solver_of, run_to):
    solver = solver_of("column_small")
    list(run_to(solver, 0.2))
    assert solver.grid_mass() == pytest.approx(solver.points * solver.body.point_mass, rel=1e-13)


def test_stress_free_block_crosses_cells_without_stress(solver_of, run_to):
    """Uniform flight over two cells: velocity exact, no stress from cell crossing."""
    solver = solver_of("self_weight", *BLOCK, *NO_GRAVITY, "explicit.damping=0.0")
    speed = np.array([2.0, -1.0, 0.5])
    solver.v.assign(np.tile(speed, (solver.points, 1)))
    list(run_to(solver, 0.125))
    assert np.abs(solver.v.numpy() - speed).max() < 1e-12
    assert np.abs(solver.sigma).max() < 1e-10 * 5.84e6
    assert np.abs(solver.x.numpy() - solver.body.x - 0.125 * speed).max() < 1e-12


@pytest.mark.parametrize(("damping", "up"), [(0.0, False), (0.3, False), (0.3, True)])
def test_local_damping_scales_free_fall(solver_of, run_to, damping, up):
    """Falling, the damping force D m g acts upwards; rising, downwards: a = -g (1 -+ D)."""
    solver = solver_of("self_weight", *BLOCK, f"explicit.damping={damping}")
    start = 5.0 if up else -0.1
    solver.v.assign(np.tile([0.0, 0.0, start], (solver.points, 1)))
    list(run_to(solver, 0.2))
    acceleration = -9.81 * (1.0 + damping if up else 1.0 - damping)
    v = solver.v.numpy()
    assert v[:, 2] == pytest.approx(start + acceleration * 0.2, rel=1e-10)
    assert np.abs(v[:, :2]).max() < 1e-10
    energies = solver.energies()
    fallen = -(solver.x.numpy() - solver.body.x)[:, 2].mean()
    weight = solver.points * solver.body.point_mass * 9.81
    assert energies["W_ext"] == pytest.approx(weight * fallen, rel=1e-9)
    assert energies["W_damping"] == pytest.approx(damping * weight * abs(fallen), rel=1e-9, abs=1e-12)


def test_gravity_ramp_in_free_fall(solver_of, run_to):
    """g grows linearly over t_ramp: v = -g t^2 / (2 t_ramp), up to the first-order time integration."""
    solver = solver_of("self_weight", *BLOCK, "loads.ramp=0.4", "explicit.damping=0.0")
    list(run_to(solver, 0.4))
    error = 9.81 * solver.time_step / 2  # left-hand sum of a linear ramp
    assert solver.v.numpy()[:, 2] == pytest.approx(-9.81 * 0.4 / 2 + error, rel=1e-3)


def test_time_step_is_the_courant_step_of_the_fastest_axis(solver_of, run_to):
    solver = solver_of("self_weight", *BLOCK, *NO_GRAVITY, "explicit.damping=0.0")
    solver.v.assign(np.tile([0.0, 0.0, 3.0], (solver.points, 1)))
    list(run_to(solver, 0.02))
    wave = np.sqrt(7.86153846e6 / 2000.0)
    assert wave == pytest.approx(62.69, abs=0.01)
    assert solver.time_step == pytest.approx(0.5 * 0.125 / (wave + 3.0), rel=1e-6)
