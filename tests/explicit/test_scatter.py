"""Sums over nodes, a lane of a warp per node, agree with NumPy's, whatever the order of the points; planted errors are
seen. Warp's block runtime runs the warps on the CPU."""

from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp

from explicit.kernels import reductions as reductions_module
from explicit.kernels import scatter as scatter_module
from explicit.kernels.layout import layout
from explicit.kernels.scatter import scatter
from explicit.kernels.warps import warps
from explicit.sparse_grid import SparseGrid
from mpm.devices import KERNEL_OPTIONS, start_warp

start_warp()
REALS = pytest.mark.parametrize("real", [wp.float32, wp.float64])
CELL, MASS, VOLUME = 0.5, 3.0, 0.02
ROUND_OFF = {wp.float32: 2e-6, wp.float64: 1e-14}  # relative to the greatest sum of an array


@pytest.fixture(autouse=True)
def blocks(monkeypatch):
    """Kernels that ask for blocks of threads get them: 32 fibers a block."""
    monkeypatch.setattr(wp.config, "enable_cpu_blocks", True)


def kernels(real, sums, module):
    """Kernels that call each of the sums `sums`, in a Warp module of that name."""
    wp.set_module_options(KERNEL_OPTIONS | {"default_grid_stride": False, "block_dim": 32}, wp.get_module(module))
    types = layout(real)
    Setup, Pencils, Points, vec3, vec4 = types.Setup, types.Pencils, types.Points, types.vec3, types.vec4
    add_point, add_momentum, add_volume = sums.add_point, sums.add_momentum, sums.add_volume
    stencil = scatter_module.gimp(real).stencil

    @wp.kernel(module=module)
    def loads(
        setup: Setup, pencils: Pencils, points: Points, count: int, m: wp.array(dtype=vec4), f: wp.array(dtype=vec4)
    ):
        thread = wp.tid()
        p = wp.min(thread, count - 1)
        x, v, tau, theta = points.x[p], points.v[p], points.tau[p], points.theta[p]
        add_point(setup, pencils, thread, count, x, v, tau, theta, m, f)

    @wp.kernel(module=module)
    def momentum(setup: Setup, pencils: Pencils, points: Points, count: int, nodes: wp.array(dtype=vec4)):
        thread = wp.tid()
        p = wp.min(thread, count - 1)
        i, j, k, sx, sy, sz, _dx, _dy, _dz = stencil(points.x[p], setup.inv_cell)
        add_momentum(pencils, thread, count, i, j, k, sx, sy, sz, vec3(setup.mass * points.v[p]), nodes)

    @wp.kernel(module=module)
    def volume(setup: Setup, pencils: Pencils, points: Points, count: int, nodes: wp.array(dtype=vec4)):
        thread = wp.tid()
        p = wp.min(thread, count - 1)
        i, j, k, sx, sy, sz, _dx, _dy, _dz = stencil(points.x[p], setup.inv_cell)
        add_volume(pencils, thread, count, i, j, k, sx, sy, sz, points.theta[p], nodes)

    return SimpleNamespace(loads=loads, momentum=momentum, volume=volume)


def basis(x):
    """First node (3,), weights (3, 3) and slopes (3, 3) [1/m], axis by axis, of a point at `x`: means of the hat and of
    its slope over the point's domain, from their antiderivatives."""
    first = np.floor(x / CELL - 0.25)
    s = x[:, None] / CELL - first[:, None] - np.arange(3)

    def area(t):
        t = np.clip(t, -1.0, 1.0)
        return np.where(t < 0, t + t**2 / 2, t - t**2 / 2)

    def hat(t):
        return np.maximum(1.0 - np.abs(t), 0.0)

    return first.astype(int), (area(s + 0.25) - area(s - 0.25)) / 0.5, (hat(s + 0.25) - hat(s - 0.25)) / (0.5 * CELL)


def expected(x, v, tau, theta, grid, nodes):
    """(m, m v), (force, m theta), (m v, 0) and (theta, 0, 0, 0) of the nodes (n, 4)."""
    base = grid.base.numpy()
    sums = np.zeros((4, nodes, 4))
    for p in range(len(x)):
        (i, j, k), s, d = basis(x[p])
        xx, yy, zz, yz, xz, xy = tau[p]
        stress = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        for a, b, c in np.ndindex(3, 3, 3):
            n = base[i + a - grid.i0, j + b - grid.j0] + k + c
            weight = s[0, a] * s[1, b] * s[2, c]
            slope = np.array([d[0, a] * s[1, b] * s[2, c], s[0, a] * d[1, b] * s[2, c], s[0, a] * s[1, b] * d[2, c]])
            sums[0, n] += weight * MASS * np.array([1.0, *v[p]])
            sums[1, n] += [*(-VOLUME * stress @ slope), weight * MASS * theta[p]]
            sums[2, n] += weight * MASS * np.array([*v[p], 0.0])
            sums[3, n, 0] += weight * theta[p]
    return sums


