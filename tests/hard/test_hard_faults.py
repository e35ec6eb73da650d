"""Broken states: every finding of `compare.hard.faults` keeps its limit."""

from findings import assert_complete, assert_stable, each_case, each_finding

import compare.hard.faults  # noqa: F401 (registers the cases)

BOTH = ("explicit", "implicit")
EXPECTED = {
    "too far": [
        ("explicit", "a fixed step that motion makes too long"),
        *(("explicit", f"a point thrown at {speed} m/s") for speed in ("1e+03", "1e+30", "1e+200")),
        *((solver, "a point put 1e30 m away") for solver in BOTH),
        ("implicit", "a step of a thousand times its length"),
    ],
    "not a number": [
        *(("explicit", f"NaN in {name} of a point") for name in ("x", "v", "tau", "theta", "eps_p_eqv")),
        ("explicit", "NaN in v in the checkpoint"),
        *(
            ("implicit", f"NaN in {name} of a point")
            for name in ("x", "v", "b_e", "mean", "theta", "jacobian", "eps_p_eqv")
        ),
        ("implicit", "NaN in b_e in the checkpoint"),
    ],
}


@each_finding(EXPECTED)
def test_finding_keeps_its_limit(name, solver, what):
    assert_stable(name, solver, what)


@each_case(EXPECTED)
def test_a_case_finds_this_and_no_more(name):
    assert_complete(name, EXPECTED)
