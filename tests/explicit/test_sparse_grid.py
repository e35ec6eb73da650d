"""Sparse grid storage: every stencil finds its nodes, and storage follows the material."""

import numpy as np
import pytest
import warp as wp

from explicit.kernels import layout as K
from explicit.solver import ExplicitSolver
from explicit.sparse_grid import SparseGrid
from mpm.body import build
from mpm.devices import start_warp
from mpm.load import load_scene

start_warp()
CELL = 0.05
VEC3 = K.layout(wp.float64).vec3


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


def clock_after_fit(grid, x):
    """The distance travelled that a fit without the host leaves: `grid` has room for points `x`, or the host must
    make some."""
    clock = wp.full(K.CLOCK_SIZE, 0.7, dtype=wp.float64, device="cpu")
    grid.fit(wp.array(x, dtype=VEC3, device="cpu"))
    grid.reset_travel(clock)
    return clock.numpy()[K.TRAVEL]


def test_a_fit_without_the_host_stores_what_one_with_it_does():
    x = np.random.default_rng(5).uniform(-0.4, 0.9, (300, 3))
    grid, moved = grid_for(x), x + 0.3 * CELL
    assert clock_after_fit(grid, moved) == 0.0
    assert set(map(tuple, stored_nodes(grid))) == set(map(tuple, stored_nodes(grid_for(moved))))
    assert len(set(map(tuple, stored_nodes(grid)))) == grid.stored <= grid.most_stored


FAR = np.array([[20 * CELL, 0.0, 0.0]])  # beyond the window
SPREAD = np.random.default_rng(6).uniform(0.0, 0.9, (300, 3))  # within it, but more nodes than there is room for


@pytest.mark.parametrize("moved", [FAR, SPREAD], ids=["window", "nodes"])
def test_where_there_is_no_room_a_fit_leaves_the_stored_nodes_as_they_are(moved):
    x = np.random.default_rng(5).uniform(0.0, 0.3, (300, 3))
    x[0] = 0.45  # the window reaches on to 0.9
    grid = grid_for(x)
    before, most = stored_nodes(grid), grid.most_stored
    moved = x + FAR if moved is FAR else moved
    assert clock_after_fit(grid, moved) == K.OUT_OF_NODES
    base, pencil = grid.base.numpy(), grid.pencil_of.numpy()[:most]
    i, j = np.divmod(pencil, base.shape[1])
    np.testing.assert_array_equal(np.arange(most) - base[i, j], before[:, 2])
    assert grid.most_stored == most
    assert grid.follow(wp.array(moved, dtype=VEC3, device="cpu"))
    assert set(map(tuple, stencil_nodes(moved))) <= set(map(tuple, stored_nodes(grid)))


def test_a_full_column_takes_no_more_than_four_times_its_quarter():
    scenes = (load_scene("column_small", [f"geometry.symmetry='{part}'"]) for part in ("quarter", "full"))
    quarter, full = (ExplicitSolver(build(scene), "cpu") for scene in scenes)
    assert full.points == 4 * quarter.points
    assert full.grid.stored <= 4 * quarter.grid.stored
    assert full.bytes <= 4 * quarter.bytes
