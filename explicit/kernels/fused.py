"""The step in four launches, as a GPU takes it: it waits longer for a launch than for the work of a small one.

The physics is that of the phases (`explicit.kernels`); what differs is where it is done. `update_nodes` starts the
step that was planned, takes what points have added to the sums, and leaves these clean and the nodes ready for what
follows. Wall conditions and the pressure law are applied where points read nodes. `stress_to_nodes` ends a step of the
points and adds them to the sums of the next, which its first thread plans.

Points are added to nodes by warps (`explicit.kernels.scatter`). Elsewhere no thread writes what another one of the
kernel reads: the clock of the step under way and the plan of the next are two arrays. Loops over nodes that are read
are written out: what a loop indexes would go to local memory.
"""

import functools
from types import SimpleNamespace

import warp as wp

from explicit.kernels.clock import clock_kernels
from explicit.kernels.grid import grid_kernels
from explicit.kernels.layout import DT, GRAVITY, INVERTED, KE_GRID, WORK_DECAY, layout
from explicit.kernels.scatter import scatter
from explicit.kernels.simd import simd
from explicit.kernels.stress import stress_kernels
from explicit.kernels.transfer import transfer_kernels
from explicit.kernels.warps import WARP
from mpm.devices import KERNEL_OPTIONS
from mpm.drucker_prager import drucker_prager
from mpm.gimp import gimp

# Threads a block: with 128 and not Warp's 256, 25,120 points are spread over all multiprocessors of a large GPU, and
# more threads fit into one where each takes 100 registers or more.
BLOCK = 4 * WARP
GO_ON, MAY_FIT, STOP = range(3)  # what comes after a step of a batch


