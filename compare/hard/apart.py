"""A small run in a process of its own, disturbed in the middle, and what it leaves for `resume`.

What may crash runs in a process forked for it, so that a crash is a finding and ends nothing else.
"""

import functools
import os
import pickle
import signal
import tempfile
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from compare.solvers import runs_of
from mpm.errors import NumericalError, SceneError
from mpm.load import load_scene
from mpm.results import Results

MODES = ("explicit", "implicit")
SCENE = "column_small"
SETTINGS = ("grid.cell=0.25", "explicit.until=0.3", "implicit.max_steps=8", "output.every=0.1", "output.vtk=false")
WHEN = 0.15  # [s] after which a fault strikes: behind it lies a checkpoint of the collapse
OWN = {"wall_before", "nodes_stored_max"}  # of a process and what it stored, no part of the state


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
    if spoilt := [name for name, value in saved.items() if not finite(value)]:
        return f"the checkpoint holds what is not finite: {', '.join(spoilt)}"
    outcome = apart(lambda: runs_of(mode).resume(folder))
    if outcome.how != "returned":
        return f"resume: {outcome.said}"
    ended, wanted = left_in(folder), undisturbed(mode)
    other = [name for name in wanted if name not in OWN and not np.array_equal(ended[name], wanted[name])]
    return f"resumed, it ends otherwise: {', '.join(other)}" if other else ""


def finite(value) -> bool:
    """Whether a value of the state holds no NaN or infinity."""
    return not isinstance(value, np.ndarray | float) or bool(np.isfinite(value).all())


def one_line(text: str, folder: Path) -> str:
    """What a run said, in a line that does not name its folder."""
    return "; ".join(text.replace(str(folder), "DIR").splitlines())
