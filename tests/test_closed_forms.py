"""The closed forms of the tests: the balance that they solve, and integrals by quadrature."""

import numpy as np
import pytest
from closed_forms import self_weight_height, self_weight_stretch
from scipy.integrate import quad


@pytest.mark.parametrize("young", [1e4, 1e6, 1e9])
def test_self_weight_stretch_carries_what_lies_above(young):
    """tau/J = E ln(stretch)/stretch = -rho g depth, at every depth; no stretch at the top."""
    depth = np.linspace(0.0, 50.0, 101)
    stretch = self_weight_stretch(young, 80.0, 10.0, depth)
    assert young * np.log(stretch) / stretch == pytest.approx(-800.0 * depth, rel=1e-6, abs=1e-9 * young)
    assert stretch[0] == 1.0 and np.all(np.diff(stretch) < 0.0)


@pytest.mark.parametrize("young", [1e4, 1e6, 1e9])
def test_self_weight_height_is_the_stretch_integrated(young):
    """Against quadrature; stiff columns lose rho g h^2/(2 E), as linear elasticity has it."""
    numeric, _ = quad(lambda depth: self_weight_stretch(young, 80.0, 10.0, depth), 0.0, 50.0, epsabs=1e-12)
    assert self_weight_height(young, 80.0, 10.0, 50.0) == pytest.approx(numeric, rel=1e-12)
    if young == 1e9:
        assert 50.0 - numeric == pytest.approx(800.0 * 50.0**2 / (2.0 * young), rel=1e-4)
