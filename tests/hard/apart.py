"""A small run in a process of its own, disturbed in the middle, and what it leaves for `resume`.

What may crash runs in a process forked for it, so that a crash fails its test and ends nothing else.
"""

import functools
import os
import pickle
import signal
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from findings import HAS_IMPLICIT

from compare.solvers import runs_of
from mpm.errors import NumericalError, SceneError
from mpm.load import load_scene
from mpm.results import Results

SCENE = "column_small"
SETTINGS = ("grid.cell=0.25", "explicit.until=0.3", "implicit.max_steps=8", "output.every=0.1", "output.vtk=false")
WHEN = 0.15  # [s] after which a fault strikes: behind it lies a checkpoint of the collapse
OWN = {"wall_before", "nodes_stored_max"}  # of a process and what it stored, no part of the state

_no_implicit = pytest.mark.skipif(not HAS_IMPLICIT, reason="dolfinx or petsc4py is not installed (see ./repose info)")
IMPLICIT = pytest.param("implicit", marks=_no_implicit)
each_mode = pytest.mark.parametrize("mode", ["explicit", IMPLICIT])


@dataclass(frozen=True)
class Ending:
    """How a call ended that ran in a process of its own: "returned", "raised" or "killed"; what a user reads of it."""

    how: str
    said: str
    code: int = 0


def apart(call) -> Ending:
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
            ending = Ending("returned", "")
        except BaseException as error:
            named = isinstance(error, SceneError | NumericalError)
            text = str(error) if named or isinstance(error, OSError) else f"{type(error).__name__}: {error}"
            code = error.exit_code if named else 1
            ending = Ending("raised", text, code)
        with os.fdopen(sender, "wb") as pipe:
            pickle.dump(ending, pipe)
        os._exit(0)
    os.close(sender)
    with os.fdopen(receiver, "rb") as pipe:
        told = pipe.read()
    _, status = os.waitpid(child, 0)
    if os.WIFSIGNALED(status):
        return Ending("killed", signal.Signals(os.WTERMSIG(status)).name, -os.WTERMSIG(status))
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


@functools.cache
def undisturbed(mode: str) -> dict:
    """What a run leaves that nothing disturbs. Call it before a fork: the child then has its kernels loaded."""
    with tempfile.TemporaryDirectory() as above:
        start(mode, Path(above) / "run")
        return left_in(Path(above) / "run")


def left_in(folder: Path) -> dict:
    """The restart state in `folder`, the history and the times of the snapshots."""
    results = Results.open(folder)
    history = {f"history of {name}": column for name, column in results.history().items()}
    return results.read_checkpoint() | history | {"times of snapshots": results.times}


def assert_resumes_as_undisturbed(mode: str, folder: Path):
    """The checkpoint in `folder` is whole, and the run resumed from it ends as if undisturbed, to the bit."""
    for name, value in Results.open(folder).read_checkpoint().items():
        assert finite(value), f"{name} in the checkpoint is not finite"
    ending = apart(lambda: runs_of(mode).resume(folder))
    assert ending.how == "returned", ending.said
    ended, wanted = left_in(folder), undisturbed(mode)
    for name in wanted.keys() - OWN:
        np.testing.assert_array_equal(ended[name], wanted[name], err_msg=name)


def finite(value) -> bool:
    """Whether a value of the state holds no NaN or infinity."""
    return not isinstance(value, np.ndarray | float) or bool(np.isfinite(value).all())
