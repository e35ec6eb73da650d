"""What every run of a solver shares: outputs when they are due, checkpoints, Ctrl-C, how it ends and its summary."""

import signal
import time
from contextlib import contextmanager, suppress
from functools import partial

import numpy as np

from mpm.body import Body, build
from mpm.command import command
from mpm.errors import NumericalError, SceneError
from mpm.fields import follow, following
from mpm.packing import packing
from mpm.provenance import peak_memory_mb
from mpm.ranks import count
from mpm.results import Results
from mpm.runout import run_out
from mpm.seed import Seeds
from mpm.theory import theory
from mpm.vtk import write_vtk
from mpm.watch import Beyond

# What is no result: points beyond a wall, in cells, and the volume, over the initial one, of what yields at psi = 0.
MOST_BEYOND = 0.5
VOLUME_RANGE = (0.7, 1.3)
FARTHEST = 1e4  # of the body's first radii and heights from the origin: beyond, no lattice follows a point


class Interrupted(KeyboardInterrupt):
    """The user, or the system by SIGTERM, asked the run to stop; a checkpoint was saved."""


def reopen(directory) -> Results:
    """The results of a run that can go on. Raises SceneError where there is no checkpoint or the run has ended."""
    results = Results.open(directory)
    if not results.has_checkpoint:
        raise SceneError(f"{directory}: no checkpoint to resume from")
    if (ended := results.summary()) is not None:
        raise SceneError(f"{directory}: this run ended at t = {ended['sim_time']:.4g} s ({ended['stop_reason']})")
    return results


def body_of(results: Results) -> Body:
    """The body that a run started from, without its mesh file, which may be gone by now."""
    reference, height, *axis = results.read_static("extent")  # earlier versions wrote no axis: it was x = y = 0
    seeds = Seeds(results.read_static("x0"), reference, height, tuple(axis) or (0.0, 0.0))
    return build(results.scene, seeds)


def find_invalid(state: dict, farthest: float, ids=None) -> str:
    """What in a restart state is not finite, or farther than `farthest` [m] from the origin; "" where all is well.

    `ids` (n,): numbers of the state's points in the whole body, where these are a part of it.
    """
    points = len(state["x"])
    ids = np.arange(points) if ids is None else ids
    for name, value in state.items():
        if isinstance(value, np.ndarray) and not np.isfinite(value).all():
            row = int(np.argwhere(~np.isfinite(value))[0][0])
            return f"{name} of point {ids[row]} is not finite" if len(value) == points else f"{name} is not finite"
    off = np.abs(state["x"]).max(axis=1)
    if off.max(initial=0.0) > farthest:
        row = int(off.argmax())
        return f"point {ids[row]} has left the grid: x = {np.array2string(state['x'][row], precision=4)} m"
    return ""


