"""Points in the order of the cells that their stencils start in, for work that neighbours share (`explicit.fused`)."""

import functools
from types import SimpleNamespace

import warp as wp

from explicit.kernels.layout import layout
from mpm.devices import KERNEL_OPTIONS
from mpm.gimp import gimp


@functools.cache
def order_kernels(real):
    """Return the kernels for `real` (wp.float32 or wp.float64).

    They are in a Warp module of their own, which runs on a CPU do not compile.
    """
    types = layout(real)
    name = f"repose_order_{real.__name__}"
    wp.set_module_options(KERNEL_OPTIONS, module=wp.get_module(name))
    Points, Pencils, node_of, vec3 = types.Points, types.Pencils, types.node_of, types.vec3
    base = gimp(real).base

    @wp.kernel(module=name)
    def number_cells(
        x: wp.array(dtype=vec3),
        inv_cell: real,
        pencils: Pencils,
        cell_of: wp.array(dtype=wp.int32),
        order: wp.array(dtype=wp.int32),
    ):
        """What points are sorted by, the first node of their stencil; and their numbers, to be sorted with it. Points
        beyond the stored pencils, for which the host must make room first, count to those at the rim."""
        p = wp.tid()
        at = x[p]
        i = wp.clamp(base(at[0], inv_cell), pencils.i0, pencils.i0 + pencils.base.shape[0] - 1)
        j = wp.clamp(base(at[1], inv_cell), pencils.j0, pencils.j0 + pencils.base.shape[1] - 1)
        cell_of[p] = node_of(pencils, i, j, base(at[2], inv_cell))
        order[p] = p

    @wp.func(module=name)
    def copy_point(of: Points, p: int, to: Points, q: int):
        """Point `p` of `of` becomes point `q` of `to`."""
        to.x[q] = of.x[p]
        if to.lost.shape[0] > 0:
            to.lost[q] = of.lost[p]
        to.v[q] = of.v[p]
        to.carry[q] = of.carry[p]
        to.tau[q] = of.tau[p]
        to.theta[q] = of.theta[p]
        if to.dilated.shape[0] > 0:
            to.dilated[q] = of.dilated[p]
        if to.law_state.shape[0] > 0:
            to.law_state[q] = of.law_state[p]

    @wp.kernel(module=name)
    def take_points(order: wp.array(dtype=wp.int32), body: Points, by_cell: Points):
        """The body's points, in the order of cells."""
        q = wp.tid()
        copy_point(body, order[q], by_cell, q)

    @wp.kernel(module=name)
    def put_back(order: wp.array(dtype=wp.int32), by_cell: Points, body: Points):
        """Points in the order of cells, back to their places in the body."""
        q = wp.tid()
        copy_point(by_cell, q, body, order[q])

    return SimpleNamespace(number_cells=number_cells, take_points=take_points, put_back=put_back)
