"""Point fields of snapshots: names, units, and what those are that follow from others."""

import numpy as np

from mpm.drucker_prager import Constants

# What a snapshot can hold of every point, beside its position x [m]. Vectors have the components x, y, z, the stress
# (Cauchy's, tension positive) those of STRESS.
UNITS = {
    "displacement": "m",
    "velocity": "m/s",
    "stress": "Pa",
    "eps_p_eqv": "-",  # equivalent plastic strain
    "pressure": "Pa",
    "volume": "m3",
    "volume_ratio": "-",  # over the initial volume
    "friction_mobilised": "-",
}
STRESS = ("xx", "yy", "zz", "yz", "xz", "xy")
PLASTIC = ("eps_p_eqv", "friction_mobilised")  # an elastic material has none of these


def pressure(stress) -> np.ndarray:
    """-tr(sigma)/3 (n,) [Pa] of `stress` (n, 6) [Pa]."""
    return -stress[:, :3].mean(axis=1)


def friction_mobilised(stress, volume_ratio, constants: Constants) -> np.ndarray:
    """Share of its strength that the material uses (n,) [-]: sqrt(J2)/(eta p + xi), 0 to 1, where it flows.

    sqrt(J2) and the pressure p are those of Kirchhoff's stress, J sigma, in which the cone is written (see
    `mpm.drucker_prager`); `stress` (n, 6) [Pa] is sigma, `volume_ratio` (n,) [-] J. Without cohesion it is the slope
    sqrt(J2)/p over the cone's slope eta. 0 where there is no stress.
    """
    tau = np.asarray(stress, float) * np.asarray(volume_ratio, float)[:, None]
    p = pressure(tau)
    deviator = tau[:, :3] + p[:, None]
    root_j2 = np.sqrt(0.5 * (deviator**2).sum(axis=1) + (tau[:, 3:] ** 2).sum(axis=1))
    strength = np.maximum(constants.eta * p + constants.xi, 0.0)
    # Beyond the cone is round-off alone, at a strength of zero too.
    return np.divide(np.minimum(root_j2, strength), strength, out=np.zeros_like(strength), where=strength > 0.0)
