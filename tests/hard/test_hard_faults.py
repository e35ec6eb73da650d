"""Faults from outside: every finding of `compare.hard.faults` keeps its limit."""

import functools
import importlib.util
from contextlib import nullcontext, suppress

import pytest

import compare.hard.faults  # noqa: F401 (registers the cases)
from compare.hard.case import CASES
from mpm.errors import SceneError

HAS_IMPLICIT = None not in (importlib.util.find_spec("dolfinx"), importlib.util.find_spec("petsc4py"))
BOTH = ("explicit", "implicit")
EXPECTED = {
    "too far": [
        ("explicit", "a fixed step of three Courant steps"),
        *(("explicit", f"a point thrown at {speed} m/s") for speed in ("1e+03", "1e+30", "1e+200")),
        *((solver, "a point put 1e30 m away") for solver in BOTH),
        ("implicit", "a step of a thousand times its length"),
    ],
    "not a number": [
        *(("explicit", f"NaN in {name} of a point") for name in ("x", "v", "sigma", "volume", "opening", "eps_p_eqv")),
        ("explicit", "NaN in v in the checkpoint"),
        *(("implicit", f"NaN in {name} of a point") for name in ("x", "v", "b_e", "jacobian", "opening", "eps_p_eqv")),
        ("implicit", "NaN in b_e in the checkpoint"),
    ],
    "interrupted": [
        *((solver, f"killed while writing a {file}") for solver in BOTH for file in ("checkpoint", "snapshot")),
        ("explicit", "runs lost when killed at any moment"),
        *(
            (solver, f"results in {where}")
            for solver in BOTH
            for where in ("a file", "a file's name as folder", "/proc")
        ),
        *((solver, "the folder vanishes in mid-run") for solver in BOTH),
    ],
    "disk full": [
        *((solver, f"disk full: what {what}") for solver in BOTH for what in ("the user reads", "is saved")),
    ],
}
SILENT = "goes on to its end without a word, and into the checkpoint"
OVERFLOW = "the index of its cell overflows"
CRASH = "HDF5 fails to close its files: tracebacks, then a segmentation fault, in place of one line and exit code 1"
KNOWN = {  # what does not hold
    ("explicit", "a point put 1e30 m away"): f"segmentation fault: {OVERFLOW}",
    ("implicit", "a point put 1e30 m away"): f"ValueError, negative dimensions: {OVERFLOW}",
    ("explicit", "NaN in x of a point"): f"segmentation fault: {OVERFLOW}",
    ("implicit", "NaN in x of a point"): f"ValueError, negative dimensions: {OVERFLOW}",
    ("implicit", "NaN in b_e of a point"): "named, but saved as the last good state: only positions are looked at",
    **{("explicit", f"NaN in {name} of a point"): SILENT for name in ("opening", "eps_p_eqv")},
    **{("implicit", f"NaN in {name} of a point"): SILENT for name in ("v", "jacobian", "opening", "eps_p_eqv")},
    **{(solver, "disk full: what the user reads"): CRASH for solver in BOTH},
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
