"""`repose study damping`: its target, and the study on tiny runs that go on where they were."""

import json
import math

import pytest
from installed import HAS_IMPLICIT
from test_comparison import repose, rows_of, text_of

from compare.batch import Job, Outcome
from compare.studies.damping import SHARES, _row, target_of
from mpm.errors import SceneError
from mpm.load import load_scene
from mpm.results import Results
from mpm.theory import eq4

SHORT = ("--set", "explicit.max_time=0.5", "--set", "implicit.max_steps=2")


def test_a_target_is_a_run_out_or_eq4s():
    scene = load_scene("column_1")
    assert target_of("1.119", scene) == 1.119
    assert target_of("eq4", scene) == pytest.approx(float(eq4(1.0, math.tan(math.radians(37.55)))))


@pytest.mark.parametrize("target", ["far", "-1", "0", "nan", "inf"])
def test_another_target_is_refused(target):
    with pytest.raises(SceneError, match="must be a run-out R_995 > 0"):
        target_of(target, load_scene("column_1"))


def test_eq4_is_refused_where_it_does_not_speak():
    with pytest.raises(SceneError, match=r"Eq\. 4 is for a column that only friction holds"):
        target_of("eq4", load_scene("column_1", ["material.cohesion=100.0"]))


def test_what_the_study_decides_cannot_be_set(tmp_path, capsys):
    asked = ("study", "damping", "column_small", "--target", "0.3", "--out", tmp_path / "out")
    assert repose(*asked, "--set", "explicit.damping=0.1", "--set", "grid.scatter=0.2") == 2
    assert capsys.readouterr().err.count("the study sets it itself") == 2


def test_a_target_beyond_every_damping_is_told_and_runs_are_kept(tmp_path, capsys):
    """Within half a second the front gets nowhere near 1.5: runs without damping tell, no other D is tried."""
    folder = tmp_path / "out"
    asked = ("study", "damping", "column_small", "--target", "1.5", *SHORT, "--realisations", "2", "--out", folder)
    assert repose(*asked) == 0
    report = json.loads((folder / "report.json").read_text())
    (one,) = report["checks"]
    assert one["holds"] is False and "No D in [0, 0.9] was found: without damping the run-out is" in one["sentence"]
    assert one["sentence"] in text_of((folder / "report.html").read_text(encoding="utf-8"))
    explicit = [row for row in report["rows"] if row["damping"] is not None]
    assert [(row["damping"], row["R_995_n"]) for row in explicit] == [(0.0, 2)]
    assert explicit[0]["damped"] == explicit[0]["decayed"] == 0.0  # of gravity's work, without damping
    assert len(rows_of(folder)) == 1 + HAS_IMPLICIT
    capsys.readouterr()
    assert repose(*asked) == 0
    assert capsys.readouterr().out.count("kept from an earlier call") == 2 + 2 * HAS_IMPLICIT


def test_where_gravitys_work_goes(tmp_path):
    """Of 20 J: 8 into damping, 1 into the decay, 10 into plastic flow; 4 J of motion at the peak."""
    job = Job("D0.4", "column_1", ("explicit.damping=0.4",), "explicit")
    rows = [
        {"time": t, "W_ext": 10 * t, "W_damping": 4 * t, "W_decay": 0.5 * t, "W_plastic": 5 * t, "KE_grid": t * (4 - t)}
        for t in (0.0, 1.0, 2.0)
    ]
    outcomes = []
    for name, kept in (("new", set(rows[0])), ("old", set(rows[0]) - {"W_decay"})):
        run = Results.create(tmp_path / name, job.scene, {})
        run.append_history([{key: row[key] for key in kept} for row in rows])
        outcomes.append(Outcome(job, tmp_path / name, {"R_995": 0.6, "R_max": 0.7, "stop_reason": "rest"}, None))
    found = _row("D = 0.4", 0.4, outcomes)
    assert {name: (found[name].mean, found[name].n) for name in SHARES} == {
        "damped": (0.4, 2), "decayed": (0.05, 1), "plastic": (0.5, 2), "peak_motion": (0.2, 2),
    }  # fmt: skip
