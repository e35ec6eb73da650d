"""Isotropic elasticity and the Drucker-Prager cone with its apex, the one place they are written.

Stress is tension positive, sigma_m = tr(sigma)/3, f = sqrt(J2) + eta sigma_m - xi. The return map works on
the two invariants (sigma_m, sqrt(J2)): the deviator keeps its direction, so the same function serves Cauchy
stress (explicit) and Kirchhoff stress with Hencky strain (implicit).
"""

import functools
import math
from dataclasses import dataclass
from types import SimpleNamespace

import warp as wp

CONES = ("inner", "outer", "plane_strain")
# Elastic points never reach the cone. Finite, because inf - inf is NaN in the yield function.
NEVER_YIELDS = 1e30


@dataclass(frozen=True)
class Constants:
    """Material constants of one scene: moduli and strengths in Pa, the rest dimensionless.

    `eta`, `eta_bar` are the friction and dilatancy slopes of the cone, `xi` its cohesive strength [Pa];
    `apex_memory`: what opens at the apex must close before pressure returns.
    """

    bulk: float
    shear: float
    eta: float
    eta_bar: float
    xi: float
    density: float
    plastic: bool
    apex_memory: bool

    @property
    def p_wave_modulus(self) -> float:
        """M = K + 4G/3 [Pa], the modulus of confined compression."""
        return self.bulk + 4.0 * self.shear / 3.0

    @property
    def p_wave_speed(self) -> float:
        """c = sqrt(M/rho) [m/s]."""
        return math.sqrt(self.p_wave_modulus / self.density)


def cone_slope(angle_deg: float, cone: str) -> float:
    """Slope eta of the Drucker-Prager cone that matches Mohr-Coulomb at `angle_deg` [degrees].

    `inner` meets the extension corners, `outer` the compression corners, `plane_strain` the plane-strain
    collapse load. Also gives eta_bar from the dilatancy angle.
    """
    s, t = math.sin(math.radians(angle_deg)), math.tan(math.radians(angle_deg))
    if cone == "plane_strain":
        return 3.0 * t / math.sqrt(9.0 + 12.0 * t * t)
    return 6.0 * s / (math.sqrt(3.0) * (3.0 + s if cone == "inner" else 3.0 - s))


def cone_strength(cohesion: float, angle_deg: float, cone: str) -> float:
    """Strength xi [Pa] of the cone for `cohesion` [Pa] and friction `angle_deg` [degrees]."""
    s, c = math.sin(math.radians(angle_deg)), math.cos(math.radians(angle_deg))
    if cone == "plane_strain":
        return 3.0 * cohesion / math.sqrt(9.0 + 12.0 * (s / c) ** 2)
    return 6.0 * cohesion * c / (math.sqrt(3.0) * (3.0 + s if cone == "inner" else 3.0 - s))


