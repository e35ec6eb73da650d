"""Runs as a user of the command line meets them: what is written and printed, exit codes, Ctrl-C, a full disk."""

import json
import re
import signal
from xml.etree import ElementTree

import meshio
import numpy as np
import pytest
from installed import needs_implicit
from program import COARSE, TINY, but_compiling, start

from compare.cli import main as cli
from mpm.fields import UNITS
from mpm.load import load_scene
from mpm.results import Results

CONTRACT = {
    *("mode", "scene", "points", "cells_per_radius", "precision", "device", "steps", "sim_time", "wall_s", "setup_s"),
    *("stop_reason", "R_max", "R_995", "R_connected", "h_inf", "mass_error", "grid_ke_ratio", "peak_memory_mb"),
    *("point_steps_per_s", "eq4", "eq45"),
}
IMPLICIT_CONTRACT = {
    *(CONTRACT - {"mass_error", "grid_ke_ratio"}),
    *("newton_iterations", "linear_iterations", "failed_steps", "unbalanced_ratio", "regularisation"),
}

# run, plot, resume


def test_run_writes_results_summary_and_paraview_files(repose, tmp_path):
    answer = repose("run", *TINY)
    assert answer.code == 0
    assert answer.err == ""
    folder = tmp_path / "runs" / "column_small-explicit"
    assert {path.name for path in folder.iterdir()} == {"results.h5", "checkpoint.h5", "summary.json", "vtk"}
    assert (folder / "vtk" / "run.pvd").is_file()
    summary = json.loads((folder / "summary.json").read_text())
    assert set(summary) >= CONTRACT
    assert (summary["mode"], summary["scene"], summary["device"]) == ("explicit", "column_small", "cpu")
    assert (summary["points"], summary["cells_per_radius"], summary["precision"]) == (208, 4.0, "float64")
    assert summary["sim_time"] == pytest.approx(0.05)
    assert summary["stop_reason"] == "end_time"
    assert summary["mass_error"] < 1e-12
    assert 0 < summary["grid_ke_ratio"] <= 1
    # tan(37.55 degrees) is 0.7687, so the values differ a little from those for 0.77
    assert (summary["eq4"], summary["eq45"]) == pytest.approx((0.3069, 0.4183), rel=4e-3)
    run = Results.open(folder)
    np.testing.assert_allclose(run.times, [0.0, 0.02, 0.04, 0.05])
    assert run.scene.grid.cell == 0.25
    assert run.read_static("x0").shape == (208, 3)
    assert np.all(np.diff(run.history()["time"]) > 0)


def test_run_prints_banner_and_table_with_units(repose):
    printed = repose("run", *TINY, "--out", "mine").out
    assert "column_small: explicit, 208 points" in printed
    assert "float64, cpu" in printed
    for text in ("final height h_inf [m]", "simulated time [s]", "time stepping [s]", "peak memory [MB]", "end_time"):
        assert text in printed
    assert "results in mine (`repose plot mine` draws them; ParaView opens vtk/run.pvd)" in printed


def test_paraview_is_not_mentioned_where_nothing_was_written_for_it(repose, tmp_path):
    answer = repose("run", *TINY, "--set", "output.vtk=false", "--out", "mine")
    assert "ParaView" not in answer.out
    assert not (tmp_path / "mine" / "vtk").exists()


def test_a_folder_name_with_brackets_is_printed_as_it_is(repose, tmp_path):
    answer = repose("run", *TINY, "--out", "[a] :s: [b]")
    assert "results in [a] :s: [b] (" in answer.out
    assert (tmp_path / "[a] :s: [b]" / "results.h5").is_file()


def test_plot_makes_three_pictures(repose, tmp_path):
    repose("run", *TINY, "--out", "mine")
    answer = repose("plot", "mine")
    assert answer.code == 0
    assert answer.out.split() == ["mine/morphology.png", "mine/profile.png", "mine/history.png"]
    for name in answer.out.split():
        assert (tmp_path / name).read_bytes().startswith(b"\x89PNG")


