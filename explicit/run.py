"""Run loop of the explicit solver: build -> step until done -> snapshots, history, checkpoints -> results."""

import signal
import time
from contextlib import contextmanager, suppress

import numpy as np
import warp as wp

from explicit.solver import ExplicitSolver
from mpm.config import Scene, parse_scene
from mpm.devices import find_device
from mpm.errors import NumericalError, SceneError, StepRefused
from mpm.geometry import Seeds
from mpm.provenance import peak_memory_mb, provenance
from mpm.results import Results
from mpm.runout import front, run_out
from mpm.scene import Body, build, theory
from mpm.vtk import write_vtk

REST_KE = 1e-4  # grid kinetic energy over its peak, below which the body may be at rest
REST_DRIFT = 1e-3  # relative advance of the front (R_995) over sqrt(h0/g), likewise
MAX_TIME = 60.0  # default end, in units of sqrt(h0/g), of a run that never comes to rest
HISTORY_ROWS = 20  # default history rows per sqrt(h0/g)
ENERGY_GROWTH = 1.5  # kinetic energy over all energy ever supplied, above which the step is unstable


class Interrupted(KeyboardInterrupt):
    """The user asked the run to stop; a checkpoint was saved."""


def run(scene: Scene, directory, device="cpu", force=False, monitor=None) -> dict:
    """Run a scene into `directory`; return the summary.

    `monitor`, if given, has `start(run)`, `row(run, row)` and `stop(run)`, called with this run's `ExplicitRun`.
    Raises SceneError (bad input, folder in use), NumericalError (the message names the last checkpoint),
    Interrupted (Ctrl-C, after a checkpoint).
    """
    started = time.perf_counter()
    place = find_device(device)
    body = build(scene)
    described = provenance(device, scene.explicit.precision)
    results = Results.create(directory, scene.model_dump(mode="json"), {**described, "mode": "explicit"}, force)
    this = ExplicitRun(body, results, place)
    this.begin()
    return this.go(started, monitor)


def resume(directory, device=None, monitor=None) -> dict:
    """Go on with a run from its checkpoint, by default on the device it was started on; return the summary.

    On the CPU the end is bitwise that of an uninterrupted run. Raises as `run`, and SceneError when there is
    no checkpoint or the run has ended.
    """
    started = time.perf_counter()
    results = Results.open(directory)
    if not results.has_checkpoint:
        raise SceneError(f"{directory}: no checkpoint to resume from")
    if (ended := results.summary()) is not None:
        raise SceneError(f"{directory}: this run ended at t = {ended['sim_time']:.4g} s ({ended['stop_reason']})")
    place = find_device(device or str(results.provenance["device"]))
    seeds = Seeds(results.read_static("x0"), *results.read_static("extent"))
    this = ExplicitRun(build(parse_scene(results.scene), seeds), results, place)
    this.restore(results.read_checkpoint())
    return this.go(started, monitor)


