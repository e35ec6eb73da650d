"""Faults from outside: every finding of `compare.hard.faults` keeps its limit."""

from findings import assert_complete, assert_stable, each_case, each_finding

import compare.hard.faults  # noqa: F401 (registers the cases)

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
    ("too far", "explicit", "a point put 1e30 m away"): f"segmentation fault: {OVERFLOW}",
    ("too far", "implicit", "a point put 1e30 m away"): f"ValueError, negative dimensions: {OVERFLOW}",
    ("not a number", "explicit", "NaN in x of a point"): f"segmentation fault: {OVERFLOW}",
    ("not a number", "implicit", "NaN in x of a point"): f"ValueError, negative dimensions: {OVERFLOW}",
    (
        "not a number",
        "implicit",
        "NaN in b_e of a point",
    ): "named, but saved as the last good state: only positions are looked at",
    **{("not a number", "explicit", f"NaN in {name} of a point"): SILENT for name in ("opening", "eps_p_eqv")},
    **{
        ("not a number", "implicit", f"NaN in {name} of a point"): SILENT
        for name in ("v", "jacobian", "opening", "eps_p_eqv")
    },
    **{("disk full", solver, "disk full: what the user reads"): CRASH for solver in BOTH},
}


@each_finding(EXPECTED, KNOWN)
def test_finding_keeps_its_limit(name, solver, what):
    assert_stable(name, solver, what)


@each_case(EXPECTED)
def test_a_case_finds_this_and_no_more(name):
    assert_complete(name, EXPECTED)