def test_a_box_is_plotted_without_a_radial_profile(repose, tmp_path):
    scene = ("self_weight", "--set", "explicit.until=0.01")
    assert repose("run", *scene, "--out", "box").code == 0
    answer = repose("plot", "box")
    assert answer.code == 0
    assert answer.out.split() == ["box/morphology.png", "box/history.png"]
    assert json.loads((tmp_path / "box" / "summary.json").read_text())["eq4"] is None


def test_a_folder_in_use_is_refused_and_force_replaces_the_run(repose, refused, tmp_path):
    repose("run", *TINY, "--out", "mine")
    (tmp_path / "mine" / "notes.txt").write_text("keep me")
    before = (tmp_path / "mine" / "results.h5").read_bytes()
    message = refused("run", *TINY, "--out", "mine")
    assert "mine is not empty" in message
    assert "--force" in message and "repose resume mine" in message
    assert (tmp_path / "mine" / "results.h5").read_bytes() == before
    assert len(list((tmp_path / "mine" / "vtk").glob("*.vtu"))) == 4
    assert repose("run", *COARSE, "--set", "explicit.until=0.01", "--out", "mine", "--force").code == 0
    assert json.loads((tmp_path / "mine" / "summary.json").read_text())["sim_time"] == pytest.approx(0.01)
    assert len(list((tmp_path / "mine" / "vtk").glob("*.vtu"))) == 2
    assert (tmp_path / "mine" / "notes.txt").read_text() == "keep me"


# export


def test_export_writes_chosen_fields_again_as_vtu_or_csv(repose, refused, tmp_path):
    repose("run", *TINY, "--set", "output.vtk=false", "--out", "mine")
    answer = repose("export", "mine")
    assert (answer.code, answer.out) == (0, "mine/vtk/run.pvd lists 4 snapshots\n")
    assert set(meshio.read("mine/vtk/000003.vtu").point_data) == set(UNITS) - {"volume"}  # not stored by default
    answer = repose("export", "mine", "--fields", "pressure", "velocity", "--out", "there")
    assert answer.out == "there/run.pvd lists 4 snapshots\n"
    assert set(meshio.read("there/000003.vtu").point_data) == {"pressure", "velocity"}
    answer = repose("export", "mine", "--format", "csv", "--fields", "pressure", "eps_p_eqv")
    assert answer.out == "mine/csv/snapshots.csv lists 4 snapshots\n"
    heading, *rows = (tmp_path / "mine" / "csv" / "000003.csv").read_text().splitlines()
    assert heading == "x [m],y [m],z [m],pressure [Pa],eps_p_eqv [-]"
    assert len(rows) == 208
    message = refused("export", "mine", "--fields", "velocity", "speed")
    assert message.startswith("error: no field speed in mine: it has displacement, ")
    assert "no run in nowhere" in refused("export", "nowhere")


# Implicit mode


@needs_implicit
def test_implicit_mode_stops_resumes_and_is_drawn_as_the_explicit_one(repose, tmp_path):
    class Impatient(cli.Monitor):
        def row(self, run, row):
            super().row(run, row)
            if row["step"] == 3:
                signal.raise_signal(signal.SIGINT)

    settings = ("--set", "implicit.max_steps=6", "--set", "output.every=0.2")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cli, "Monitor", Impatient)
        answer = repose("run", *COARSE, *settings, "--mode", "implicit")
    assert answer.code == 130
    assert re.match(r"column_small: implicit, 208 points, \d+ unknowns, dt = \S+ s, float64, cpu \(.+\), ", answer.out)
    so_far = r"\nstep 1 of at most 6, about \d+% of the way to rest, run-out .+, unbalanced \d\.\de-\d\d\n"
    assert re.search(so_far, answer.out)
    where = "runs/column_small-implicit"
    assert re.fullmatch(rf"stopped at t = \S+ s; `repose resume {where}` goes on\n", answer.err)

    answer = repose("resume", where)
    assert (answer.code, answer.err) == (0, "")
    for text in ("pseudo-time [s]", "Newton iterations", "failed steps", "external forces", "max_steps"):
        assert text in answer.out
    assert "kinetic" not in answer.out
    folder = tmp_path / where
    summary = json.loads((folder / "summary.json").read_text())
    assert set(summary) >= IMPLICIT_CONTRACT
    assert (summary["mode"], summary["device"], summary["precision"]) == ("implicit", "cpu", "float64")
    assert (folder / "vtk" / "run.pvd").is_file()
    assert repose("plot", where).out.split() == [f"{where}/{name}.png" for name in ("morphology", "profile", "history")]


