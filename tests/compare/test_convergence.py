"""Richardson extrapolation: limit and order of errors made to a known law, and what has no limit."""

import numpy as np
import pytest

from compare.convergence import Limit, ensemble_limit, richardson
from compare.ensembles import Estimate

HALVED = (0.2, 0.1, 0.05)
UNEVEN = (1 / 8, 1 / 10, 1 / 16)  # as of 8, 10 and 16 cells across a radius


@pytest.mark.parametrize("factor", [0.3, -0.2])
@pytest.mark.parametrize("order", [0.5, 1.0, 2.0, 4.0])
@pytest.mark.parametrize("h", [HALVED, UNEVEN])
def test_limit_and_order_of_a_pure_power_are_found(h, order, factor):
    found = richardson(h, 0.7 + factor * np.array(h) ** order)
    assert found.converged and found.reason == ""
    assert found.value == pytest.approx(0.7, abs=1e-10)
    assert found.order == pytest.approx(order, abs=1e-8)


def test_by_hand():
    """Ratio 2, changes 0.4 and 0.1: the order is log2(4) = 2 and 0.1/3 is still to come."""
    found = richardson((4.0, 2.0, 1.0), (1.5, 1.1, 1.0))
    assert found.order == pytest.approx(2.0)
    assert found.value == pytest.approx(1.0 - 0.1 / 3)


def test_a_second_term_of_the_error_fades_as_the_grids_are_refined():
    """Of 1 + 0.5 h + h^2 the order tends to 1 as h, and the limit's error to 0 as h^2: a quarter of the cell."""
    coarse, fine = (richardson(h, 1.0 + 0.5 * h + h**2) for h in (np.array(HALVED) / 8, np.array(HALVED) / 32))
    assert abs(fine.order - 1.0) == pytest.approx(abs(coarse.order - 1.0) / 4, rel=0.1)
    assert abs(fine.value - 1.0) == pytest.approx(abs(coarse.value - 1.0) / 16, rel=0.2)


def test_the_finest_three_count_in_whatever_order_they_come():
    """The coarsest grid is far off the law of the others."""
    found = richardson((0.1, 0.4, 0.05, 0.2), (0.7 + 0.3 * 0.1, 9.0, 0.7 + 0.3 * 0.05, 0.7 + 0.3 * 0.2))
    assert found.value == pytest.approx(0.7) and found.order == pytest.approx(1.0)


def test_a_limit_far_from_the_finest_value_is_no_limit():
    """Changes 0.2 and 0.15 with ratio 2: the trend points to 0.65 - 0.15 (0.15/0.05) = 0.2."""
    found = richardson(HALVED, (1.0, 0.8, 0.65))
    assert not found.converged and "more than 20%" in found.reason


@pytest.mark.parametrize(
    ("f", "words"),
    [
        ((1.0, 1.2, 1.1), "oscillates"),
        ((1.0, 0.8, 0.9), "oscillates"),
        ((1.0, 1.1, 1.3), "not settling"),
        ((1.0, 1.0, 1.1), "not settling"),
        ((1.0, 1.5, 1.5), "hardly changes"),
        ((1.0, 1.5, 1.501), "hardly changes"),  # order 9
        ((1.0, 1.0, 1.0), "same value"),
        ((1.0, np.nan, 1.2), "no value"),
    ],
)
@pytest.mark.parametrize("h", [HALVED, UNEVEN])
def test_what_has_no_limit_says_why(h, f, words):
    found = richardson(h, f)
    assert not found.converged and words in found.reason
    assert np.isnan(found.value) and np.isnan(found.order)


@pytest.mark.parametrize("h", [HALVED, UNEVEN])
@pytest.mark.parametrize("law", [np.log, lambda h: h**-1.0, lambda h: h**0.1])
def test_a_law_without_a_limit_or_too_slow_for_one_is_not_settling(h, law):
    assert "not settling" in richardson(h, law(np.array(h))).reason


@pytest.mark.parametrize(
    ("h", "f"),
    [
        ((0.2, 0.1), (1.0, 1.1)),
        ((0.2, 0.1, 0.1), (1.0, 1.1, 1.2)),
        ((0.2, 0.1, 0.0), (1.0, 1.1, 1.2)),
        ((0.2, 0.1, 0.05), (1.0, 1.1)),
    ],
)
def test_grids_that_allow_no_extrapolation_are_refused(h, f):
    with pytest.raises(ValueError, match="grid sizes"):
        richardson(h, f)


