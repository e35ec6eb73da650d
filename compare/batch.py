"""Runs of a study, each in a process of its own: kept, reused, gone on with, and failed ones reported as such."""

import fcntl
import hashlib
import json
import os
import shlex
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

from compare.launch import ONE_THREAD, exit_code, may_take_ranks, refuse_ranks, sorted_lines, start, stop
from compare.solvers import runs_of
from compare.worker import JOB, OUTCOME
from mpm.body import build
from mpm.command import command
from mpm.devices import find_device
from mpm.errors import INTERRUPTED, SceneError
from mpm.load import load_scene
from mpm.precheck import refusals
from mpm.provenance import code_version, decisive, device_name
from mpm.results import Results
from mpm.scene import Scene

LOCK = "lock"
LOOK_EVERY = 0.2  # [s] between looks at the processes


class Workers(NamedTuple):
    """How many runs of a batch go at a time, and on how many MPI ranks each, where its device takes several."""

    runs: int = 1
    ranks: int = 1


@dataclass(frozen=True)
class Job:
    """One run: `name` in its study, scene file or preset, `--set` overrides, mode, device.

    `regularisation`: what differs from `implicit.pseudo_time.Regularisation`.
    `ranks`: how many MPI ranks compute it; on a device that takes one alone it is one.
    """

    name: str
    reference: str
    settings: tuple[str, ...]
    mode: str
    device: str = "cpu"
    regularisation: dict[str, float] = field(default_factory=dict)
    ranks: int = 1

    @cached_property
    def scene(self) -> Scene:
        """The resolved scene. Raises SceneError with every problem."""
        return load_scene(self.reference, list(self.settings))

    @cached_property
    def key(self) -> str:
        """Digest of what decides result and cost: resolved scene, mode, regularisation, device, ranks, solver's code.

        Raises SceneError for a device that is not there, with a list of those that are, or an unreadable mesh file.
        """
        find_device(self.device)
        decides: list[Any] = [self.scene.model_dump(mode="json"), self.regularisation, device_name(self.device)]
        decides.append(decisive(self.mode, self.scene))
        if self.ranks > 1:
            decides.append(f"{self.ranks} ranks")
        return hashlib.sha256(json.dumps(decides, sort_keys=True).encode()).hexdigest()[:12]

    @property
    def command(self) -> str:
        """The command that makes the same run, or the benchmark's where the command line has no such setting."""
        ranks = ["--ranks", str(self.ranks)] if self.ranks > 1 else []
        settings = [word for item in self.settings for word in ("--set", item)]
        if not self.regularisation:
            return command("run", self.reference, "--mode", self.mode, "--device", self.device, *ranks, *settings)
        words = ["python", "benchmarks/implicit_runs.py", self.reference, "--table", "FILE"]
        words += [word for name, value in self.regularisation.items() for word in ("--reg", f"{name}={value:g}")]
        return shlex.join(words + settings)


@dataclass(frozen=True)
class Outcome:
    """How a job ended: `summary` of a run that is done (see `mpm.run`), else the `reason` it failed for."""

    job: Job
    folder: Path
    summary: dict | None
    reason: str | None
    reused: bool = False

    @property
    def done(self) -> bool:
        """Whether the run ended with a result."""
        return self.summary is not None

    @property
    def results(self) -> Results:
        """The run's store. Raises SceneError where the run failed before it had one."""
        return Results.open(self.folder)