@needs_implicit
def test_implicit_mode_refuses_a_gpu(refused, tmp_path):
    message = refused("run", *COARSE, "--mode", "implicit", "--device", "cuda:0")
    assert message == "error: --device cuda:0: the implicit solver runs on the CPU\n"
    assert list(tmp_path.iterdir()) == []


@needs_implicit
def test_demo_ends_with_the_page_to_open_that_compare_makes(repose, tmp_path, monkeypatch):
    monkeypatch.setattr(
        cli, "DEMO", ("column_small", ["grid.cell=0.25", "explicit.max_time=0.2", "implicit.max_steps=3"])
    )
    answer = repose("demo")
    assert (answer.code, answer.err) == (0, "")
    report = json.loads((tmp_path / "runs" / "demo" / "report.json").read_text())
    runs = {name: report["runs"][name]["R_995"] for name in ("explicit, D = 0.4", "implicit")}
    explicit, implicit = (f"{value:.4f}" for value in runs.values())
    *_, run_outs, page = answer.out.splitlines()
    assert run_outs == f"run-out R_995: explicit {explicit}, implicit {implicit}; quasistatic theory (Eq. 4) 0.3074"
    assert page == "open runs/demo/report.html in a browser"
    assert "draws them" not in answer.out
    html = (tmp_path / "runs" / "demo" / "report.html").read_text(encoding="utf-8")
    assert html.count("data:image/png;base64,") == 5
    assert len(list(tmp_path.glob("runs/demo/runs/*/vtk/run.pvd"))) == 4
    assert repose("demo").code == 0  # replaces the last one


def test_demo_replaces_another_report_in_a_named_folder_only_with_force(refused, tmp_path):
    (tmp_path / "mine").mkdir()
    report = tmp_path / "mine" / "report.json"
    report.write_text('{"about": {"study": "error"}}')
    message = refused("demo", "--out", "mine")
    assert "mine/report.json is a report about something else" in message and "--force" in message
    assert report.read_text() == '{"about": {"study": "error"}}'
    assert list((tmp_path / "mine").iterdir()) == [report]


def snapshots_for_paraview(folder) -> list[float]:
    """Times [s] that folder/vtk/run.pvd lists; the files are there."""
    entries = ElementTree.parse(folder / "vtk" / "run.pvd").getroot().findall("Collection/DataSet")
    assert all((folder / "vtk" / entry.get("file")).is_file() for entry in entries)
    return [float(entry.get("timestep")) for entry in entries]


# Exit code 3: the numbers go wrong


def test_a_time_step_that_motion_makes_too_long_names_the_courant_limit(repose, tmp_path):
    scene = load_scene("column_small", ["grid.cell=0.25"])
    step = 0.9995 * scene.grid.cell / scene.material.constants().p_wave_speed
    answer = repose("run", *TINY, "--set", f"explicit.time_step={step}", "--out", "mine")
    assert answer.code == 3
    assert re.match(r"numerical failure: time step refused at t = 0\.0\d+ s, step \d+: ", answer.err)
    assert f"explicit.time_step = {step:.4g}: over the Courant limit, must be at most h/(c + |v|) = " in answer.err
    assert re.search(r"last good state: t = 0\.0\d+ s in mine/checkpoint\.h5", answer.err)
    assert answer.out.endswith("ParaView opens mine/vtk/run.pvd, up to the last snapshot\n")
    assert snapshots_for_paraview(tmp_path / "mine") == list(Results.open(tmp_path / "mine").times)
    state = Results.open(tmp_path / "mine").read_checkpoint()
    assert state["x"].shape == (208, 3)
    assert np.isfinite(state["x"]).all()
    assert not (tmp_path / "mine" / "summary.json").exists()


# Exit code 1: the machine fails


def test_a_full_disk_is_an_error_line(repose, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Results, "write_snapshot", full)
    answer = repose("run", *TINY)
    assert answer.code == 1
    assert answer.err == "error: [Errno 28] No space left on device\n"


# Ctrl-C


