"""Bisection for D on run-outs that are known functions of it."""

import math

import pytest

from compare.calibration import bisect
from compare.ensembles import Estimate


def known(runout, half):
    """Ensembles of five whose mean is `runout`(D) and whose interval is `half` wide either way, and the D asked for."""
    asked = []

    def run_outs(damping):
        asked.append(damping)
        return Estimate(runout(damping), half / 2.7764451, 4.0, 5)

    return run_outs, asked


def test_damping_and_interval_of_a_straight_line():
    """R = 1.2 - 1.2 D = 0.75 at D = 0.375; 0.45, 0.225, 0.3375 and 0.39375 are tried, and the last is within 0.0225."""
    run_outs, asked = known(lambda d: 1.2 - 1.2 * d, 0.03)
    found = bisect(run_outs, 0.75)
    assert asked == pytest.approx([0.0, 0.45, 0.225, 0.3375, 0.39375])
    assert found.damping == asked[-1]
    assert (found.low, found.high) == (pytest.approx(0.375 - 0.025), pytest.approx(0.375 + 0.025))
    assert list(found.tried) == asked


@pytest.mark.parametrize("target", [0.3, 0.58, 1.0, 1.119])
def test_the_interval_holds_the_root_of_a_curve_as_steep_as_a_collapse(target):
    """R = 1.23 exp(-2.6 D)."""
    run_outs, _ = known(lambda d: 1.23 * math.exp(-2.6 * d), 0.012)
    found = bisect(run_outs, target)
    root = math.log(1.23 / target) / 2.6
    assert found.low < root < found.high
    assert found.high - found.low == pytest.approx(2 * 0.012 / (2.6 * target), rel=0.4)  # chords, not tangents


@pytest.mark.parametrize(
    ("target", "tried", "words"),
    [
        (1.3, [0.0], "without damping the run-out is 1.200 ± 0.030, short of 1.3"),
        (
            0.01,
            [0.0, *(0.9 - 0.9 / 2**n for n in range(1, 9))],
            "at D = 0.896 the run-out is still 0.124 ± 0.030, beyond",
        ),
    ],
)
def test_no_damping_meets_what_lies_outside(target, tried, words):
    run_outs, asked = known(lambda d: 1.2 - 1.2 * d, 0.03)
    found = bisect(run_outs, target)
    assert (found.damping, found.low, found.high) == (None, None, None)
    assert words in found.said and asked == pytest.approx(tried)


def test_a_target_within_the_interval_of_an_end_is_met_there():
    run_outs, asked = known(lambda d: 1.2 - 1.2 * d, 0.03)
    found = bisect(run_outs, 1.21)
    assert asked == [0.0, 0.45] and (found.damping, found.low) == (0.0, 0.0)
    assert found.high == pytest.approx(0.02 / 1.2)  # 1.2 + 0.03 - 1.2 D = 1.21


@pytest.mark.parametrize("other", [None, Estimate(0.7, math.nan, 0.0, 1)])
def test_where_no_damping_meets_the_target_the_interval_ends_below_what_comes_to_no_result(other):
    run_outs, _ = known(lambda d: 1.2 - 1.2 * d, 0.03)
    found = bisect(lambda d: run_outs(d) if d == 0.0 else other, 1.21)
    assert (found.damping, found.low, found.high) == (0.0, 0.0, 0.45)
    assert list(found.tried) == [0.0]


def test_a_jump_is_bracketed():
    run_outs, asked = known(lambda d: 1.0 if d < 0.3 else 0.2, 0.0)
    found = bisect(run_outs, 0.5)
    assert found.low < 0.3 < found.high and found.high - found.low <= 0.005
    assert len(asked) == 9  # 0.9/2^8 is the first below 0.005


def test_damping_at_which_runs_come_to_no_result_is_too_much():
    """R = 1.2 - 1.2 D up to D = 0.6: 0.525 is met at 0.5625, after 0.675 gave nothing."""
    run_outs, asked = known(lambda d: 1.2 - 1.2 * d, 0.03)
    found = bisect(lambda d: run_outs(d) if d <= 0.6 else None, 0.525)
    assert asked == pytest.approx([0.0, 0.45, 0.5625])
    assert found.damping == pytest.approx(0.5625) and found.low == pytest.approx(0.5625 - 0.025)
    assert found.high == pytest.approx(0.675)  # where the first that is too much is
    found = bisect(lambda d: run_outs(d) if d <= 0.6 else None, 0.3)
    assert found.damping is None and "still 0.483 ± 0.030, beyond 0.3, and runs with more come to no" in found.said


def test_without_a_result_at_no_damping_nothing_is_found():
    found = bisect(lambda d: Estimate(1.0, float("nan"), 0.0, 1), 0.5)
    assert found.damping is None and "without damping fewer than two runs" in found.said
