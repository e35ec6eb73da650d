"""The material law at its apex: every finding of `compare.hard.law` keeps its limit."""

import functools

import pytest

import compare.hard.law  # noqa: F401 (registers the cases)
from compare.hard.case import CASES

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
KNOWN = {  # what does not hold, with its figure
    ("law", "isotropic tensions of 1e-300 Pa and less that return NaN"): "4 of 7, below 1e-316 Pa: d_lambda underflows "
    "to zero, so that it counts as a return to the cone, whose factor is 0/0 without a deviator",
}


@functools.cache
def findings(name: str) -> dict:
    """What the case `name` finds, by solver and what it is."""
    (case,) = [case for case in CASES if case.name == name]
    found = {}
    for one in case.run():
        assert (one.solver, one.what) not in found
        found[one.solver, one.what] = one
    return found


def marks_of(name, solver="", what=""):
    """Of a test of the case `name`, or of one of its findings."""
    marks = [pytest.mark.slow] if any(case.slow for case in CASES if case.name == name) else []
    if (solver, what) in KNOWN:
        marks.append(pytest.mark.xfail(reason=KNOWN[solver, what], strict=False))
    return marks


EACH = [(name, *key) for name, keys in EXPECTED.items() for key in keys]


@pytest.mark.parametrize(
    ("name", "solver", "what"), [pytest.param(*one, marks=marks_of(*one), id=": ".join(one)) for one in EACH]
)
def test_finding_keeps_its_limit(name, solver, what):
    finding = findings(name)[solver, what]
    assert finding.stable, f"{what} = {finding.value:.4g}, limit {finding.limit:.4g} ({finding.reason}): {finding.note}"


@pytest.mark.parametrize("name", [pytest.param(name, marks=marks_of(name)) for name in EXPECTED])
def test_a_case_finds_this_and_no_more(name):
    assert set(findings(name)) == set(EXPECTED[name])
