"""Points to nodes: mass, momentum, forces and the block rows of the tangent.

`order` (points,): forces and blocks are added cell by cell, so that the rows which a point adds to are still near.
"""

import warp as wp

from implicit.kernels.layout import NAME, OUTSIDE, SELF, mat33, real, vec3
from mpm.devices import NOT_NEGATIVE

ZERO = wp.constant(real(0.0))


@wp.kernel(module=NAME)
def p2g(
    nodes: wp.array2d(dtype=wp.int32),
    reach: wp.array(dtype=wp.vec3i),
    weight: wp.array(dtype=mat33),
    mass: real,
    v: wp.array(dtype=vec3),
    load: wp.array(dtype=vec3),
    node_mass: wp.array(dtype=real),
    node_momentum: wp.array(dtype=vec3),
    node_load: wp.array(dtype=vec3),
):
    """Lumped mass [kg], momentum [kg m/s] and external force [N] of the nodes; `load` [N] acts on a point."""
    p = wp.tid()
    s, count = weight[p], reach[p]
    sx, sy, sz = s[0], s[1], s[2]
    vp, fp = v[p], load[p]
    for a in range(count[0]):
        for b in range(count[1]):
            for c in range(count[2]):
                n = nodes[p, 9 * a + 3 * b + c]
                if n > OUTSIDE:
                    w = sx[a] * sy[b] * sz[c]
                    wp.atomic_add(node_mass, n, w * mass)
                    wp.atomic_add(node_momentum, n, (w * mass) * vp)
                    wp.atomic_add(node_load, n, w * fp)


@wp.kernel(module=NAME)
def g2p(
    nodes: wp.array2d(dtype=wp.int32),
    reach: wp.array(dtype=wp.vec3i),
    weight: wp.array(dtype=mat33),
    gained: wp.array(dtype=vec3),
    keep: real,
    v: wp.array(dtype=vec3),
):
    """FLIP: v_p = keep v_p + sum N gained, `gained` [m/s] what a node's velocity gained over what was kept."""
    p = wp.tid()
    s, count = weight[p], reach[p]
    sx, sy, sz = s[0], s[1], s[2]
    vp = keep * v[p]
    for a in range(count[0]):
        for b in range(count[1]):
            for c in range(count[2]):
                n = nodes[p, 9 * a + 3 * b + c]
                if n > OUTSIDE:
                    vp += (sx[a] * sy[b] * sz[c]) * gained[n]
    v[p] = vp


@wp.kernel(module=NAME)
def internal_force(
    order: wp.array(dtype=wp.int32),
    nodes: wp.array2d(dtype=wp.int32),
    reach: wp.array(dtype=wp.vec3i),
    weight: wp.array(dtype=mat33),
    slope: wp.array(dtype=mat33),
    flux: wp.array(dtype=mat33),
    volume: real,
    force: wp.array(dtype=vec3),
):
    """Add sum V0 (tau F^-T) grad_0 N [N] to `force`."""
    p = order[wp.tid()]
    s, ds, count = weight[p], slope[p], reach[p]
    sx, sy, sz = s[0], s[1], s[2]
    dx, dy, dz = ds[0], ds[1], ds[2]
    stress = volume * flux[p]
    for a in range(count[0]):
        for b in range(count[1]):
            for c in range(count[2]):
                n = nodes[p, 9 * a + 3 * b + c]
                if n > OUTSIDE:
                    gradient = vec3(dx[a] * sy[b] * sz[c], sx[a] * dy[b] * sz[c], sx[a] * sy[b] * dz[c])
                    wp.atomic_add(force, n, stress * gradient)


@wp.kernel(module=NAME)
def stiffness(
    order: wp.array(dtype=wp.int32),
    nodes: wp.array2d(dtype=wp.int32),
    reach: wp.array(dtype=wp.vec3i),
    weight: wp.array(dtype=mat33),
    slope: wp.array(dtype=mat33),
    tangent: wp.array2d(dtype=mat33),
    volume: real,
    place: wp.array2d(dtype=wp.int32),
    values: wp.array(dtype=mat33),
):
    """Add each point's 3x3 blocks; `place` (nodes, 125) says where a node's block with a neighbour is kept."""
    p = order[wp.tid()]
    s, ds, count = weight[p], slope[p], reach[p]
    sx, sy, sz = s[0], s[1], s[2]
    dx, dy, dz = ds[0], ds[1], ds[2]
    for a in range(count[0]):
        for b in range(count[1]):
            for c in range(count[2]):
                row = nodes[p, 9 * a + 3 * b + c]
                if row > OUTSIDE:
                    ga = volume * dx[a] * sy[b] * sz[c]
                    gb = volume * sx[a] * dy[b] * sz[c]
                    gc = volume * sx[a] * sy[b] * dz[c]
                    from_x = ga * tangent[p, 0] + gb * tangent[p, 3] + gc * tangent[p, 6]
                    from_y = ga * tangent[p, 1] + gb * tangent[p, 4] + gc * tangent[p, 7]
                    from_z = ga * tangent[p, 2] + gb * tangent[p, 5] + gc * tangent[p, 8]
                    for d in range(count[0]):
                        for e in range(count[1]):
                            along_x = dx[d] * sy[e]
                            along_y = sx[d] * dy[e]
                            along_z = sx[d] * sy[e]
                            at = 25 * (d - a + 2) + 5 * (e - b + 2) - c + 2
                            for f in range(count[2]):
                                if nodes[p, 9 * d + 3 * e + f] > OUTSIDE:
                                    block = (
                                        (along_x * sz[f]) * from_x
                                        + (along_y * sz[f]) * from_y
                                        + (along_z * dz[f]) * from_z
                                    )
                                    wp.atomic_add(values, place[row, (at + f) & NOT_NEGATIVE] & NOT_NEGATIVE, block)


@wp.kernel(module=NAME)
def add_diagonal(
    place: wp.array2d(dtype=wp.int32),
    diagonal: wp.array(dtype=real),
    values: wp.array(dtype=mat33),
):
    """Add diagonal[n] I [N/m] to the block of node n with itself."""
    n = wp.tid()
    values[place[n, SELF]] = values[place[n, SELF]] + diagonal[n] * wp.identity(3, dtype=real)


@wp.kernel(module=NAME)
def apply_dirichlet(
    held: wp.array(dtype=vec3),
    row: wp.array(dtype=wp.int32),
    column: wp.array(dtype=wp.int32),
    scale: real,
    values: wp.array(dtype=mat33),
):
    """Take held components (1 in `held`) out of the system; `scale` [N/m] stands on their diagonal."""
    e = wp.tid()
    r, c = row[e], column[e]
    block = values[e]
    for i in range(3):
        for k in range(3):
            if held[r][i] > ZERO or held[c][k] > ZERO:
                block[i, k] = ZERO
                if r == c and i == k:
                    block[i, k] = scale
    values[e] = block
