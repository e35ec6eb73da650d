"""The material law at its apex: every finding of `compare.hard.law` keeps its limit."""

from findings import assert_complete, assert_stable, each_case, each_finding

import compare.hard.law  # noqa: F401 (registers the cases)

EXPECTED = {
    "apex": [
        *((solver, "stress while open, over E") for solver in ("explicit", "implicit")),
        *(
            (solver, "elastic volume strain beside min(strain since the start, 0)")
            for solver in ("explicit", "implicit")
        ),
        *((solver, "volume strain that the law gains in loops") for solver in ("explicit", "implicit")),
        *((solver, "opening left at the end of a loop") for solver in ("explicit", "implicit")),
        *((solver, "largest opening of a loop beside the first loop's") for solver in ("explicit", "implicit")),
        *((solver, "ln(V/V0) of the point after the loops") for solver in ("explicit", "implicit")),
        *((solver, "paths without deviator that end in NaN") for solver in ("explicit", "implicit")),
        ("law", "isotropic tensions of 1e-300 Pa and less that return NaN"),
    ]
}


@each_finding(EXPECTED)
def test_finding_keeps_its_limit(name, solver, what):
    assert_stable(name, solver, what)


@each_case(EXPECTED)
def test_a_case_finds_this_and_no_more(name):
    assert_complete(name, EXPECTED)
