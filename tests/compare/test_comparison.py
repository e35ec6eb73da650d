"""`repose compare` and `repose study`: reports of real, short runs, whose page, JSON and table say the same."""

import csv
import html
import json
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from browser import measure
from installed import needs_implicit, needs_ranks

from compare.batch import Outcome
from compare.checks import quasistatic_checks
from compare.cli import main as cli
from compare.comparison import _distances, plan
from compare.launch import start
from compare.plots.reports import pareto_front
from compare.report.page import refuse_another
from compare.report.sections import check, soil_section, verdict
from explicit.run import REST_KE, REST_KE_OF_FALL
from mpm.body import build
from mpm.errors import SceneError
from mpm.load import load_scene
from mpm.results import Results
from mpm.theory import quasistatic_profile

pytestmark = needs_implicit
LONGEST = 120  # seconds: nothing hangs
SHORT = ("--set", "grid.cell=0.25", "--set", "explicit.max_time=0.2", "--set", "implicit.max_steps=3")


def repose(*arguments) -> int:
    """Exit code of `repose ARGUMENTS`."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["repose", *map(str, arguments)])
        with pytest.raises(SystemExit) as end:
            cli.main()
    return end.value.code or 0


def text_of(page) -> str:
    """What a reader of the page reads, tags and line breaks left out."""
    return " ".join(html.unescape(re.sub(r"<[^>]*>", " ", page)).split())


def rows_of(folder) -> list[dict[str, str]]:
    """The rows of the report's table."""
    with open(folder / "table.csv", newline="") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def compared(tmp_path_factory):
    """A short comparison: its folder and report.json."""
    folder = tmp_path_factory.mktemp("compare") / "out"
    assert repose("compare", "column_small", *SHORT, "--out", folder) == 0
    return folder, json.loads((folder / "report.json").read_text())


def test_page_json_and_table_say_the_same(compared):
    folder, report = compared
    page = text_of((folder / "report.html").read_text(encoding="utf-8"))
    assert report["verdict"]["sentence"] in page
    holding = sum(one["holds"] is True for one in report["checks"])
    assert report["verdict"]["sentence"].startswith(f"{holding} of {len(report['checks'])} checks hold.")
    assert report["verdict"]["holds"] == (holding == len(report["checks"]))
    for one in report["checks"]:
        assert one["name"] in page and one["sentence"] in page
        if one["holds"] is not None:
            assert one["holds"] == (abs(one["value"]) <= one["limit"])
    rows = rows_of(folder)
    assert [row["run"] for row in rows] == list(report["deposits"])
    for row in rows:
        assert float(row["R_995"]) == report["deposits"][row["run"]]["R_995"]


def test_the_report_is_made_of_what_the_runs_say(compared):
    folder, report = compared
    summaries = [json.loads(path.read_text()) for path in folder.glob("runs/*/summary.json")]
    assert len(summaries) == len(report["runs"]) == 4
    for label, summary in report["runs"].items():
        assert summary in summaries
        assert report["deposits"][label]["R_995"] == pytest.approx(summary["R_995"], abs=1e-6)  # single precision
    checks = {one["name"]: one for one in report["checks"]}
    implicit, explicit = report["runs"]["implicit"], report["runs"]["explicit, D = 0.4"]
    # A fifth of a second and three steps are no collapse to rest.
    off = checks["came to rest, implicit"]
    assert (off["value"], off["holds"]) == (1.0, False) and implicit["stop_reason"] == "max_steps"
    gain = checks["volume kept, implicit"]
    assert gain["value"] == report["deposits"]["implicit"]["volume_error"]
    assert checks["came to rest, explicit"]["holds"] is False
    assert explicit["stop_reason"] == "max_time"
    assert report["provenance"]["report made by"].startswith("repose compare column_small --set grid.cell=0.25")


@pytest.mark.slow
def test_all_checks_hold_of_the_column_that_a_first_comparison_is_made_with(tmp_path):
    """`repose demo` and the pages compare column_sand: 10 cells per r0, 40 s of one core."""
    assert cli.DEMO == ("column_sand", [])
    assert repose("compare", "column_sand", "--out", tmp_path / "out") == 0
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["verdict"] == {"holds": True, "sentence": "11 of 11 checks hold."}


@pytest.mark.parametrize("width", [1280, 420])
def test_browser_shows_every_figure_and_table(compared, tmp_path, width):
    folder, report = compared
    seen = measure(folder / "report.html", width, tmp_path)
    figures = report["opening"] + [one for section in report["sections"] for one in section["figures"]]
    assert len(seen["images"]) == len(figures) == 5
    assert all(image["natural_width"] > 0 and image["width"] > 250 for image in seen["images"])
    tables = [one for section in report["sections"] for one in section["tables"]]
    assert len(seen["tables"]) == len(tables) + 1  # provenance
    assert all(table["rows"] > 0 for table in seen["tables"])
    assert seen["scroll_width"] <= seen["client_width"]
    assert seen["font_size"] >= 14