def together(rng):
    """Points of one cell, a warp of them and some more."""
    return 1.0 + CELL * rng.uniform(0.3, 1.2, (45, 3))


def apart(rng):
    """No two points of a warp in a cell."""
    return rng.permutation(np.argwhere(np.ones((4, 4, 4)))) * CELL + CELL * rng.uniform(0.3, 1.2, (64, 3))


def heap(rng):
    """Some in a cell."""
    return rng.uniform(0.0, 2.0, (203, 3))


def by_cell(rng):
    x = heap(rng)
    return x[np.lexsort(np.floor(x / CELL - 0.25).T)]


def on_faces(rng):
    """Some reach two nodes along an axis, where the domain ends at the third."""
    return rng.integers(0, 8, (70, 3)) * CELL / 4


def few(rng):
    return heap(rng)[:5]


def worst_difference(real, place, sums, module) -> float:
    """Greatest difference of the sums from NumPy's, each relative to the array's greatest number."""
    rng = np.random.default_rng(5)
    types, dtype = layout(real), wp.dtype_to_numpy(real)
    x, vec6 = place(rng).astype(dtype), wp.types.vector(6, real)
    v, tau, theta = (rng.normal(size=shape).astype(dtype) for shape in ((len(x), 3), (len(x), 6), len(x)))
    points, grid, setup, pencils = types.Points(), SparseGrid(real, CELL, "cpu"), types.Setup(), types.Pencils()
    points.x, points.v = (wp.array(each, dtype=types.vec3, device="cpu") for each in (x, v))
    points.tau, points.theta = wp.array(tau, dtype=vec6, device="cpu"), wp.array(theta, dtype=real, device="cpu")
    grid.follow(points.x)
    pencils.base, pencils.i0, pencils.j0 = grid.base, grid.i0, grid.j0
    setup.inv_cell, setup.mass, setup.volume = 1.0 / CELL, MASS, VOLUME
    k = kernels(real, sums, module)
    m, f, mapped, volume = (wp.zeros(grid.capacity, dtype=types.vec4, device="cpu") for _ in range(4))
    for kernel, nodes in ((k.loads, (m, f)), (k.momentum, (mapped,)), (k.volume, (volume,))):
        threads = -(-len(x) // 32) * 32
        wp.launch(kernel, threads, inputs=[setup, pencils, points, len(x), *nodes], device="cpu", block_dim=32)
    right = expected(*(each.astype(float) for each in (x, v, tau, theta)), grid, grid.capacity)
    found = [nodes.numpy() for nodes in (m, f, mapped, volume)]
    return max(np.abs(one - other).max() / np.abs(other).max() for one, other in zip(found, right, strict=True))


@REALS
@pytest.mark.parametrize("place", [together, apart, heap, by_cell, on_faces, few])
def test_sums_over_nodes(real, place):
    assert worst_difference(real, place, scatter(real), f"test_scatter_{real.__name__}") < ROUND_OFF[real]


# The comparison sees what such a sum can get wrong.


def broken(monkeypatch, **parts):
    """The sums with some of what they are made of replaced."""
    for name, part in parts.items():
        monkeypatch.setattr(scatter_module, name, lambda _real, part=part: part)
    return scatter.__wrapped__(wp.float64)


@pytest.mark.parametrize("lanes", [26, 32])
def test_a_lost_node_and_lanes_without_one_that_add_are_caught(monkeypatch, lanes):
    """26: the last node of a stencil goes without; 32: it is added by all lanes that have no node of their own."""
    monkeypatch.setattr(reductions_module, "NODES", lanes)
    sums = broken(monkeypatch, reductions=reductions_module.reductions.__wrapped__(wp.float64))
    assert worst_difference(wp.float64, heap, sums, f"test_scatter_{lanes}_lanes") > 1e-3


def test_a_lost_point_is_caught(monkeypatch):
    """The last of the 203 points."""

    @wp.func_native(
        "const int there = count - 1 - (thread & ~31); return there < 32 ? (1u << there) - 1u : 0xffffffffu;"
    )
    def one_less(count: int, thread: int) -> wp.uint32: ...

    sums = broken(monkeypatch, warps=SimpleNamespace(**vars(warps(wp.float64)) | {"lanes_below": one_less}))
    assert worst_difference(wp.float64, heap, sums, "test_scatter_lost_point") > 1e-3


def test_the_wrong_point_of_a_group_is_caught(monkeypatch):
    """The last of a group in place of each."""

    @wp.func_native("return 31 - __builtin_clz(mask);")
    def last(mask: wp.uint32) -> int: ...

    sums = broken(monkeypatch, warps=SimpleNamespace(**vars(warps(wp.float64)) | {"first": last}))
    assert worst_difference(wp.float64, heap, sums, "test_scatter_wrong_point") > 1e-3
