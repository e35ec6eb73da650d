"""Transfers between points and grid: p2g, and g2p with the second mapping.

Pencils without weight are read, at the cost of a product, but not written to: p2g counts the pencils reached, g2p2g
looks at each weight in loops that are written out. Each is the fastest of the forms tried (benchmarks/README.md).
"""

import functools
from types import SimpleNamespace

import warp as wp

from explicit.kernels.layout import CARRIED, DT, GRAVITY, NOT_FINITE, TOO_FAST, WORK_DECAY, layout
from explicit.kernels.simd import simd
from mpm.gimp import gimp


@functools.cache
def transfer_kernels(real):
    """Return the kernels for `real` (wp.float32 or wp.float64)."""
    types = layout(real)
    name = types.name
    vec3 = types.vec3
    vec4 = types.vec4
    Points = types.Points
    Pencils = types.Pencils
    Setup = types.Setup
    node_of = types.node_of
    float64 = wp.float64
    stencil, reached = gimp(real).stencil, gimp(real).reached
    scaled, add_scaled, gather, add = (getattr(simd(real), name) for name in ("scaled", "add_scaled", "gather", "add"))
    zero, half, one = (wp.constant(real(value)) for value in (0.0, 0.5, 1.0))

    @wp.kernel(module=name)
    def p2g(
        setup: Setup,
        pencils: Pencils,
        clock: wp.array(dtype=float64),
        points: Points,
        node_momentum: wp.array(dtype=vec4),
        node_force: wp.array(dtype=vec4),
    ):
        """Mass and momentum; force -V0 tau grad N - N m g e_z, and mass times volume strain beside it."""
        if clock[DT] == float64(0.0):
            return
        p = wp.tid()
        i, j, k, sx, sy, sz, dx, dy, dz = stencil(points.x[p], setup.inv_cell)
        m = setup.mass
        vp = points.v[p]
        carried = vec4(m, m * vp[0], m * vp[1], m * vp[2])
        s = -setup.volume * points.tau[p]
        force_x = vec4(s[0], s[5], s[4], zero)
        force_y = vec4(s[5], s[1], s[3], zero)
        force_z = vec4(s[4], s[3], s[2], zero)
        weight = vec4(zero, zero, -m * real(clock[GRAVITY]), m * points.theta[p])
        for a in range(reached(sx)):
            for b in range(reached(sy)):
                wxy = sx[a] * sy[b]
                flat = add_scaled(dx[a] * sy[b], force_x, add_scaled(sx[a] * dy[b], force_y, scaled(wxy, weight)))
                steep = scaled(wxy, force_z)
                load = scaled(wxy, carried)
                n = node_of(pencils, i + a, j + b, k)
                for c in range(3):
                    add(node_momentum, n + c, scaled(sz[c], load))
                    add(node_force, n + c, add_scaled(sz[c], flat, scaled(dz[c], steep)))

    @wp.kernel(module=name)
    def g2p2g(
        setup: Setup,
        pencils: Pencils,
        clock: wp.array(dtype=float64),
        points: Points,
        node_velocity: wp.array(dtype=vec4),
        node_increment: wp.array(dtype=vec4),
        node_mapped: wp.array(dtype=vec4),
        ledger: wp.array2d(dtype=float64),
        speed: wp.array(dtype=real),
        fault: wp.array(dtype=wp.int32),
    ):
        """FLIP velocity of the point, the velocity that will carry it, and the second mapping (MUSL)."""
        if clock[DT] == float64(0.0):
            return
        p = wp.tid()
        i, j, k, sx, sy, sz, _dx, _dy, _dz = stencil(points.x[p], setup.inv_cell)
        moved = vec4(zero, zero, zero, zero)
        gained = vec4(zero, zero, zero, zero)
        for a in range(3):
            for b in range(3):
                wxy = sx[a] * sy[b]
                n = node_of(pencils, i + a, j + b, k)
                moved = add_scaled(wxy, gather(node_velocity, n, sz), moved)
                gained = add_scaled(wxy, gather(node_increment, n, sz), gained)
        vp = points.v[p] + vec3(gained[0], gained[1], gained[2])
        carried = vec3(moved[1], moved[2], moved[3])
        m = setup.mass
        if setup.decay > zero:
            # On what the grid does not see of v no force ever acts: without a decay points shake for ever and a heap
            # creeps.
            lost = wp.min(setup.decay * real(clock[DT]), one) * (vp - carried)
            work = m * (wp.dot(vp, lost) - half * wp.dot(lost, lost))
            wp.atomic_add(ledger, WORK_DECAY, p & (ledger.shape[1] - 1), float64(work))
            vp = vp - lost
        points.v[p] = vp
        points.carry[p] = carried
        mv = vec4(m * vp[0], m * vp[1], m * vp[2], zero)
        for a in range(3):
            for b in range(3):
                wxy = sx[a] * sy[b]
                if wxy > zero:
                    load = scaled(wxy, mv)
                    n = node_of(pencils, i + a, j + b, k)
                    for c in range(3):
                        add(node_mapped, n + c, scaled(sz[c], load))
        # Plain reads first: an atomic only when the point is faster than what is recorded.
        fastest = zero
        for axis in range(3):
            fastest = wp.max(fastest, wp.abs(carried[axis]))
            if wp.abs(vp[axis]) > speed[axis]:
                wp.atomic_max(speed, axis, wp.abs(vp[axis]))
        if fastest > speed[CARRIED]:
            wp.atomic_max(speed, CARRIED, fastest)
        if not (wp.isfinite(wp.dot(vp, vp)) and wp.isfinite(wp.dot(carried, carried))):
            wp.atomic_max(fault, NOT_FINITE, p + 1)
        if fastest * real(clock[DT]) > half * setup.cell:
            wp.atomic_max(fault, TOO_FAST, p + 1)

    return SimpleNamespace(
        p2g=p2g,
        g2p2g=g2p2g,
    )
