"""A body that is spread over several MPI ranks: the part of each, and the whole as the first rank sees it.

The first rank runs the program; the others serve it (`serve`): it tells them what to do with their part, and all do it
together. What it asks for is of the whole body, in the order of its points, so that a run is judged, written and
restarted as on one rank, and on any number of them.
"""

import sys
from contextlib import suppress
from itertools import count
from typing import Any

import numpy as np

from mpm.body import Body
from mpm.domains import UNEVEN, cut_plan, histogram, migrate, owner_of
from mpm.errors import INTERRUPTED, NumericalError, SceneError
from mpm.gimp import HALF_LENGTH_IN_CELLS

BUILD, DISMISS = "build", "dismiss"


class Part:
    """What the part of one rank has beside a solver; `ids` (n,) are its points' numbers in the body `whole`.

    A subclass gives the methods that only raise NotImplementedError.
    """

    comm: Any  # of mpi4py, which only runs on several ranks load
    whole: Body
    ids: Any
    cut: Any

    @property
    def held(self) -> list[str]:
        """Names of the point arrays that the material has, whether there are points here or not."""
        raise NotImplementedError

    def field(self, name: str) -> np.ndarray:
        """One of the point arrays (n, ...)."""
        raise NotImplementedError

    def take(self, rows: dict[str, np.ndarray]):
        """Hold the points of `rows` (an array for each name in `held`, and "id") in place of those so far."""
        raise NotImplementedError

    def columns(self, x) -> np.ndarray:
        """The pencils (n, 2) at which the stencils of points `x` (n, 3) [m] start."""
        return np.floor(x[:, :2] / self.whole.scene.grid.cell - HALF_LENGTH_IN_CELLS).astype(int)

    def cut_anew(self, x) -> np.ndarray:
        """Cut the plan for points `x` (n, 3) [m] of the whole body; the numbers of those that are this rank's."""
        columns = self.columns(x)
        held, points = np.unique(columns, axis=0, return_counts=True)
        self.cut = cut_plan(held, points, self.comm.size)
        return np.flatnonzero(owner_of(columns, self.cut) == self.comm.rank)

    def hand_on(self, x):
        """Give the points, at `x` (n, 3) [m], to the ranks whose domains they are in, cut anew where loads differ."""
        columns = self.columns(x)
        loads = np.array(self.comm.allgather(len(columns)))
        if loads.max() > UNEVEN * loads.mean():
            self.cut = cut_plan(*histogram(columns, self.comm), self.comm.size)
        owner = owner_of(columns, self.cut)
        if self.comm.allreduce(int((owner != self.comm.rank).sum())):
            self.take(migrate({name: self.field(name) for name in self.held} | {"id": self.ids}, owner, self.comm))

    def gathered(self, name: str) -> np.ndarray | None:
        """An array of all points in the order of the body, on the first rank; empty where the material has none."""
        parts = self.comm.gather((self.ids, self.field(name)))
        if parts is None:
            return None
        held = sum(len(part) for _, part in parts)
        whole = np.empty((held, *parts[0][1].shape[1:]), parts[0][1].dtype)
        for ids, part in parts if held else ():
            whole[ids] = part
        return whole

    def each(self, name: str) -> list | None:
        """What the method `name` gives on each rank, on the first rank."""
        return self.comm.gather(getattr(self, name)())


def serve(comm):
    """Do what the first rank asks, until it dismisses this one. Raises what is no fault of the run's."""
    parts: dict[int, Part] = {}
    while True:
        number, order, arguments = comm.bcast(None)
        if order == DISMISS:
            return
        with suppress(NumericalError, SceneError):  # all ranks raise it, the first one tells it
            if order == BUILD:
                make, *arguments = arguments
                parts[number] = make(*arguments, comm)
            else:
                getattr(parts[number], order)(*arguments)


def abort(comm, error: BaseException):
    """Say what ended this rank, and end all: those that wait for it in the middle of an order would do so for ever."""
    stopped = isinstance(error, KeyboardInterrupt)
    said = "interrupted" if stopped else f"error: rank {comm.rank}: {str(error) or type(error).__name__}"
    # Not to sys.stderr, which a progress bar may hold back, and in one write, as two ranks may have something to say.
    print(f"{said}\n", end="", file=sys.__stderr__, flush=True)
    comm.Abort(INTERRUPTED if stopped else 1)


def dismiss(comm):
    """Let the other ranks go."""
    comm.bcast((None, DISMISS, ()))


class Gathered:
    """One array of all points, as `numpy` of a Warp array gives it."""

    def __init__(self, whole: "Whole", name: str):
        self.whole, self.name = whole, name

    @property
    def size(self) -> int:
        """Points that have it; 0 where the material has no use for it."""
        return self.whole.points if self.name in self.whole.part.held else 0

    def numpy(self) -> np.ndarray:
        """The array (n, ...), a copy."""
        return self.whole.ask("gathered", self.name)


class Whole:
    """On the first rank, what stands in a solver's place: it asks all ranks, each with its `part`.

    There may be several at a time, each with a number that all ranks know its parts by.
    """

    SAME: tuple[str, ...] = ()  # attributes of the first rank's part that are the same on all
    _numbers = count()

    def __init__(self, make, body: Body, argument, comm):
        """`make(body, argument, comm)`, a function of a module, gives a rank's part; it raises SceneError on all ranks
        or on none."""
        self.body, self.comm, self.points = body, comm, len(body.x)
        self._number = next(self._numbers)
        comm.bcast((self._number, BUILD, (make, body, argument)))
        self.part = self._together(make, body, argument, comm)

    def ask(self, order: str, *arguments):
        """Let all ranks call the method `order` of their parts; what it gives here.

        Raises NumericalError where it does so on any rank.
        """
        self.comm.bcast((self._number, order, arguments))
        return self._together(getattr(self.part, order), *arguments)

    def _together(self, call, *arguments):
        try:
            return call(*arguments)
        except (NumericalError, SceneError):
            raise
        except BaseException as error:
            abort(self.comm, error)

    def __getattr__(self, name):
        if name in self.SAME:
            return getattr(self.part, name)
        raise AttributeError(name)