def run_all(jobs: list[Job], directory: Path, workers: Workers, force: bool, monitor) -> list[Outcome]:
    """Run what is not there yet, with so many `workers`; the outcomes in the order of `jobs`.

    A run's folder is `directory`/NAME-KEY, so that another scene, device or version of the code never meets it.
    `force` runs all of them again. `monitor` has `start(jobs)`, `look(job, log)`, `ended(outcome)` and `stop()`.
    Raises SceneError, before anything is run, for what a solver would refuse, for a solver that is not installed and
    where another call is at work in `directory`. Raises KeyboardInterrupt after every process has saved its state: the
    same call, without `force`, then goes on from there.
    """
    outcomes: list[Outcome | None] = [None] * len(jobs)
    if workers.ranks > 1:
        takers = [job for job in jobs if may_take_ranks(job.device)]
        for device in {job.device for job in takers or jobs}:
            refuse_ranks(device, workers.ranks)
        jobs = [replace(job, ranks=workers.ranks) if job in takers else job for job in jobs]
    folders = [directory / f"{job.name}-{job.key}" for job in jobs]  # every scene is resolved before any run starts
    for mode in {job.mode: None for job in jobs}:
        runs_of(mode)
    refused = [problem for job in jobs for problem in refusals(build(job.scene), job.mode)]
    if refused:
        raise SceneError(list(dict.fromkeys(refused)))
    waiting = list(range(len(jobs)))
    active: dict[int, tuple[Path, subprocess.Popen]] = {}
    with _alone_in(directory) as lock, killed_as_by_ctrl_c():
        monitor.start(jobs)
        try:
            while waiting or active:
                while waiting and len(active) < workers.runs:
                    number = waiting.pop(0)
                    job, folder = jobs[number], folders[number]
                    if not force and (folder / OUTCOME).is_file():
                        outcomes[number] = _outcome(job, folder, reused=True)
                        monitor.ended(outcomes[number])
                    else:
                        active[number] = folder, _start(job, folder, force, lock)
                time.sleep(LOOK_EVERY if active else 0.0)
                for number, (folder, process) in list(active.items()):
                    monitor.look(jobs[number], _log(folder))
                    if (code := process.poll()) is None:
                        continue
                    del active[number]
                    if exit_code(code) == INTERRUPTED:
                        raise KeyboardInterrupt
                    outcomes[number] = _outcome(jobs[number], folder, code)
                    monitor.ended(outcomes[number])
        except KeyboardInterrupt:
            same = "the same command without --force" if force else "the same command"
            raise KeyboardInterrupt(f"stopped; finished runs are in {directory}: {same} goes on") from None
        finally:
            for number, (_, process) in active.items():
                # Again, if the terminal has sent it: that does no harm.
                stop(process) if jobs[number].ranks > 1 else process.send_signal(signal.SIGINT)
            for _, process in active.values():
                process.wait()
            monitor.stop()
    return outcomes


@contextmanager
def killed_as_by_ctrl_c():
    """Take `kill` for Ctrl-C: runs then save their state and are not left behind."""
    try:
        before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    except ValueError:  # only the main thread is told of signals
        yield
        return
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


@contextmanager
def _alone_in(directory: Path):
    """An open file whose lock says that a study is at work in `directory`; SceneError where another one holds it."""
    directory.mkdir(parents=True, exist_ok=True)
    with open(directory / LOCK, "w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise SceneError(f"{directory}: another study, or a run that it left behind, is at work there") from None
        yield lock


def _start(job: Job, folder: Path, force: bool, lock) -> subprocess.Popen:
    """The process of one run, which holds on to `lock`; what it prints goes to a log beside its folder."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / OUTCOME).unlink(missing_ok=True)
    if force:
        for name in ("checkpoint.h5", "summary.json"):
            (folder / name).unlink(missing_ok=True)
    asked = {"scene": job.scene.model_dump(mode="json"), "mode": job.mode, "device": job.device}
    asked |= {"regularisation": job.regularisation, "command": job.command, "code": code_version(job.mode)}
    (folder / JOB).write_text(json.dumps(asked, indent=2), encoding="utf-8")
    words = ["-P", "-m", "compare.worker", str(folder)]
    env = os.environ | ONE_THREAD | {"COLUMNS": "200", "PYTHONUNBUFFERED": "1"}
    streams: dict[str, Any] = {"stderr": subprocess.STDOUT, "stdin": subprocess.DEVNULL, "pass_fds": (lock.fileno(),)}
    with open(_log(folder), "w", encoding="utf-8") as log:
        if job.ranks > 1:
            return start(job.ranks, words, stdout=log, env=env, **streams)
        return subprocess.Popen([sys.executable, *words], stdout=log, env=env, **streams)


def _log(folder: Path) -> Path:
    return folder.with_name(folder.name + ".log")  # with_suffix would take ".5-KEY" of column "0.5" for a suffix


def _outcome(job: Job, folder: Path, code: int = 0, reused: bool = False) -> Outcome:
    """What outcome.json says, or, of a process that left none, how it died."""
    if (folder / OUTCOME).is_file():
        said = json.loads((folder / OUTCOME).read_text(encoding="utf-8"))
        summary = Results.open(folder).summary() if said["status"] == "done" else None
        return Outcome(job, folder, summary, said["reason"], reused)
    how = f"signal {-code}" if code < 0 else f"exit code {code}"
    log = _log(folder).read_text(encoding="utf-8", errors="replace").strip().splitlines()
    lines = [line for line, is_launchers in sorted_lines(log) if line and not is_launchers]
    return Outcome(job, folder, None, f"the process died ({how}): {lines[-1] if lines else 'without a word'}")