@functools.cache
def fused_kernels(real):
    """Return the kernels for `real` (wp.float32 or wp.float64).

    They are in a Warp module of their own, which runs on a CPU do not compile.

    Node arrays: `sum_momentum` (m, m v) and `sum_force` (force but for the weight, m theta) are what points add up;
    `node_velocity` (m, v_new), `node_increment` (dt a, 0), `node_mapped` (the second mapping's m v, 1/m) and
    `node_volume` (sum of m ln det F, m theta, 1/m, 0) are of the step under way.
    """
    types = layout(real)
    name = f"repose_fused_{real.__name__}"
    options = KERNEL_OPTIONS | {"default_grid_stride": False, "block_dim": BLOCK}
    wp.set_module_options(options, module=wp.get_module(name))
    vec3, vec4, vec6 = types.vec3, types.vec4, types.vec6
    Points, Pencils, Walls, Setup = types.Points, types.Pencils, types.Walls, types.Setup
    moved, node_of = types.moved, types.node_of
    Material = drucker_prager(real).Material
    float64 = wp.float64
    clock_functions, grid, transfer, stress = (
        make(real) for make in (clock_kernels, grid_kernels, transfer_kernels, stress_kernels)
    )
    goes_on, fit_due = clock_functions.goes_on, clock_functions.fit_due
    plan_step, follow_plan = clock_functions.plan_step, clock_functions.follow_plan
    balance, record_work, mapped_velocity = grid.balance, grid.record_work, grid.mapped_velocity
    node_mask, free_components, near_walls = grid.node_mask, grid.free_components, grid.near_walls
    flip, gather_velocity, watch, accuse = transfer.flip, transfer.gather_velocity, transfer.watch, transfer.accuse
    trial_stress, given_by_node, returned = stress.trial_stress, stress.given_by_node, stress.returned
    add_scaled, read, stencil = simd(real).add_scaled, simd(real).load, gimp(real).stencil
    sums = scatter(real)
    add_point, add_momentum, add_volume = sums.add_point, sums.add_momentum, sums.add_volume
    zero, one, half = (wp.constant(real(value)) for value in (0.0, 1.0, 0.5))

    @wp.kernel(module=name)
    def mark_due(
        setup: Setup,
        clock: wp.array(dtype=float64),
        until: wp.array(dtype=float64),
        speed: wp.array(dtype=real),
        fault: wp.array(dtype=wp.int32),
        due: wp.array(dtype=wp.int32),
    ):
        """Before a batch of steps: whether the stored nodes must follow the points first."""
        due[0] = fit_due(setup, clock, until[0], speed, fault)

    @wp.kernel(module=name)
    def start_steps(
        setup: Setup,
        pencils: Pencils,
        clock: wp.array(dtype=float64),
        until: wp.array(dtype=float64),
        plan: wp.array(dtype=float64),
        points: Points,
        count: wp.int32,
        speed: wp.array(dtype=real),
        fault: wp.array(dtype=wp.int32),
        sum_momentum: wp.array(dtype=vec4),
        sum_force: wp.array(dtype=vec4),
    ):
        """Before the first step of a batch, or after a fit of the stored nodes: plan the step, and add the points to
        the sums, which are clean."""
        thread = wp.tid()
        if thread == 0:
            plan_step(setup, clock, until[0], speed, fault, plan)
        if goes_on(setup, clock, speed, fault) > 0:
            p = wp.min(thread, count - 1)
            x, v, tau, theta = points.x[p], points.v[p], points.tau[p], points.theta[p]
            add_point(setup, pencils, thread, count, x, v, tau, theta, sum_momentum, sum_force)

    @wp.kernel(module=name)
    def update_nodes(
        setup: Setup,
        walls: Walls,
        pencils: Pencils,
        plan: wp.array(dtype=float64),
        clock: wp.array(dtype=float64),
        speed: wp.array(dtype=real),
        pencil_of: wp.array(dtype=wp.int32),
        sum_momentum: wp.array(dtype=vec4),
        sum_force: wp.array(dtype=vec4),
        node_velocity: wp.array(dtype=vec4),
        node_increment: wp.array(dtype=vec4),
        node_mapped: wp.array(dtype=vec4),
        node_volume: wp.array(dtype=vec4),
        ledger: wp.array2d(dtype=float64),
    ):
        """Start the planned step: momentum balance of the nodes, from the sums, which it leaves clean."""
        n = wp.tid()
        if n == 0:
            follow_plan(plan, clock, speed)
        dt = real(plan[DT])
        if dt == zero:
            return
        q = sum_momentum[n]
        f = sum_force[n]
        none = vec4(zero, zero, zero, zero)
        sum_momentum[n] = none
        sum_force[n] = none
        m = q[0]
        velocity, increment, mapped, volume = none, none, none, none
        if m > zero:
            mask = node_mask(walls, pencils, pencil_of, n)
            gravity = real(plan[GRAVITY])
            v, dv, damped = balance(setup, mask, m, vec3(q[1], q[2], q[3]), vec3(f[0], f[1], f[2]), dt, gravity)
            inverse = one / m
            velocity = vec4(m, v[0], v[1], v[2])
            increment = vec4(dv[0], dv[1], dv[2], zero)
            mapped = vec4(zero, zero, zero, inverse)
            volume = vec4(zero, f[3], inverse, zero)
            record_work(setup, ledger, n, m, v, damped, dt, gravity)
        node_velocity[n] = velocity
        node_increment[n] = increment
        node_mapped[n] = mapped
        node_volume[n] = volume

    @wp.kernel(module=name)
    def g2p2g(
        setup: Setup,
        pencils: Pencils,
        clock: wp.array(dtype=float64),
        points: Points,
        order: wp.array(dtype=wp.int32),
        count: wp.int32,
        node_velocity: wp.array(dtype=vec4),
        node_increment: wp.array(dtype=vec4),
        node_mapped: wp.array(dtype=vec4),
        ledger: wp.array2d(dtype=float64),
        speed: wp.array(dtype=real),
        fault: wp.array(dtype=wp.int32),
    ):
        """FLIP velocity of the point, the velocity that will carry it, and the second mapping (MUSL)."""
        dt = real(clock[DT])
        if dt == zero:
            return
        thread = wp.tid()
        p = wp.min(thread, count - 1)
        i, j, k, sx, sy, sz, _dx, _dy, _dz = stencil(points.x[p], setup.inv_cell)
        moved, gained = gather_velocity(pencils, i, j, k, sx, sy, sz, node_velocity, node_increment)
        vp, carried, work = flip(setup, points.v[p], moved, gained, dt)
        if thread < count:
            if setup.decay > zero:
                wp.atomic_add(ledger, WORK_DECAY, p & (ledger.shape[1] - 1), float64(work))
            points.v[p] = vp
            points.carry[p] = carried
            wrong = watch(setup, vp, carried, dt, speed)
            if wrong > 0:
                accuse(order[p], wrong, fault)
        add_momentum(pencils, thread, count, i, j, k, sx, sy, sz, setup.mass * vp, node_mapped)

    @wp.kernel(module=name)
    def strain_to_nodes(
        setup: Setup,
        material: Material,
        walls: Walls,
        pencils: Pencils,
        clock: wp.array(dtype=float64),
        points: Points,
        order: wp.array(dtype=wp.int32),
        count: wp.int32,
        node_mapped: wp.array(dtype=vec4),
        node_volume: wp.array(dtype=vec4),
        fault: wp.array(dtype=wp.int32),
    ):
        """Velocity gradient of the second mapping; trial deviator into `tau`; mass times ln det F to the nodes."""
        dt = real(clock[DT])
        if dt == zero:
            return
        thread = wp.tid()
        p = wp.min(thread, count - 1)
        i, j, k, sx, sy, sz, dx, dy, dz = stencil(points.x[p], setup.inv_cell)
        near = near_walls(walls, i, j, k)
        none = vec4(zero, zero, zero, zero)
        lx, ly, lz = none, none, none
        for a in range(3):
            mean, bent, slope = none, none, none
            for b in range(3):
                n = node_of(pencils, i + a, j + b, k)
                along, up = none, none
                for c in range(3):
                    q = read(node_mapped, n + c)
                    mask = vec3(one, one, one)
                    if near > 0:
                        mask = free_components(walls, i + a, j + b, k + c)
                    v = mapped_velocity(mask, q, q[3])
                    along = add_scaled(sz[c], v, along)
                    up = add_scaled(dz[c], v, up)
                mean = add_scaled(sy[b], along, mean)
                bent = add_scaled(dy[b], along, bent)
                slope = add_scaled(sy[b], up, slope)
            lx = add_scaled(dx[a], mean, lx)
            ly = add_scaled(sx[a], bent, ly)
            lz = add_scaled(sx[a], slope, lz)
        trial, m_d, inverted = trial_stress(setup, material, points.tau[p], dt * lx, dt * ly, dt * lz)
        if thread < count:
            points.tau[p] = trial
            if inverted > 0:
                wp.atomic_max(fault, INVERTED, order[p] + 1)
        add_volume(pencils, thread, count, i, j, k, sx, sy, sz, m_d, node_volume)

    @wp.kernel(module=name)
    def stress_to_nodes(
        setup: Setup,
        material: Material,
        pencils: Pencils,
        clock: wp.array(dtype=float64),
        until: wp.array(dtype=float64),
        plan: wp.array(dtype=float64),
        points: Points,
        count: wp.int32,
        node_volume: wp.array(dtype=vec4),
        ledger: wp.array2d(dtype=float64),
        speed: wp.array(dtype=real),
        fault: wp.array(dtype=wp.int32),
        then: wp.int32,
        due: wp.array(dtype=wp.int32),
        sum_momentum: wp.array(dtype=vec4),
        sum_force: wp.array(dtype=vec4),
    ):
        """Stress of the points, which then move, and what comes `then`: the next step begins with them (GO_ON), but not
        where a fit of the stored nodes is `due` before it (MAY_FIT), nor after the last one of a batch (STOP)."""
        thread = wp.tid()
        if thread == 0 and then == MAY_FIT:
            due[0] = fit_due(setup, clock, until[0], speed, fault)
        dt = real(clock[DT])
        if dt == zero:
            return
        if thread == 0 and then != STOP:
            plan_step(setup, clock, until[0], speed, fault, plan)
        p = wp.min(thread, count - 1)
        x = one * points.x[p]
        tau, theta = vec6(), zero * points.theta[p]
        i, j, k, sx, sy, sz, _dx, _dy, _dz = stencil(x, setup.inv_cell)
        given = vec4(zero, zero, zero, zero)
        for a in range(3):
            for b in range(3):
                n = node_of(pencils, i + a, j + b, k)
                along = vec4(zero, zero, zero, zero)
                for c in range(3):
                    q = read(node_volume, n + c)
                    along = add_scaled(sz[c], given_by_node(material, q[0], q[1], q[2]), along)
                given = add_scaled(sx[a] * sy[b], along, given)
        if thread < count:
            tau, theta = returned(setup, material, points, p, given, ledger)
            x = moved(points, p, x, dt * points.carry[p])
            points.tau[p] = tau
            points.theta[p] = theta
            points.x[p] = x
        goes = goes_on(setup, clock, speed, fault)
        if then == STOP or (then == MAY_FIT and fit_due(setup, clock, until[0], speed, fault) > 0):
            goes = 0
        if goes > 0:
            add_point(setup, pencils, thread, count, x, points.v[p], tau, theta, sum_momentum, sum_force)

    @wp.kernel(module=name)
    def grid_energy(
        walls: Walls,
        pencils: Pencils,
        pencil_of: wp.array(dtype=wp.int32),
        node_velocity: wp.array(dtype=vec4),
        node_mapped: wp.array(dtype=vec4),
        energy: wp.array2d(dtype=float64),
    ):
        """Kinetic energy of the grid with the velocities of the second mapping."""
        n = wp.tid()
        m = node_velocity[n][0]
        if m > zero:
            q = node_mapped[n]
            v = mapped_velocity(node_mask(walls, pencils, pencil_of, n), q, q[3])
            wp.atomic_add(energy, KE_GRID, n % energy.shape[1], float64(half * m * wp.dot(v, v)))

    return SimpleNamespace(
        mark_due=mark_due,
        start_steps=start_steps,
        update_nodes=update_nodes,
        g2p2g=g2p2g,
        strain_to_nodes=strain_to_nodes,
        stress_to_nodes=stress_to_nodes,
        grid_energy=grid_energy,
    )
