"""Transfer between points and grid: every finding of `compare.hard.transfer` keeps its limit."""

from findings import assert_complete, assert_misses_by, assert_stable, each_case, each_finding, each_miss

import compare.hard.transfer  # noqa: F401 (registers the cases)

STARTS = ("points between faces", "points on faces", "origin no binary fraction")
EXPECTED = {
    "cell crossing": [
        ("explicit", f"{what}, {start}") for start in STARTS for what in ("stress over E", "velocity error over speed")
    ],
    "flying alone": [
        ("explicit", "velocity gained beside g t, over g t"),
        ("explicit", "distance from the parabola at the end of the flight, over the path"),
    ],
    "node with hardly any mass": [
        ("explicit", "speed over the input's, points"),
        ("explicit", "speed over the input's, points are carried"),
        ("explicit", "speed over the input's, grid, from which strain is taken"),
        ("explicit", "speed over the input's, grid, after the forces"),
        ("implicit", "points' way in a step, over g dt^2"),
        ("implicit", "nodes' way in a step, over the points'"),
    ],
}
KNOWN = {  # what does not hold, with its figure
    (
        "node with hardly any mass",
        "explicit",
        "speed over the input's, grid, after the forces",
    ): (
        2e4,
        "a node's force falls with "
        "the slope of a weight, its mass with the weight; what points take of it is weighted again, and stays below",
    ),
}


@each_finding(EXPECTED, KNOWN)
def test_finding_keeps_its_limit(name, solver, what):
    assert_stable(name, solver, what)


@each_miss(KNOWN)
def test_a_miss_is_as_large_as_is_known(name, solver, what, figure):
    assert_misses_by(name, solver, what, figure)


@each_case(EXPECTED)
def test_a_case_finds_this_and_no_more(name):
    assert_complete(name, EXPECTED)
