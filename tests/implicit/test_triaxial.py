"""One material point in triaxial compression, through the kernels that the solver uses."""

import numpy as np
import pytest
import warp as wp

from compare.hard.law import FinitePoint
from mpm.drucker_prager import Constants, dilatancy_slope, friction_cone
from mpm.errors import SceneError

pytest.importorskip("implicit._dolfinx", reason="dolfinx or petsc4py is not installed", exc_type=SceneError)
from implicit.kernels import points
from implicit.kernels.layout import mat33, real

YOUNG, POISSON, PHI, PSI = 25e6, 0.3, 35.0, 5.0
CELL_PRESSURE, AXIAL_STRAIN, STEPS = 150e3, 0.1, 100
DEVIATOR_STRESS = 403.526e3  # (sigma_1/sigma_3 - 1) times the cell pressure; GeoWarp has 403.5259 kPa
MOST_ITERATIONS = 8


def constants():
    bulk, shear = YOUNG / (3.0 * (1.0 - 2.0 * POISSON)), YOUNG / (2.0 * (1.0 + POISSON))
    eta, xi = friction_cone(PHI, 0.0, PSI, "outer")
    return Constants(bulk, shear, eta, dilatancy_slope(PSI, "outer"), xi, 2000.0, True)


def array(values, dtype):
    return wp.array(values, dtype=dtype, device="cpu")


class Element(FinitePoint):
    """A point in triaxial compression: F = diag(lateral, lateral, axial)."""

    @staticmethod
    def gradient(lateral, axial):
        return np.diag([lateral, lateral, axial]) - np.eye(3)

    def lateral_stress(self, lateral, axial):
        """Lateral Cauchy stress [Pa] at this increment, and its derivative over the lateral stretch.

        P = tau F^-T, so that sigma_xx = P_xx/(J lateral axial), J at the start of the step. The coupling's share of
        dP_xx is the work of its nodal forces on a stretch along x.
        """
        strained, v = self.deform(self.gradient(lateral, axial)), self.volume_law
        flux, tangent = array(np.zeros((1, 3, 3)), mat33), array(np.zeros((1, 9, 3, 3)), mat33)
        wp.launch(points.stress_flux, 1, inputs=[*strained, flux], device="cpu")
        v.set_slopes(0.0)
        outputs = [real(0.0), v.closed, real(v.own_share), v.filled, tangent, v.volumetric]
        wp.launch(points.tangent_flux, 1, inputs=[*strained, *outputs], device="cpu")
        v.linearise()
        p, t = flux.numpy()[0, 0, 0], tangent.numpy()[0]
        coupling = v.coupling((self.corners * [1.0, 1.0, 0.0]).ravel()).reshape(8, 3)
        slope = t[0][0, 0] + t[1][0, 1] + coupling[:, 0] @ self.corners[:, 0]  # dP_xx/dF_xx + dP_xx/dF_yy
        area = self.state.jacobian.numpy()[0] * lateral * axial
        return p / area, slope / area - p / (area * lateral)


def test_triaxial_compression():
    """10 % of axial strain at constant cell pressure, the lateral stretch found by Newton's method in each step.

    The deviator stress is the closed form's, from sigma_1/sigma_3 = (sqrt3 + 2 eta)/(sqrt3 - eta), once the point
    yields: to six digits. The volume grows by plastic flow eta_bar d_lambda on an axial plastic strain of d_lambda
    (eta_bar/3 - 1/sqrt3), corrected for the elastic strain, which follows tau = J sigma.
    """
    law = constants()
    exact = (np.sqrt(3.0) + 2.0 * law.eta) / (np.sqrt(3.0) - law.eta)
    assert (exact - 1.0) * CELL_PRESSURE == pytest.approx(DEVIATOR_STRESS, rel=1e-6)
    element = Element(law, CELL_PRESSURE)
    assert element.sigma == pytest.approx([-CELL_PRESSURE] * 3 + [0.0] * 3, rel=1e-12, abs=1e-9)

    lateral, deviator, volume = 1.0, [], [1.0]
    for step in range(STEPS):
        axial = (1.0 - AXIAL_STRAIN * (step + 1) / STEPS) / (1.0 - AXIAL_STRAIN * step / STEPS)
        for _ in range(MOST_ITERATIONS):
            stress, slope = element.lateral_stress(lateral, axial)
            if abs(stress + CELL_PRESSURE) < 1e-9 * CELL_PRESSURE:
                break
            lateral -= (stress + CELL_PRESSURE) / slope
        else:
            pytest.fail(f"step {step}: lateral stress {stress:.6g} Pa after {MOST_ITERATIONS} iterations")
        element.strain(Element.gradient(lateral, axial))
        assert element.sigma[:2] == pytest.approx(-CELL_PRESSURE, rel=1e-8)
        deviator.append(abs(element.sigma[2] - element.sigma[0]))
        volume.append(element.state.jacobian.numpy()[0])
    deviator = np.array(deviator)
    assert np.all(np.diff(deviator[:10]) > 0.0)  # elastic up to some 2 % of strain
    assert deviator[-50:] == pytest.approx(DEVIATOR_STRESS, rel=1e-6)
    assert deviator[-1] == pytest.approx((exact - 1.0) * CELL_PRESSURE, rel=1e-8)

    elastic = 0.5 * np.log(np.diag(element.b_e.numpy()[0])) + element.state.mean.numpy()[0] / (3.0 * law.bulk)
    flow = law.eta_bar / (law.eta_bar / 3.0 - 1.0 / np.sqrt(3.0))
    grown = flow * np.log(axial) / (1.0 - elastic.sum() + flow * elastic[2])
    assert np.log(volume[-1] / volume[-2]) == pytest.approx(grown, rel=1e-3)
    assert volume[-1] > 1.0
