"""Transfers between points and grid: p2g, and g2p with the second mapping.

Pencils without weight are read, at the cost of a product, but not written to: p2g counts the pencils reached, g2p2g
looks at each weight in loops that are written out. Each is the fastest of the forms tried (benchmarks/README.md).
"""

import functools
from types import SimpleNamespace

import warp as wp

from explicit.kernels.layout import CARRIED, DT, NOT_FINITE, TOO_FAST, WORK_DECAY, layout
from explicit.kernels.reductions import reductions
from explicit.kernels.simd import simd
from mpm.gimp import gimp


@functools.cache
def transfer_kernels(real):
    """Return the kernels for `real` (wp.float32 or wp.float64)."""
    types = layout(real)
    name = types.name
    vec3 = types.vec3
    vec4 = types.vec4
    vec6 = types.vec6
    Points = types.Points
    Pencils = types.Pencils
    Setup = types.Setup
    node_of = types.node_of
    float64 = wp.float64
    stencil, reached = gimp(real).stencil, gimp(real).reached
    scaled, add_scaled, gather, add = (getattr(simd(real), name) for name in ("scaled", "add_scaled", "gather", "add"))
    raise_to = reductions(real).raise_to
    zero, half, one = (wp.constant(real(value)) for value in (0.0, 0.5, 1.0))
    not_finite, too_fast = wp.constant(1 << NOT_FINITE), wp.constant(1 << TOO_FAST)

    @wp.func(module=name)
    def point_load(setup: Setup, v: vec3, tau: vec6, theta: real):
        """What a point hands to nodes: (m, m v), the columns of -V0 tau, and m theta in the fourth component."""
        m = setup.mass
        s = -setup.volume * tau
        return (
            vec4(m, m * v[0], m * v[1], m * v[2]),
            vec4(s[0], s[5], s[4], zero),
            vec4(s[5], s[1], s[3], zero),
            vec4(s[4], s[3], s[2], zero),
            vec4(zero, zero, zero, m * theta),
        )

    @wp.func(module=name)
    def flip(setup: Setup, v: vec3, moved: vec4, gained: vec4, dt: real):
        """FLIP velocity of a point that had `v`, the velocity that will carry it, and the energy [J] that it loses.

        `moved`, `gained`: the nodes' (m, v) and velocity increments at the point.
        """
        vp = v + vec3(gained[0], gained[1], gained[2])
        carried = vec3(moved[1], moved[2], moved[3])
        work = zero
        if setup.decay > zero:
            # On what the grid does not see of v no force ever acts: without a decay points shake for ever and a heap
            # creeps.
            lost = wp.min(setup.decay * dt, one) * (vp - carried)
            work = setup.mass * (wp.dot(vp, lost) - half * wp.dot(lost, lost))
            vp = vp - lost
        return vp, carried, work

    @wp.func(module=name)
    def gather_velocity(
        pencils: Pencils,
        i: int,
        j: int,
        k: int,
        sx: vec3,
        sy: vec3,
        sz: vec3,
        node_velocity: wp.array(dtype=vec4),
        node_increment: wp.array(dtype=vec4),
    ):
        """The nodes' (m, v) and velocity increments at a point."""
        moved = vec4(zero, zero, zero, zero)
        gained = vec4(zero, zero, zero, zero)
        for a in range(3):
            for b in range(3):
                wxy = sx[a] * sy[b]
                n = node_of(pencils, i + a, j + b, k)
                moved = add_scaled(wxy, gather(node_velocity, n, sz), moved)
                gained = add_scaled(wxy, gather(node_increment, n, sz), gained)
        return moved, gained

    @wp.func(module=name)
    def watch(setup: Setup, v: vec3, carried: vec3, dt: real, speed: wp.array(dtype=real)):
        """Record the speeds of a point; more than 0 where something is wrong with them (see `accuse`)."""
        fastest = wp.max(wp.max(wp.abs(carried[0]), wp.abs(carried[1])), wp.abs(carried[2]))
        for axis in range(3):
            raise_to(speed, axis, wp.abs(v[axis]))
        raise_to(speed, CARRIED, fastest)
        wrong = wp.int32(0)
        if not (wp.isfinite(wp.dot(v, v)) and wp.isfinite(wp.dot(carried, carried))):
            wrong = wrong | not_finite
        if fastest * dt > half * setup.cell:
            wrong = wrong | too_fast
        return wrong

    @wp.func(module=name)
    def accuse(p: int, wrong: wp.int32, fault: wp.array(dtype=wp.int32)):
        """Report what `watch` found wrong with the body's point `p`."""
        if (wrong & not_finite) > 0:
            wp.atomic_max(fault, NOT_FINITE, p + 1)
        if (wrong & too_fast) > 0:
            wp.atomic_max(fault, TOO_FAST, p + 1)

    @wp.kernel(module=name)
    def p2g(
        setup: Setup,
        pencils: Pencils,
        clock: wp.array(dtype=float64),
        points: Points,
        node_momentum: wp.array(dtype=vec4),
        node_force: wp.array(dtype=vec4),
    ):
        """Mass and momentum; force -V0 tau grad N, and mass times volume strain beside it."""
        if clock[DT] == float64(0.0):
            return
        p = wp.tid()
        i, j, k, sx, sy, sz, dx, dy, dz = stencil(points.x[p], setup.inv_cell)
        carried, force_x, force_y, force_z, strain = point_load(setup, points.v[p], points.tau[p], points.theta[p])
        for a in range(reached(sx)):
            for b in range(reached(sy)):
                wxy = sx[a] * sy[b]
                flat = add_scaled(dx[a] * sy[b], force_x, add_scaled(sx[a] * dy[b], force_y, scaled(wxy, strain)))
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
        """FLIP velocity of the point, the velocity that will carry it, and the second mapping (MUSL, Sulsky et al.
        1995)."""
        dt = real(clock[DT])
        if dt == zero:
            return
        p = wp.tid()
        i, j, k, sx, sy, sz, _dx, _dy, _dz = stencil(points.x[p], setup.inv_cell)
        moved, gained = gather_velocity(pencils, i, j, k, sx, sy, sz, node_velocity, node_increment)
        vp, carried, work = flip(setup, points.v[p], moved, gained, dt)
        if setup.decay > zero:
            wp.atomic_add(ledger, WORK_DECAY, p & (ledger.shape[1] - 1), float64(work))
        points.v[p] = vp
        points.carry[p] = carried
        m = setup.mass
        mv = vec4(m * vp[0], m * vp[1], m * vp[2], zero)
        for a in range(3):
            for b in range(3):
                wxy = sx[a] * sy[b]
                if wxy > zero:
                    load = scaled(wxy, mv)
                    n = node_of(pencils, i + a, j + b, k)
                    for c in range(3):
                        add(node_mapped, n + c, scaled(sz[c], load))
        wrong = watch(setup, vp, carried, dt, speed)
        if wrong > 0:
            accuse(p, wrong, fault)

    return SimpleNamespace(
        p2g=p2g,
        g2p2g=g2p2g,
        point_load=point_load,
        flip=flip,
        gather_velocity=gather_velocity,
        watch=watch,
        accuse=accuse,
    )
