"""What must stand and stay: every finding of `compare.hard.rest` keeps its limit."""

from findings import assert_complete, assert_misses_by, assert_stable, each_case, each_finding, each_miss, of_one_solver

import compare.hard.rest  # noqa: F401 (registers the cases)

BODIES = ("cohesive column", "sand between rollers")
CREEP = [f"lambda0 = {aspect}: R in another 4 sqrt(h0/g)" for aspect in ("1", "0.5")]
ASKED = {
    "quiet column": (
        "explicit",
        [
            f"{body}: {what}"
            for body in BODIES
            for what in ("drift of the top", "grid kinetic energy, over that of the speed that D leaves alone")
        ],
    ),
    "quiet column, implicit": (
        "implicit",
        [f"{body}: {what}" for body in BODIES for what in ("steps to rest", "drift of the top")],
    ),
    "creep after rest": ("explicit", CREEP),
    "creep after rest, implicit": ("implicit", CREEP),
    "small cut, implicit": (
        "implicit",
        [
            "Newton iterations, at the most",
            "settlement of the top, (max - min)/mean",
            "condition number of the load step, at the most",
            "condition number of a collapse step, at the most",
        ],
    ),
}
MISSED = {  # what does not hold: (figure, why)
    ("small cut, implicit", "settlement of the top, (max - min)/mean"): (
        0.00505,
        "limit 0.005; averages over nodes reach two cells and see the block's faces",
    ),
}
EXPECTED, KNOWN = of_one_solver(ASKED, MISSED)


@each_finding(EXPECTED, KNOWN)
def test_finding_keeps_its_limit(name, solver, what):
    assert_stable(name, solver, what)


@each_miss(KNOWN)
def test_a_miss_is_as_large_as_is_known(name, solver, what, figure):
    assert_misses_by(name, solver, what, figure)


@each_case(EXPECTED)
def test_a_case_finds_this_and_no_more(name):
    assert_complete(name, EXPECTED)
