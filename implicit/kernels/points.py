"""What a point feels of the nodes' displacement increment: finite strain, stress, consistent tangent.

Multiplicative elastoplasticity with Hencky strain and Kirchhoff stress (Simo 1992; de Souza Neto, Peric and
Owen 2008, ch. 14). The mean stress comes from the nodes (`implicit.volume`); the deviator is the point's own. Its
isochoric elastic left Cauchy-Green tensor is pushed by the increment, b_trial = F b F^T, the deviator of the principal
logarithmic strains is returned to the cone by `mpm.drucker_prager`, and the principal directions are kept. In them the
derivative of the logarithm is written with (ln a - ln b)/(a - b), which has no singularity where principal stretches
coincide.
"""

import warp as wp

from implicit.kernels.eigen import eigen
from implicit.kernels.layout import LAW, NAME, OUTSIDE, LawState, Material, mat33, real, vec3, vec6

ZERO, HALF, ONE, TWO, THREE = (wp.constant(real(value)) for value in (0.0, 0.5, 1.0, 2.0, 3.0))
FIFTH, SEVENTH, SMALL = (wp.constant(real(value)) for value in (0.2, 1.0 / 7.0, 1e-2))
return_map, return_slopes = LAW.return_map, LAW.return_slopes


@wp.kernel(module=NAME)
def deform(
    u: wp.array(dtype=vec3),
    nodes: wp.array2d(dtype=wp.int32),
    reach: wp.array(dtype=wp.vec3i),
    weight: wp.array(dtype=mat33),
    slope: wp.array(dtype=mat33),
    deformation: wp.array(dtype=mat33),
    det: wp.array(dtype=real),
):
    """F = I + sum u (x) grad N and its determinant; gradients with respect to where the step started."""
    p = wp.tid()
    s, ds, count = weight[p], slope[p], reach[p]
    sx, sy, sz = s[0], s[1], s[2]
    dx, dy, dz = ds[0], ds[1], ds[2]
    fx = vec3(ZERO, ZERO, ZERO)
    fy = vec3(ZERO, ZERO, ZERO)
    fz = vec3(ZERO, ZERO, ZERO)
    for a in range(count[0]):
        for b in range(count[1]):
            for c in range(count[2]):
                n = nodes[p, 9 * a + 3 * b + c]
                if n > OUTSIDE:
                    un = u[n]
                    fx += (dx[a] * sy[b] * sz[c]) * un
                    fy += (sx[a] * dy[b] * sz[c]) * un
                    fz += (sx[a] * sy[b] * dz[c]) * un
    f = mat33(ONE + fx[0], fy[0], fz[0], fx[1], ONE + fy[1], fz[1], fx[2], fy[2], ONE + fz[2])
    deformation[p] = f
    det[p] = wp.determinant(f)


@wp.func(module=NAME)
def principal(f: mat33, b: mat33):
    """Principal directions (columns) of b_trial = F b F^T, its eigenvalues and its Hencky strains."""
    trial = f * b * wp.transpose(f)
    # The eigenvalues of b - I: at small strain those of b would lose what they have in common.
    axes, over = eigen(trial - wp.identity(3, dtype=real))
    strain = HALF * vec3(wp.log(ONE + over[0]), wp.log(ONE + over[1]), wp.log(ONE + over[2]))
    return axes, vec3(ONE + over[0], ONE + over[1], ONE + over[2]), strain


@wp.func(module=NAME)
def diagonal(q: mat33, d: vec3):
    """q diag(d) q^T."""
    return q * mat33(d[0], ZERO, ZERO, ZERO, d[1], ZERO, ZERO, ZERO, d[2]) * wp.transpose(q)


@wp.func(module=NAME)
def log_quotient(a: real, b: real):
    """(ln a - ln b)/(a - b), by the series of 2 artanh where a and b are close."""
    r = (a - b) / (a + b)
    if wp.abs(r) > SMALL:
        return wp.log(a / b) / (a - b)
    r2 = r * r
    return TWO * (ONE + r2 * (ONE / THREE + r2 * (FIFTH + r2 * SEVENTH))) / (a + b)


@wp.func(module=NAME)
def law_state_of(law_state: wp.array(dtype=LawState), p: int):
    """State of the law at point `p`; zeros where the material is elastic, which reads none."""
    if law_state.shape[0] > 0:
        return law_state[p]
    return LawState()


@wp.func(module=NAME)
def returned(strain: vec3, nodal: real, gap: real, viscous: real, law_state: LawState, material: Material):
    """Trial deviator of Hencky strains, and what the return map makes of it at the nodes' mean stress `nodal` [Pa].

    `viscous` is the share w of the trial deviator that stays, s = (1 - w) s_returned + w s_trial (Duvaut and Lions
    1972): an overstress in proportion to the step's plastic shear, gone at rest.
    """
    third = (strain[0] + strain[1] + strain[2]) / THREE
    deviator = (TWO * material.shear) * (strain - vec3(third, third, third))
    root = wp.sqrt(HALF * wp.dot(deviator, deviator))
    mean, scale, dilation, after, _work = return_map(nodal, gap, root, law_state, material)
    scale = scale + viscous * (ONE - scale)
    return root, deviator, mean, scale, dilation, after


