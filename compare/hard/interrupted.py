"""Hard cases of interruptions: a process killed, a disk full, a folder that cannot be written or vanishes."""

import os
import shutil
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import h5py

from compare.hard.apart import (
    MODES,
    SCENE,
    SETTINGS,
    WHEN,
    apart,
    finite,
    not_resumed,
    one_line,
    scratch,
    start,
    undisturbed,
)
from compare.hard.case import Finding, hard_case
from mpm.errors import SceneError
from mpm.results import CHECKPOINT, RESULTS, Results

WHOLE = "the earlier checkpoint is whole, and resumed it ends as if undisturbed, to the bit"
KILLS = 6  # at moments of no one's choice
FULL_AT = (5000, 0, 700, 2000, 10000, 15000, 20000, 25000)  # bytes that the disk still has


@hard_case("interrupted")
def interrupted():
    """Killed while it writes, killed at any moment, a folder that cannot be written or vanishes."""
    for mode in MODES:
        undisturbed(mode)
        for file in ("checkpoint", "snapshots"):
            yield _killed_in(mode, file)
        if mode == "explicit":
            yield _killed_anywhere()
        yield from _no_folder(mode)


@hard_case("disk full", slow=True)
def disk_full():
    """A disk that fills up some time after a checkpoint."""
    for mode in MODES:
        undisturbed(mode)
        yield from _disk_full(mode)


def _killed_in(mode: str, place: str) -> Finding:
    """SIGKILL from within the second half of a checkpoint, or of a snapshot."""
    make, write = h5py.Group.create_dataset, Path.write_bytes

    def create(group, name, *arguments, **named):
        dataset = make(group, name, *arguments, **named)
        if place == "snapshots" and len(group) > 2:
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

    with scratch() as folder:
        outcome = apart(lambda: start(mode, folder, act))
        problem = not_resumed(mode, folder) if outcome.said == "SIGKILL" else f"not killed: {outcome}"
    return Finding(f"killed while writing a {place.rstrip('s')}", mode, float(bool(problem)), 0.0, WHOLE, problem)


def _killed_anywhere() -> Finding:
    """SIGKILL at moments of no one's choice, while outputs are written all the time."""
    busy = ["output.every=0.0005", "output.history_every=0.0005"]
    lost, problems, times = 0, "", []
    with scratch() as folder:
        for kill in range(KILLS):
            shutil.rmtree(folder, ignore_errors=True)
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
            try:
                results = Results.open(folder)
                saved = results.read_checkpoint()
                times.append(float(saved["clock"][0]))
                results.truncate_after(times[-1])
                for index in range(results.snapshot_count):
                    results.snapshot(index)
                whole = results.history()["time"].max() <= times[-1] and all(map(finite, saved.values()))
                lost, problems = lost + (not whole), problems or "" if whole else "not whole"
            except Exception as error:
                lost, problems = lost + 1, f"{type(error).__name__}: {error}"
    note = problems or f"of {KILLS} runs, at t = {', '.join(f'{t:.3f}' for t in times)} s"
    reason = "checkpoint, snapshots and history up to it can be read"
    return Finding("runs lost when killed at any moment", "explicit", float(lost), 0.0, reason, note)


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


def _disk_full(mode: str):
    """Whether the program says so in a line, and what it leaves on disk."""
    readable, worst, codes, said = 0, "", [], ""
    for more in FULL_AT[: None if mode == "explicit" else 1]:  # an implicit run takes three times as long
        with scratch() as folder:
            settings = [part for each in SETTINGS for part in ("--set", each)]
            program = FULL.format(mode=mode, when=WHEN, results=RESULTS, more=more)
            command = [sys.executable, "-P", "-c", program, "run", SCENE, "--mode", mode, "--out", str(folder)]
            path = os.pathsep.join(entry for entry in sys.path if entry)
            ended = subprocess.run(
                [*command, *settings],
                cwd=folder.parent,
                capture_output=True,
                text=True,
                env=os.environ | {"PYTHONPATH": path},
            )
            codes.append(ended.returncode)
            lines = ended.stderr.splitlines()
            if ended.returncode != 1 or len(lines) != 1 or not lines[0].startswith("error: "):
                how = f"{ended.returncode}, {len(lines)} lines on stderr, {ended.stderr.count('Traceback')} tracebacks"
                said = said or f"exit code {how}; first: {next((x for x in lines if 'Error' in x), '')}"
            readable, note = readable + 1, not_resumed(mode, folder)
            if note:
                readable, worst = readable - 1, note
    reason = "one line that starts with 'error: ', exit code 1, no traceback"
    tries = f"exit codes {codes}"
    yield Finding("disk full: what the user reads", mode, float(bool(said)), 0.0, reason, said or tries)
    yield Finding("disk full: what is saved", mode, float(len(codes) - readable), 0.0, WHOLE, worst or tries)


def _no_folder(mode: str):
    """Results that cannot be written: below a file, in /proc, in a folder that vanishes."""
    reason = "a named error (exit code 2) that gives the system's reason, nothing run"
    with scratch() as file:
        file.write_text("")
        places = {"a file": file, "a file's name as folder": file / "run", "/proc": Path("/proc/repose")}
        for what, place in places.items():
            outcome = apart(lambda place=place: start(mode, place))
            holds = outcome.code == SceneError.exit_code and f"cannot write to {place}: " in outcome.said
            said = one_line(outcome.said, file)
            yield Finding(f"results in {what}", mode, float(not holds), 0.0, reason, said or outcome.how)
    with scratch() as folder:
        outcome = apart(lambda: start(mode, folder, lambda run: shutil.rmtree(run.results.directory)))
        holds = outcome.how == "raised" and outcome.code == 1 and "No such file" in outcome.said
        reason = "the system's error, which the program prints in a line (exit code 1)"
        said = one_line(outcome.said, folder) or outcome.how
        yield Finding("the folder vanishes in mid-run", mode, float(not holds), 0.0, reason, said)
