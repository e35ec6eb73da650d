"""Runs of a study: kept and reused, gone on with where they stopped, failures reported without losing the others."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace

import pytest
from installed import needs_ranks

from compare import batch
from compare.batch import Job, Workers, run_all
from mpm import provenance
from mpm.errors import SceneError
from mpm.results import Results

FAST = ("grid.cell=0.25", "explicit.until=0.05", "output.vtk=false")


class Quiet:
    """A monitor that only remembers which runs ended, and how."""

    def __init__(self):
        self.names = []

    def start(self, jobs):
        self.jobs = jobs

    def look(self, job, log):
        pass

    def ended(self, outcome):
        self.names.append((outcome.job.name, outcome.reused))

    def stop(self):
        self.stopped = True


def job(name="a", *settings, **named):
    return Job(name, "column_small", (*FAST, *settings), "explicit", **named)


def test_a_run_is_kept_and_another_setting_never_meets_it(tmp_path):
    first = run_all([job()], tmp_path, Workers(), False, Quiet())[0]
    assert first.done and first.summary["sim_time"] == pytest.approx(0.05)
    monitor = Quiet()
    again, other = run_all([job(), job("a", "explicit.damping=0.1")], tmp_path, Workers(), False, monitor)
    assert monitor.names == [("a", True), ("a", False)]
    assert monitor.stopped
    assert again.summary == first.summary
    assert again.folder == first.folder != other.folder


def test_the_solvers_code_and_the_device_are_part_of_what_a_run_is(monkeypatch):
    key = job().key
    monkeypatch.setattr(provenance, "code_version", lambda mode: "other")
    assert job().key != key
    monkeypatch.undo()
    monkeypatch.setattr(batch, "device_name", lambda device: "other")
    assert job().key != key
    monkeypatch.undo()
    assert job("b").key == key  # the name is the study's


def test_each_run_has_a_log_of_its_own_whatever_dots_its_name_has(tmp_path):
    run_all([job("D0.4-0.5"), job("D0.4-0.25", "explicit.damping=0.2")], tmp_path, Workers(2), False, Quiet())
    logs = sorted(path.name for path in tmp_path.glob("*.log"))
    assert [name.rpartition("-")[0] for name in logs] == ["D0.4-0.25", "D0.4-0.5"]
    assert all("column_small: explicit" in (tmp_path / name).read_text() for name in logs)


def test_force_runs_it_again(tmp_path):
    first = run_all([job()], tmp_path, Workers(), False, Quiet())[0]
    date = first.results.provenance["date"]
    time.sleep(1.1)  # dates are to the second
    again = run_all([job()], tmp_path, Workers(), True, Quiet())[0]
    assert not again.reused
    assert again.results.provenance["date"] > date
    assert again.summary["R_995"] == first.summary["R_995"]


def test_a_failed_run_says_why_and_the_others_go_on(tmp_path):
    jobs = [job("bad", "explicit.time_step=0.003986"), job("good")]  # h/c = 3.988 ms: too long as points speed up
    bad, good = run_all(jobs, tmp_path, Workers(2), False, Quiet())
    assert not bad.done and good.done
    assert "Courant limit" in bad.reason
    kept = run_all(jobs[:1], tmp_path, Workers(), False, Quiet())[0]
    assert kept.reused and kept.reason == bad.reason


@pytest.mark.parametrize(("script", "how"), [("exit 7", "exit code 7"), ("kill -9 $$", "signal 9")])
def test_a_process_that_dies_is_a_failed_run_and_is_tried_again(tmp_path, monkeypatch, script, how):
    shell = tmp_path / "python"
    shell.write_text(f"#!/bin/sh\necho last words\n{script}\n")
    shell.chmod(0o755)
    monkeypatch.setattr(batch.sys, "executable", str(shell))
    (dead,) = run_all([job()], tmp_path / "runs", Workers(), False, Quiet())
    assert not dead.done
    assert how in dead.reason and "last words" in dead.reason
    monkeypatch.undo()
    assert run_all([job()], tmp_path / "runs", Workers(), False, Quiet())[0].done


@pytest.mark.parametrize("by", [signal.SIGINT, signal.SIGTERM], ids=["ctrl-c", "kill"])
def test_an_interrupt_saves_every_run_and_the_same_call_goes_on_to_the_same_bits(found_by_processes, tmp_path, by):
    """A study is interrupted as its run has passed a checkpoint; its end is that of a run that was not."""
    # Two calls at once in one folder would write over each other.
    settings = ("grid.cell=0.25", "explicit.until=6.0", "output.every=0.5", "output.vtk=false")
    code = (
        "from pathlib import Path; from test_batch import Quiet; from compare.batch import Job, Workers, run_all;"
        f"run_all([Job('a', 'column_small', {settings!r}, 'explicit')], Path('runs'), Workers(), False, Quiet())"
    )
    study = subprocess.Popen([sys.executable, "-c", code], cwd=tmp_path, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 60
    while not (found := list(tmp_path.glob("runs/*/checkpoint.h5"))) and time.monotonic() < deadline:
        time.sleep(0.02)
    with pytest.raises(SceneError, match="another study"):
        run_all([job()], tmp_path / "runs", Workers(), False, Quiet())
    study.send_signal(by)
    _, err = study.communicate(timeout=60)
    assert "the same command goes on" in err
    assert not (found[0].parent / "summary.json").exists()
    one = Job("a", "column_small", settings, "explicit")
    (resumed,) = run_all([one], tmp_path / "runs", Workers(), False, Quiet())
    (whole,) = run_all([one], tmp_path / "whole", Workers(), False, Quiet())
    assert not resumed.reused
    assert resumed.summary["R_995"] == whole.summary["R_995"]
    assert resumed.summary["steps"] == whole.summary["steps"]
    assert (Results.open(found[0].parent).times == whole.results.times).all()


def test_a_checkpoint_that_cannot_be_read_is_started_anew(tmp_path):
    (first,) = run_all([job()], tmp_path, Workers(), False, Quiet())
    for name in ("outcome.json", "summary.json"):
        (first.folder / name).unlink()
    (first.folder / "checkpoint.h5").write_bytes(b"cut short")
    (again,) = run_all([job()], tmp_path, Workers(), False, Quiet())
    assert again.done and again.summary["R_995"] == first.summary["R_995"]


def test_a_mesh_is_known_by_its_content_and_a_device_by_what_there_is(tmp_path):
    body = tmp_path / "body.stl"
    scene = tmp_path / "scene.toml"
    scene.write_text(
        'name = "m"\n[geometry]\nshape = "mesh"\nfile = "body.stl"\n[grid]\ncell = 0.1\n'
        "[material]\nyoung = 1e6\npoisson = 0.3\ndensity = 2000.0\nfriction_angle = 30.0\n"
    )
    keys = []
    for content in (b"one", b"two"):
        body.write_bytes(content)
        keys.append(Job("a", str(scene), (), "explicit").key)
    assert keys[0] != keys[1]
    body.unlink()
    with pytest.raises(SceneError, match=r"body\.stl: No such file"):
        _ = Job("a", str(scene), (), "explicit").key
    with pytest.raises(SceneError, match="this machine has: cpu"):
        _ = job(device="cuda:9").key


def test_a_bad_scene_is_told_before_anything_runs(tmp_path):
    with pytest.raises(SceneError, match="poisson"):
        run_all([job(), job("b", "material.poisson=2")], tmp_path, Workers(), False, Quiet())
    assert not list(tmp_path.iterdir())  # nothing was started


def test_what_a_solver_would_refuse_is_told_before_anything_runs(tmp_path):
    jobs = [job(), job("b", "explicit.time_step=1.0"), job("c", "explicit.time_step=1.0")]
    with pytest.raises(SceneError) as caught:
        run_all(jobs, tmp_path, Workers(), False, Quiet())
    assert len(caught.value.problems) == 1 and "Courant limit" in caught.value.problems[0]
    assert not list(tmp_path.iterdir())


def test_the_command_makes_the_same_run():
    assert job("a", "explicit.damping=0.4").command == (
        "repose run column_small --mode explicit --device cpu --set grid.cell=0.25 --set explicit.until=0.05 "
        "--set output.vtk=false --set explicit.damping=0.4"
    )


@needs_ranks
def test_a_run_on_ranks_is_a_run_of_its_own_with_the_same_result(tmp_path):
    (alone,) = run_all([job()], tmp_path, Workers(), False, Quiet())
    (many,) = run_all([job()], tmp_path, Workers(ranks=2), False, Quiet())
    assert many.done and not many.reused
    assert many.folder != alone.folder
    assert (many.summary["ranks"], many.job.ranks) == (2, 2)
    assert many.summary["R_995"] == pytest.approx(alone.summary["R_995"], rel=1e-9)
    assert "--ranks 2" in many.job.command
    log = many.folder.with_name(many.folder.name + ".log").read_text()
    assert "on 2 ranks" in log and "\x1b" not in log  # a launcher may give ranks a terminal: no bar all the same
    assert run_all([job()], tmp_path, Workers(ranks=2), False, Quiet())[0].reused


def test_a_run_on_one_gpu_has_one_rank_in_a_batch_of_ranks(monkeypatch, tmp_path):
    """No process is started."""
    monkeypatch.setattr(batch, "find_device", lambda name: None)
    monkeypatch.setattr(batch, "device_name", str)
    monkeypatch.setattr("mpm.devices.gpu_count", lambda: 3)
    started = []

    def stand_in(job, folder, force, lock):
        started.append((job.name, job.ranks))
        folder.with_name(folder.name + ".log").touch()
        return subprocess.Popen(["true"])

    monkeypatch.setattr(batch, "_start", stand_in)
    monkeypatch.setattr(batch, "runs_of", lambda mode: None)
    jobs = [replace(job(device), device=device) for device in ("cuda:0", "cpu", "cuda")]
    run_all(jobs, tmp_path, Workers(ranks=3), False, Quiet())
    assert started == [("cuda:0", 1), ("cpu", 3), ("cuda", 3)]
    with pytest.raises(SceneError, match="that is one device, for one rank"):
        run_all(jobs[:1], tmp_path, Workers(ranks=3), False, Quiet())
    with pytest.raises(SceneError, match="each of 4 ranks takes a GPU of its own, and this machine has 3"):
        run_all(jobs, tmp_path, Workers(ranks=4), False, Quiet())
    assert len(started) == 3


@needs_ranks
def test_a_run_whose_rank_is_killed_is_a_failed_run(tmp_path, ranks_below):
    """Its log ends with what the launcher has to say; what the run said last is more use."""
    long = Job("a", "column_small", ("explicit.until=60.0", "output.every=0.05", "output.vtk=false"), "explicit")
    killed = []

    class Killer(Quiet):
        def look(self, job, log):
            if not killed and list(tmp_path.glob("*/checkpoint.h5")):
                killed.extend(ranks_below(os.getpid()))
                os.kill(killed[-1], signal.SIGKILL)

    (dead,) = run_all([long], tmp_path, Workers(ranks=2), False, Killer())
    assert not dead.done
    assert dead.reason.startswith("the process died (exit code 137): ")
    assert "mpiexec" not in dead.reason and "signal 9" not in dead.reason


@needs_ranks
def test_ctrl_c_saves_a_run_on_ranks_and_the_same_call_goes_on(tmp_path):
    settings = ("grid.cell=0.25", "explicit.until=6.0", "output.every=0.5", "output.vtk=false")
    one = Job("a", "column_small", settings, "explicit")

    class Interrupting(Quiet):
        def look(self, job, log):
            if list(tmp_path.glob("*/checkpoint.h5")):
                raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt, match="the same command goes on"):
        run_all([one], tmp_path, Workers(ranks=2), False, Interrupting())
    (folder,) = {path.parent for path in tmp_path.glob("*/checkpoint.h5")}
    assert not (folder / "summary.json").exists()
    (resumed,) = run_all([one], tmp_path, Workers(ranks=2), False, Quiet())
    assert resumed.done and resumed.folder == folder
    assert resumed.summary["sim_time"] == pytest.approx(6.0)
