"""Warp kernels that find which grid nodes the material needs: one run of nodes along z per (i, j)."""

import functools
from types import SimpleNamespace

import warp as wp

from explicit.kernels.layout import OFF_GRID, layout
from mpm.gimp import HALF_LENGTH_IN_CELLS, NODES_PER_AXIS, gimp

MARGIN = 1  # cells that a point may travel before the stored nodes must be found anew
EMPTY = 2**30
LAST = NODES_PER_AXIS - 1  # node of a stencil along an axis, counted from its first


@functools.cache
def sparse_grid_kernels(real):
    """Return the kernels for `real`; they share the Warp module of the step kernels (one compile)."""
    types = layout(real)
    name, vec3 = types.name, types.vec3
    base_node = gimp(real).base
    margin, empty, last = wp.constant(MARGIN), wp.constant(EMPTY), wp.constant(LAST)
    half_length = wp.constant(real(HALF_LENGTH_IN_CELLS))

    @wp.kernel(module=name)
    def plan_bounds(x: wp.array(dtype=vec3), inv_cell: real, bounds: wp.array(dtype=wp.int32)):
        """Smallest and largest first stencil node over all points: (i_min, j_min, i_max, j_max)."""
        p = wp.tid()
        i = base_node(x[p][0], inv_cell)
        j = base_node(x[p][1], inv_cell)
        # Plain reads first: an atomic only when the point lies outside what is recorded.
        if i < bounds[0]:
            wp.atomic_min(bounds, 0, i)
        if j < bounds[1]:
            wp.atomic_min(bounds, 1, j)
        if i > bounds[2]:
            wp.atomic_max(bounds, 2, i)
        if j > bounds[3]:
            wp.atomic_max(bounds, 3, j)

    @wp.kernel(module=name)
    def clear_spans(low: wp.array2d(dtype=wp.int32), high: wp.array2d(dtype=wp.int32)):
        i, j = wp.tid()
        low[i, j] = empty
        high[i, j] = -empty

    @wp.kernel(module=name)
    def point_spans(
        x: wp.array(dtype=vec3),
        inv_cell: real,
        i0: wp.int32,
        j0: wp.int32,
        low: wp.array2d(dtype=wp.int32),
        high: wp.array2d(dtype=wp.int32),
    ):
        """Range of first stencil nodes along z of the points whose stencil starts at pencil (i, j)."""
        p = wp.tid()
        i = base_node(x[p][0], inv_cell) - i0
        j = base_node(x[p][1], inv_cell) - j0
        k = base_node(x[p][2], inv_cell)
        if i < 0 or j < 0 or i >= low.shape[0] or j >= low.shape[1]:
            return  # the window is too small, which `plan_bounds` has found as well
        if k < low[i, j]:
            wp.atomic_min(low, i, j, k)
        if k > high[i, j]:
            wp.atomic_max(high, i, j, k)

    @wp.kernel(module=name)
    def widen_spans(
        low: wp.array2d(dtype=wp.int32),
        high: wp.array2d(dtype=wp.int32),
        first: wp.array2d(dtype=wp.int32),
        count: wp.array2d(dtype=wp.int32),
    ):
        """Nodes of each pencil that a stencil can reach while points travel less than the margin."""
        i, j = wp.tid()
        bottom = int(empty)
        top = -int(empty)
        for a in range(i - last - margin, i + margin + 1):
            for b in range(j - last - margin, j + margin + 1):
                if a >= 0 and b >= 0 and a < low.shape[0] and b < low.shape[1]:
                    bottom = wp.min(bottom, low[a, b])
                    top = wp.max(top, high[a, b])
        first[i, j] = bottom - margin
        count[i, j] = wp.max(top - bottom + 1 + last + 2 * margin, 0)

    @wp.kernel(module=name)
    def shift_base(
        first: wp.array2d(dtype=wp.int32),
        count: wp.array2d(dtype=wp.int32),
        base: wp.array2d(dtype=wp.int32),
        found: wp.array(dtype=wp.int32),
    ):
        """From "index of the pencil's first node" to "index of its node k = 0", so that node k is base + k; how many
        nodes there are, behind the four bounds in `found`."""
        i, j = wp.tid()
        if i == base.shape[0] - 1 and j == base.shape[1] - 1:
            found[4] = base[i, j] + count[i, j]
        base[i, j] = base[i, j] - first[i, j]

    @wp.kernel(module=name)
    def label_nodes(
        first: wp.array2d(dtype=wp.int32),
        count: wp.array2d(dtype=wp.int32),
        base: wp.array2d(dtype=wp.int32),
        pencil_of: wp.array(dtype=wp.int32),
    ):
        """Which pencil (i * window + j) each stored node belongs to."""
        i, j = wp.tid()
        start = base[i, j] + first[i, j]
        for n in range(start, start + count[i, j]):
            pencil_of[n] = i * count.shape[1] + j

    @wp.kernel(module=name)
    def find_strays(
        x: wp.array(dtype=vec3),
        inv_cell: real,
        i0: wp.int32,
        j0: wp.int32,
        first: wp.array2d(dtype=wp.int32),
        count: wp.array2d(dtype=wp.int32),
        slack: wp.int32,
        fault: wp.array(dtype=wp.int32),
    ):
        """Report a point whose stencil is not stored; with `slack` [cells], only one farther out of the window."""
        p = wp.tid()
        start = inv_cell * x[p] - vec3(half_length, half_length, half_length)
        stored = wp.int32(0)
        # In real numbers first: what is not finite, or large, has no index. Comparisons with NaN are false.
        if (
            start[0] >= real(i0 - slack)
            and start[1] >= real(j0 - slack)
            and start[0] < real(i0 + count.shape[0] - last + slack)
            and start[1] < real(j0 + count.shape[1] - last + slack)
            and wp.abs(start[2]) < real(empty)
        ):
            if slack > 0:
                return
            i = base_node(x[p][0], inv_cell) - i0
            j = base_node(x[p][1], inv_cell) - j0
            k = base_node(x[p][2], inv_cell)
            for a in range(i, i + last + 1):
                for b in range(j, j + last + 1):
                    if k >= first[a, b] and k + last < first[a, b] + count[a, b]:
                        stored += 1
        if stored < (last + 1) * (last + 1):
            wp.atomic_max(fault, OFF_GRID, p + 1)

    return SimpleNamespace(
        find_strays=find_strays,
        plan_bounds=plan_bounds,
        clear_spans=clear_spans,
        point_spans=point_spans,
        widen_spans=widen_spans,
        shift_base=shift_base,
        label_nodes=label_nodes,
    )
