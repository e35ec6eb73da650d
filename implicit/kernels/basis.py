"""The points' view of the lattice for one step: which nodes, with what weights and slopes.

The basis is that of the start of the step (updated Lagrangian), so it is evaluated once and every Newton
iteration reads it; the assembly does not know which basis it is.
"""

import warp as wp

from implicit.kernels.layout import BASIS, NAME, OUTSIDE, mat33, real, vec3

stencil = BASIS.stencil
# A third node's slope, in 1/h, and a node's weight below which they are round-off of a domain that ends on a node. The
# weight is quadratic in the overlap, the slope linear.
NO_SLOPE, NO_WEIGHT = wp.constant(real(1e-9)), wp.constant(real(1e-18))


@wp.func(module=NAME)
def reached(ds: vec3, inv_cell: real):
    """How many of an axis' three nodes the point sees: the third has no slope unless the domain reaches over."""
    if ds[2] > NO_SLOPE * inv_cell:
        return 3
    return 2


@wp.kernel(module=NAME)
def evaluate_basis(
    x: wp.array(dtype=vec3),
    inv_cell: real,
    base: wp.array(dtype=wp.vec3i),
    reach: wp.array(dtype=wp.vec3i),
    weight: wp.array(dtype=mat33),
    slope: wp.array(dtype=mat33),
):
    """First node of each point's stencil, nodes seen per axis, weights [-] and slopes [1/m] (row: axis)."""
    p = wp.tid()
    i, j, k, sx, sy, sz, dx, dy, dz = stencil(x[p], inv_cell)
    base[p] = wp.vec3i(i, j, k)
    reach[p] = wp.vec3i(reached(dx, inv_cell), reached(dy, inv_cell), reached(dz, inv_cell))
    weight[p] = wp.matrix_from_rows(sx, sy, sz)
    slope[p] = wp.matrix_from_rows(dx, dy, dz)


@wp.kernel(module=NAME)
def mark_active(
    base: wp.array(dtype=wp.vec3i),
    reach: wp.array(dtype=wp.vec3i),
    weight: wp.array(dtype=mat33),
    corner: wp.vec3i,
    touched: wp.array3d(dtype=wp.int32),
):
    """Mark the nodes of a window, from node `corner` on, that some point sees by more than round-off."""
    p = wp.tid()
    at, count, s = base[p] - corner, reach[p], weight[p]
    sx, sy, sz = s[0], s[1], s[2]
    for a in range(count[0]):
        for b in range(count[1]):
            for c in range(count[2]):
                if sx[a] * sy[b] * sz[c] > NO_WEIGHT:
                    touched[at[0] + a, at[1] + b, at[2] + c] = 1


@wp.kernel(module=NAME)
def look_up(
    base: wp.array(dtype=wp.vec3i),
    corner: wp.vec3i,
    number: wp.array3d(dtype=wp.int32),
    nodes: wp.array2d(dtype=wp.int32),
):
    """Numbers of the nodes of each point's stencil, OUTSIDE where a node is not solved for."""
    p = wp.tid()
    at = base[p] - corner
    for a in range(3):
        for b in range(3):
            for c in range(3):
                i, j, k = at[0] + a, at[1] + b, at[2] + c
                n = OUTSIDE
                if i < number.shape[0] and j < number.shape[1] and k < number.shape[2]:
                    n = number[i, j, k]
                nodes[p, 9 * a + 3 * b + c] = n


@wp.kernel(module=NAME)
def mark_neighbours(
    nodes: wp.array2d(dtype=wp.int32),
    reach: wp.array(dtype=wp.vec3i),
    coupled: wp.array2d(dtype=wp.int32),
):
    """Mark which of a node's 125 neighbours (offset -2..2 per axis) share a point with it."""
    p = wp.tid()
    count = reach[p]
    for a in range(count[0]):
        for b in range(count[1]):
            for c in range(count[2]):
                row = nodes[p, 9 * a + 3 * b + c]
                if row != OUTSIDE:
                    for d in range(count[0]):
                        for e in range(count[1]):
                            for f in range(count[2]):
                                if nodes[p, 9 * d + 3 * e + f] != OUTSIDE:
                                    coupled[row, 25 * (d - a + 2) + 5 * (e - b + 2) + f - c + 2] = 1


@wp.kernel(module=NAME)
def weights_by_rows(
    nodes: wp.array2d(dtype=wp.int32),
    reach: wp.array(dtype=wp.vec3i),
    weight: wp.array(dtype=mat33),
    start: wp.array(dtype=wp.int32),
    column: wp.array(dtype=wp.int32),
    value: wp.array(dtype=real),
):
    """N in compressed rows, a row a point, from `start` on; nodes OUTSIDE leave a zero in column 0."""
    p = wp.tid()
    s, count = weight[p], reach[p]
    sx, sy, sz = s[0], s[1], s[2]
    at = start[p]
    for a in range(count[0]):
        for b in range(count[1]):
            for c in range(count[2]):
                n = nodes[p, 9 * a + 3 * b + c]
                if n > OUTSIDE:
                    column[at] = n
                    value[at] = sx[a] * sy[b] * sz[c]
                at += 1