class ExplicitRun:
    """One run: a solver, a results folder, and when the next output is due."""

    def __init__(self, body: Body, results: Results, device):
        self.body, self.results = body, results
        self.solver = ExplicitSolver(body, device)
        scene = body.scene
        self.rest_wanted = scene.explicit.until == "rest"
        self.end = scene.explicit.until
        if self.rest_wanted:
            self.end = scene.explicit.max_time or MAX_TIME * body.time_scale
        self.every = scene.output.every
        watch = body.time_scale / HISTORY_ROWS
        self.history_every = scene.output.history_every or watch
        if self.rest_wanted:
            self.history_every = min(self.history_every, watch)  # rest is judged on history rows
        self.snapshots = self.rows = 0
        self.peak_ke = self.wall_before = 0.0
        self.recent: list[tuple[float, float, float]] = []  # (time, R_995, grid KE) over the last sqrt(h0/g)
        self.stepping_since = None
        self.unsaved: list[dict[str, float]] = []  # history rows since the last checkpoint
        self.stop_reason = None

    def begin(self):
        """The body's initial shape, first history row, snapshot and checkpoint, before any step."""
        self.results.write_static("x0", self.body.x)
        self.results.write_static("extent", np.array([self.body.measure.reference, self.body.height]))
        self.e0 = self._kinetic_and_elastic(self.solver.energies())
        self._write_row()
        self._write_snapshot()
        self.save()

    def restore(self, state: dict):
        """Take over a checkpoint, and drop outputs written after it."""
        self.solver.restore(state)
        for name in ("snapshots", "rows", "peak_ke", "e0", "wall_before"):
            setattr(self, name, state[name])
        self.recent = [tuple(row) for row in state["recent"]]
        self.solver.nodes_stored_start = int(state["nodes_stored_start"])
        self.solver.nodes_stored_max = max(int(state["nodes_stored_max"]), self.solver.nodes_stored_max)
        self.results.truncate_after(self.solver.time)

    def go(self, started: float, monitor) -> dict:
        """Step until rest, the end time, Ctrl-C or divergence; write the summary and return it."""
        self.setup_s = time.perf_counter() - started
        self.stepping_since = time.perf_counter()
        if monitor:
            monitor.start(self)
        try:
            with _deferred_interrupt() as interrupt:
                self._loop(interrupt, monitor)
                summary = self.summary()
                if self.body.scene.output.vtk:
                    write_vtk(self.results)
                self.results.finish(summary)
        except NumericalError as error:
            if isinstance(error, StepRefused):
                self.save()
            saved = self.results.read_checkpoint()["clock"][0]
            raise NumericalError(
                f"{error}\nlast good state: t = {saved:.6g} s in {self.results.directory / 'checkpoint.h5'}"
            ) from None
        finally:
            if monitor:
                monitor.stop(self)
        return summary

    def _loop(self, interrupt, monitor):
        while self.stop_reason is None:
            row = self.advance()
            if row and monitor:
                monitor.row(self, row)
            if interrupt.asked and not self.stop_reason:
                self.save()
                where = self.results.directory
                raise Interrupted(f"stopped at t = {self.solver.time:.6g} s; `repose resume {where}` goes on")

    def advance(self) -> dict[str, float] | None:
        """A batch of steps and whatever output is due; the history row, if one was."""
        self.solver.aim(min(self.snapshots * self.every, self.end))
        now = self.solver.advance(self.rows * self.history_every)
        row, ended = None, now >= self.end
        if now >= self.rows * self.history_every or ended:
            row = self._write_row()
            if self.rest_wanted and self._at_rest():
                self.stop_reason = "rest"
            elif ended:
                self.stop_reason = "max_time" if self.rest_wanted else "end_time"
        if now >= self.snapshots * self.every or self.stop_reason:
            self._write_snapshot()
            self.save()
        return row

    def _write_row(self) -> dict[str, float]:
        energies = self.solver.energies()
        time_now = self.solver.time
        row = {"time": time_now, "step": self.solver.steps, "dt": self.solver.time_step}
        x = self.solver.x.numpy()
        row |= front(x, self.body.measure) | energies
        supplied = self.e0 + max(energies["W_ext"], 0.0)
        row["residual"] = supplied - self._kinetic_and_elastic(energies)
        row["residual"] -= energies["W_plastic"] + energies["W_damping"]
        self.peak_ke = max(self.peak_ke, energies["KE_grid"])
        self.recent.append((time_now, row["R_995"], row["KE_grid"]))
        while len(self.recent) > 1 and self.recent[1][0] <= time_now - self.body.time_scale:
            self.recent.pop(0)
        self.unsaved.append(row)
        self.last_row = row
        self.rows = int(time_now / self.history_every + 1e-9) + 1
        floor = 1e-9 * self.body.point_mass * len(self.body.x) * self.body.scene.loads.gravity * self.body.height
        if energies["KE_points"] > ENERGY_GROWTH * supplied + floor:
            raise NumericalError(
                f"diverged at t = {time_now:.6g} s, step {self.solver.steps}: kinetic energy "
                f"{energies['KE_points']:.4g} J exceeds what gravity supplied, {supplied:.4g} J; "
                f"the time step {self.solver.time_step:.3g} s is unstable"
            )
        return row

    @staticmethod
    def _kinetic_and_elastic(energies) -> float:
        return energies["KE_points"] + energies["E_elastic"]

    def _at_rest(self) -> bool:
        """Grid kinetic energy small all through the last sqrt(h0/g), so that no turning point of a swing counts,
        and front drift small over it. The points' own kinetic energy never decays under FLIP."""
        (since, earlier, _), (now, runout, _) = self.recent[0], self.recent[-1]
        if now - since < self.body.time_scale or max(ke for _, _, ke in self.recent) > REST_KE * self.peak_ke:
            return False
        return abs(runout - earlier) < REST_DRIFT * (1.0 + runout)

    def _write_snapshot(self):
        wanted = self.body.scene.output.fields
        x = self.solver.x.numpy()
        fields = {"x": x}
        makers = {
            "displacement": lambda: x - self.body.x,
            "velocity": self.solver.v.numpy,
            "stress": self.solver.sigma.numpy,
            "pressure": lambda: -self.solver.sigma.numpy()[:, :3].mean(axis=1),
            "volume": self.solver.volume.numpy,
        }
        if self.body.constants.plastic:
            makers["eps_p_eqv"] = self.solver.eps_p_eqv.numpy
        fields |= {name: makers[name]() for name in wanted}
        # Single precision is ample for pictures and metrics and halves the file; restarts use the checkpoint.
        fields = {name: value.astype(np.float32) for name, value in fields.items()}
        self.results.write_snapshot(self.solver.time, self.solver.steps, fields)
        self.snapshots = int(self.solver.time / self.every + 1e-9) + 1

    def save(self):
        """History rows and a checkpoint; a restart regenerates what comes after."""
        if self.unsaved:
            self.results.append_history(self.unsaved)
            self.unsaved = []
        state = self.solver.state()
        state |= {name: getattr(self, name) for name in ("snapshots", "rows", "peak_ke", "e0")}
        state["recent"] = np.array(self.recent)
        state["wall_before"] = self._wall()
        state["nodes_stored_start"] = self.solver.nodes_stored_start
        state["nodes_stored_max"] = self.solver.nodes_stored_max
        self.results.write_checkpoint(state)

    def _wall(self) -> float:
        since = self.stepping_since
        return self.wall_before + (time.perf_counter() - since if since else 0.0)

    def summary(self) -> dict:
        """What `summary.json` holds; run-outs are (r - r0)/r0 (see `mpm.runout`), lengths in m, times in s."""
        solver, scene, wall = self.solver, self.body.scene, self._wall()
        total = self.body.point_mass * solver.points
        return {
            "mode": "explicit",
            "scene": scene.name,
            "points": solver.points,
            "cells_per_radius": self.body.measure.reference / scene.grid.cell,
            "precision": scene.explicit.precision,
            "device": solver.device.alias,
            "steps": solver.steps,
            "sim_time": solver.time,
            "wall_s": wall,
            "setup_s": self.setup_s,
            "stop_reason": self.stop_reason,
            **run_out(solver.x.numpy(), self.body.measure),
            "mass_error": abs(solver.grid_mass() / total - 1.0),
            "grid_ke_ratio": self.last_row["KE_grid"] / self.peak_ke if self.peak_ke else 0.0,
            "peak_memory_mb": self.memory_mb(),
            "point_steps_per_s": solver.points * solver.steps / wall,
            **theory(scene),
            "energy_residual": self.last_row["residual"] / max(self.last_row["W_ext"], 1e-300),
            "nodes_stored_start": solver.nodes_stored_start,
            "nodes_stored_max": solver.nodes_stored_max,
            "bytes_per_point": solver.bytes_per_point,
        }

    def memory_mb(self) -> float:
        """Peak memory [MB]: of the process on the CPU, of the device's pool on a GPU."""
        device = self.solver.device
        return wp.get_mempool_used_mem_high(device) / 1e6 if device.is_cuda else peak_memory_mb()


class _Flag:
    asked = False


@contextmanager
def _deferred_interrupt():
    """Turn Ctrl-C into a flag, so that a batch of steps ends before the checkpoint is written."""
    flag = _Flag()

    def ask(_signal, _frame):
        flag.asked = True

    previous = None
    with suppress(ValueError):  # not the main thread: leave signals alone
        previous = signal.signal(signal.SIGINT, ask)
    try:
        yield flag
    finally:
        if previous is not None:
            signal.signal(signal.SIGINT, previous)