def ensembles(means, error, n=5):
    return [Estimate(mean, error, n - 1.0, n) for mean in means]


def test_the_limit_of_ensembles_has_the_spread_of_the_extrapolation():
    """Order 1 held by means whose errors are small: value = f3 - (f2 - f3) for a ratio of 2, of which the order's own
    uncertainty is left: to first order d(value) = d(f1) - 4 d(f2) + 4 d(f3), sqrt(33) times the error of one."""
    found = ensemble_limit(HALVED, ensembles((0.9, 0.8, 0.75), 1e-4))
    assert found.known and (found.value, found.order) == (pytest.approx(0.7), pytest.approx(1.0))
    half = 2.776 * np.sqrt(33) * 1e-4  # as wide as t's; a sum of three t's is a little narrower
    assert found.low < 0.7 < found.high
    assert found.high - found.low == pytest.approx(2 * half, rel=0.15)


def test_grids_that_agree_within_three_percent_have_the_finest_ensemble_without_error_of_the_grid():
    """Half of a difference's interval is 2.306 sqrt(2) x 0.005 = 0.0163; 3 % of 0.7005 are 0.0210."""
    found = ensemble_limit(HALVED, ensembles((0.702, 0.701, 0.7005), 0.005))
    assert found.known and found.value == 0.7005 and np.isnan(found.order)
    assert found.high - found.value == pytest.approx(2.776 * 0.005, rel=1e-3)
    assert "changes by less than 3% over the three" in found.said and "without the error of its grid" in found.said
    oscillating = ensemble_limit(HALVED, ensembles((0.702, 0.701, 0.7015), 1e-6))  # more runs tell it no worse
    assert oscillating.known and oscillating.value == 0.7015


def test_a_change_that_does_not_show_in_wide_intervals_is_undecided():
    """The same means, the interval 0.0326: the coarsest may be 0.0341 off the finest."""
    found = ensemble_limit(HALVED, ensembles((0.702, 0.701, 0.7005), 0.01))
    assert found.undecided and not found.known and "allow one of 0.0341, more than 3% of the finest" in found.said


@pytest.mark.parametrize("n", [2, 3, 5, 20])
def test_fewer_runs_pass_no_grids_that_more_runs_do_not(n):
    """The finest ensemble is 20 % off the coarsest; with two runs no change between neighbours shows."""
    assert not ensemble_limit(UNEVEN, ensembles((0.40, 0.36, 0.32), 0.008, n)).known


@pytest.mark.parametrize(("lost", "low", "high"), [(0, 0.025, 0.974), (10, 0.025, 0.984), (25, 0.025, 0.999)])
def test_draws_without_a_limit_count_as_beyond_either_end(monkeypatch, lost, low, high):
    """The limits of the 1,000 draws are 0 to 0.999, without the first `lost`. 25 lie outside on either side: of 10 that
    have no limit 15 more, so that the interval reaches from the 16th of 990 to the 16th from above."""
    told = [Limit(0.5, 1.0, True, "")]  # of the means
    told += [Limit(draw / 1000, 1.0, draw >= lost, "") for draw in range(1000)]
    monkeypatch.setattr("compare.convergence.richardson", lambda _h, _f: told.pop(0))
    found = ensemble_limit(HALVED, ensembles((0.9, 0.8, 0.75), 1e-4))
    assert (found.low, found.high) == (low, high)


@pytest.mark.parametrize(
    ("means", "error", "n", "words"),
    [
        ((0.7, 0.8, 0.75), 1e-4, 5, "not converged: the value goes up with one refinement"),
        ((0.36, 0.345, 0.33), 0.006, 5, "is not settling"),  # neighbours do not differ, the ends do
        ((0.9, 0.8, 0.75), 0.01, 5, "of the draws have a limit"),  # the last change is of the size of its interval
        ((0.9, 0.8, 0.75), float("nan"), 1, "fewer than two runs"),
    ],
)
def test_ensembles_without_a_limit_say_why(means, error, n, words):
    found = ensemble_limit(HALVED, ensembles(means, error, n))
    assert not found.known and words in found.said
