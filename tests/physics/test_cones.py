"""The cones against Mohr-Coulomb, each in the state that it is matched to, and tests that bring sand to that state.

Tension positive: Mohr-Coulomb is (s1 - s3)/2 + (s1 + s3)/2 sin(phi) - c cos(phi) = 0 with s1 the largest principal
stress and s3 the smallest.
"""

import math

import numpy as np
import pytest

from compare.hard.law import SAND, return_map
from mpm.drucker_prager import CONES, dilatancy_slope, friction_cone
from mpm.scene import Material

RANDOM = np.random.default_rng(3)
PHI = SAND["friction_angle"]


def invariants(stress):
    """sigma_m and sqrt(J2) of principal stresses (..., 3), and the deviator."""
    mean = stress.mean(axis=-1, keepdims=True)
    deviator = stress - mean
    return mean[..., 0], np.sqrt(0.5 * (deviator**2).sum(axis=-1)), deviator


def mohr_coulomb(stress, phi, cohesion):
    """Yield function [Pa] of principal stresses (..., 3), phi [radians]."""
    s1, s3 = stress.max(axis=-1), stress.min(axis=-1)
    return 0.5 * (s1 - s3) + 0.5 * (s1 + s3) * np.sin(phi) - cohesion * np.cos(phi)


# Constants


@pytest.mark.parametrize(
    ("cone", "psi", "eta"),
    [("inner", 0.0, 0.5849), ("outer", 0.0, 0.8831), ("plane_strain", 0.0, 0.6094), ("plane_strain", PHI, 0.5749)],
)
def test_friction_slopes_of_the_papers_sand(cone, psi, eta):
    assert friction_cone(PHI, 0.0, psi, cone)[0] == pytest.approx(eta, abs=1e-4)


@pytest.mark.parametrize("phi", [0.5, 20.0, 37.55, 80.0])
def test_plane_strain_cone_without_dilatancy_and_with_associated_flow(phi):
    """psi = 0: eta = sin(phi), xi = c cos(phi). psi = phi: 3 tan(phi) and 3 c over sqrt(9 + 12 tan(phi)^2)."""
    s, t = math.sin(math.radians(phi)), math.tan(math.radians(phi))
    assert friction_cone(phi, 1e3, 0.0, "plane_strain") == pytest.approx((s, 1e3 * s / t), rel=1e-13)
    size = math.sqrt(9.0 + 12.0 * t * t)
    assert friction_cone(phi, 1e3, phi, "plane_strain") == pytest.approx((3.0 * t / size, 3e3 / size), rel=1e-13)


@pytest.mark.parametrize("cone", CONES)
@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_all_cones_have_the_apex_of_mohr_coulomb(cone, share):
    """xi/eta = c cot(phi), whatever psi."""
    for phi in RANDOM.uniform(1.0, 80.0, 50):
        eta, xi = friction_cone(phi, 1e4, share * phi, cone)
        assert xi / eta == pytest.approx(1e4 / math.tan(math.radians(phi)), rel=1e-12)


@pytest.mark.parametrize("cone", CONES)
def test_dilatancy_slope_at_most_the_friction_slope(cone):
    """eta_bar = 0 at psi = 0 and eta at psi = phi, less between: plastic work d_lambda (xi - (eta - eta_bar) sigma_m)
    is never negative."""
    for phi in RANDOM.uniform(1.0, 80.0, 50):
        assert dilatancy_slope(0.0, cone) == 0.0
        assert dilatancy_slope(phi, cone) == pytest.approx(friction_cone(phi, 0.0, phi, cone)[0], rel=1e-13)
        for psi in RANDOM.uniform(0.0, phi, 10):
            assert dilatancy_slope(psi, cone) < friction_cone(phi, 0.0, psi, cone)[0]


# Yield surfaces


@pytest.mark.parametrize(("cone", "equal"), [("inner", "s3"), ("outer", "s1")])
def test_triaxial_states_on_mohr_coulomb_are_on_their_cone(cone, equal):
    """`inner` in triaxial extension (the two smaller principal stresses equal), `outer` in triaxial compression."""
    for phi_deg, psi_share, cohesion, s3 in RANDOM.uniform([1, 0, 0, -1e6], [80, 1, 1e5, 0], (200, 4)):
        phi = math.radians(phi_deg)
        s1 = (2.0 * cohesion * math.cos(phi) + s3 * (1.0 - math.sin(phi))) / (1.0 + math.sin(phi))
        if s1 < s3:
            continue  # beyond the apex
        stress = np.array([s1, s3 if equal == "s3" else s1, s3])
        scale = abs(s3) + cohesion
        assert mohr_coulomb(stress, phi, cohesion) == pytest.approx(0.0, abs=1e-12 * scale)
        mean, root, _ = invariants(stress)
        eta, xi = friction_cone(phi_deg, cohesion, psi_share * phi_deg, cone)
        assert root + eta * mean - xi == pytest.approx(0.0, abs=1e-12 * scale)


