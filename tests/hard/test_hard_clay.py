"""Clay that stood while pressure locked: every finding of `compare.hard.clay` keeps its limit."""

from findings import assert_complete, assert_stable, each_case, each_finding, of_one_solver

import compare.hard.clay  # noqa: F401 (registers the cases)

STANDS_OR_FALLS = ["tall block: height left, over h0", "critical height, off 3.83 c/(rho g)"]
STIFF = ["tall block, nu = 0.499: R"]
ASKED = {
    "clay": ("explicit", [*STANDS_OR_FALLS, *STIFF]),
    "clay, implicit": ("implicit", STANDS_OR_FALLS),
    "clay, nearly incompressible, implicit": ("implicit", STIFF),
}
EXPECTED, _NONE = of_one_solver(ASKED, {})


@each_finding(EXPECTED)
def test_finding_keeps_its_limit(name, solver, what):
    assert_stable(name, solver, what)


@each_case(EXPECTED)
def test_a_case_finds_this_and_no_more(name):
    assert_complete(name, EXPECTED)
