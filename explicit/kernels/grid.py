"""Grid phases: clearing, momentum balance with local damping, wall conditions."""

import functools
from types import SimpleNamespace

import warp as wp

from explicit.kernels.layout import DT, GRAVITY, WORK_DAMPING, WORK_EXTERNAL, layout
from mpm.gimp import NODES_PER_AXIS
from mpm.walls import FREE, NORMAL, TANGENTIAL


@functools.cache
def grid_kernels(real):
    """Return the kernels for `real` (wp.float32 or wp.float64)."""
    types = layout(real)
    name = types.name
    vec3 = types.vec3
    vec4 = types.vec4
    Pencils = types.Pencils
    Walls = types.Walls
    Setup = types.Setup
    float64 = wp.float64
    zero, one = wp.constant(real(0.0)), wp.constant(real(1.0))
    last = wp.constant(NODES_PER_AXIS - 1)  # node of a stencil along an axis, counted from its first

    @wp.func(module=name)
    def held(walls: Walls, axis: int, node: int):
        """What the walls across `axis` hold, NORMAL and TANGENTIAL, where node index `node` touches or passes them."""
        kind = FREE
        if node <= walls.low[axis]:
            kind = walls.low_kind[axis]
        if node >= walls.high[axis]:
            kind = kind | walls.high_kind[axis]
        return kind

    @wp.func(module=name)
    def free_components(walls: Walls, i: int, j: int, k: int):
        """1 on the free components of a node's velocity, 0 on the held ones."""
        on_x = held(walls, 0, i)
        on_y = held(walls, 1, j)
        on_z = held(walls, 2, k)
        mask = vec3(one, one, one)
        if (on_x & NORMAL) + ((on_y | on_z) & TANGENTIAL) > 0:
            mask[0] = zero
        if (on_y & NORMAL) + ((on_z | on_x) & TANGENTIAL) > 0:
            mask[1] = zero
        if (on_z & NORMAL) + ((on_x | on_y) & TANGENTIAL) > 0:
            mask[2] = zero
        return mask

    @wp.func(module=name)
    def near_walls(walls: Walls, i: int, j: int, k: int):
        """1 where a node of the stencil that starts at (i, j, k) touches a wall or lies beyond, 0 elsewhere."""
        if i <= walls.low[0] or j <= walls.low[1] or k <= walls.low[2]:
            return 1
        if i + last >= walls.high[0] or j + last >= walls.high[1] or k + last >= walls.high[2]:
            return 1
        return 0

    @wp.func(module=name)
    def node_mask(walls: Walls, pencils: Pencils, pencil_of: wp.array(dtype=wp.int32), n: int):
        window = pencils.base.shape[1]
        i = pencil_of[n] / window
        j = pencil_of[n] - i * window
        return free_components(walls, i + pencils.i0, j + pencils.j0, n - pencils.base[i, j])

    @wp.kernel(module=name)
    def clear_grid(
        clock: wp.array(dtype=float64),
        node_momentum: wp.array(dtype=vec4),
        node_force: wp.array(dtype=vec4),
        node_mapped: wp.array(dtype=vec4),
        node_dilation: wp.array(dtype=real),
    ):
        if clock[DT] == float64(0.0):
            return
        n = wp.tid()
        node_momentum[n] = vec4(zero, zero, zero, zero)
        node_force[n] = vec4(zero, zero, zero, zero)
        node_mapped[n] = vec4(zero, zero, zero, zero)
        node_dilation[n] = zero

    @wp.func(module=name)
    def balance(setup: Setup, mask: vec3, m: real, momentum: vec3, force: vec3, dt: real, gravity: real):
        """Momentum balance of a node: velocity after the step, its increment and the force of local damping.

        On each free component k, m dv_k/dt = f_k - D |f| sgn(v_k), |f| that of the free components: local damping
        (Cundall 1987), with the magnitude of the whole force as in Wyser et al. 2023. `mask` has 1 on free components,
        `force` no weight: of the points' weights a node bears m g.
        """
        v = wp.cw_mul(mask, momentum / m)
        f = wp.cw_mul(mask, force - vec3(zero, zero, m * gravity))
        damped = vec3(zero, zero, zero)
        if setup.damping > zero:
            size = setup.damping * wp.length(f)
            for axis in range(3):
                if wp.abs(v[axis]) > setup.still:
                    damped[axis] = size * wp.sign(v[axis])  # held components are still
        dv = dt * ((f - damped) / m)
        return v + dv, dv, damped

    @wp.func(module=name)
    def record_work(
        setup: Setup,
        ledger: wp.array2d(dtype=float64),
        n: int,
        m: real,
        v: vec3,
        damped: vec3,
        dt: real,
        gravity: real,
    ):
        """Work of gravity and of local damping on a node in a step that gives it velocity `v`."""
        lifted = -m * gravity * v[2] * dt
        wp.atomic_add(ledger, WORK_EXTERNAL, n % ledger.shape[1], float64(lifted))
        if setup.damping > zero:
            wp.atomic_add(ledger, WORK_DAMPING, n % ledger.shape[1], float64(wp.dot(damped, v) * dt))

    @wp.func(module=name)
    def mapped_velocity(mask: vec3, momentum: vec4, inverse_mass: real):
        """Velocity of the second mapping, with 0 in the fourth component."""
        v = inverse_mass * momentum
        return vec4(mask[0] * v[0], mask[1] * v[1], mask[2] * v[2], zero)

    @wp.kernel(module=name)
    def update_grid(
        setup: Setup,
        walls: Walls,
        pencils: Pencils,
        clock: wp.array(dtype=float64),
        pencil_of: wp.array(dtype=wp.int32),
        node_momentum: wp.array(dtype=vec4),
        node_force: wp.array(dtype=vec4),
        counted: wp.array(dtype=wp.int32),
        ledger: wp.array2d(dtype=float64),
    ):
        """Momentum and force in; (m, v_new) and the velocity increment dt a out, beside it m theta as it was."""
        dt = real(clock[DT])
        if dt == zero:
            return
        n = wp.tid()
        q = node_momentum[n]
        m = q[0]
        if m > zero:
            mask = node_mask(walls, pencils, pencil_of, n)
            f = node_force[n]
            gravity = real(clock[GRAVITY])
            v, dv, damped = balance(setup, mask, m, vec3(q[1], q[2], q[3]), vec3(f[0], f[1], f[2]), dt, gravity)
            node_momentum[n] = vec4(m, v[0], v[1], v[2])
            node_force[n] = vec4(dv[0], dv[1], dv[2], f[3])
            if counted.shape[0] > 0:  # noqa: SIM102 (Warp would read counted[n] all the same)
                if counted[n] == 0:
                    return
            record_work(setup, ledger, n, m, v, damped, dt, gravity)

    @wp.kernel(module=name)
    def hold_walls(
        walls: Walls,
        pencils: Pencils,
        clock: wp.array(dtype=float64),
        pencil_of: wp.array(dtype=wp.int32),
        node_velocity: wp.array(dtype=vec4),
        node_mapped: wp.array(dtype=vec4),
    ):
        """Nodal velocity of the second mapping: momentum over mass, wall conditions applied."""
        if clock[DT] == float64(0.0):
            return
        n = wp.tid()
        m = node_velocity[n][0]
        if m > zero:
            mask = node_mask(walls, pencils, pencil_of, n)
            node_mapped[n] = mapped_velocity(mask, node_mapped[n], one / m)

    return SimpleNamespace(
        clear_grid=clear_grid,
        update_grid=update_grid,
        hold_walls=hold_walls,
        balance=balance,
        record_work=record_work,
        mapped_velocity=mapped_velocity,
        node_mask=node_mask,
        free_components=free_components,
        near_walls=near_walls,
    )
