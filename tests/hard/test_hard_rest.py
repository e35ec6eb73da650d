"""What must stand and stay: every finding of `compare.hard.rest` keeps its limit."""

import functools
import importlib.util

import pytest

import compare.hard.rest  # noqa: F401 (registers the cases)
from compare.hard.case import CASES

HAS_IMPLICIT = None not in (importlib.util.find_spec("dolfinx"), importlib.util.find_spec("petsc4py"))
BODIES = ("cohesive column", "sand between rollers")
CREEP = [f"lambda0 = {aspect}: R in another 4 sqrt(h0/g)" for aspect in ("1", "0.5")]
EXPECTED = {
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
KNOWN = {  # what does not hold, with its figure
    ("creep after rest", CREEP[1]): "2.7 %: at 5 cells per r0 the low column is not at rest after 60 sqrt(h0/g), where "
    "the run ends; at 8 cells 0.34 %",
    ("creep after rest, implicit", CREEP[1]): "0.83 %: rest allows 0.1 % of 1 + R per sqrt(h0/g), 1.5 % of this R in 4",
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


def marks_of(name, what=""):
    """Of a test of the case `name`, or of one of its findings."""
    marks = [pytest.mark.slow] if any(case.slow for case in CASES if case.name == name) else []
    if EXPECTED[name][0] == "implicit" and not HAS_IMPLICIT:
        marks.append(pytest.mark.skip(reason="dolfinx or petsc4py is not installed (see ./repose info)"))
    if (name, what) in KNOWN:
        marks.append(pytest.mark.xfail(reason=KNOWN[name, what], raises=AssertionError, strict=False))
    return marks


EACH = [(name, solver, what) for name, (solver, whats) in EXPECTED.items() for what in whats]


@pytest.mark.parametrize(
    ("name", "solver", "what"),
    [pytest.param(*one, marks=marks_of(one[0], one[2]), id=": ".join(one)) for one in EACH],
)
def test_finding_keeps_its_limit(name, solver, what):
    finding = findings(name)[solver, what]
    assert finding.stable, f"{what} = {finding.value:.4g}, limit {finding.limit:.4g} ({finding.reason}): {finding.note}"


@pytest.mark.parametrize("name", [pytest.param(name, marks=marks_of(name)) for name in EXPECTED])
def test_a_case_finds_this_and_no_more(name):
    solver, whats = EXPECTED[name]
    assert set(findings(name)) == {(solver, what) for what in whats}
