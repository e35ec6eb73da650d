"""Interruptions: a process killed, a disk full, a folder that cannot be written or vanishes."""

import os
import shutil
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import h5py
import pytest
from apart import (
    IMPLICIT,
    SCENE,
    SETTINGS,
    WHEN,
    apart,
    assert_resumes_as_undisturbed,
    each_mode,
    finite,
    start,
    undisturbed,
)

from mpm.errors import SceneError
from mpm.results import CHECKPOINT, RESULTS, Results

KILLS = 6  # at moments of no one's choice
FULL_AT = (5000, 0, 700, 2000, 10000, 15000, 20000, 25000)  # bytes that the disk still has


@each_mode
@pytest.mark.parametrize("place", ["checkpoint", "snapshot"])
def test_killed_while_it_writes(tmp_path, mode, place):
    """SIGKILL from within the second half of a checkpoint, or of a snapshot: the earlier checkpoint serves."""
    make, write = h5py.Group.create_dataset, Path.write_bytes

    def create(group, name, *arguments, **named):
        dataset = make(group, name, *arguments, **named)
        if len(group) > 2:
            group.file.flush()
            os.kill(os.getpid(), signal.SIGKILL)
        return dataset

    def write_half(path, content):
        write(path, content[: len(content) // 2])
        os.kill(os.getpid(), signal.SIGKILL)

    def act(_run):  # in the forked process only
        if place == "checkpoint":
            Path.write_bytes = write_half
        else:
            h5py.Group.create_dataset = create

    undisturbed(mode)
    assert apart(lambda: start(mode, tmp_path / "run", act)).said == "SIGKILL"
    assert_resumes_as_undisturbed(mode, tmp_path / "run")


@pytest.mark.parametrize("kill", range(KILLS))
def test_killed_at_any_moment(tmp_path, kill):
    """SIGKILL while outputs are written all the time: checkpoint, snapshots and history up to it can be read."""
    folder, busy = tmp_path / "run", ["output.every=0.0005", "output.history_every=0.0005"]
    undisturbed("explicit")
    child = os.fork()
    if child == 0:
        with suppress(BaseException):
            start("explicit", folder, more=busy)
        os._exit(0)
    patience = time.monotonic() + 60.0
    while not (folder / CHECKPOINT).is_file() and time.monotonic() < patience:
        time.sleep(0.01)
    time.sleep(0.2 + 0.13 * kill)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    results = Results.open(folder)
    saved = results.read_checkpoint()
    assert all(map(finite, saved.values()))
    reached = float(saved["clock"][0])
    results.truncate_after(reached)
    for index in range(results.snapshot_count):
        results.snapshot(index)
    assert results.history()["time"].max() <= reached


# Of the program, whose disk is full a while after a checkpoint was written. What a process may write to a file is
# limited, as a full disk would: "File too large" in place of "No space left on device".
FULL = """
import resource
import sys
from pathlib import Path

import {mode}.run
from compare.cli import main as cli

class Monitor(cli.Monitor):
    def row(self, run, row):
        super().row(run, row)
        if row["time"] > {when}:
            size = (run.results.directory / {results!r}).stat().st_size + {more}
            resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))

cli.Monitor = Monitor
cli.main()
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mode", "more"),
    [
        *(("explicit", more) for more in FULL_AT),
        pytest.param("implicit", FULL_AT[0], marks=IMPLICIT.marks),  # which takes three times as long
    ],
)
def test_a_disk_that_fills_up(tmp_path, mode, more):
    """One line that starts with "error: ", exit code 1, no traceback; the earlier checkpoint serves."""
    undisturbed(mode)
    settings = [part for each in SETTINGS for part in ("--set", each)]
    program = FULL.format(mode=mode, when=WHEN, results=RESULTS, more=more)
    command = [sys.executable, "-P", "-c", program, "run", SCENE, "--mode", mode, "--out", str(tmp_path / "run")]
    path = os.pathsep.join(entry for entry in sys.path if entry)
    ended = subprocess.run(
        [*command, *settings], cwd=tmp_path, capture_output=True, text=True, env=os.environ | {"PYTHONPATH": path}
    )
    lines = ended.stderr.splitlines()
    assert ended.returncode == 1, ended.stderr
    assert len(lines) == 1, ended.stderr
    assert lines[0].startswith("error: ")
    assert_resumes_as_undisturbed(mode, tmp_path / "run")


@each_mode
@pytest.mark.parametrize("place", ["a file", "below a file", "/proc"])
def test_results_that_cannot_be_written(tmp_path, mode, place):
    """A named error (exit code 2) that gives the system's reason."""
    file = tmp_path / "file"
    file.write_text("")
    folder = {"a file": file, "below a file": file / "run", "/proc": Path("/proc/repose")}[place]
    ending = apart(lambda: start(mode, folder))
    assert ending.code == SceneError.exit_code, ending
    assert f"cannot write to {folder}: " in ending.said


@each_mode
def test_a_folder_that_vanishes_in_mid_run(tmp_path, mode):
    """The system's error, which the program prints in a line (exit code 1)."""
    undisturbed(mode)
    ending = apart(lambda: start(mode, tmp_path / "run", lambda run: shutil.rmtree(run.results.directory)))
    assert (ending.how, ending.code) == ("raised", 1)
    assert "No such file" in ending.said
