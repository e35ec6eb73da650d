"""Transfer between points and grid: every finding of `compare.hard.transfer` keeps its limit."""

import functools
import importlib.util
from contextlib import nullcontext, suppress

import pytest

import compare.hard.transfer  # noqa: F401 (registers the cases)
from compare.hard.case import CASES
from mpm.errors import SceneError

HAS_IMPLICIT = None not in (importlib.util.find_spec("dolfinx"), importlib.util.find_spec("petsc4py"))
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
    ("explicit", "speed over the input's, grid, after the forces"): "4e4 times the input's: a node's force falls with "
    "the slope of a weight, its mass with the weight; what points take of it is weighted again, and stays below",
}


@functools.cache
def findings(name: str) -> dict:
    """What the case `name` finds, by solver and what it is; without dolfinx, what comes before its implicit part."""
    (case,) = [case for case in CASES if case.name == name]
    found = {}
    with nullcontext() if HAS_IMPLICIT else suppress(SceneError):
        for one in case.run():
            assert (one.solver, one.what) not in found
            found[one.solver, one.what] = one
    return found


def marks_of(name, solver="", what=""):
    """Of a test of the case `name`, or of one of its findings."""
    marks = [pytest.mark.slow] if any(case.slow for case in CASES if case.name == name) else []
    if solver == "implicit" and not HAS_IMPLICIT:
        marks.append(pytest.mark.skip(reason="dolfinx or petsc4py is not installed (see ./repose info)"))
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
    assert set(findings(name)) == {key for key in EXPECTED[name] if HAS_IMPLICIT or key[0] != "implicit"}
