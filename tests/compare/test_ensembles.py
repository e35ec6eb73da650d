"""Ensembles: intervals against tables of Student's t and SciPy's tests, and when a claim holds."""

import math

import numpy as np
import pytest
from scipy import stats

from compare.batch import Job, Workers
from compare.ensembles import (
    Estimate,
    Part,
    difference,
    ensemble,
    estimate,
    flat,
    joined,
    paired,
    relative,
    run_ensembles,
    within,
)
from mpm.errors import SceneError

FIVE, FOUR = (0.61, 0.60, 0.62, 0.59, 0.63), (0.50, 0.54, 0.51, 0.53)


def test_mean_error_and_interval_by_hand():
    """Standard deviation sqrt(0.001/4) = 0.01581, over sqrt(5): 0.007071; t of four degrees at 95 % is 2.776."""
    found = estimate(FIVE)
    assert (found.mean, found.n) == (pytest.approx(0.61), 5)
    assert found.standard_error == pytest.approx(0.0070711, abs=1e-7)
    assert found.half == pytest.approx(2.776 * 0.0070711, rel=1e-3)
    assert (found.low, found.high) == stats.t.interval(0.95, 4, loc=found.mean, scale=found.standard_error)
    assert found.said() == "0.610 ± 0.020"
    assert found.over(0.5).said("+.1%") == "+22.0% ± 3.9%"


def test_failed_runs_are_left_out_and_one_run_has_no_interval():
    assert estimate([0.2, None, math.nan, 0.4]).n == 2
    one = estimate([0.3, None])
    assert math.isnan(one.standard_error) and one.half == math.inf and one.said() == "0.300"
    assert within(one, -math.inf, math.inf) is None
    assert estimate([None]) is None


def test_a_difference_is_welchs():
    a, b = estimate(FIVE), estimate(FOUR)
    found = difference(a, b)
    against = stats.ttest_ind(FIVE, FOUR, equal_var=False)
    assert found.mean / found.standard_error == pytest.approx(against.statistic)
    assert 2 * stats.t.sf(abs(against.statistic), found.freedom) == pytest.approx(against.pvalue)
    assert difference(estimate([1.0, 1.0]), estimate([3.0, 3.0])).half == 0.0
    assert difference(a, estimate([0.3])).half == math.inf


def test_the_interval_of_a_ratio_covers_the_ratio_as_often_as_it_says():
    """1,000 pairs of ensembles of 5, whose means are 0.33 and 0.30: 95 % of the intervals cover 0.1, within 2 %."""
    draw = np.random.default_rng(1)
    throws = zip(draw.normal(0.33, 0.004, (1000, 5)), draw.normal(0.30, 0.004, (1000, 5)), strict=True)
    found = [relative(estimate(a), estimate(b)) for a, b in throws]
    assert np.mean([one.low <= 0.1 <= one.high for one in found]) == pytest.approx(0.95, abs=0.02)


def test_pairs_tell_a_small_change_of_scattered_runs():
    """Runs that scatter by 3 %, each 0.1 % longer: the pairs know it exactly, the means to 4 %."""
    longer = [1.001 * value for value in FIVE]
    assert paired(longer, FIVE).mean == pytest.approx(1e-3) and paired(longer, FIVE).half < 1e-12
    assert relative(estimate(longer), estimate(FIVE)).half > 0.03
    assert paired([0.2, None, 0.3], [0.1, 0.1, None]).n == 1
    assert paired([None], [0.1]) is None


@pytest.mark.parametrize(
    ("mean", "holds"),
    [(0.05, True), (-0.05, True), (0.09, None), (0.11, None), (0.13, False), (-0.13, False)],
)
def test_a_claim_holds_when_its_whole_interval_does(mean, holds):
    """Half of the interval is 4.303 x 0.005 = 0.0215, the limits are -0.1 and 0.1."""
    assert within(Estimate(mean, 0.005, 2.0, 3), -0.1, 0.1) is holds


def test_realisations_are_one_job_from_several_random_starts():
    jobs = ensemble(Job("D0.4-0.5", "column_small", ("grid.cell=0.25",), "explicit"), 3)
    assert [one.name for one in jobs] == ["D0.4-0.5-r0", "D0.4-0.5-r1", "D0.4-0.5-r2"]
    assert [(one.scene.grid.scatter, one.scene.grid.realisation) for one in jobs] == [(0.5, 0), (0.5, 1), (0.5, 2)]
    assert len({one.key for one in jobs}) == 3


def test_one_realisation_is_refused(tmp_path):
    with pytest.raises(SceneError, match="realisations 1: must be >= 2"):
        run_ensembles([], 1, tmp_path, Workers(), False, None)


def test_a_row_of_a_table_has_mean_half_and_number():
    row = flat({"D": 0.4, "R": estimate(FIVE), "H": None}, ("R", "H"))
    assert row == {"D": 0.4, "R": pytest.approx(0.61), "R_half": pytest.approx(0.01963, abs=1e-5), "R_n": 5} | {
        "H": None, "H_half": None, "H_n": 0,
    }  # fmt: skip


def test_of_many_cases_those_that_do_not_hold_are_named():
    means = (("a", 0.5), ("b", 2.0), ("c", 1.0))
    good, bad, open_ = (Part(name, Estimate(mean, 0.01, 4.0, 5), 0.0, 1.0, "x") for name, mean in means)
    assert joined([good, bad]) == (False, "a: x (holds); b: x (does not hold)")
    assert joined([good] * 5) == (True, "it holds in all 5 cases")
    assert joined([good] * 4 + [open_]) == (None, "c: x (undecided); it holds in the other 4 cases")
    assert joined([]) == (None, "no such run was asked for")