@wp.kernel(module=NAME)
def stress_flux(
    deformation: wp.array(dtype=mat33),
    b_e: wp.array(dtype=mat33),
    nodal: wp.array(dtype=real),
    gap: wp.array(dtype=real),
    law_state: wp.array(dtype=LawState),
    material: Material,
    viscous: real,
    flux: wp.array(dtype=mat33),
):
    """tau F^-T, whose product with a node's gradient is the nodal force per initial volume."""
    p = wp.tid()
    f = deformation[p]
    axes, _square, strain = principal(f, b_e[p])
    before = law_state_of(law_state, p)
    _r, deviator, mean, scale, _d, _after = returned(strain, nodal[p], gap[p], viscous, before, material)
    tau = diagonal(axes, scale * deviator + vec3(mean, mean, mean))
    flux[p] = tau * wp.transpose(wp.inverse(f))


@wp.kernel(module=NAME)
def tangent_flux(
    deformation: wp.array(dtype=mat33),
    b_e: wp.array(dtype=mat33),
    nodal: wp.array(dtype=real),
    gap: wp.array(dtype=real),
    law_state: wp.array(dtype=LawState),
    material: Material,
    viscous: real,
    blend: real,
    closed: wp.array(dtype=real),
    own: real,
    filled: wp.array(dtype=real),
    tangent: wp.array2d(dtype=mat33),
    volumetric: wp.array(dtype=mat33),
):
    """d(tau F^-T)/dF as nine matrices: entry (i, k) of tangent[p, 3 j + l] is d flux_ij / dF_kl.

    In principal axes, with l = dF F^-1: d eps_ij = 1/2 f_ij (l_ij b_j + l_ji b_i), f_ij the quotient of
    logarithms; then dtau from the slopes of the return map, and the geometric part -tau l^T. `blend` [-] is a
    share of the elastic in place of the plastic modulus; 0 is the exact derivative.

    The mean stress of the nodes is taken to follow the point's own volume strain, with the share `own` [-] of the bulk
    modulus that its nodes have: K `closed` (points,), and K where dilatancy has filled the gap, which `filled` (1 or
    0) then tells. `volumetric` is d flux over the nodes' mean stress, with which `implicit.volume` makes up for it.
    """
    p = wp.tid()
    f = deformation[p]
    axes, square, strain = principal(f, b_e[p])
    before = law_state_of(law_state, p)
    root, deviator, mean, scale, _d, _after = returned(strain, nodal[p], gap[p], viscous, before, material)
    mean_m, mean_g, mean_r, root_m, _g, root_r = return_slopes(nodal[p], gap[p], root, before, material)
    fill = ZERO
    if mean_g > ZERO:
        fill = ONE
    filled[p] = fill
    tau = scale * deviator + vec3(mean, mean, mean)
    root_m, root_r = (ONE - viscous) * root_m, (ONE - viscous) * root_r + viscous
    keep = ONE - blend
    mean_m, mean_r, root_m, root_r = keep * mean_m + blend, keep * mean_r, keep * root_m, keep * root_r + blend
    scale = keep * scale + blend
    direction = vec3(ZERO, ZERO, ZERO)
    if root > ZERO:
        direction = deviator / root
    else:
        scale = root_r
    g = material.shear
    k = own * material.bulk * (closed[p] + fill * (ONE - closed[p]))
    back = wp.inverse(f)  # reference gradients: grad = F^-T grad_0
    volumetric[p] = diagonal(axes, vec3(mean_m, mean_m, mean_m) + root_m * direction) * wp.transpose(back)

    # d tau_ii / d l_kk
    normal = mat33()
    for i in range(3):
        for c in range(3):
            value = k * mean_m + g * mean_r * direction[c] - TWO * g * scale / THREE
            value += direction[i] * (k * root_m + g * (root_r - scale) * direction[c])
            if i == c:
                value += TWO * g * scale
            normal[i, c] = value
    # d tau_ij / d l_ij: the quotient of logarithms is the same for ij and ji
    between = (scale * g) * vec3(
        log_quotient(square[1], square[2]), log_quotient(square[2], square[0]), log_quotient(square[0], square[1])
    )
    to_reference = back * axes  # row j: reference axis j in principal axes
    for j0 in range(3):
        for l0 in range(3):
            block = mat33()  # (i, k) in principal axes
            for i in range(3):
                for c in range(3):
                    if i == c:
                        value = (normal[i, i] - tau[i]) * to_reference[j0, i] * to_reference[l0, i]
                        for j in range(3):
                            if j != i:
                                value += between[3 - i - j] * square[j] * to_reference[j0, j] * to_reference[l0, j]
                        block[i, c] = value
                    else:
                        # j = i, l = k: normal coupling; j = k, l = i: shear and the geometric part
                        shear = between[3 - i - c] * square[i] - tau[i]
                        block[i, c] = (
                            normal[i, c] * to_reference[j0, i] * to_reference[l0, c]
                            + shear * to_reference[j0, c] * to_reference[l0, i]
                        )
            tangent[p, 3 * j0 + l0] = axes * block * wp.transpose(axes)


