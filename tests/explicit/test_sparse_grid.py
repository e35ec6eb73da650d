"""Sparse grid storage: every stencil finds its nodes, and storage follows the material."""

import numpy as np
import pytest
import warp as wp

from explicit.kernels.layout import layout
from explicit.solver import ExplicitSolver
from explicit.sparse_grid import SparseGrid
from mpm.body import build
from mpm.devices import start_warp
from mpm.load import load_scene

start_warp()
CELL = 0.05
VEC3 = layout(wp.float64).vec3


def grid_for(x):
    grid = SparseGrid(wp.float64, CELL, wp.get_device("cpu"))
    grid.follow(wp.array(x, dtype=VEC3, device="cpu"))
    return grid


def stencil_nodes(x):
    """All (i, j, k) that points `x` reach."""
    base = np.floor(x / CELL - 0.25).astype(int)
    steps = np.stack(np.meshgrid(*[np.arange(3)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    return np.unique((base[:, None] + steps).reshape(-1, 3), axis=0)


def stored_nodes(grid):
    """All (i, j, k) that the grid stores, in storage order."""
    base, pencil = grid.base.numpy(), grid.pencil_of.numpy()[: grid.stored]
    i, j = np.divmod(pencil, base.shape[1])
    return np.stack([i + grid.i0, j + grid.j0, np.arange(grid.stored) - base[i, j]], axis=1)


@pytest.mark.parametrize("seed", range(4))
def test_each_node_a_point_reaches_is_stored_once_with_a_cell_to_spare(seed):
    rng = np.random.default_rng(seed)
    x = np.concatenate([rng.uniform(-0.4, 0.9, (300, 3)), rng.normal(0, 3.0, (20, 3))])
    nodes = stored_nodes(grid_for(x))
    stored = set(map(tuple, nodes))
    assert len(stored) == len(nodes)
    moved = x + rng.uniform(-CELL, CELL, x.shape)  # as far as points may go before the grid follows
    assert set(map(tuple, stencil_nodes(moved))) <= stored
    assert set(map(tuple, stencil_nodes(x))) <= stored


def test_storage_follows_the_material_not_the_box_around_it():
    """Two clusters cost twice one cluster, however far apart they fly."""
    cluster = np.random.default_rng(0).uniform(0.0, 0.5, (500, 3))
    one = grid_for(cluster).stored
    for distance in (2.0, 20.0):
        far = cluster + np.array([distance, 0.0, 0.0])
        assert grid_for(np.concatenate([cluster, far])).stored == 2 * one


def test_grid_follows_points_that_leave_the_window():
    grid = grid_for(np.zeros((1, 3)) + 0.3)
    x = np.array([[-7.1, 3.2, 11.0]])
    assert grid.follow(wp.array(x, dtype=VEC3, device="cpu"))
    assert set(map(tuple, stencil_nodes(x))) <= set(map(tuple, stored_nodes(grid)))
    assert grid.stored < 200


def test_a_full_column_takes_no_more_than_four_times_its_quarter():
    scenes = (load_scene("column_small", [f"geometry.symmetry='{part}'"]) for part in ("quarter", "full"))
    quarter, full = (ExplicitSolver(build(scene), "cpu") for scene in scenes)
    assert full.points == 4 * quarter.points
    assert full.grid.stored <= 4 * quarter.grid.stored
    assert full.bytes <= 4 * quarter.bytes
