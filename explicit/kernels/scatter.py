"""Sums of the points over the nodes that they reach, as a GPU makes them: a lane of a warp per node.

The points of a warp hand over what they give. Those of them that reach the same 27 nodes are a group, in whatever order
they come. Group after group 27 lanes, one for each node, add up what the points of the group give to it, and add that
to the node at once. Of points sorted by cell a warp has six or seven groups, so that nodes are added to a third as
often as where each point adds to its own (benchmarks/README.md has the counts).

All threads of a warp call one of these functions, and in a kernel once; `thread` is the number of the calling one, and
those from `count` on have no points.
"""

import functools
from types import SimpleNamespace

import warp as wp

from explicit.kernels.layout import layout
from explicit.kernels.reductions import reductions
from explicit.kernels.transfer import transfer_kernels
from explicit.kernels.warps import warps
from mpm.gimp import NODES_PER_AXIS, gimp


@functools.cache
def scatter(real):
    """Return the functions for `real` (wp.float32 or wp.float64).

    Members: `add_point(setup, pencils, thread, count, x, v, tau, theta, sum_momentum, sum_force)`: mass, momentum,
    force and m theta of the points, as in `transfer.p2g`;
    `add_momentum(pencils, thread, count, i, j, k, sx, sy, sz, mv, nodes)`: momentum `mv`, as in `transfer.g2p2g`;
    `add_volume(pencils, thread, count, i, j, k, sx, sy, sz, m_d, nodes)`: mass times ln det F into the first component,
    as in `stress.strain_points`.
    """
    types = layout(real)
    name, vec3, vec4, vec6 = types.name, types.vec3, types.vec4, types.vec6
    Setup, Pencils, node_of = types.Setup, types.Pencils, types.node_of
    stencil, point_load = gimp(real).stencil, transfer_kernels(real).point_load
    add_node, add_first = reductions(real).add_node, reductions(real).add_first
    w = warps(real)
    lane, lanes_below, first, same, of_lane = w.lane, w.lanes_below, w.first, w.same, w.of_lane
    wide_row, narrow_row, put, four, two, single = w.wide_row, w.narrow_row, w.put, w.four, w.two, w.one
    zero = wp.constant(real(0.0))
    axis_nodes, nodes_of_stencil = wp.constant(NODES_PER_AXIS), wp.constant(NODES_PER_AXIS**3)
    nobody, lowest = wp.constant(wp.uint32(0)), wp.constant(wp.uint32(1))

    @wp.func(module=name)
    def own_node():
        """Which node of a stencil the lane has, along x, y and z; the last five have the last one, and add nothing."""
        n = wp.min(lane(), nodes_of_stencil - 1)
        a = n // (axis_nodes * axis_nodes)
        b = n // axis_nodes - a * axis_nodes
        return a, b, n % axis_nodes

    @wp.func(module=name)
    def neighbours(pencils: Pencils, thread: int, count: int, i: int, j: int, k: int):
        """Mask of the lanes whose points' stencils start at the same node (i, j, k) as this one's; after this, what
        lanes have handed over can be read."""
        cell = wp.int32(-1)
        if thread < count:
            cell = node_of(pencils, i, j, k)
        return same(cell)

    @wp.func(module=name)
    def group_of(pencils: Pencils, p: int, alike: wp.uint32, i: int, j: int, k: int, a: int, b: int, c: int):
        """The group that lane `p` is of, and the number of this lane's node in it."""
        n = node_of(pencils, of_lane(i, p) + a, of_lane(j, p) + b, of_lane(k, p)) + c
        return wp.uint32(of_lane(int(alike), p)), n

    @wp.func(module=name)
    def add_point(
        setup: Setup,
        pencils: Pencils,
        thread: int,
        count: int,
        x: vec3,
        v: vec3,
        tau: vec6,
        theta: real,
        sum_momentum: wp.array(dtype=vec4),
        sum_force: wp.array(dtype=vec4),
    ):
        i, j, k, sx, sy, sz, dx, dy, dz = stencil(x, setup.inv_cell)
        carried, force_x, force_y, force_z, strain = point_load(setup, v, tau, theta)
        mine = wide_row(lane())
        put(mine, 0, vec4(carried[1], carried[2], carried[3], strain[3]))
        put(mine, 4, vec4(force_x[0], force_y[1], force_z[2], force_y[2]))
        put(mine, 8, vec4(force_x[2], force_x[1], sx[0], dx[0]))
        put(mine, 12, vec4(sx[1], dx[1], sx[2], dx[2]))
        put(mine, 16, vec4(sy[0], dy[0], sy[1], dy[1]))
        put(mine, 20, vec4(sy[2], dy[2], sz[0], dz[0]))
        put(mine, 24, vec4(sz[1], dz[1], sz[2], dz[2]))
        alike = neighbours(pencils, thread, count, i, j, k)
        a, b, c = own_node()
        left = lanes_below(count, thread)
        while left != nobody:
            group, n = group_of(pencils, first(left), alike, i, j, k, a, b, c)
            left = left & ~group
            m, mv, m_theta, force = real(0.0), vec3(), real(0.0), vec3()
            while group != nobody:
                row = wide_row(first(group))
                group = group & (group - lowest)
                wx, wy, wz = two(row, 10 + 2 * a), two(row, 16 + 2 * b), two(row, 22 + 2 * c)
                given, normal, shear = four(row, 0), four(row, 4), two(row, 8)
                yz, xz, xy = normal[3], shear[0], shear[1]
                wyz = wy[0] * wz[0]
                weight, gx = wx[0] * wyz, wx[1] * wyz
                gy, gz = wx[0] * (wy[1] * wz[0]), wx[0] * (wy[0] * wz[1])
                m = m + weight * setup.mass
                mv = mv + weight * vec3(given[0], given[1], given[2])
                m_theta = m_theta + weight * given[3]
                force = force + gx * vec3(normal[0], xy, xz)
                force = force + gy * vec3(xy, normal[1], yz)
                force = force + gz * vec3(xz, yz, normal[2])
            add_node(sum_momentum, n, vec4(m, mv[0], mv[1], mv[2]))
            add_node(sum_force, n, vec4(force[0], force[1], force[2], m_theta))

    @wp.func(module=name)
    def add_momentum(
        pencils: Pencils,
        thread: int,
        count: int,
        i: int,
        j: int,
        k: int,
        sx: vec3,
        sy: vec3,
        sz: vec3,
        mv: vec3,
        nodes: wp.array(dtype=vec4),
    ):
        mine = narrow_row(lane())
        put(mine, 0, vec4(mv[0], mv[1], mv[2], sx[0]))
        put(mine, 4, vec4(sx[1], sx[2], sy[0], sy[1]))
        put(mine, 8, vec4(sy[2], sz[0], sz[1], sz[2]))
        alike = neighbours(pencils, thread, count, i, j, k)
        a, b, c = own_node()
        left = lanes_below(count, thread)
        while left != nobody:
            group, n = group_of(pencils, first(left), alike, i, j, k, a, b, c)
            left = left & ~group
            total = vec3()
            while group != nobody:
                row = narrow_row(first(group))
                group = group & (group - lowest)
                weight = single(row, 3 + a) * single(row, 6 + b) * single(row, 9 + c)
                given = four(row, 0)
                total = total + weight * vec3(given[0], given[1], given[2])
            add_node(nodes, n, vec4(total[0], total[1], total[2], zero))

    @wp.func(module=name)
    def add_volume(
        pencils: Pencils,
        thread: int,
        count: int,
        i: int,
        j: int,
        k: int,
        sx: vec3,
        sy: vec3,
        sz: vec3,
        m_d: real,
        nodes: wp.array(dtype=vec4),
    ):
        mine = narrow_row(lane())
        put(mine, 0, vec4(zero, zero, zero, m_d * sx[0]))
        put(mine, 4, vec4(m_d * sx[1], m_d * sx[2], sy[0], sy[1]))
        put(mine, 8, vec4(sy[2], sz[0], sz[1], sz[2]))
        alike = neighbours(pencils, thread, count, i, j, k)
        a, b, c = own_node()
        left = lanes_below(count, thread)
        while left != nobody:
            group, n = group_of(pencils, first(left), alike, i, j, k, a, b, c)
            left = left & ~group
            total = real(0.0)
            while group != nobody:
                row = narrow_row(first(group))
                group = group & (group - lowest)
                total = total + single(row, 3 + a) * single(row, 6 + b) * single(row, 9 + c)
            if lane() < nodes_of_stencil and total != zero:
                add_first(nodes, n, total)

    return SimpleNamespace(add_point=add_point, add_momentum=add_momentum, add_volume=add_volume)
