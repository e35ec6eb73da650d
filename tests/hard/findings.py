"""What the tests of hard cases share: a case is run once, and each finding that is expected of it is a test."""

import functools
from contextlib import nullcontext, suppress

import pytest
from installed import HAS_IMPLICIT, NO_IMPLICIT

from compare.hard.case import CASES
from mpm.errors import SceneError


def of_one_solver(asked, missed):
    """`expected` and `known` of `each_finding`, from {case: (solver, [what])} and {(case, what): (figure, why)}."""
    expected = {name: [(solver, what) for what in whats] for name, (solver, whats) in asked.items()}
    return expected, {(name, asked[name][0], what): miss for (name, what), miss in missed.items()}


def each_finding(expected, known={}):  # noqa: B006 (read only)
    """Parametrises a test over `case`, `solver` and `what` of every finding in `expected` {case: [(solver, what)]}.

    `known` {(case, solver, what): (figure, why)}: findings that do not keep their limit.
    """
    findings = [(name, *key) for name, keys in expected.items() for key in keys]
    params = []
    for name, solver, what in findings:
        marks = _marks(name, [solver])
        if (name, solver, what) in known:
            figure, why = known[name, solver, what]
            marks.append(pytest.mark.xfail(reason=f"{figure:g}: {why}", raises=AssertionError, strict=True))
        params.append(pytest.param(name, solver, what, marks=marks, id=f"{name}: {solver}: {what}"))
    return pytest.mark.parametrize(("name", "solver", "what"), params)


def each_miss(known):
    """Parametrises a test over `case`, `solver`, `what` and `figure` of every finding that does not keep its limit."""
    params = [
        pytest.param(*key, figure, marks=_marks(key[0], [key[1]]), id=": ".join(key))
        for key, (figure, _) in known.items()
    ]
    return pytest.mark.parametrize(("name", "solver", "what", "figure"), params)


def each_case(expected):
    """Parametrises a test over the `name` of every case in `expected`."""
    solvers = {name: [solver for solver, _ in keys] for name, keys in expected.items()}
    return pytest.mark.parametrize("name", [pytest.param(name, marks=_marks(name, solvers[name])) for name in expected])


def assert_stable(name, solver, what):
    """The finding keeps its limit."""
    finding = _found(name)[solver, what]
    assert finding.stable, f"{what} = {finding.value:.4g}, limit {finding.limit:.4g} ({finding.reason}): {finding.note}"


def assert_misses_by(name, solver, what, figure):
    """A finding that does not keep its limit has the figure that is known of it, within a fifth, to either side."""
    assert _found(name)[solver, what].value == pytest.approx(figure, rel=0.2)


def assert_complete(name, expected):
    """The case finds what is expected of it and no more."""
    assert set(_found(name)) == {key for key in expected[name] if HAS_IMPLICIT or key[0] != "implicit"}


@functools.cache
def _found(name: str) -> dict:
    """What the case `name` finds, by solver and what it is; without dolfinx, what comes before its implicit part."""
    (case,) = [case for case in CASES if case.name == name]
    found = {}
    with nullcontext() if HAS_IMPLICIT else suppress(SceneError):
        for one in case.run():
            assert (one.solver, one.what) not in found
            found[one.solver, one.what] = one
    return found


def _marks(name, solvers):
    """Of a test that needs `solvers` of the case `name`."""
    marks = [pytest.mark.slow] if any(case.slow for case in CASES if case.name == name) else []
    if set(solvers) == {"implicit"} and not HAS_IMPLICIT:
        marks.append(pytest.mark.skip(reason=NO_IMPLICIT))
    return marks