def test_the_same_comparison_reuses_its_runs_and_another_is_refused(compared, capsys):
    folder, _ = compared
    capsys.readouterr()
    assert repose("compare", "column_small", *SHORT, "--out", folder) == 0
    assert capsys.readouterr().out.count("kept from an earlier call") == 4
    assert repose("compare", "column_small", *SHORT, "--set", "material.friction_angle=30.0", "--out", folder) == 2
    assert "choose another --out, or --force replaces it" in capsys.readouterr().err


def test_a_step_over_the_courant_limit_is_refused_before_anything_runs(tmp_path, capsys):
    folder = tmp_path / "out"
    assert repose("compare", "column_small", *SHORT, "--set", "explicit.time_step=0.05", "--out", folder) == 2
    assert "explicit.time_step = 0.05: over the Courant limit" in capsys.readouterr().err
    assert not folder.exists()


def test_a_failed_run_is_in_the_report_with_its_reason(tmp_path):
    folder = tmp_path / "out"
    assert repose("compare", "column_small", *SHORT, "--set", "explicit.time_step=0.003986", "--out", folder) == 3
    report = json.loads((folder / "report.json").read_text())
    page = text_of((folder / "report.html").read_text(encoding="utf-8"))
    assert len(report["failed"]) == 1 and "Courant limit" in report["failed"][0]  # with twice the cell it is no limit
    assert "failed: time step refused at t = " in page
    checks = {one["name"]: one["holds"] for one in report["checks"]}
    assert checks["run-out, implicit against explicit"] is None
    assert "could not be judged: run-out, implicit against explicit" in report["verdict"]["sentence"]


def test_a_box_that_stands_has_no_run_out_to_compare(tmp_path):
    folder = tmp_path / "out"
    settings = ("--set", "implicit.load_steps=2", "--set", "explicit.max_time=0.5")
    assert repose("compare", "self_weight", *settings, "--out", folder) == 0
    report = json.loads((folder / "report.json").read_text())
    assert not any("run-out" in one["name"] for one in report["checks"])
    names = {one["name"] for one in report["checks"]}
    assert "profile, implicit against explicit" in names
    assert not any("volume" in name for name in names)  # an elastic body is compacted by its weight


def test_a_column_that_stands_is_not_held_against_eq4(tmp_path):
    folder = tmp_path / "out"
    assert repose("compare", "column_small", *SHORT, "--set", "material.cohesion=5e4", "--out", folder) == 0
    report = json.loads((folder / "report.json").read_text())
    assert not any("run-out" in one["name"] for one in report["checks"])
    texts = [text for section in report["sections"] for text in section["text"]]
    assert any("only friction holds" in text for text in texts)
    assert any("It stands: its height 0.5 m is below" in text for text in texts)
    assert {summary["eq4"] for summary in report["runs"].values()} == {None}


def test_run_outs_are_checked_against_the_other_solver_eq4_and_twice_the_cell():
    """By hand: implicit 0.32, explicit 0.30, Eq. 4 0.3074; 0.35 on the coarse grid; one coarse run failed."""
    jobs = plan("column_small", [], "cpu")
    summary = {"stop_reason": "rest", "unbalanced_ratio": 0.009, "grid_ke_ratio": 1e-5, "failed_steps": 3, "steps": 40}
    outcomes = [Outcome(one, None, None if one is jobs[3] else summary, "broke") for one in jobs]
    deposits = [{"R_995": value, "volume_error": 0.06} for value in (0.32, 0.30, 0.35)] + [None]
    checks = quasistatic_checks(outcomes, deposits, {"implicit from explicit": 0.02}, collapsed=True)
    found = {one["name"]: (one["value"], one["holds"]) for one in checks}
    assert found == {
        "run-out, implicit against explicit": (pytest.approx(0.32 / 0.30 - 1), True),
        "run-out, implicit against Eq. 4": (pytest.approx(0.32 / 0.30743 - 1, abs=1e-4), True),
        "run-out, explicit against Eq. 4": (pytest.approx(0.30 / 0.30743 - 1, abs=1e-4), True),
        "profile, implicit against explicit": (0.02, True),
        "came to rest, implicit": (0.0, True),
        "came to rest, explicit": (0.0, True),
        "tries that failed, implicit": (0.075, False),
        "volume kept, implicit": (0.06, False),
        "volume kept, explicit": (0.06, False),
        "run-out on twice the cell, implicit": (pytest.approx(0.35 / 0.32 - 1), True),
        "run-out on twice the cell, explicit": (None, None),
    }
    said = {one["name"]: one["sentence"] for one in checks}
    assert said["run-out, implicit against explicit"] == (
        "+6.7% (10% allowed): R_995 is 0.320, that of the explicit run 0.300"
    )
    assert said["volume kept, implicit"] == "+6.0% (1% allowed)"
    assert said["tries that failed, implicit"] == "3 in 40 steps, 7.5% (5% allowed)"
    assert said["came to rest, explicit"].startswith("yes: the grid's kinetic energy is 1e-05 of its peak; rest asks")
    assert f"{REST_KE:g}, or {REST_KE_OF_FALL:g} of M g h0" in said["came to rest, explicit"]
    assert said["run-out on twice the cell, implicit"].startswith("+9.4% (10% allowed): R_995 is 0.350 on it")
    assert said["run-out on twice the cell, explicit"] == "not known: a run failed"


