"""Closed forms, and of which scenes they speak: the run-out R = (r_inf - r0)/r0 of a column with aspect ratio lambda0 =
h0/r0; the height at which a vertical cut stands.

Equation numbers are those of Wyser et al. 2023 (Geosciences 13, 119). Lengths of the run-out are in units of r0.
"""

import math

import numpy as np

from mpm.body import Body
from mpm.scene import Column, Scene

SQRT3 = np.sqrt(3.0)
EQ2_SWITCH = 0.74
CUT_STABILITY = 3.83  # rho g h/c at which a vertical cut without friction falls, on a circular slip surface


def eq2(lambda0, tan_theta):
    """Semi-empirical dynamic run-out [-] (Eq. 2, after Lajeunesse): truncated cone, from lambda0 = 0.74 a root.

    `lambda0` and `tan_theta` [-] broadcast. As printed the branches do not meet: for tan(theta) = 0.77 the run-out
    jumps from 0.44 to 0.73. NaN where lambda0 < 0.74 exceeds 2 sqrt3 tan(theta), which makes the cone's root complex.
    """
    lambda0 = np.asarray(lambda0, float)
    power_law = np.sqrt(3.0 * lambda0 / EQ2_SWITCH) - 1.0
    return np.where(lambda0 < EQ2_SWITCH, _truncated_cone(lambda0 / tan_theta), power_law)


def eq4(lambda0, tan_theta):
    """Quasistatic run-out [-] (Eq. 4): truncated cone with its top at h0, full cone from lambda0 = sqrt3 tan(theta).

    `lambda0` and `tan_theta` [-] broadcast. Continuous, with its slope, at the switch.
    """
    a = np.asarray(lambda0, float) / tan_theta
    return np.where(a < SQRT3, _truncated_cone(a), np.cbrt(3.0 * a) - 1.0)


def dynamic_slope(lambda0, tan_phi):
    """tan(theta) of the dynamic deposit (Eq. 5), from the yield angle's tangent and lambda0 [-]."""
    return np.sqrt(tan_phi**3 / (3.0 * np.asarray(lambda0, float)))


def eq45(lambda0, tan_phi):
    """Dynamic run-out [-]: Eq. 5 in Eq. 4. Its switch falls at lambda0 = tan(phi), so no root turns complex."""
    return eq4(lambda0, dynamic_slope(lambda0, tan_phi))


def eq6(lambda0):
    """Power law fitted to the experiments, 1.30 lambda0^0.63 [-].

    Prefactor and exponent are exchanged against the paper's print (`eq6_printed`): so the RMSE against the digitised
    experiments is the 0.13 that the paper states.
    """
    return 1.30 * np.asarray(lambda0, float) ** 0.63


def eq6_printed(lambda0):
    """The power law as the paper prints it, 0.63 lambda0^1.30 [-]: it misses the experiments by an RMSE of 0.41."""
    return 0.63 * np.asarray(lambda0, float) ** 1.30


def quasistatic_profile(lambda0, tan_theta, r):
    """Height h(r) [-] of Eq. 4's solid at radii `r` [-]: flank of slope tan(theta), top cut at h0."""
    r_inf = 1.0 + eq4(lambda0, tan_theta)
    return np.clip(tan_theta * (r_inf - np.asarray(r, float)), 0.0, lambda0)


def critical_height(cohesion, density, gravity, friction_angle):
    """Height [m] up to which a vertical cut stands, 3.83 c/(rho g) tan(45 degrees + phi/2).

    `cohesion` c [Pa], `density` rho [kg/m3], `gravity` g [m/s2] > 0, `friction_angle` phi [degrees]. Terzaghi's form
    for plane strain with the stability number of a circular slip (Fellenius; 4 on a plane one).
    """
    return CUT_STABILITY * cohesion / (density * gravity) * np.tan(np.radians(45.0 + 0.5 * friction_angle))


def _truncated_cone(a):
    """Run-out [-] of the truncated cone with its top at h0, a = lambda0/tan(theta); NaN beyond a = 2 sqrt3."""
    square = 4.0 - a * a / 3.0
    return 0.5 * (a + np.sqrt(np.where(square < 0.0, np.nan, square))) - 1.0


def tan_phi(scene: Scene) -> float:
    """Slope [-] of the scene's angle of friction. Eq. 4 takes it for tan(theta), that of the angle of repose."""
    return math.tan(math.radians(scene.material.friction_angle))


def has_eq4(scene: Scene) -> bool:
    """Whether Eq. 4 speaks of this scene: a column that only friction holds and that gravity pulls."""
    material = scene.material
    only_friction = material.model != "elastic" and material.cohesion == 0 and material.friction_angle > 0
    return isinstance(scene.geometry, Column) and only_friction and scene.loads.gravity > 0


def theory(scene: Scene) -> dict[str, float | None]:
    """Run-outs of Eq. 4 and of Eq. 5 in Eq. 4 with theta = phi [-]; None where Eq. 4 does not speak of the scene."""
    if not has_eq4(scene):
        return {"eq4": None, "eq45": None}
    lambda0, slope = scene.geometry.aspect_ratio, tan_phi(scene)
    return {"eq4": float(eq4(lambda0, slope)), "eq45": float(eq45(lambda0, slope))}


def outlook(body: Body) -> str:
    """What is to be expected of a column with cohesion, of which Eq. 4 does not speak, in a line; "" of all others.

    It stands where it is no higher than a vertical cut that stands (`mpm.theory.critical_height`).
    """
    scene, material = body.scene, body.scene.material
    cohesive = material.model != "elastic" and material.cohesion > 0 and scene.loads.gravity > 0
    if not (cohesive and isinstance(scene.geometry, Column)):
        return ""
    critical = critical_height(material.cohesion, material.density, scene.loads.gravity, material.friction_angle)
    cut = f"that of a vertical cut that just stands, 3.83 c/(rho g) tan(45 degrees + phi/2) = {critical:.3g} m"
    if body.height <= critical:
        return f"it stands: its height {body.height:g} m is below {cut}; no Eq. 4, as there is no run-out"
    return f"no Eq. 4, which is for what only friction holds: the height {body.height:g} m is above {cut}"
