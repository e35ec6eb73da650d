"""Interruptions: every finding of `compare.hard.interrupted` keeps its limit."""

from findings import assert_complete, assert_stable, each_case, each_finding

import compare.hard.interrupted  # noqa: F401 (registers the cases)

BOTH = ("explicit", "implicit")
EXPECTED = {
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


@each_finding(EXPECTED)
def test_finding_keeps_its_limit(name, solver, what):
    assert_stable(name, solver, what)


@each_case(EXPECTED)
def test_a_case_finds_this_and_no_more(name):
    assert_complete(name, EXPECTED)
