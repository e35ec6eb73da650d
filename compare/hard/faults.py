"""Hard cases of what goes wrong from outside: steps too long, numbers that are none, a process killed, a disk full.

A fault is stable (0, not 1) where the user reads what happened and goes on from the last good state. What may crash
runs in a process forked for it, so that a crash is a finding and ends nothing else.
"""

import functools
import importlib
import os
import pickle
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from compare.hard.case import Finding, hard_case
from mpm.config import load_scene
from mpm.errors import NumericalError, SceneError
from mpm.results import CHECKPOINT, RESULTS, Results

MODES = ("explicit", "implicit")
SCENE = "column_small"
SETTINGS = ("grid.cell=0.25", "explicit.until=0.3", "implicit.max_steps=8", "output.every=0.1", "output.vtk=false")
WHEN = 0.15  # [s] after which a fault strikes: behind it lies a checkpoint of the collapse
POINT = 7  # which is struck
STATE = {
    "explicit": ("x", "v", "sigma", "volume", "opening", "eps_p_eqv"),
    "implicit": ("x", "v", "b_e", "jacobian", "opening", "eps_p_eqv"),
}
OWN = {"wall_before", "nodes_stored_max"}  # of a process and what it stored, no part of the state
GOOD = (
    "said in a named error (exit code 3); the last good state is whole on disk, and resumed it ends as if undisturbed"
)
WHOLE = "the earlier checkpoint is whole, and resumed it ends as if undisturbed, to the bit"
KILLS = 6  # at moments of no one's choice
FULL_AT = (5000, 0, 700, 2000, 10000, 15000, 20000, 25000)  # bytes that the disk still has


@dataclass(frozen=True)
class Outcome:
    """How a call ended that ran in a process of its own: "returned", "raised" or "killed"; what a user reads of it."""

    how: str
    said: str
    code: int = 0


def apart(call) -> Outcome:
    """Run `call()` in a forked process."""
    receiver, sender = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(receiver)
        # PETSc's and faulthandler's handlers would report at length, and take the parent's MPI along.
        for number in (signal.SIGSEGV, signal.SIGBUS, signal.SIGFPE):
            signal.signal(number, signal.SIG_DFL)
        try:
            call()
            outcome = Outcome("returned", "")
        except BaseException as error:
            named = isinstance(error, SceneError | NumericalError)
            text = str(error) if named or isinstance(error, OSError) else f"{type(error).__name__}: {error}"
            code = error.exit_code if named else 1
            outcome = Outcome("raised", text, code)
        with os.fdopen(sender, "wb") as pipe:
            pickle.dump(outcome, pipe)
        os._exit(0)
    os.close(sender)
    with os.fdopen(receiver, "rb") as pipe:
        told = pipe.read()
    _, status = os.waitpid(child, 0)
    if os.WIFSIGNALED(status):
        return Outcome("killed", signal.Signals(os.WTERMSIG(status)).name, -os.WTERMSIG(status))
    return pickle.loads(told)


class Striker:
    """A monitor that calls `act(run)` once, at the first history row after `WHEN` seconds."""

    def __init__(self, act):
        self.act = act

    def start(self, _run):
        pass

    stop = start

    def row(self, run, row):
        if self.act and row["time"] > WHEN:
            act, self.act = self.act, None
            act(run)


def runs_of(mode: str):
    """The module with `run` and `resume`. Raises SceneError where the solver is not installed."""
    return importlib.import_module(f"{mode}.run")


def start(mode: str, folder: Path, act=None, more=()):
    """Run the scene of these cases, with `act(run)` in the middle of it."""
    runs_of(mode).run(load_scene(SCENE, [*SETTINGS, *more]), folder, monitor=Striker(act) if act else None)


@contextmanager
def scratch():
    """A folder's name, for a run."""
    with tempfile.TemporaryDirectory() as above:
        yield Path(above) / "run"


@functools.cache
def undisturbed(mode: str) -> dict:
    """What a run leaves that nothing disturbs."""
    with scratch() as folder:
        start(mode, folder)
        return left_in(folder)


def left_in(folder: Path) -> dict:
    """The restart state in `folder`, the history and the times of the snapshots."""
    results = Results.open(folder)
    history = {f"history of {name}": column for name, column in results.history().items()}
    return results.read_checkpoint() | history | {"times of snapshots": results.times}


def not_resumed(mode: str, folder: Path) -> str:
    """What is wrong with the run in `folder` once it was resumed to its end; "" where nothing is."""
    try:
        saved = Results.open(folder).read_checkpoint()
    except SceneError as error:
        return f"no checkpoint: {error}"
    if spoilt := [name for name, value in saved.items() if not _finite(value)]:
        return f"the checkpoint holds what is not finite: {', '.join(spoilt)}"
    outcome = apart(lambda: runs_of(mode).resume(folder))
    if outcome.how != "returned":
        return f"resume: {outcome.said}"
    ended, wanted = left_in(folder), undisturbed(mode)
    other = [name for name in wanted if name not in OWN and not np.array_equal(ended[name], wanted[name])]
    return f"resumed, it ends otherwise: {', '.join(other)}" if other else ""


def _finite(value) -> bool:
    return not isinstance(value, np.ndarray | float) or bool(np.isfinite(value).all())


def struck(mode: str, what: str, act) -> Finding:
    """The finding of a run whose state `act(run)` spoils: whether it stops by name and can be gone on with."""
    undisturbed(mode)  # not in the forked process, which would compute it for itself
    with scratch() as folder:
        outcome = apart(lambda: start(mode, folder, act))
        if outcome.how == "returned":
            return Finding(what, mode, 1.0, 0.0, GOOD, "no error: the run goes on to its end")
        said = _one_line(outcome.said, folder)
        if outcome.code != NumericalError.exit_code:
            return Finding(what, mode, 1.0, 0.0, GOOD, f"{outcome.how}: {said}")
        if "last good state: t = " not in outcome.said:
            return Finding(what, mode, 1.0, 0.0, GOOD, f"no last good state in: {said}")
        problem = not_resumed(mode, folder)
        return Finding(what, mode, float(bool(problem)), 0.0, GOOD, f"{problem}; it said: {said}" if problem else said)


