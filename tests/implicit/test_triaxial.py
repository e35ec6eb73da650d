"""One material point in triaxial compression, through the kernels that the solver uses."""

import numpy as np
import pytest
import warp as wp

from mpm.devices import start_warp
from mpm.drucker_prager import Constants, cone_slope
from mpm.errors import SceneError

pytest.importorskip("implicit._dolfinx", reason="dolfinx or petsc4py is not installed", exc_type=SceneError)
from implicit.kernels import points
from implicit.kernels.layout import LAW, OUTSIDE, STENCIL, mat33, real, vec3, vec6

YOUNG, POISSON, PHI, PSI = 25e6, 0.3, 35.0, 5.0
CELL_PRESSURE, AXIAL_STRAIN, STEPS = 150e3, 0.1, 100
DEVIATOR_STRESS = 403.526e3  # (sigma_1/sigma_3 - 1) times the cell pressure; GeoWarp has 403.5259 kPa
MOST_ITERATIONS = 8


def constants(apex_memory):
    bulk, shear = YOUNG / (3.0 * (1.0 - 2.0 * POISSON)), YOUNG / (2.0 * (1.0 + POISSON))
    slopes = cone_slope(PHI, "outer"), cone_slope(PSI, "outer")
    return Constants(bulk, shear, *slopes, 0.0, 2000.0, True, apex_memory)


class Element:
    """A point in the middle of one linear cell of unit size, whose eight nodes follow a prescribed stretch."""

    def __init__(self, law: Constants, mean: float):
        start_warp()
        self.material = LAW.pack(law)
        corners = np.argwhere(np.ones((2, 2, 2)))
        nodes = np.full((1, STENCIL), OUTSIDE, np.int32)
        nodes[0, corners @ [9, 3, 1]] = np.arange(8)
        self.corners = corners - 0.5
        self.u = wp.zeros(8, dtype=vec3, device="cpu")
        self.basis = [
            wp.array(nodes, dtype=wp.int32, device="cpu"),
            wp.array([[2, 2, 2]], dtype=wp.vec3i, device="cpu"),
            wp.array(np.tile([0.5, 0.5, 0.0], (1, 3, 1)), dtype=mat33, device="cpu"),
            wp.array(np.tile([-1.0, 1.0, 0.0], (1, 3, 1)), dtype=mat33, device="cpu"),
        ]
        self.b_e = wp.array([np.exp(2.0 * mean / (3.0 * law.bulk)) * np.eye(3)], dtype=mat33, device="cpu")
        self.jacobian = wp.full(1, real(1.0), dtype=real, device="cpu")
        self.opening = wp.zeros(int(law.apex_memory), dtype=real, device="cpu")
        self.eps_p_eqv = wp.zeros(1, dtype=real, device="cpu")
        self.x, self.moved = wp.zeros(1, dtype=vec3, device="cpu"), wp.zeros(1, dtype=vec3, device="cpu")

    def stretch(self, lateral, axial):
        """u = (F - I) x at the nodes for F = diag(lateral, lateral, axial)."""
        self.u.numpy()[:] = self.corners * (np.array([lateral, lateral, axial]) - 1.0)

    def lateral_stress(self, lateral, axial):
        """Lateral Cauchy stress [Pa] at this increment, and its derivative over the lateral stretch.

        P = tau F^-T, so that sigma_xx = P_xx/(J lateral axial), J at the start of the step.
        """
        self.stretch(lateral, axial)
        flux, tangent = wp.zeros(1, dtype=mat33, device="cpu"), wp.zeros((1, 9), dtype=mat33, device="cpu")
        smallest = wp.full(1, real(1.0), dtype=real, device="cpu")
        state = [self.u, *self.basis, self.b_e, self.opening, self.material, real(0.0)]
        wp.launch(points.stress_flux, 1, inputs=[*state, flux, smallest], device="cpu")
        wp.launch(points.tangent_flux, 1, inputs=[*state, real(0.0), tangent], device="cpu")
        p, t = flux.numpy()[0, 0, 0], tangent.numpy()[0]
        slope = t[0][0, 0] + t[1][0, 1]  # dP_xx/dF_xx + dP_xx/dF_yy
        area = self.jacobian.numpy()[0] * lateral * axial
        return p / area, slope / area - p / (area * lateral)

    def commit(self, lateral, axial):
        self.stretch(lateral, axial)
        changed = [self.x, self.b_e, self.jacobian, self.opening, self.eps_p_eqv, self.moved]
        wp.launch(points.commit, 1, inputs=[self.u, *self.basis, self.material, real(0.0), *changed], device="cpu")

    @property
    def sigma(self):
        """Cauchy stress (6,) [Pa]."""
        sigma = wp.zeros(1, dtype=vec6, device="cpu")
        wp.launch(points.cauchy, 1, inputs=[self.b_e, self.jacobian, self.material, sigma], device="cpu")
        return sigma.numpy()[0]


@pytest.mark.parametrize("apex_memory", [True, False])
def test_triaxial_compression(apex_memory):
    """10 % of axial strain at constant cell pressure, the lateral stretch found by Newton's method in each step.

    The deviator stress is the closed form's, from sigma_1/sigma_3 = (sqrt3 + 2 eta)/(sqrt3 - eta), once the point
    yields: to six digits, with or without the memory of the apex, which compression never reaches. The volume grows
    by plastic flow eta_bar d_lambda on an axial plastic strain of d_lambda (eta_bar/3 - 1/sqrt3), corrected for the
    elastic strain, which follows tau = J sigma.
    """
    law = constants(apex_memory)
    exact = (np.sqrt(3.0) + 2.0 * law.eta) / (np.sqrt(3.0) - law.eta)
    assert (exact - 1.0) * CELL_PRESSURE == pytest.approx(DEVIATOR_STRESS, rel=1e-6)
    element = Element(law, -CELL_PRESSURE)
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
        element.commit(lateral, axial)
        assert element.sigma[:2] == pytest.approx(-CELL_PRESSURE, rel=1e-8)
        deviator.append(abs(element.sigma[2] - element.sigma[0]))
        volume.append(element.jacobian.numpy()[0])
    deviator = np.array(deviator)
    assert np.all(np.diff(deviator[:10]) > 0.0)  # elastic up to some 2 % of strain
    assert deviator[-50:] == pytest.approx(DEVIATOR_STRESS, rel=1e-6)
    assert deviator[-1] == pytest.approx((exact - 1.0) * CELL_PRESSURE, rel=1e-8)

    elastic = 0.5 * np.log(np.diag(element.b_e.numpy()[0]))
    flow = law.eta_bar / (law.eta_bar / 3.0 - 1.0 / np.sqrt(3.0))
    grown = flow * np.log(axial) / (1.0 - elastic.sum() + flow * elastic[2])
    assert np.log(volume[-1] / volume[-2]) == pytest.approx(grown, rel=1e-3)
    assert volume[-1] > 1.0