def test_a_run_that_did_not_come_to_rest_says_no_and_why():
    jobs = plan("column_small", [], "cpu")
    summary = {"stop_reason": "max_steps", "unbalanced_ratio": 0.09, "failed_steps": 0, "steps": 40}
    still = {"stop_reason": "max_time", "grid_ke_ratio": 1e-2}
    outcomes = [Outcome(jobs[0], None, summary, None), Outcome(jobs[1], None, still, None)]
    checks = quasistatic_checks(outcomes, [None, None], {}, collapsed=False)
    said = {one["name"]: one for one in checks}
    assert said["came to rest, implicit"]["sentence"].startswith("no (steps up, not at rest): the out-of-balance force")
    assert said["came to rest, explicit"]["sentence"].startswith("no (time up, not at rest): the grid's kinetic energy")
    assert "These do not: came to rest, implicit; came to rest, explicit." in verdict(checks)["sentence"]


def test_the_soil_is_told_with_units_as_an_engineer_writes_them():
    scene = load_scene("self_weight", ["material.cohesion=500.0", "material.model=drucker_prager"])
    soil, body = soil_section(scene)["tables"]
    rows = {row[3]: row[:3] for row in [*soil["rows"], *body["rows"]]}
    assert rows["material.young"] == ["Young's modulus E", pytest.approx(5.84), "MPa"]
    assert rows["material.cohesion"] == ["cohesion c", 0.5, "kPa"]
    assert rows["material.density"] == ["bulk density", 2000.0, "kg/m3"]
    assert rows["material.poisson"] == ["Poisson's ratio", 0.3, None]
    assert rows["geometry.size"] == ["edge lengths along x, y, z", "0.25, 0.25, 2", "m"]
    assert rows["geometry.walls.z_min"] == ["face z = 0", "fixed", None]


def test_a_report_names_commands_as_they_were_typed(monkeypatch):
    monkeypatch.setenv("REPOSE_COMMAND", "./repose")
    assert plan("column_small", [], "cpu")[0].command.startswith("./repose run column_small --mode implicit")


@pytest.mark.parametrize("taken", ["explicit.damping=0.1", "explicit.until=2.0"])
def test_what_a_comparison_decides_cannot_be_set(taken):
    with pytest.raises(SceneError, match=r"D = 0\.4"):
        plan("column_small", [taken], "cpu")


def test_a_study_refuses_a_folder_that_holds_more_than_was_asked_for(tmp_path):
    about = {"study": "paper", "lambda0": [0.5, 1.0]}
    (tmp_path / "report.json").write_text(json.dumps({"about": about}))
    refuse_another(tmp_path, about | {"lambda0": [0.5, 1.0, 2.0]}, False)
    with pytest.raises(SceneError, match="something else"):
        refuse_another(tmp_path, about | {"lambda0": [0.5]}, False)
    refuse_another(tmp_path, about | {"lambda0": [0.5]}, True)


def test_distance_from_eq4_counts_its_volume_beyond_a_deposit_that_stops_short(tmp_path):
    """The column itself, which has not collapsed: what lies beyond r0 under Eq. 4's flank must have moved out there."""
    scene = load_scene("column_0.5")
    x = build(scene).x
    run = Results.create(tmp_path / "run", scene, {})
    run.write_static("extent", np.array([1.0, 0.5, 0.0, 0.0]))
    run.write_snapshot(0.0, 0, {"x": x.astype(np.float32)})
    found = _distances({"explicit": Outcome(None, run.directory, {}, None)}, scene)["explicit from Eq. 4"]
    r = np.linspace(0.0, 1.5, 30001)
    beyond = np.where(r > 1.0, quasistatic_profile(0.5, np.tan(np.radians(37.55)), r) * 2 * np.pi * r, 0.0)
    volume = 2 * np.sum((beyond[1:] + beyond[:-1]) / 2) * (r[1] - r[0])  # as much is missing as there is too much
    assert found == pytest.approx(volume / (np.pi * 0.5), rel=0.03)


