"""Walls hold: the rough base, the planes of symmetry and the paper's far walls."""

import numpy as np

PAPER = ("grid.extent='paper'", "material.friction_angle=5.0", "explicit.damping=0.0")


def test_the_papers_far_walls_cap_the_run_out(solver_of, run_to):
    """Rollers at x, y = 4 h0 = 2 m: a slippery column reaches them and stays inside; without them it goes on."""
    reach = {}
    for extent in (PAPER[0], "grid.extent='material'"):
        solver = solver_of("column_small", extent, *PAPER[1:])
        list(run_to(solver, 1.2))
        reach[extent] = solver.x.numpy()[:, :2].max()
    assert 1.8 < reach[PAPER[0]] < 2.0 + solver.body.measure.half_length
    assert reach["grid.extent='material'"] > 2.1


def test_points_stay_within_base_and_symmetry_planes(solver_of, run_to):
    """A point may dip under a wall by less than its half-length, where the wall's nodes no longer bear it fully."""
    solver = solver_of("column_small", "explicit.damping=0.05")
    list(run_to(solver, 1.5))
    assert solver.x.numpy().min() > -solver.body.measure.half_length
    velocity = solver.node_mapped.numpy()
    base, pencil = solver.grid.base.numpy(), solver.grid.pencil_of.numpy()
    i, j = np.divmod(pencil, base.shape[1])
    k = np.arange(len(pencil)) - base[i, j]
    stored = np.arange(len(pencil)) < solver.grid.stored
    assert np.all(velocity[stored & (k <= 0)] == 0.0)
    assert np.all(velocity[stored & (i + solver.grid.i0 <= 0), 0] == 0.0)
    assert np.all(velocity[stored & (j + solver.grid.j0 <= 0), 1] == 0.0)
    assert np.abs(velocity[stored & (k > 0)]).max() > 0.0