class Run:
    """One run: a solver, a results folder, and when the next output is due.

    `solver` has `time` [s], `steps`, `points` and `restore(state)`. A subclass gives the solver's `mode`, the
    `device` (Warp's alias) and `precision` it runs with, and the methods below that only raise NotImplementedError.
    """

    mode: str
    device: str
    precision: str

    def __init__(self, body: Body, results: Results, solver):
        self.body, self.results, self.solver = body, results, solver
        self.every = body.scene.output.every
        self.snapshots = 0
        self.wall_before = self.setup_s = self.saved_time = 0.0
        self.stepping_since: float | None = None
        self.unsaved: list[dict[str, float]] = []  # history rows since the last checkpoint
        self.stop_reason: str | None = None

    @property
    def x(self) -> np.ndarray:
        """Positions (n, 3) [m] of the points."""
        raise NotImplementedError

    @property
    def progress(self) -> tuple[float, float]:
        """How far the run is, and where it ends at the latest; in the unit that suits the solver."""
        raise NotImplementedError

    def advance(self) -> dict[str, float] | None:
        """A batch of steps and whatever output is due; the history row, if one was. Sets `stop_reason` at the end."""
        raise NotImplementedError

    def first_row(self):
        """The history row before any step."""
        raise NotImplementedError

    def own_fields(self) -> dict:
        """For each of the point fields that the solver knows itself, a function that gives it: velocity, stress,
        volume_ratio and, where the material yields, eps_p_eqv."""
        raise NotImplementedError

    def state(self) -> dict:
        """What a checkpoint holds beside what every run has."""
        raise NotImplementedError

    def state_is_whole(self, error: NumericalError) -> bool:
        """Whether the solver's state is still that before the step that raised `error`."""
        raise NotImplementedError

    def figures(self) -> dict:
        """What the solver adds to the summary."""
        raise NotImplementedError

    def write_grid(self):
        """The background grid for ParaView, beside the points; nothing where the solver has no mesh of it."""

    def begin(self):
        """The body's initial shape, first history row, snapshot and checkpoint, before any step."""
        self.results.write_static("x0", self.body.x)
        measure = self.body.measure
        self.results.write_static("extent", np.array([measure.reference, self.body.height, *measure.axis]))
        self.first_row()
        self.write_snapshot()
        self.save(self.state())

    def restore(self, state: dict):
        """Take over a checkpoint, and drop outputs written after it. Raises SceneError where it is damaged."""
        if wrong := self._differs(state) or find_invalid(state, self.farthest):
            raise SceneError(f"{self.results.directory}: the checkpoint is damaged: {wrong}")
        self.solver.restore(state)
        self.snapshots, self.wall_before = state["snapshots"], state["wall_before"]
        self.saved_time = self.solver.time
        self.results.truncate_after(self.saved_time)

    @property
    def farthest(self) -> float:
        """How far [m] from the origin a point can be."""
        return FARTHEST * (self.body.measure.reference + self.body.height + np.abs(self.body.x).max())

    def misplaced(self, beyond: Beyond, volume_ratio: float) -> str:
        """Why points, one of them so far beyond a wall, with `volume_ratio` of the initial volume, are no result; ""
        where they may be."""
        remedy = "a smaller grid.cell or stiffer material may hold it"
        if beyond.cells > MOST_BEYOND:
            return f"point {beyond.point} lies {beyond.cells:.2g} cells beyond a wall, at x = {beyond.x} m; {remedy}"
        constants, (low, high) = self.body.constants, VOLUME_RANGE
        if constants.plastic and constants.eta_bar == 0.0 and not low <= volume_ratio <= high:
            return f"volume is {volume_ratio:.3g} of the initial one ({low} to {high} allowed); {remedy}"
        return ""

    def whole_state(self) -> dict:
        """`state()`, finite and on the grid. Raises NumericalError that names the point."""
        state = self.state()
        self.refuse_invalid(find_invalid(state, self.farthest))
        return state

    def refuse_invalid(self, wrong: str):
        """Raises NumericalError where something is `wrong` with the state (see `find_invalid`)."""
        if wrong:
            raise NumericalError(f"diverged at t = {self.solver.time:.6g} s, step {self.solver.steps}: {wrong}")

    def _differs(self, state: dict) -> str:
        """What in a restart state is not as this run would write it: names, types, points; "" where nothing is."""
        for name, mine in (self.state() | {"snapshots": 0, "wall_before": 0.0}).items():
            if name not in state:
                return f"{name} is missing"
            is_array = isinstance(mine, np.ndarray)
            if is_array != isinstance(state[name], np.ndarray) or np.ndim(mine) != np.ndim(state[name]):
                return f"{name} has another form"
            if is_array and len(mine) == self.solver.points and state[name].shape != mine.shape:
                return f"{name} is of other points"
        return ""

    def go(self, started: float, monitor) -> dict:
        """Step until the run ends, Ctrl-C or divergence; write the summary and return it.

        `started`: `time.perf_counter()` when set-up began. Raises NumericalError, whose message names the last
        checkpoint, and Interrupted, after a checkpoint; ParaView files are written first, up to the last snapshot.
        """
        self.setup_s = time.perf_counter() - started
        self.stepping_since = time.perf_counter()
        if monitor:
            monitor.start(self)
        try:
            with _deferred_interrupt() as interrupt:
                self._loop(interrupt, monitor)
                summary = self.summary()
                self.write_paraview()
                self.results.finish(summary)
        except Interrupted:
            self.write_paraview()  # by now a second Ctrl-C ends the program at once
            raise
        except NumericalError as error:
            with suppress(NumericalError):  # of a state that is spoilt: the last checkpoint is the last good one
                if self.state_is_whole(error):
                    self.save(self.whole_state())
            with suppress(OSError):  # `error` is what a user must read
                self.write_paraview(grid=False)  # whose last increment is one that failed
            saved = self.results.directory / "checkpoint.h5"
            raise NumericalError(f"{error}\nlast good state: t = {self.saved_time:.6g} s in {saved}") from None
        finally:
            if monitor:
                monitor.stop(self)
        return summary

    def write_paraview(self, grid=True):
        """ParaView files of the snapshots so far, where the scene wants any; `grid`: the solver's mesh beside them."""
        if self.body.scene.output.vtk:
            write_vtk(self.results)
            if grid:
                self.write_grid()

    def _loop(self, interrupt, monitor):
        while self.stop_reason is None:
            row = self.advance()
            if row and monitor:
                monitor.row(self, row)
            if interrupt.asked and not self.stop_reason:
                self.save(self.whole_state())
                where = self.results.directory
                raise Interrupted(f"stopped at t = {self.solver.time:.6g} s; `{command('resume', where)}` goes on")

    def field_makers(self) -> dict:
        """For each of the point fields (see `mpm.fields.UNITS`), a function that gives it."""
        own, body = self.own_fields(), self.body
        makers = own | {
            "displacement": lambda: self.x - body.x,
            "volume": lambda: body.point_volume * own["volume_ratio"](),
        }
        for name in following(own, body.constants):
            makers[name] = partial(follow, name, lambda other: own[other](), body.constants)
        return makers

    def add_row(self, row: dict[str, float]):
        """A history row, written with the next checkpoint."""
        self.unsaved.append(row)
        self.last_row = row

    def output_when_due(self):
        """A snapshot and a checkpoint where the next one is due, and at the end of the run."""
        if self.solver.time >= self.snapshots * self.every or self.stop_reason:
            state = self.whole_state()
            self.write_snapshot()
            self.save(state)

    def write_snapshot(self):
        """Positions and the fields that the scene asks for."""
        makers = self.field_makers()
        fields = {"x": self.x} | {name: makers[name]() for name in self.body.scene.output.fields}
        # Single precision is ample for pictures and metrics and halves the file; restarts use the checkpoint.
        fields = {name: value.astype(np.float32) for name, value in fields.items()}
        self.results.write_snapshot(self.solver.time, self.solver.steps, fields)
        self.snapshots = int(self.solver.time / self.every + 1e-9) + 1

    def save(self, state: dict):
        """History rows and a checkpoint of `state`; a restart regenerates what comes after."""
        if self.unsaved:
            self.results.append_history(self.unsaved)
            self.unsaved = []
        self.saved_time = self.solver.time
        self.results.write_checkpoint(state | {"snapshots": self.snapshots, "wall_before": self._wall()})

    def _wall(self) -> float:
        since = self.stepping_since
        return self.wall_before + (time.perf_counter() - since if since else 0.0)

    def summary(self) -> dict:
        """What `summary.json` holds; run-outs are (r - r0)/r0 (see `mpm.runout`), lengths in m, times in s."""
        solver, scene, wall, makers, x = self.solver, self.body.scene, self._wall(), self.field_makers(), self.x
        return {
            "mode": self.mode,
            "scene": scene.name,
            "points": solver.points,
            "cells_per_radius": self.body.measure.reference / scene.grid.cell,
            "precision": self.precision,
            "device": self.device,
            "ranks": count(),
            "steps": solver.steps,
            "sim_time": solver.time,
            "wall_s": wall,
            "setup_s": self.setup_s,
            "stop_reason": self.stop_reason,
            **run_out(x, self.body.measure),
            **packing(x, makers["volume"](), makers["pressure"](), self.body),
            "peak_memory_mb": self.memory_mb(),
            "point_steps_per_s": solver.points * solver.steps / wall,
            **theory(scene),
            **self.figures(),
        }

    def memory_mb(self) -> float:
        """Peak memory [MB] of the process."""
        return peak_memory_mb()


class _Flag:
    asked = False


@contextmanager
def _deferred_interrupt():
    """Turn Ctrl-C and `kill` into a flag, so that a batch of steps ends before the checkpoint is written."""
    flag = _Flag()

    def ask(_signal, _frame):
        flag.asked = True

    previous = {}
    with suppress(ValueError):  # not the main thread: leave signals alone
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGUSR1):  # the last by way of a launcher of ranks
            previous[number] = signal.signal(number, ask)
    try:
        yield flag
    finally:
        for number, handler in previous.items():
            if handler is not None:  # None: set by another language's library
                signal.signal(number, handler)
