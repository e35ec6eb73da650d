"""Isotropic elasticity and the Drucker-Prager cone with its apex, the one place they are written.

Stress is tension positive, sigma_m = tr(sigma)/3, f = sqrt(J2) + eta sigma_m - xi.

The pressure law lives at the nodes of the background grid, in both solvers (Bonet and Burton's 1998 nodal volume in
MPM form). A point carries theta_p, the volume strain it has reached; with uGIMP weights N and masses m

    d_i = sum_p N m d_p / sum_p N m,   theta_p += sum_i N d_i,   theta_i = sum_p N m theta_p / sum_p N m,
    sigma_i = K min(theta_i, xi/(eta K)),   sigma_m of a point = sum_i N sigma_i,

with d_p = ln det F of the step. What a node opens beyond the apex must close before it bears pressure again: theta_i
remembers it. Were the one-sided law at the eight points of a cell, only the most compressed would bear load: phi = 0
blocks lock, sand gains volume. The deviator is the point's own; `return_map` takes it to the cone at the mean stress
that the nodes give, and what plastic flow dilates at psi > 0 is taken from theta. sigma stands for Kirchhoff stress, in
both solvers.
"""

import functools
import math
from dataclasses import dataclass
from types import SimpleNamespace

import warp as wp

CONES = ("inner", "outer", "plane_strain")
# The law's own state variables with their units: what a point remembers where the material yields. Both solvers hand
# them on as one vector (see `mpm.law_state`); checkpoints and output fields have them by name.
LAW_STATE = {
    "eps_p_eqv": "-",  # equivalent plastic strain
}
# Elastic points never reach the cone. Finite, because inf - inf is NaN in the yield function.
NEVER_YIELDS = 1e30


@dataclass(frozen=True)
class Constants:
    """Material constants of one scene: moduli and strengths in Pa, the rest dimensionless.

    `eta`, `eta_bar` are the friction and dilatancy slopes of the cone, `xi` its cohesive strength [Pa].
    """

    bulk: float
    shear: float
    eta: float
    eta_bar: float
    xi: float
    density: float
    plastic: bool

    @property
    def young(self) -> float:
        """E = 9 K G/(3 K + G) [Pa]."""
        return 9.0 * self.bulk * self.shear / (3.0 * self.bulk + self.shear)

    @property
    def p_wave_modulus(self) -> float:
        """M = K + 4G/3 [Pa], the modulus of confined compression."""
        return self.bulk + 4.0 * self.shear / 3.0

    @property
    def p_wave_speed(self) -> float:
        """c = sqrt(M/rho) [m/s]."""
        return math.sqrt(self.p_wave_modulus / self.density)

    @property
    def opens_at(self) -> float:
        """Volume strain xi/(eta K) [-] of the apex, beyond which a node opens; NEVER_YIELDS where there is no apex."""
        stress_per_strain = self.eta * self.bulk  # zero where it underflows, too
        return self.xi / stress_per_strain if self.plastic and stress_per_strain > 0.0 else NEVER_YIELDS

    @property
    def law_state_start(self) -> tuple[float, ...]:
        """What each of LAW_STATE starts from; nothing where the material is elastic."""
        return (0.0,) if self.plastic else ()


def dilatancy_slope(angle_deg: float, cone: str) -> float:
    """Slope eta_bar of the flow potential for the dilatancy angle psi `angle_deg` [degrees].

    `plane_strain`: volume strain over greatest shear strain is sin(psi) in plane strain.
    """
    s = math.sin(math.radians(angle_deg))
    if cone == "plane_strain":
        return s / math.sqrt(1.0 + s * s / 3.0)
    return 6.0 * s / (math.sqrt(3.0) * (3.0 + s if cone == "inner" else 3.0 - s))


def friction_cone(phi_deg: float, cohesion: float, psi_deg: float, cone: str) -> tuple[float, float]:
    """Slope eta [-] and strength xi [Pa] of the cone that matches Mohr-Coulomb at phi, psi [degrees], c [Pa].

    `inner` meets it in triaxial extension, `outer` in triaxial compression. `plane_strain` meets it where plastic
    strain out of plane vanishes, at s_z = -2/3 eta_bar sqrt(J2): with A = sqrt(1 - eta_bar^2/3) the Mohr circle has
    radius A sqrt(J2) and centre sigma_m + eta_bar sqrt(J2)/3. At psi = 0 eta = sin(phi); for associated flow (psi =
    phi) it is the usual 3 tan(phi)/sqrt(9 + 12 tan(phi)^2).
    """
    s, c = math.sin(math.radians(phi_deg)), math.cos(math.radians(phi_deg))
    if cone == "plane_strain":
        eta_bar = dilatancy_slope(psi_deg, cone)
        size = math.sqrt(1.0 - eta_bar * eta_bar / 3.0) + eta_bar * s / 3.0
        return s / size, cohesion * c / size
    size = math.sqrt(3.0) * (3.0 + s if cone == "inner" else 3.0 - s)
    return 6.0 * s / size, 6.0 * cohesion * c / size