@wp.kernel(module=NAME)
def volume_slopes(
    nodes: wp.array2d(dtype=wp.int32),
    reach: wp.array(dtype=wp.vec3i),
    weight: wp.array(dtype=mat33),
    slope: wp.array(dtype=mat33),
    start: wp.array(dtype=wp.int32),
    held: wp.array(dtype=vec3),
    deformation: wp.array(dtype=mat33),
    volumetric: wp.array(dtype=mat33),
    strain: wp.array(dtype=vec3),
    force: wp.array(dtype=vec3),
):
    """Rows of the points, from `start` on: d(ln det F)/du = F^-T grad_0 N and d flux over mean stress times grad_0 N.

    Zero for components that walls hold (1 in `held`).
    """
    p = wp.tid()
    s, ds, count = weight[p], slope[p], reach[p]
    sx, sy, sz = s[0], s[1], s[2]
    dx, dy, dz = ds[0], ds[1], ds[2]
    back = wp.transpose(wp.inverse(deformation[p]))
    push = volumetric[p]
    at = start[p]
    for a in range(count[0]):
        for b in range(count[1]):
            for c in range(count[2]):
                n = nodes[p, 9 * a + 3 * b + c]
                if n > OUTSIDE:
                    gradient = vec3(dx[a] * sy[b] * sz[c], sx[a] * dy[b] * sz[c], sx[a] * sy[b] * dz[c])
                    free = vec3(ONE, ONE, ONE) - held[n]
                    strain[at] = wp.cw_mul(free, back * gradient)
                    force[at] = wp.cw_mul(free, push * gradient)
                at += 1


@wp.kernel(module=NAME)
def commit(
    u: wp.array(dtype=vec3),
    nodes: wp.array2d(dtype=wp.int32),
    reach: wp.array(dtype=wp.vec3i),
    weight: wp.array(dtype=mat33),
    deformation: wp.array(dtype=mat33),
    b_e: wp.array(dtype=mat33),
    nodal: wp.array(dtype=real),
    gap: wp.array(dtype=real),
    law_state: wp.array(dtype=LawState),
    material: Material,
    viscous: real,
    x: wp.array(dtype=vec3),
    mean: wp.array(dtype=real),
    theta: wp.array(dtype=real),
    moved: wp.array(dtype=vec3),
):
    """Accept the increment: the point moves (`moved` [m]) and takes its returned elastic state and that of the law.

    Plastic dilation fills what `theta` has opened, or builds pressure.
    """
    p = wp.tid()
    axes, _square, strain = principal(deformation[p], b_e[p])
    before = law_state_of(law_state, p)
    _r, deviator, mean_p, scale, dilation, after = returned(strain, nodal[p], gap[p], viscous, before, material)
    elastic = (scale / material.shear) * deviator  # twice the Hencky strain
    b_e[p] = diagonal(axes, vec3(wp.exp(elastic[0]), wp.exp(elastic[1]), wp.exp(elastic[2])))
    mean[p] = mean_p
    theta[p] = theta[p] - dilation
    if law_state.shape[0] > 0:
        law_state[p] = after
    s, count = weight[p], reach[p]
    sx, sy, sz = s[0], s[1], s[2]
    step = vec3(ZERO, ZERO, ZERO)
    for a in range(count[0]):
        for b in range(count[1]):
            for c in range(count[2]):
                n = nodes[p, 9 * a + 3 * b + c]
                if n > OUTSIDE:
                    step += (sx[a] * sy[b] * sz[c]) * u[n]
    moved[p] = step
    x[p] = x[p] + step


@wp.kernel(module=NAME)
def cauchy(
    b_e: wp.array(dtype=mat33),
    mean: wp.array(dtype=real),
    jacobian: wp.array(dtype=real),
    material: Material,
    sigma: wp.array(dtype=vec6),
):
    """Cauchy stress [Pa] (xx, yy, zz, yz, xz, xy): deviator of the elastic state, mean Kirchhoff stress `mean` [Pa]."""
    p = wp.tid()
    axes, _square, strain = principal(wp.identity(3, dtype=real), b_e[p])
    own = mean[p] - (TWO * material.shear / THREE) * (strain[0] + strain[1] + strain[2])
    s = diagonal(axes, (TWO * material.shear) * strain + vec3(own, own, own)) / jacobian[p]
    sigma[p] = vec6(s[0, 0], s[1, 1], s[2, 2], s[1, 2], s[0, 2], s[0, 1])
