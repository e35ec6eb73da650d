"""Point fields of snapshots: names, units, and what those are that follow from others."""

from collections.abc import Callable

import numpy as np

from mpm.drucker_prager import LAW_STATE, Constants

# What a snapshot can hold of every point, beside its position x [m]. Vectors have the components x, y, z, the stress
# (Cauchy's, tension positive) those of STRESS.
UNITS = {
    "displacement": "m",
    "velocity": "m/s",
    "stress": "Pa",
    **LAW_STATE,
    "pressure": "Pa",
    "deviatoric_stress": "Pa",
    "volume": "m3",
    "volume_ratio": "-",  # over the initial volume
    "friction_mobilised": "-",
}
STRESS = ("xx", "yy", "zz", "yz", "xz", "xy")
PLASTIC = (*LAW_STATE, "friction_mobilised")  # an elastic material has none of these


def pressure(stress) -> np.ndarray:
    """-tr(sigma)/3 (n,) [Pa] of `stress` (n, 6) [Pa]."""
    return -stress[:, :3].mean(axis=1)


def deviatoric_stress(stress) -> np.ndarray:
    """q = sqrt(3 J2) (n,) [Pa] of `stress` (n, 6) [Pa]; sigma_1 - sigma_3 in triaxial compression and extension."""
    deviator = stress[:, :3] + pressure(stress)[:, None]
    return np.sqrt(1.5 * (deviator**2).sum(axis=1) + 3.0 * (stress[:, 3:] ** 2).sum(axis=1))


def friction_mobilised(stress, volume_ratio, constants: Constants) -> np.ndarray:
    """Share of its strength that the material uses (n,) [-]: sqrt(J2)/(eta p + xi), 0 to 1, where it flows.

    sqrt(J2) and the pressure p are those of Kirchhoff's stress, J sigma, in which the cone is written (see
    `mpm.drucker_prager`); `stress` (n, 6) [Pa] is sigma, `volume_ratio` (n,) [-] J. Without cohesion it is the slope
    sqrt(J2)/p over the cone's slope eta. 0 where there is no stress.
    """
    tau = np.asarray(stress, float) * np.asarray(volume_ratio, float)[:, None]
    root_j2 = deviatoric_stress(tau) / np.sqrt(3.0)
    strength = np.maximum(constants.eta * pressure(tau) + constants.xi, 0.0)
    # Beyond the cone is round-off alone, at a strength of zero too.
    return np.divide(np.minimum(root_j2, strength), strength, out=np.zeros_like(strength), where=strength > 0.0)


# Fields that follow from others: from which, and the function of these and of the material's constants.
FOLLOWS: dict[str, tuple[tuple[str, ...], Callable[..., np.ndarray]]] = {
    "pressure": (("stress",), lambda stress, _constants: pressure(stress)),
    "deviatoric_stress": (("stress",), lambda stress, _constants: deviatoric_stress(stress)),
    "friction_mobilised": (("stress", "volume_ratio"), friction_mobilised),
}


def following(names, constants: Constants) -> list[str]:
    """Which fields follow from those called `names` and are not among them."""
    present = set(names)
    return [
        name
        for name, (needed, _) in FOLLOWS.items()
        if name not in present and present.issuperset(needed) and (constants.plastic or name not in PLASTIC)
    ]


def follow(name: str, field_of, constants: Constants) -> np.ndarray:
    """The field `name` from those that it follows from; `field_of(other)` gives the array of one of them."""
    needed, function = FOLLOWS[name]
    return function(*map(field_of, needed), constants)
