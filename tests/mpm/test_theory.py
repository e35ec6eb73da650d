"""The closed forms: known values, smoothness where they change branch, and the volume they must keep."""

import numpy as np
import pytest
from scipy.integrate import quad

from compare.experiments import experiments
from mpm.theory import (
    dynamic_slope,
    eq2,
    eq4,
    eq6,
    eq6_printed,
    eq45,
    quasistatic_profile,
)

TAN = 0.77
LAMBDA0 = (0.5, 1.0, 2.0, 4.0, 8.0)
# Worked out by hand from the paper's equations, to four digits.
EQ4 = (0.3069, 0.5764, 0.9825, 1.4978, 2.1471)
EQ45 = (0.4183, 0.9739, 1.7915, 2.9477, 4.5829)
EQ6 = (0.8400, 1.3000, 2.0118, 3.1134, 4.8183)
EQ6_PRINTED = (0.2559, 0.6300, 1.5512, 3.8196, 9.4050)
# (lambda0 + (4 tan^2 - lambda0^2/3)^(1/2))/(2 tan) - 1 below 0.74, (3 lambda0/0.74)^(1/2) - 1 from there.
EQ2 = {0.25: 0.1579, 0.5: 0.3069, 1.0: 1.0135, 2.0: 1.8475, 4.0: 3.0269, 8.0: 4.6949}

EQ4_SWITCH = np.sqrt(3.0) * TAN  # the full cone's apex is at h0
EQ45_SWITCH = TAN


@pytest.mark.parametrize(("lambda0", "expected"), [*zip(LAMBDA0, EQ4, strict=True)])
def test_eq4_values(lambda0, expected):
    assert round(float(eq4(lambda0, TAN)), 4) == expected


@pytest.mark.parametrize(("lambda0", "expected"), [*zip(LAMBDA0, EQ45, strict=True)])
def test_eq5_in_eq4_values(lambda0, expected):
    assert round(float(eq45(lambda0, TAN)), 4) == expected


@pytest.mark.parametrize(("lambda0", "expected"), [*zip(LAMBDA0, EQ6, strict=True)])
def test_eq6_values(lambda0, expected):
    assert round(float(eq6(lambda0)), 4) == expected


@pytest.mark.parametrize(("lambda0", "expected"), [*zip(LAMBDA0, EQ6_PRINTED, strict=True)])
def test_eq6_values_as_printed(lambda0, expected):
    assert round(float(eq6_printed(lambda0)), 4) == expected


@pytest.mark.parametrize(("function", "rmse"), [(eq6, 0.129), (eq6_printed, 0.411)])
def test_rmse_of_eq6_against_the_experiments(function, rmse):
    """The paper states 0.13."""
    lambda0, measured = experiments().T
    assert np.sqrt(np.mean((function(lambda0) - measured) ** 2)) == pytest.approx(rmse, abs=5e-4)


@pytest.mark.parametrize(("lambda0", "expected"), EQ2.items())
def test_eq2_values(lambda0, expected):
    assert round(float(eq2(lambda0, TAN)), 4) == expected


def test_eq2_jumps_where_its_branches_meet():
    below, at = eq2(np.array([np.nextafter(0.74, 0.0), 0.74]), TAN)
    assert round(below, 2) == 0.44
    assert round(at, 2) == 0.73


@pytest.mark.parametrize("tangent", [0.25, TAN, 3.0])
def test_eq2_is_real_for_every_lambda0_up_to_20(tangent):
    lambda0 = np.linspace(1e-3, 20.0, 20_000)
    with np.errstate(all="raise"):
        assert np.all(np.isfinite(eq2(lambda0, tangent)))


def test_eq2_is_nan_where_its_root_is_complex():
    """4 tan^2 < lambda0^2/3 from lambda0 = 0.5 on for tan = 0.5/sqrt 12; the other branch has no such root."""
    tangent = 0.5 / np.sqrt(12.0)
    values = eq2(np.array([0.499, 0.501, 0.739, 0.74]), tangent)
    np.testing.assert_array_equal(np.isnan(values), [False, True, True, False])