@functools.cache
def drucker_prager(real):
    """Return `Material` (a Warp struct), `second_invariant`, `return_map` and `return_slopes` (Warp functions).

    `second_invariant(s)` is J2 of a deviator `s` (vec6: xx, yy, zz, yz, xz, xy) [Pa2].

    `return_map(sigma_m, root_j2, opening, material)` takes the trial invariants [Pa] and the volume strain [-] by
    which the material has opened at the apex, and gives (sigma_m, scale, opening, d_eps, work): the returned mean
    stress [Pa], the factor on the deviator, the opening that remains, the increment of equivalent plastic strain
    sqrt(2/3 eps_p:eps_p) [-] and the plastic work per volume [J/m3].

    Shear return where it lands on the cone, otherwise the apex: sigma = (xi/eta) I, zero at c = 0. What opens at
    the apex must close, at zero pressure, before pressure builds up again. Without that memory each opening and
    closing leaves the material larger: a psi = 0 column gained 6 % of volume in 1.5 s (tests/physics/test_collapse.py),
    and crept on past Eq. 4 (benchmarks/results/paper_runs_cpu.csv).

    `return_slopes` (same arguments) differentiates it: d mean/d sigma_m, d mean/d root_j2, and the same of the
    returned sqrt(J2). The returned invariants are linear in the trial ones within each regime.
    """
    name = f"repose_{real.__name__}"
    zero, one, half = (wp.constant(real(value)) for value in (0.0, 1.0, 0.5))
    third, two_ninths = (wp.constant(real(value)) for value in (1.0 / 3.0, 2.0 / 9.0))
    vec6 = wp.types.vector(6, real)
    INTACT, OPEN, USED_UP = (wp.constant(code) for code in range(3))

    @wp.struct
    class Material:
        bulk: real
        shear: real
        eta: real
        eta_bar: real
        xi: real
        plastic: int
        apex_memory: int

    @wp.func(module=name)
    def second_invariant(s: vec6):
        return half * (s[0] * s[0] + s[1] * s[1] + s[2] * s[2]) + s[3] * s[3] + s[4] * s[4] + s[5] * s[5]

    @wp.func(module=name)
    def close(sigma_m: real, opening: real, material: Material):
        """What is open closes first, at no pressure: mean stress and opening after that."""
        trial = sigma_m
        opened = opening
        if opening > zero and sigma_m < zero:
            trial = sigma_m + material.bulk * opening
            opened = zero  # set, not computed: a rest of round-off would count as open
            if trial > zero:
                trial = zero
                opened = opening + sigma_m / material.bulk
        return trial, opened

    @wp.func(module=name)
    def multiplier(root_j2: real, trial: real, opened: real, material: Material):
        """d_lambda of the shear return, its derivative over f, and what dilatancy does with what is open: nothing yet
        (INTACT), or takes a part of it at no pressure (OPEN), or all of it and then builds pressure (USED_UP).
        """
        f = root_j2 + material.eta * trial - material.xi
        per_f = one / (material.shear + material.bulk * material.eta * material.eta_bar)
        d_lambda = f * per_f
        if opened > zero and material.bulk * material.eta_bar * d_lambda > trial:
            used_up = (f + material.eta * material.bulk * opened) * per_f
            if material.eta_bar * used_up > opened + trial / material.bulk:
                return used_up, per_f, USED_UP
            return (root_j2 - material.xi) / material.shear, one / material.shear, OPEN
        return d_lambda, per_f, INTACT

    @wp.func(module=name)
    def return_map(sigma_m: real, root_j2: real, opening: real, material: Material):
        trial, opened = close(sigma_m, opening, material)
        mean = trial
        scale = one
        d_eps = zero
        work = zero
        if root_j2 + material.eta * trial - material.xi > zero:
            d_lambda, _per_f, regime = multiplier(root_j2, trial, opened, material)
            volume_strain = material.eta_bar * d_lambda
            root = root_j2 - material.shear * d_lambda
            # Without a deviator there is nothing to scale; `root` alone misses it where shear * d_lambda underflows.
            if root_j2 > zero and (root >= zero or regime != INTACT):
                scale = wp.max(root, zero) / root_j2  # open, at c = 0: zero but for round-off
                d_eps = wp.sqrt(third * d_lambda * d_lambda + two_ninths * volume_strain * volume_strain)
                mean = trial - material.bulk * volume_strain
                if regime != INTACT:
                    gap = opened + trial / material.bulk - volume_strain
                    mean = wp.min(material.bulk * gap, zero)
                    opened = wp.max(gap, zero)
            else:
                mean = material.xi / material.eta
                scale = zero
                volume_strain = (trial - mean) / material.bulk
                shear_strain = root_j2 / material.shear
                # Dilatancy does not close again. Not negative but for round-off, where the cone ends at the apex.
                opened = wp.max(opened + volume_strain - material.eta_bar * shear_strain, zero)
                d_eps = wp.sqrt(third * shear_strain * shear_strain + two_ninths * volume_strain * volume_strain)
            work = mean * volume_strain + scale * (one - scale) * root_j2 * root_j2 / material.shear
        return mean, scale, opened, d_eps, work

    @wp.func(module=name)
    def return_slopes(sigma_m: real, root_j2: real, opening: real, material: Material):
        trial, opened = close(sigma_m, opening, material)
        mean_m, mean_r, root_m, root_r = one, zero, zero, one
        if opened > zero and sigma_m < zero:
            mean_m = zero  # closing
        if root_j2 + material.eta * trial - material.xi > zero:
            d_lambda, per_f, regime = multiplier(root_j2, trial, opened, material)
            softens = material.bulk * material.eta_bar * per_f
            if root_j2 == zero or regime == OPEN or (regime == INTACT and root_j2 < material.shear * d_lambda):
                mean_m, root_r = zero, zero
            else:
                passes = mean_m
                if regime == USED_UP:
                    passes = one
                mean_m, mean_r = passes * (one - softens * material.eta), -softens
                root_m, root_r = -passes * material.shear * per_f * material.eta, one - material.shear * per_f
        return mean_m, mean_r, root_m, root_r

    def pack(constants: Constants) -> Material:
        """Material struct for kernels from host constants."""
        material = Material()
        material.bulk = constants.bulk
        material.shear = constants.shear
        material.eta = constants.eta
        material.eta_bar = constants.eta_bar
        material.xi = constants.xi if constants.plastic else NEVER_YIELDS
        material.plastic = int(constants.plastic)
        material.apex_memory = int(constants.plastic and constants.apex_memory)
        return material

    return SimpleNamespace(
        Material=Material,
        second_invariant=second_invariant,
        return_map=return_map,
        return_slopes=return_slopes,
        pack=pack,
    )
