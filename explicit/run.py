"""Runs of the explicit solver: energies watched, rest judged by kinetic energy and front."""

import time

import numpy as np
import warp as wp

from explicit.solver import ExplicitSolver
from mpm.body import Body, build
from mpm.devices import find_device
from mpm.errors import NumericalError, StepRefused
from mpm.law_state import variables
from mpm.precheck import refuse
from mpm.provenance import decisive, provenance
from mpm.ranks import world
from mpm.results import Results
from mpm.run import Run, body_of, reopen
from mpm.runout import REST_WINDOW
from mpm.scene import Scene
from mpm.watch import Beyond

# Grid kinetic energy below which the body may be at rest: over its peak, or over the energy of the fall M g h0, so that
# what stands is at rest at once.
REST_KE, REST_KE_OF_FALL = 1e-4, 1e-6
REST_DRIFT = 1e-3  # relative advance of the front (R_995) over REST_WINDOW, likewise
MAX_TIME = 60.0  # default end, in units of sqrt(h0/g), of a run that never comes to rest
HISTORY_ROWS = 20  # default history rows per sqrt(h0/g)
ENERGY_GROWTH = 1.5  # kinetic energy over all energy ever supplied, above which the step is unstable
# What is no result: at the end, energy that the ledger misses over the work of gravity or, where that is more,
# LEAST_WORK M g h0 (a body that stands hardly falls); at any time what `Run.misplaced` finds.
MOST_RESIDUAL, LEAST_WORK = 0.05, 0.02


def run(scene: Scene, directory, device="cpu", force=False, monitor=None) -> dict:
    """Run a scene into `directory`; return the summary.

    `monitor`, if given, has `start(run)`, `row(run, row)` and `stop(run)`, called with this run's `ExplicitRun`.
    Raises SceneError (bad input, folder in use), NumericalError (the message names the last checkpoint),
    Interrupted (Ctrl-C, after a checkpoint).
    """
    started = time.perf_counter()
    find_device(device)  # before what takes longer
    body = build(scene)
    refuse(body, ExplicitRun.mode)
    solver = solver_of(body, device)  # before the folder: there may be too few devices for the ranks
    described = provenance(device, scene.explicit.precision) | decisive(ExplicitRun.mode, scene)
    results = Results.create(directory, scene, described, force)
    this = ExplicitRun(body, results, solver)
    this.begin()
    return this.go(started, monitor)


def resume(directory, device=None, monitor=None) -> dict:
    """Go on with a run from its checkpoint, by default on the device it was started on; return the summary.

    On the CPU the end is bitwise that of an uninterrupted run. Raises as `run`, and SceneError when there is
    no checkpoint or the run has ended.
    """
    started = time.perf_counter()
    results = reopen(directory)
    device = device or str(results.provenance["device"])
    find_device(device)  # likewise
    body = body_of(results)
    this = ExplicitRun(body, results, solver_of(body, device))
    this.restore(results.read_checkpoint())
    return this.go(started, monitor)


def solver_of(body: Body, device: str):
    """The solver on the ranks that the program was started on. Raises SceneError for devices that are not there."""
    if (comm := world()) is None:
        return ExplicitSolver(body, find_device(device))
    from explicit.ranks import RankedSolver

    return RankedSolver(body, device, comm)