def test_ctrl_c_leaves_a_checkpoint_from_which_resume_finishes(tmp_path):
    until = 20.0  # a second or two: long enough to be interrupted
    settings = ["--set", f"explicit.until={until}", "--set", "output.every=5", "--set", "output.vtk=false"]
    process = start("run", *COARSE, *settings, "--out", "mine", cwd=tmp_path)
    assert process.stdout.readline().startswith("column_small: explicit, 208 points")
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "Traceback" not in err
    assert re.fullmatch(r"stopped at t = \S+ s; `repose resume mine` goes on\n|interrupted\n", but_compiling(err))
    stopped = Results.open(tmp_path / "mine").read_checkpoint()["clock"][0]
    assert stopped < until
    assert not (tmp_path / "mine" / "summary.json").exists()

    process = start("resume", "mine", cwd=tmp_path)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, but_compiling(err)) == (0, "")
    assert "end_time" in out
    run = Results.open(tmp_path / "mine")
    times = run.history()["time"]
    assert times[0] == 0.0
    assert times[-1] == pytest.approx(until)
    assert np.all(np.diff(times) > 0)
    np.testing.assert_allclose(run.times, [0.0, 5.0, 10.0, 15.0, 20.0])
    assert run.summary()["sim_time"] == pytest.approx(until)


def test_ctrl_c_in_the_middle_says_where_it_stopped(repose, tmp_path):
    """Without timing: the signal arrives as the third history row is shown."""

    class Impatient(cli.Monitor):
        rows = 0

        def row(self, run, row):
            self.rows += 1
            if self.rows == 3:
                signal.raise_signal(signal.SIGINT)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cli, "Monitor", Impatient)
        answer = repose("run", *COARSE, "--set", "explicit.until=0.2", "--out", "mine")
    assert answer.code == 130
    run = Results.open(tmp_path / "mine")
    stopped = float(run.read_checkpoint()["clock"][0])
    assert 0 < stopped < 0.2
    assert answer.err == f"stopped at t = {stopped:.6g} s; `repose resume mine` goes on\n"
    assert answer.out.endswith("ParaView opens mine/vtk/run.pvd, up to the last snapshot\n")
    assert snapshots_for_paraview(tmp_path / "mine") == list(run.times) == [0.0]
    assert run.history()["time"][-1] == pytest.approx(stopped)
    assert repose("resume", "mine").code == 0
    times = run.history()["time"]
    assert np.all(np.diff(times) > 0)
    assert times[-1] == pytest.approx(0.2)
    assert snapshots_for_paraview(tmp_path / "mine") == list(run.times)


def killed_at_a_snapshot(number, tmp_path) -> Results:
    """A run whose process gets the signal `number` once its third snapshot is there."""
    settings = ("--set", "explicit.until=20", "--set", "output.every=0.5")
    process = start("run", *COARSE, *settings, "--out", "mine", cwd=tmp_path)
    assert process.stdout.readline().startswith("column_small: explicit, 208 points")
    run = Results.open(tmp_path / "mine")
    while run.read_checkpoint()["snapshots"] < 3:  # replaced whole, where the results are in the middle of a write
        assert process.poll() is None
    process.send_signal(number)
    _, err = process.communicate(timeout=60)
    assert process.returncode == (130 if number == signal.SIGTERM else -number), err
    assert not (tmp_path / "mine" / "summary.json").exists()
    return run


def test_a_killed_run_is_exported_and_resumed_with_all_its_paraview_files(repose, tmp_path):
    """kill -9: nothing can be written at that moment."""
    run = killed_at_a_snapshot(signal.SIGKILL, tmp_path)
    assert not (tmp_path / "mine" / "vtk").exists()
    assert repose("export", "mine").code == 0
    assert snapshots_for_paraview(tmp_path / "mine") == list(run.times)
    assert repose("resume", "mine").code == 0
    np.testing.assert_allclose(snapshots_for_paraview(tmp_path / "mine"), np.arange(41) * 0.5)


def test_kill_stops_a_run_as_ctrl_c_does(repose, tmp_path):
    run = killed_at_a_snapshot(signal.SIGTERM, tmp_path)
    assert snapshots_for_paraview(tmp_path / "mine") == list(run.times)
    assert repose("resume", "mine").code == 0
    assert run.summary()["sim_time"] == pytest.approx(20.0)
