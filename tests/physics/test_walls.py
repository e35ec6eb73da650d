"""Walls hold: the rough base, the planes of symmetry and the paper's far walls."""

from dataclasses import replace

import numpy as np
import pytest

from explicit.solver import ExplicitSolver
from mpm.body import build
from mpm.devices import start_warp
from mpm.load import load_scene
from mpm.walls import FIXED, FREE, NOWHERE, ROLLER, TANGENTIAL, Walls

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
    i, j, k = node_indices(solver).T
    velocity = velocity[: len(i)]
    assert np.all(velocity[k <= 0] == 0.0)
    assert np.all(velocity[i <= 0, 0] == 0.0)
    assert np.all(velocity[j <= 0, 1] == 0.0)
    assert np.abs(velocity[k > 0]).max() > 0.0


def node_indices(solver):
    """Lattice indices (n, 3) of the stored nodes."""
    base, pencil = solver.grid.base.numpy(), solver.grid.pencil_of.numpy()[: solver.grid.stored]
    i, j = np.divmod(pencil, base.shape[1])
    return np.stack([i + solver.grid.i0, j + solver.grid.j0, np.arange(len(pencil)) - base[i, j]], axis=1)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize(
    ("kind", "normal", "tangential"),
    [(FREE, False, False), (ROLLER, True, False), (FIXED, True, True), (TANGENTIAL, False, True)],
)
def test_a_wall_holds_the_components_of_its_kind(axis, kind, normal, tangential):
    """Beyond its plane as on it, and no others; the last kind is no scene's, and needs nothing of the kernels."""
    start_warp()
    overrides = ["geometry.size=[0.5, 0.5, 0.5]", "grid.cell=0.125", "geometry.walls={z_min='free'}"]
    body = build(load_scene("self_weight", overrides))
    plane, kinds = np.full(3, -NOWHERE), np.full(3, FREE)
    plane[axis], kinds[axis] = 1, kind
    walls = Walls(tuple(plane), body.walls.high, tuple(kinds), body.walls.high_kind)
    solver = ExplicitSolver(replace(body, walls=walls))
    solver.v.assign(np.random.default_rng(0).uniform(0.5, 1.0, (solver.points, 3)))
    solver.set_target(1.0)
    solver.step()
    nodes = node_indices(solver)
    with_mass = solver.node_momentum.numpy()[: len(nodes), 0] > 0
    still = solver.node_mapped.numpy()[: len(nodes), :3] == 0.0
    for held_side in (True, False):
        side = with_mass & ((nodes[:, axis] <= 1) == held_side)
        across = np.arange(3) == axis
        expected = np.where(across, normal, tangential) & held_side
        assert side.sum() > 20 and np.all(still[side] == expected)


def test_where_walls_meet_each_holds_its_own():
    """On an edge of two rollers both normal components are held; a fixed wall holds all beside any other."""
    start_warp()
    walls = "geometry.walls={x_min='roller', y_min='roller', z_min='fixed'}"
    body = build(load_scene("self_weight", ["geometry.size=[0.5, 0.5, 0.5]", "grid.cell=0.125", walls]))
    solver = ExplicitSolver(body)
    solver.v.assign(np.random.default_rng(0).uniform(0.5, 1.0, (solver.points, 3)))
    solver.set_target(1.0)
    solver.step()
    nodes = node_indices(solver)
    still = solver.node_mapped.numpy()[: len(nodes), :3] == 0.0
    with_mass = solver.node_momentum.numpy()[: len(nodes), 0] > 0
    at = {tuple(node): held for node, held, there in zip(nodes, still, with_mass, strict=True) if there}
    assert at[0, 0, 2].tolist() == [True, True, False] and at[0, 2, 2].tolist() == [True, False, False]
    assert at[2, 2, 2].tolist() == [False, False, False]
    assert at[0, 0, 0].tolist() == at[2, 2, 0].tolist() == [True, True, True]
