"""The points' stress update: strain increment and trial deviator, pressure law at the nodes, return map.

A point carries Kirchhoff stress tau = J sigma and the volume strain `theta` that bears pressure. The deviator of tau
accumulates 2 G dev(D) dt in the rotated frame, its mean is K theta: in pure stretch that is Hencky's law, which stores
all energy a fall can supply, as constant moduli between Cauchy stress and strain rate do not (at most E per volume in
compression). Its force on the nodes needs the initial volume alone.
"""

import functools
from types import SimpleNamespace

import warp as wp

from explicit.kernels.layout import DT, INVERTED, WORK_PLASTIC, layout
from explicit.kernels.simd import simd
from mpm.drucker_prager import drucker_prager
from mpm.gimp import gimp


@functools.cache
def stress_kernels(real):
    """Return the kernels for `real` (wp.float32 or wp.float64)."""
    types = layout(real)
    name = types.name
    vec3 = types.vec3
    vec4 = types.vec4
    vec6 = types.vec6
    mat33 = types.mat33
    Points = types.Points
    Pencils = types.Pencils
    Setup = types.Setup
    moved, node_of = types.moved, types.node_of
    float64 = wp.float64
    stencil, law = gimp(real).stencil, drucker_prager(real)
    add_scaled, gather = simd(real).add_scaled, simd(real).gather
    return_map, second_invariant = law.return_map, law.second_invariant
    node_law, node_gap = law.node_law, law.node_gap
    Material = law.Material
    zero, one, two, half, third = (wp.constant(real(value)) for value in (0.0, 1.0, 2.0, 0.5, 1.0 / 3.0))
    quarter, fifth, sixth = (wp.constant(real(value)) for value in (0.25, 0.2, 1.0 / 6.0))
    small = wp.constant(real(0.02))  # the series of ln(1 + x) is then right to 1e-11

    @wp.func(module=name)
    def rotate(sigma: vec6, spin: vec3):
        """Q sigma Q^T for the rotation Q of the half-step (Hughes-Winget) formula; `spin` is the axial vector
        of the spin increment. A plain Jaumann increment W sigma - sigma W would lengthen sigma each step."""
        a = half * spin
        c = two / (one + wp.dot(a, a))
        skew = wp.skew(a)
        q = wp.identity(3, dtype=real) + c * (skew + skew * skew)
        s = mat33(sigma[0], sigma[5], sigma[4], sigma[5], sigma[1], sigma[3], sigma[4], sigma[3], sigma[2])
        r = q * s * wp.transpose(q)
        return vec6(r[0, 0], r[1, 1], r[2, 2], r[1, 2], r[0, 2], r[0, 1])

    @wp.func(module=name)
    def log_of_one_plus(x: real):
        """ln(1 + x), to full relative precision where x is small, as it is in nearly every step."""
        if wp.abs(x) < small:
            return x * (one - x * (half - x * (third - x * (quarter - x * (fifth - x * sixth)))))
        return wp.log(one + x)

    @wp.func(module=name)
    def trial_stress(setup: Setup, material: Material, old: vec6, lx: vec4, ly: vec4, lz: vec4):
        """Trial deviator of a point whose Kirchhoff stress was `old`, its mass times ln det F, and 1 where det F <= 0.

        `lx`, `ly`, `lz`: columns of dL = dt grad v, in their first three components.
        """
        # det(I + dL) - 1 without the 1, which float32 would round to
        trace = lx[0] + ly[1] + lz[2]
        minors = lx[0] * ly[1] - ly[0] * lx[1] + lx[0] * lz[2] - lz[0] * lx[2] + ly[1] * lz[2] - lz[1] * ly[2]
        cube = wp.determinant(mat33(lx[0], ly[0], lz[0], lx[1], ly[1], lz[1], lx[2], ly[2], lz[2]))
        growth = trace + minors + cube
        inverted = wp.int32(0)
        if growth <= -one:
            inverted = wp.int32(1)
            growth = zero
        m_d = setup.mass * log_of_one_plus(growth)
        spin = half * vec3(ly[2] - lz[1], lz[0] - lx[2], lx[1] - ly[0])
        s = rotate(old, spin)
        g2 = two * material.shear
        even = g2 * third * trace + third * (old[0] + old[1] + old[2])
        trial = vec6(
            s[0] + g2 * lx[0] - even,
            s[1] + g2 * ly[1] - even,
            s[2] + g2 * lz[2] - even,
            s[3] + material.shear * (ly[2] + lz[1]),
            s[4] + material.shear * (lx[2] + lz[0]),
            s[5] + material.shear * (lx[1] + ly[0]),
        )
        return trial, m_d, inverted

    @wp.func(module=name)
    def given_by_node(material: Material, m_d: real, m_theta: real, inverse_mass: real):
        """Pressure law at a node: (d, tau_m, gap, 0) from the sums of m ln det F and of m theta before the step.

        theta of the nodes takes its last increment as it is, where theta of the points takes the average of the
        averages: equal but for one increment, and one scatter less.
        """
        d = inverse_mass * m_d
        theta = inverse_mass * m_theta + d
        return vec4(d, node_law(theta, material), node_gap(theta, material), zero)

    @wp.func(module=name)
    def returned(
        setup: Setup,
        material: Material,
        points: Points,
        p: int,
        given: vec4,
        ledger: wp.array2d(dtype=float64),
    ):
        """Kirchhoff stress and theta of point `p`: mean stress from the nodes, trial deviator returned to the cone.

        `given`: what `given_by_node` gives, at the point. What it has dilated, and the law's state, are kept.
        """
        grown = points.theta[p] + given[0]
        mean = given[1]
        s = points.tau[p]
        if material.plastic > 0:
            root_j2, before = wp.sqrt(second_invariant(s)), points.law_state[p]
            mean, scale, dilation, after, work = return_map(given[1], given[2], root_j2, before, material)
            s = scale * s
            points.law_state[p] = after
            if work != zero:
                wp.atomic_add(ledger, WORK_PLASTIC, p & (ledger.shape[1] - 1), float64(work) * float64(setup.volume))
            if dilation > zero:
                grown = grown - dilation
                points.dilated[p] = points.dilated[p] + dilation
        s[0] = s[0] + mean
        s[1] = s[1] + mean
        s[2] = s[2] + mean
        return s, grown

    @wp.kernel(module=name)
    def strain_points(
        setup: Setup,
        material: Material,
        pencils: Pencils,
        clock: wp.array(dtype=float64),
        points: Points,
        node_mapped: wp.array(dtype=vec4),
        node_dilation: wp.array(dtype=real),
        fault: wp.array(dtype=wp.int32),
    ):
        """Velocity gradient of the second mapping; trial deviator into `tau`; mass times ln det F to the nodes."""
        dt = real(clock[DT])
        if dt == zero:
            return
        p = wp.tid()
        i, j, k, sx, sy, sz, dx, dy, dz = stencil(points.x[p], setup.inv_cell)
        none = vec4(zero, zero, zero, zero)
        lx, ly, lz = none, none, none
        for a in range(3):
            mean, bent, slope = none, none, none
            for b in range(3):
                n = node_of(pencils, i + a, j + b, k)
                along = gather(node_mapped, n, sz)
                mean = add_scaled(sy[b], along, mean)
                bent = add_scaled(dy[b], along, bent)
                slope = add_scaled(sy[b], gather(node_mapped, n, dz), slope)
            lx = add_scaled(dx[a], mean, lx)
            ly = add_scaled(sx[a], bent, ly)
            lz = add_scaled(sx[a], slope, lz)
        trial, m_d, inverted = trial_stress(setup, material, points.tau[p], dt * lx, dt * ly, dt * lz)
        if inverted > 0:
            wp.atomic_max(fault, INVERTED, p + 1)
        points.tau[p] = trial
        for a in range(3):
            for b in range(3):
                wxy = sx[a] * sy[b]
                if wxy > zero:
                    n = node_of(pencils, i + a, j + b, k)
                    for c in range(3):
                        wp.atomic_add(node_dilation, n + c, m_d * wxy * sz[c])

    @wp.kernel(module=name)
    def apply_node_law(
        material: Material,
        clock: wp.array(dtype=float64),
        node_velocity: wp.array(dtype=vec4),
        node_dilation: wp.array(dtype=real),
        node_force: wp.array(dtype=vec4),
    ):
        """What the pressure law gives into `node_force`, which holds m theta before the step."""
        if clock[DT] == float64(0.0):
            return
        n = wp.tid()
        m = node_velocity[n][0]
        if m > zero:
            node_force[n] = given_by_node(material, node_dilation[n], node_force[n][3], one / m)

    @wp.kernel(module=name)
    def update_stress(
        setup: Setup,
        material: Material,
        pencils: Pencils,
        clock: wp.array(dtype=float64),
        points: Points,
        node_given: wp.array(dtype=vec4),
        ledger: wp.array2d(dtype=float64),
    ):
        """Stress of the points from what the nodes give; then the points move."""
        dt = real(clock[DT])
        if dt == zero:
            return
        p = wp.tid()
        xp = points.x[p]
        i, j, k, sx, sy, sz, _dx, _dy, _dz = stencil(xp, setup.inv_cell)
        given = vec4(zero, zero, zero, zero)
        for a in range(3):
            for b in range(3):
                n = node_of(pencils, i + a, j + b, k)
                given = add_scaled(sx[a] * sy[b], gather(node_given, n, sz), given)
        tau, theta = returned(setup, material, points, p, given, ledger)
        points.tau[p] = tau
        points.theta[p] = theta
        points.x[p] = moved(points, p, xp, dt * points.carry[p])

    return SimpleNamespace(
        strain_points=strain_points,
        apply_node_law=apply_node_law,
        update_stress=update_stress,
        trial_stress=trial_stress,
        given_by_node=given_by_node,
        returned=returned,
    )