# Laboratory tests of one element, in small strain: Hooke's law and the return map on principal stresses

CELL_PRESSURE = 1e4  # [Pa]


def compress(law, lateral, steps=400, step=-1e-3):
    """Axial compression under the cell pressure in `steps` strain increments `step` [-], and what the last one did.

    `lateral`: principal directions that the cell pressure acts on; it is [0, 1] in a triaxial test, with axis 2 axial,
    and [0] in plane strain, where direction 1 does not strain. Gives stress (3,) [Pa] and strain increment (3,) [-].
    """
    stress = np.full(3, -CELL_PRESSURE)
    for _ in range(steps):

        def stressed(strain, stress=stress):
            """Stresses (n, 3) after the increments (n, 3)."""
            dilation = strain.sum(axis=1, keepdims=True)
            trial = stress + 2.0 * law.shear * (strain - dilation / 3.0) + law.bulk * dilation
            mean, root_j2, deviator = invariants(trial)
            returned, root = return_map(mean, 0.0, root_j2, law)[:2]
            return returned[:, None] + deviator * (root / root_j2)[:, None]

        low, high = 0.0, 20.0 * abs(step)  # lateral stress grows with lateral strain
        for _ in range(8):
            strain = np.zeros((65, 3))
            strain[:, 2] = step
            strain[:, lateral] = np.linspace(low, high, 65)[:, None]
            after = stressed(strain)
            first = int(np.argmax(after[:, 0] > -CELL_PRESSURE))
            low, high = strain[first - 1, 0], strain[first, 0]
        stress, increment = after[first], strain[first]
    assert stress[lateral] == pytest.approx(-CELL_PRESSURE, rel=1e-9)
    return stress, increment


@pytest.mark.parametrize(("cone", "ratio"), [("inner", 2.5297), ("outer", 4.1210)])
@pytest.mark.parametrize("psi", [0.0, 10.0])
def test_triaxial_compression_ends_at_the_closed_form(cone, ratio, psi):
    """sigma_1/sigma_3 = (sqrt3 + 2 eta)/(sqrt3 - eta), which on the outer cone is Mohr-Coulomb's
    (1 + sin phi)/(1 - sin phi); volume over axial plastic strain is eta_bar over eta_bar/3 - 1/sqrt3."""
    law = Material(**SAND, cone=cone, dilatancy_angle=psi).constants()
    stress, strain = compress(law, [0, 1])
    exact = (math.sqrt(3.0) + 2.0 * law.eta) / (math.sqrt(3.0) - law.eta)
    assert exact == pytest.approx(ratio, abs=1e-4)
    assert stress[2] / stress[0] == pytest.approx(exact, rel=1e-6)
    if cone == "outer":
        s = math.sin(math.radians(PHI))
        assert exact == pytest.approx((1.0 + s) / (1.0 - s), rel=1e-12)
    volume_over_axial = law.eta_bar / (law.eta_bar / 3.0 - 1.0 / math.sqrt(3.0))
    assert strain.sum() / strain[2] == pytest.approx(volume_over_axial, abs=1e-6)


@pytest.mark.parametrize("cohesion", [0.0, 3e3])
@pytest.mark.parametrize("share", [0.0, 1.0 / 3.0, 1.0])
def test_plane_strain_compression_collapses_on_mohr_coulomb(cohesion, share):
    """For any psi, with volume strain over greatest shear strain sin(psi) and s_z = -2/3 eta_bar sqrt(J2)."""
    psi = share * PHI
    law = Material(**SAND, cohesion=cohesion, dilatancy_angle=psi).constants()
    stress, strain = compress(law, [0])
    _, root, deviator = invariants(stress)
    assert stress[2] < stress[1] < stress[0]
    assert deviator[1] == pytest.approx(-2.0 / 3.0 * law.eta_bar * root, abs=1e-6 * root)
    assert mohr_coulomb(stress, math.radians(PHI), cohesion) == pytest.approx(0.0, abs=1e-6 * CELL_PRESSURE)
    assert strain.sum() / (strain[0] - strain[2]) == pytest.approx(math.sin(math.radians(psi)), abs=1e-6)
