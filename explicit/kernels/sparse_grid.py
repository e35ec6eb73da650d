"""Warp kernels that find which grid nodes the material needs: one run of nodes along z per (i, j)."""

import functools
from types import SimpleNamespace

import warp as wp

from explicit.kernels.layout import DT, OFF_GRID, OUT_OF_NODES, TRAVEL, layout
from mpm.gimp import HALF_LENGTH_IN_CELLS, NODES_PER_AXIS, gimp

MARGIN = 1  # cells that a point may travel before the stored nodes must be found anew
EMPTY = 2**30
# found: of the points the smallest and largest first stencil nodes along x and y; how many nodes they need, whether
# there is room for these, and the most that were stored so far
I_MIN, J_MIN, I_MAX, J_MAX, NODES, SHORT, MOST_NODES = range(7)
FOUND_SIZE = 7
FITS, WINDOW_SHORT, NODES_SHORT = range(3)
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
    def clear_fit(low: wp.array2d(dtype=wp.int32), high: wp.array2d(dtype=wp.int32), found: wp.array(dtype=wp.int32)):
        i, j = wp.tid()
        low[i, j] = empty
        high[i, j] = -empty
        if i == 0 and j == 0:
            for axis in range(2):
                found[I_MIN + axis] = empty
                found[I_MAX + axis] = -empty

    @wp.kernel(module=name)
    def point_spans(
        x: wp.array(dtype=vec3),
        inv_cell: real,
        i0: wp.int32,
        j0: wp.int32,
        low: wp.array2d(dtype=wp.int32),
        high: wp.array2d(dtype=wp.int32),
        found: wp.array(dtype=wp.int32),
    ):
        """Smallest and largest first stencil node over all points, and the range of those along z of the points whose
        stencil starts at pencil (i, j)."""
        p = wp.tid()
        i = base_node(x[p][0], inv_cell)
        j = base_node(x[p][1], inv_cell)
        k = base_node(x[p][2], inv_cell)
        # Plain reads first: an atomic only when the point lies outside what is recorded.
        if i < found[I_MIN]:
            wp.atomic_min(found, I_MIN, i)
        if j < found[J_MIN]:
            wp.atomic_min(found, J_MIN, j)
        if i > found[I_MAX]:
            wp.atomic_max(found, I_MAX, i)
        if j > found[J_MAX]:
            wp.atomic_max(found, J_MAX, j)
        i -= i0
        j -= j0
        if i < 0 or j < 0 or i >= low.shape[0] or j >= low.shape[1]:
            return  # the window is too small, as the bounds tell
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
    def sum_rows(count: wp.array2d(dtype=wp.int32), row_nodes: wp.array(dtype=wp.int32)):
        """Nodes of the pencils of each row i."""
        i = wp.tid()
        nodes = wp.int32(0)
        for j in range(count.shape[1]):
            nodes += count[i, j]
        row_nodes[i] = nodes

    @wp.kernel(module=name)
    def place_rows(
        count: wp.array2d(dtype=wp.int32),
        row_nodes: wp.array(dtype=wp.int32),
        i0: wp.int32,
        j0: wp.int32,
        capacity: wp.int32,
        start: wp.array2d(dtype=wp.int32),
        found: wp.array(dtype=wp.int32),
    ):
        """Where each pencil's nodes start, by i, then j; how many there are, and whether there is room for all."""
        i = wp.tid()
        node = wp.int32(0)
        for before in range(i):
            node += row_nodes[before]
        for j in range(count.shape[1]):
            start[i, j] = node
            node += count[i, j]
        if i == count.shape[0] - 1:
            short = wp.int32(FITS)
            if node > capacity:
                short = NODES_SHORT
            if (
                found[I_MIN] - margin < i0
                or found[J_MIN] - margin < j0
                or found[I_MAX] + last + margin >= i0 + count.shape[0]
                or found[J_MAX] + last + margin >= j0 + count.shape[1]
            ):
                short = WINDOW_SHORT
            found[NODES] = node
            found[SHORT] = short
            if short == FITS:
                found[MOST_NODES] = wp.max(found[MOST_NODES], node)

    @wp.kernel(module=name)
    def adopt(
        new_first: wp.array2d(dtype=wp.int32),
        new_count: wp.array2d(dtype=wp.int32),
        start: wp.array2d(dtype=wp.int32),
        found: wp.array(dtype=wp.int32),
        first: wp.array2d(dtype=wp.int32),
        count: wp.array2d(dtype=wp.int32),
        base: wp.array2d(dtype=wp.int32),
        pencil_of: wp.array(dtype=wp.int32),
    ):
        """Where there is room for them, take the new pencils in place of the old ones: node k of a pencil is its base +
        k, and knows its pencil (i * window + j)."""
        i, j = wp.tid()
        if found[SHORT] == FITS:
            first[i, j] = new_first[i, j]
            count[i, j] = new_count[i, j]
            base[i, j] = start[i, j] - new_first[i, j]
            for n in range(start[i, j], start[i, j] + new_count[i, j]):
                pencil_of[n] = i * count.shape[1] + j

    @wp.kernel(module=name)
    def reset_travel(found: wp.array(dtype=wp.int32), clock: wp.array(dtype=wp.float64)):
        """The stored nodes fit the points as they are now; or they do not, and no step is taken until they do."""
        clock[TRAVEL] = wp.float64(0.0)
        if found[SHORT] != FITS:
            clock[TRAVEL] = wp.float64(OUT_OF_NODES)
        clock[DT] = wp.float64(0.0)

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
        clear_fit=clear_fit,
        point_spans=point_spans,
        widen_spans=widen_spans,
        sum_rows=sum_rows,
        place_rows=place_rows,
        adopt=adopt,
        reset_travel=reset_travel,
        find_strays=find_strays,
    )