def test_without_gravity_there_is_nothing_to_compare():
    with pytest.raises(SceneError, match="gravity"):
        plan("elastic_bar", ["loads.gravity=0.0", "explicit.max_time=1.0", "output.history_every=0.1"], "cpu")


def test_a_grid_that_does_not_fit_twice_the_cell_is_compared_alone():
    assert [one.name for one in plan("column_small", [], "cpu")] == [
        *("implicit", "explicit", "implicit-coarse", "explicit-coarse")
    ]
    assert [one.name for one in plan("column_small", ["grid.cell=0.2"], "cpu")] == ["implicit", "explicit"]


@pytest.mark.parametrize("ranks", [1, pytest.param(2, marks=needs_ranks)])
def test_study_stability_runs_each_case_in_a_process_and_says_what_held(tmp_path, monkeypatch, ranks):
    """Cases of a solver's runs on ranks, where these are asked for, the others on one."""
    from compare.hard.case import Case
    from compare.studies import stability as study_stability

    taken = []

    def counting(ranks, words, **options):
        taken.append(ranks)
        return start(ranks, words, **options)

    monkeypatch.setattr(study_stability, "start", counting)
    there = [case for case in study_stability.CASES if case.name == "coarse, implicit"]
    monkeypatch.setattr(study_stability, "CASES", [*there, Case("no such case", None, False)])
    folder = tmp_path / "out"
    assert repose("study", "stability", "--quick", "--jobs", 1, "--ranks", ranks, "--out", folder) == 3
    assert taken == [ranks, 1]
    report = json.loads((folder / "report.json").read_text())
    outcomes = [row["outcome"] for row in report["rows"]]
    assert outcomes == ["stable"] * 6 + ["died"]
    assert {one["name"]: one["holds"] for one in report["checks"]} == {"coarse, implicit": True, "no such case": None}
    assert report["failed"] and "StopIteration" in report["failed"][0]
    (picture,) = report["sections"][0]["figures"]  # a process that died left none
    assert picture["caption"].startswith("coarse, implicit: ") and (folder / picture["file"]).stat().st_size > 10_000
    assert len(rows_of(folder)) == 7


@needs_ranks
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_study_of_stability_that_is_stopped_leaves_nothing_running(tmp_path, ranks_below, number):
    """Ctrl-C and `kill`, while two ranks compute a case of minutes."""
    program = """
from compare.studies import stability
stability.CASES[:] = [case for case in stability.CASES if case.name == "friction, implicit"]
from compare.cli.main import main
main()
"""
    words = ["study", "stability", "--ranks", "2", "--jobs", "1", "--out", str(tmp_path / "out")]
    process = subprocess.Popen([sys.executable, "-c", program, *words], stderr=subprocess.PIPE, text=True)
    started = time.monotonic()
    while len(ranks := ranks_below(process.pid)) < 2:
        assert process.poll() is None and time.monotonic() - started < LONGEST
        time.sleep(0.1)
    time.sleep(1.0)
    process.send_signal(number)
    said = process.communicate(timeout=LONGEST)[1]
    assert process.returncode == 130, said
    while any(Path(f"/proc/{rank}").exists() for rank in ranks):
        assert time.monotonic() - started < LONGEST
        time.sleep(0.1)


def test_pareto_front_is_what_nothing_beats_in_both():
    points = [{"seconds": s, "error": e} for s, e in ((1, 0.5), (2, 0.6), (3, 0.1), (4, 0.1), (5, 0.05), (3, 0.2))]
    assert [(one["seconds"], one["error"]) for one in pareto_front(points)] == [(1, 0.5), (3, 0.1), (5, 0.05)]


def test_verdict_counts_and_names():
    checks = [check("a", 0.05, 0.1, ""), check("b", -0.2, 0.1, ""), check("c", None, 0.1, "")]
    checks += [check("d", 2.5, 1.6, ""), check("e", 3.0, 0.0, "")]
    assert [one["holds"] for one in checks] == [True, False, None, False, False]
    assert verdict(checks) == {
        "holds": False,
        "sentence": "1 of 5 checks hold. These do not: b (-20.0%, 10% allowed); d (2.5, 1.6 allowed); e. "
        "These could not be judged: c.",
    }
    assert verdict(checks[:1]) == {"holds": True, "sentence": "1 of 1 checks hold."}