def test_arrays_give_what_scalars_give():
    np.testing.assert_allclose(eq2(np.array(list(EQ2)), TAN), list(EQ2.values()), atol=5e-5)
    np.testing.assert_allclose(eq4(np.array(LAMBDA0), TAN), EQ4, atol=5e-5)
    np.testing.assert_allclose(eq45(np.array(LAMBDA0), TAN), EQ45, atol=5e-5)
    assert eq4(np.array(LAMBDA0)[:, None], np.array([0.5, TAN])).shape == (5, 2)


@pytest.mark.parametrize(("function", "switch"), [(eq4, EQ4_SWITCH), (eq45, EQ45_SWITCH)])
def test_value_and_slope_are_continuous_at_the_switch(function, switch):
    step = 1e-5
    below, at, above = (float(function(switch + k * step, TAN)) for k in (-1, 0, 1))
    assert below < at < above
    assert (above - at) / step == pytest.approx((at - below) / step, rel=1e-4)


def test_eq4_rises_with_a_third_of_lambda0_over_tan_theta_at_the_switch():
    """By hand: (1 - a/3 / sqrt(4 - a^2/3))/2 and (3 a)^(-2/3) are both 1/3 at a = sqrt 3."""
    step = 1e-6
    slope = (eq4(EQ4_SWITCH + step, TAN) - eq4(EQ4_SWITCH - step, TAN)) / (2 * step)
    assert float(slope) == pytest.approx(1 / (3 * TAN), rel=1e-6)


def test_the_switch_of_eq4_is_where_the_cone_just_reaches_the_columns_top():
    r_inf = 1.0 + float(eq4(EQ4_SWITCH, TAN))
    assert r_inf * TAN == pytest.approx(EQ4_SWITCH)


@pytest.mark.parametrize("tangent", [0.2, TAN, 1.5])
@pytest.mark.parametrize("lambda0", [0.01, 0.3, 0.5, 1.0, 1.3, 1.4, 4.0, 20.0])
def test_eq4s_solid_has_the_columns_volume(lambda0, tangent):
    r_inf = 1.0 + float(eq4(lambda0, tangent))
    kink = r_inf - lambda0 / tangent  # radius of the flat top, negative for a full cone
    volume, _ = quad(
        lambda r: 2.0 * np.pi * r * float(quasistatic_profile(lambda0, tangent, r)),
        0.0,
        r_inf,
        points=[kink] if kink > 0 else None,
    )
    assert volume == pytest.approx(np.pi * lambda0, rel=1e-9)


def test_profile_is_a_flat_top_then_a_flank_of_the_given_slope():
    r_inf = 1.0 + float(eq4(0.5, TAN))
    height = quasistatic_profile(0.5, TAN, np.array([0.0, r_inf - 0.2, r_inf - 0.1, r_inf, r_inf + 1.0]))
    np.testing.assert_allclose(height, [0.5, 0.2 * TAN, 0.1 * TAN, 0.0, 0.0], atol=1e-12)


def test_dynamic_slope_falls_with_height():
    assert float(dynamic_slope(TAN, TAN)) == pytest.approx(TAN / np.sqrt(3.0))
    assert np.all(np.diff(dynamic_slope(np.array(LAMBDA0), TAN)) < 0)


@pytest.mark.parametrize("tangent", [0.05, TAN, 3.0])
def test_no_lambda0_up_to_20_gives_nan_and_run_out_grows(tangent):
    lambda0 = np.concatenate([[1e-12, 1e-6], np.linspace(1e-3, 20.0, 20_000), [np.sqrt(3.0) * tangent, tangent]])
    lambda0.sort()
    with np.errstate(all="raise"):
        for values in (eq4(lambda0, tangent), eq45(lambda0, tangent), eq6(lambda0), eq6_printed(lambda0)):
            assert np.all(np.isfinite(values))
            assert np.all(values >= 0)
            assert np.all(np.diff(values) >= -1e-12)