@functools.cache
def drucker_prager(real):
    """Return `Material` (a Warp struct), `pack`, which fills it, `LawState` (a vector, in the order of LAW_STATE) and
    the Warp functions of the law.

    `second_invariant(s)` is J2 of a deviator `s` (vec6: xx, yy, zz, yz, xz, xy) [Pa2].

    `node_law(theta, material)` is the pressure law: mean stress [Pa] of a node at volume strain `theta` [-];
    `node_slope` (same arguments) is its derivative over K [-], `node_gap` the volume strain by which it is open [-].

    `return_map(sigma_m, gap, root_j2, law_state, material)` takes the mean stress that the nodes give [Pa], at most
    xi/eta, the volume strain by which they are open beyond the apex [-] (read only where psi > 0), the trial sqrt(J2)
    [Pa] and the state of the law before the step. It gives (sigma_m, scale, dilation, law_state, work): mean stress
    [Pa], factor on the deviator, plastic volume strain [-], the state of the law after the step, plastic work per
    volume [J/m3]. eps_p_eqv grows by sqrt(2/3 eps_p:eps_p). Dilatancy fills the gap first, at no pressure, and then
    builds pressure: sigma_m + K (gap - eta_bar d_lambda).

    `return_slopes` (same arguments) differentiates it: (mean_m, mean_g, mean_r, root_m, root_g, root_r), derivatives of
    the returned mean stress and sqrt(J2) over sigma_m, K gap and root_j2. Within a regime they are constant.
    """
    name = f"repose_{real.__name__}"
    zero, one, half = (wp.constant(real(value)) for value in (0.0, 1.0, 0.5))
    third, two_ninths = (wp.constant(real(value)) for value in (1.0 / 3.0, 2.0 / 9.0))
    vec6, LawState = wp.types.vector(6, real), wp.types.vector(len(LAW_STATE), real)

    @wp.struct
    class Material:
        bulk: real
        shear: real
        eta: real
        eta_bar: real
        xi: real
        opens_at: real
        plastic: int

    @wp.func(module=name)
    def second_invariant(s: vec6):
        return half * (s[0] * s[0] + s[1] * s[1] + s[2] * s[2]) + s[3] * s[3] + s[4] * s[4] + s[5] * s[5]

    @wp.func(module=name)
    def node_law(theta: real, material: Material):
        return material.bulk * wp.min(theta, material.opens_at)

    @wp.func(module=name)
    def node_slope(theta: real, material: Material):
        if theta > material.opens_at:
            return zero
        return one

    @wp.func(module=name)
    def node_gap(theta: real, material: Material):
        return wp.max(theta - material.opens_at, zero)

    @wp.func(module=name)
    def return_map(sigma_m: real, gap: real, root_j2: real, law_state: LawState, material: Material):
        mean = sigma_m
        scale = one
        dilation = zero
        work = zero
        f = root_j2 + material.eta * sigma_m - material.xi
        if f > zero and root_j2 > zero:  # without a deviator only round-off lies beyond the apex
            d_lambda = f / material.shear
            if material.eta_bar * d_lambda > gap:
                d_lambda = (f + material.eta * material.bulk * gap) / (
                    material.shear + material.bulk * material.eta * material.eta_bar
                )
                mean = sigma_m + material.bulk * (gap - material.eta_bar * d_lambda)
            dilation = material.eta_bar * d_lambda
            scale = wp.max(root_j2 - material.shear * d_lambda, zero) / root_j2  # negative by round-off alone
            law_state[0] = law_state[0] + wp.sqrt(third * d_lambda * d_lambda + two_ninths * dilation * dilation)
            work = mean * dilation + scale * (one - scale) * root_j2 * root_j2 / material.shear
        return mean, scale, dilation, law_state, work

    @wp.func(module=name)
    def return_slopes(sigma_m: real, gap: real, root_j2: real, _law_state: LawState, material: Material):
        mean_m, mean_g, mean_r, root_m, root_g, root_r = one, zero, zero, zero, zero, one
        f = root_j2 + material.eta * sigma_m - material.xi
        if f > zero and root_j2 > zero:
            root_m, root_r = -material.eta, zero
            if material.eta_bar * f > material.shear * gap:
                per_f = one / (material.shear + material.bulk * material.eta * material.eta_bar)
                mean_m = one - material.bulk * material.eta_bar * material.eta * per_f
                mean_r = -material.bulk * material.eta_bar * per_f
                root_m, root_r = -material.shear * material.eta * per_f, one - material.shear * per_f
                mean_g, root_g = mean_m, root_m
        return mean_m, mean_g, mean_r, root_m, root_g, root_r

    def pack(constants: Constants) -> Material:
        """Material struct for kernels from host constants."""
        material = Material()
        material.bulk = constants.bulk
        material.shear = constants.shear
        material.eta = constants.eta
        material.eta_bar = constants.eta_bar
        material.xi = constants.xi if constants.plastic else NEVER_YIELDS
        material.opens_at = constants.opens_at
        material.plastic = int(constants.plastic)
        return material

    return SimpleNamespace(
        Material=Material,
        LawState=LawState,
        second_invariant=second_invariant,
        node_law=node_law,
        node_slope=node_slope,
        node_gap=node_gap,
        return_map=return_map,
        return_slopes=return_slopes,
        pack=pack,
    )
