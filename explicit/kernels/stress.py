"""The points' stress update: strain increment, objective rotation, return map."""

import functools
from types import SimpleNamespace

import warp as wp

from explicit.kernels.lanes import lanes
from explicit.kernels.layout import DT, INVERTED, WORK_PLASTIC, layout
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
    Pencils = types.Pencils
    Setup = types.Setup
    node_of = types.node_of
    float64 = wp.float64
    stencil, law = gimp(real).stencil, drucker_prager(real)
    add_scaled, gather = lanes(real).add_scaled, lanes(real).gather
    return_map, second_invariant = law.return_map, law.second_invariant
    Material = law.Material
    zero, one, two, half, third = (wp.constant(real(value)) for value in (0.0, 1.0, 2.0, 0.5, 1.0 / 3.0))

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

    @wp.kernel(module=name)
    def update_stress(
        setup: Setup,
        material: Material,
        pencils: Pencils,
        clock: wp.array(dtype=float64),
        node_mapped: wp.array(dtype=vec4),
        carry: wp.array(dtype=vec3),
        x: wp.array(dtype=vec3),
        sigma: wp.array(dtype=vec6),
        volume: wp.array(dtype=real),
        eps_p_eqv: wp.array(dtype=real),
        opening: wp.array(dtype=real),
        ledger: wp.array2d(dtype=float64),
        fault: wp.array(dtype=wp.int32),
    ):
        """Strain increment from the mapped velocity, objective trial stress, return map; then the point moves."""
        dt = real(clock[DT])
        if dt == zero:
            return
        p = wp.tid()
        xp = x[p]
        i, j, k, sx, sy, sz, dx, dy, dz = stencil(xp, setup.inv_cell)
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
        lx = dt * lx
        ly = dt * ly
        lz = dt * lz
        # columns lx, ly, lz of dL = dt grad v
        stretch = wp.determinant(mat33(one + lx[0], ly[0], lz[0], lx[1], one + ly[1], lz[1], lx[2], ly[2], one + lz[2]))
        volume[p] = volume[p] * stretch
        if stretch <= zero:
            wp.atomic_max(fault, INVERTED, p + 1)
        spin = half * vec3(ly[2] - lz[1], lz[0] - lx[2], lx[1] - ly[0])
        old = sigma[p]
        s = rotate(old, spin)
        dilation = lx[0] + ly[1] + lz[2]
        g2 = two * material.shear
        even = third * dilation
        old_mean = third * (old[0] + old[1] + old[2])
        mean_trial = old_mean + material.bulk * dilation
        deviator = vec6(
            s[0] - old_mean + g2 * (lx[0] - even),
            s[1] - old_mean + g2 * (ly[1] - even),
            s[2] - old_mean + g2 * (lz[2] - even),
            s[3] + material.shear * (ly[2] + lz[1]),
            s[4] + material.shear * (lx[2] + lz[0]),
            s[5] + material.shear * (lx[1] + ly[0]),
        )
        j2 = second_invariant(deviator)
        open_old = zero
        if material.apex_memory > 0:
            open_old = opening[p]
        mean_new, scale, open_new, d_eps, work = return_map(mean_trial, wp.sqrt(j2), open_old, material)
        s = scale * deviator
        s[0] = s[0] + mean_new
        s[1] = s[1] + mean_new
        s[2] = s[2] + mean_new
        sigma[p] = s
        if material.apex_memory > 0:
            opening[p] = open_new
        if d_eps > zero:
            eps_p_eqv[p] = eps_p_eqv[p] + d_eps
            wp.atomic_add(ledger, WORK_PLASTIC, p & (ledger.shape[1] - 1), float64(work * volume[p]))
        x[p] = xp + dt * carry[p]

    return SimpleNamespace(
        update_stress=update_stress,
    )