def _one_line(text: str, folder: Path) -> str:
    return "; ".join(text.replace(str(folder), "DIR").splitlines())


def setting(name: str, value: float):
    """An `act` that sets array `name` of the solver's state to `value` at one point."""

    def act(run):
        array = getattr(run.solver if run.mode == "explicit" else run.solver.state, name)
        values = array.numpy().copy()
        values.reshape(len(values), -1)[POINT] = value
        array.assign(values)

    return act


@hard_case("too far")
def too_far():
    """A step that is too long, a point driven off every limit."""
    yield _three_courant_steps()
    for speed in (1e3, 1e30, 1e200):
        yield struck("explicit", f"a point thrown at {speed:.0e} m/s", setting("v", speed))
    for mode in MODES:
        yield struck(mode, "a point put 1e30 m away", setting("x", 1e30))
    yield _much_too_long_step()


def _three_courant_steps() -> Finding:
    """A fixed step of three times h/(c + |v|): refused, and refused again, with the state before it on disk."""
    scene = load_scene(SCENE, list(SETTINGS))
    step = 3.0 * scene.grid.cell / scene.material.constants().p_wave_speed
    reason = "refused by name before it is taken, resumed or not; the state stays"
    with scratch() as folder:
        first = apart(lambda: start("explicit", folder, more=[f"explicit.time_step={step}"]))
        saved = Results.open(folder).read_checkpoint()
        second = apart(lambda: runs_of("explicit").resume(folder))
        kept = Results.open(folder).read_checkpoint()
        holds = all(end.code == NumericalError.exit_code and "Courant limit" in end.said for end in (first, second))
        holds &= all(_finite(value) for value in saved.values())
        holds &= all(np.array_equal(saved[name], kept[name]) for name in set(saved) - OWN)
        note = _one_line(first.said, folder)
    return Finding("a fixed step of three Courant steps", "explicit", float(not holds), 0.0, reason, note)


def _much_too_long_step() -> Finding:
    """A step in pseudo-time a thousand times the longest: shortened until Newton solves it."""
    record = {}

    class Follower(Striker):
        def row(self, run, row):
            super().row(run, row)
            record.update(failed=run.solver.failed_steps, dt=row["dt"], moved=np.abs(run.x - run.body.x).max())

    def act(run):
        run.solver.length.dt *= 1e3

    runs, scene = runs_of("implicit"), load_scene(SCENE, list(SETTINGS))
    with scratch() as folder:
        try:
            runs.run(scene, folder, monitor=Follower(act))
            said = f"{record['failed']} tries failed; the points moved {record['moved']:.2f} m at most in the run"
            holds = record["moved"] < scene.geometry.radius
        except NumericalError as error:
            said, holds = _one_line(str(error), folder), not not_resumed("implicit", folder)
    reason = "shortened until Newton solves it, points within r0 of where they were; or a named error"
    return Finding("a step of a thousand times its length", "implicit", float(not holds), 0.0, reason, said)


@hard_case("not a number")
def not_a_number():
    """NaN in one point's state, in mid-run or in the checkpoint that a run is resumed from."""
    for mode in MODES:
        for name in STATE[mode]:
            yield struck(mode, f"NaN in {name} of a point", setting(name, np.nan))
        yield _doctored(mode)


def _doctored(mode: str) -> Finding:
    """A run stopped half-way, NaN written into its checkpoint, resumed."""
    name = "v" if mode == "explicit" else "b_e"
    with scratch() as folder:
        apart(lambda: start(mode, folder, lambda _run: os.kill(os.getpid(), signal.SIGKILL)))
        with h5py.File(folder / CHECKPOINT, "r+") as file:
            values = file[name][()]
            values.reshape(len(values), -1)[POINT] = np.nan
            file[name][...] = values
        outcome = apart(lambda: runs_of(mode).resume(folder))
        said = _one_line(outcome.said, folder) or outcome.how
    holds = outcome.code in (SceneError.exit_code, NumericalError.exit_code)
    what, reason = f"NaN in {name} in the checkpoint", "resume ends in a named error (exit code 2 or 3)"
    return Finding(what, mode, float(not holds), 0.0, reason, said)


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
    make = h5py.Group.create_dataset

    def create(group, name, *arguments, **named):
        dataset = make(group, name, *arguments, **named)
        in_place = (
            group.file.filename.endswith(".tmp") if place == "checkpoint" else group.name.startswith("/snapshots")
        )
        if in_place and len(group) > 2:
            group.file.flush()
            os.kill(os.getpid(), signal.SIGKILL)
        return dataset

    def act(_run):
        h5py.Group.create_dataset = create  # in the forked process only

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
                whole = results.history()["time"].max() <= times[-1] and all(map(_finite, saved.values()))
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
from compare import cli

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
            said = _one_line(outcome.said, file)
            yield Finding(f"results in {what}", mode, float(not holds), 0.0, reason, said or outcome.how)
    with scratch() as folder:
        outcome = apart(lambda: start(mode, folder, lambda run: shutil.rmtree(run.results.directory)))
        holds = outcome.how == "raised" and outcome.code == 1 and "No such file" in outcome.said
        reason = "the system's error, which the program prints in a line (exit code 1)"
        said = _one_line(outcome.said, folder) or outcome.how
        yield Finding("the folder vanishes in mid-run", mode, float(not holds), 0.0, reason, said)