class ExplicitRun(Run):
    """A run of the explicit solver: history rows are due at times, and what ends it is judged on them."""

    mode = "explicit"
    COUNTERS = ("rows", "peak_ke", "peak_work", "e0")

    def __init__(self, body: Body, results: Results, solver: ExplicitSolver):
        super().__init__(body, results, solver)
        scene = body.scene
        self.device, self.precision = solver.devices, scene.explicit.precision
        until = scene.explicit.until
        self.rest_wanted = until == "rest"
        self.end: float = (scene.explicit.max_time or MAX_TIME * body.time_scale) if until == "rest" else until
        watch = body.time_scale / HISTORY_ROWS
        self.history_every = scene.output.history_every or watch
        if self.rest_wanted:
            self.history_every = min(self.history_every, watch)  # rest is judged on history rows
        self.rows = 0
        self.peak_ke = self.peak_work = self.e0 = 0.0
        self.fall = body.point_mass * len(body.x) * scene.loads.gravity * body.height  # M g h0 [J]
        self.recent: list[tuple[float, float, float]] = []  # (time, R_995, grid KE) over REST_WINDOW

    @property
    def x(self) -> np.ndarray:
        """Positions (n, 3) [m] of the points."""
        return self.solver.x.numpy()

    @property
    def progress(self) -> tuple[float, float]:
        """Simulated time and the end time [s]."""
        return self.solver.time, self.end

    def first_row(self):
        """The history row before any step, and the energy that the body starts with."""
        self.e0 = self._kinetic_and_elastic(self.solver.energies())
        self._write_row()

    def state(self) -> dict:
        """What a checkpoint holds beside what every run has."""
        state = self.solver.state()
        state |= {name: getattr(self, name) for name in self.COUNTERS}
        state["recent"] = np.array(self.recent).reshape(-1, 3)
        state["nodes_stored_start"] = self.solver.nodes_stored_start
        state["nodes_stored_max"] = self.solver.nodes_stored_max
        return state

    def restore(self, state: dict):
        """Take over a checkpoint, and drop outputs written after it."""
        state.setdefault("lost", np.zeros_like(self.solver.lost.numpy()))  # earlier versions kept none
        super().restore(state)
        for name in self.COUNTERS:
            setattr(self, name, state[name])
        self.recent = [tuple(row) for row in state["recent"]]
        self.solver.nodes_stored_start = int(state["nodes_stored_start"])
        self.solver.nodes_stored_max = max(int(state["nodes_stored_max"]), self.solver.nodes_stored_max)

    def state_is_whole(self, error: NumericalError) -> bool:
        """Whether the step that raised `error` was refused before it was taken."""
        return isinstance(error, StepRefused)

    def advance(self) -> dict[str, float] | None:
        """A batch of steps and whatever output is due; the history row, if one was."""
        self.solver.set_target(min(self.snapshots * self.every, self.end))
        now = self.solver.advance(self.rows * self.history_every)
        row, ended = None, now >= self.end
        if now >= self.rows * self.history_every or ended:
            row = self._write_row()
            if self.rest_wanted and self._at_rest():
                self.stop_reason = "rest"
            elif ended:
                self.stop_reason = "max_time" if self.rest_wanted else "end_time"
        self.output_when_due()
        if self.stop_reason:
            self._refuse_open_ledger()
        return row

    def _write_row(self) -> dict[str, float]:
        energies, seen = self.solver.observe()
        time_now = self.solver.time
        row = {"time": time_now, "step": self.solver.steps, "dt": self.solver.time_step}
        row |= seen.front | energies | {"volume_ratio": seen.volume_ratio}
        supplied = self.e0 + max(energies["W_ext"], 0.0)
        row["residual"] = self.e0 + energies["W_ext"] - self._kinetic_and_elastic(energies)
        row["residual"] -= energies["W_plastic"] + energies["W_damping"] + energies["W_decay"]
        self.peak_ke = max(self.peak_ke, energies["KE_grid"])
        self.peak_work = max(self.peak_work, energies["W_ext"])
        self.recent.append((time_now, row["R_995"], row["KE_grid"]))
        while len(self.recent) > 1 and self.recent[1][0] <= time_now - REST_WINDOW * self.body.time_scale:
            self.recent.pop(0)
        self.add_row(row)
        self.rows = int(time_now / self.history_every + 1e-9) + 1
        if wrong := self._diverged(row, seen.beyond, supplied):
            raise NumericalError(f"diverged at t = {time_now:.6g} s, step {self.solver.steps}: {wrong}")
        return row

    @property
    def _missed(self) -> float:
        """Energy that the ledger misses, over the work of gravity or, where that is more, LEAST_WORK M g h0."""
        work = max(self.peak_work, LEAST_WORK * self.fall)
        return self.last_row["residual"] / work if work else 0.0

    def _refuse_open_ledger(self):
        """Raises NumericalError where a run that has ended, and is saved, misses more energy than a result may."""
        if abs(self._missed) > MOST_RESIDUAL:
            raise NumericalError(
                f"no result: at the end, t = {self.solver.time:.6g} s, the energy ledger misses "
                f"{self.last_row['residual']:.4g} J, {self._missed:.1%} of the work of gravity ({MOST_RESIDUAL:.0%} "
                "allowed); run it again with a smaller grid.cell, or a smaller explicit.cfl where the body is soft"
            )

    def _diverged(self, row, beyond: Beyond, supplied: float) -> str:
        """Why what the run has reached can be no result; "" where it may be one."""
        if row["KE_points"] > ENERGY_GROWTH * supplied + 1e-9 * self.fall:
            return (
                f"kinetic energy {row['KE_points']:.4g} J exceeds what gravity supplied, {supplied:.4g} J; "
                f"the time step {self.solver.time_step:.3g} s is unstable"
            )
        return self.misplaced(beyond, row["volume_ratio"])

    @staticmethod
    def _kinetic_and_elastic(energies) -> float:
        return energies["KE_points"] + energies["E_elastic"]

    def _at_rest(self) -> bool:
        """Grid kinetic energy small all through the last sqrt(h0/g), so that no turning point of a swing counts,
        and front drift small over twice that, once gravity is whole. The points' own kinetic energy decays slowly."""
        (since, earlier, _), (now, runout, _) = self.recent[0], self.recent[-1]
        scale, still = self.body.time_scale, max(REST_KE * self.peak_ke, REST_KE_OF_FALL * self.fall)
        lately = [ke for when, _, ke in self.recent if when >= now - scale]
        window = (REST_WINDOW - 1e-9) * scale
        if now - since < window or now < self.body.scene.loads.ramp + window or max(lately) > still:
            return False
        return abs(runout - earlier) < REST_DRIFT * (1.0 + runout)

    def own_fields(self) -> dict:
        """For each of the point fields that the solver knows itself, a function that gives it."""
        solver = self.solver
        own = {
            "velocity": solver.v.numpy,
            "stress": lambda: solver.sigma,
            "volume_ratio": lambda: solver.volume_ratio,
        }
        return own | (variables(solver.law_state) if self.body.constants.plastic else {})

    def figures(self) -> dict:
        """What the explicit solver adds to the summary."""
        solver, row = self.solver, self.last_row
        total = self.body.point_mass * solver.points
        return {
            "mass_error": abs(solver.grid_mass() / total - 1.0),
            "grid_ke_ratio": row["KE_grid"] / self.peak_ke if self.peak_ke else 0.0,
            "energy_residual": self._missed,
            "nodes_stored_start": solver.nodes_stored_start,
            "nodes_stored_max": solver.nodes_stored_max,
            "bytes_per_point": solver.bytes_per_point,
            "bulk_used": solver.body.constants.bulk,
        }

    def memory_mb(self) -> float:
        """Peak memory [MB]: of the process on the CPU, of the device's pool on a GPU."""
        device = self.solver.device
        return wp.get_mempool_used_mem_high(device) / 1e6 if device.is_cuda else super().memory_mb()
