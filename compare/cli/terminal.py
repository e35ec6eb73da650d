"""What a person at a terminal sees of a run: banner, progress, closing table. Plain lines when not a terminal."""

import os
import time
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from compare.launch import PLAIN_OUTPUT, cores
from mpm.ranks import count

LARGE = 20_000  # points of a run that gains from a second core
PLAIN_EVERY = 10.0  # seconds between progress lines when the output is not a terminal
BATCH_PLAIN_EVERY = 60.0  # likewise of a study, whose runs say more in their logs
# How far a run is, in the unit of its `progress`.
PROGRESS = {
    "explicit": "t = {task.completed:.2f} of at most {task.total:.3g} s",
    "implicit": "{task.percentage:.0f} % of the way to rest",
}

# No markup: "[s]" is a unit here, and a path may hold brackets; no emoji: nor is ":s:" one.
PLAIN: dict[str, Any] = {"highlight": False, "soft_wrap": True, "markup": False, "emoji": False}
out = Console(**PLAIN, force_terminal=False if PLAIN_OUTPUT in os.environ else None)
err = Console(stderr=True, **PLAIN)


def banner(run) -> str:
    """Points, nodes or unknowns, dt, precision, device and memory of a run about to start."""
    solver = run.solver
    if run.mode == "explicit":
        each, nodes = f" ({solver.bytes_per_point} bytes each)", f"{solver.grid.stored:,} nodes"
        memory = f"{solver.bytes / 1e6:.1f} MB of state"
    else:
        each, nodes = "", f"{3 * solver.nodes_solved_start:,} unknowns"
        memory = f"{run.memory_mb():.0f} MB of memory"
    where = run.results.provenance["device_name"]
    ranks = f" on {count()} ranks" if count() > 1 else ""
    return (
        f"{run.body.scene.name}: {run.mode}, {solver.points:,} points{each}, {nodes}, dt = {solver.time_step:.3g} s, "
        f"{run.precision}, {run.device}{ranks} ({where}), {memory}, set up in {run.setup_s:.1f} s"
    )


def announce(body):
    """What to know of a body before it is computed: values that look like another unit, whether it will stand."""
    from mpm.precheck import doubts  # slow to import, and `repose --help` needs none of it
    from mpm.theory import outlook

    for doubt in doubts(body):
        err.print(f"warning: {doubt}", style="yellow")
    if said := outlook(body):
        out.print(f"{body.scene.name}: {said}")


def idle_cores(run) -> str:
    """What to tell of a large run on one core of several; "" of any other."""
    could = run.device == "cpu" and count() == 1
    if not could or run.solver.points < LARGE or (there := cores()) == 1:
        return ""
    return f"this takes one of {there} cores; --ranks {there} (or all) takes all of them"


class Monitor:
    """Follows a run (see `mpm.run.Run.go`): a bar on a terminal, else a line now and then."""

    def __init__(self, banner=True):
        """`banner`: whether to begin with a line of what is about to run."""
        self.banner, self.progress = banner, None
        self.last_line = 0.0

    def start(self, run):
        """Say what is about to run, and what is to know of its body."""
        if self.banner:
            out.print(banner(run))
            if said := idle_cores(run):
                out.print(said)
        announce(run.body)
        if not (out.is_terminal or out.is_jupyter):
            return
        columns = (
            TextColumn(PROGRESS[run.mode]),
            BarColumn(),
            TextColumn("{task.fields[front]}"),
            TimeRemainingColumn(),
        )
        self.progress = Progress(*columns, console=out, transient=True)
        done, whole = run.progress
        self.task = self.progress.add_task("", total=whole, completed=done, front="")
        self.progress.start()

    def row(self, run, row):
        """Show how far the run is, with the history `row` that it has just written."""
        done, whole = run.progress
        unbalanced = f", unbalanced {row['unbalanced']:.1e}" if run.mode == "implicit" else ""
        if self.progress:  # in short, so that the bar has room on 80 columns
            self.progress.update(self.task, completed=done, front=f"run-out {row['R_995']:.3f}{unbalanced}")
        elif time.monotonic() - self.last_line > PLAIN_EVERY:
            self.last_line = time.monotonic()
            so_far = f"t = {row['time']:.3f} s of at most {whole:.3g} s, step {row['step']}"
            if run.mode == "implicit":
                so_far = f"step {row['step']} of at most {run.max_steps}, about {done:.0%} of the way to rest"
            front = f"run-out {row['R_995']:.3f} (99.5 % of mass), {row['R_max']:.3f} (farthest)"
            out.print(f"{so_far}, {front}{unbalanced}")

    def stop(self, _run):
        """Clear the bar."""
        if self.progress:
            self.progress.stop()


class BatchMonitor:
    """Follows the runs of a study (see `compare.batch.run_all`): a line as each ends, and what the running ones say
    meanwhile."""

    def __init__(self):
        self.progress, self.tasks, self.last_line = None, {}, time.monotonic()

    def start(self, jobs):
        """Begin to count the `jobs`."""
        self.left = self.whole = len(jobs)
        if out.is_terminal:
            self.progress = Progress(TextColumn("{task.description}"), BarColumn(), console=out, transient=True)
            self.all = self.progress.add_task("", total=self.whole)
            self.progress.start()

    def look(self, job, log):
        """Show the last line of `log`, to which the run of `job` prints: it says where the run is."""
        if not self.progress and time.monotonic() - self.last_line < BATCH_PLAIN_EVERY:
            return
        lines = log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        said = f"{job.name}: {lines[-1] if lines else 'starting'}"
        if not self.progress:
            self.last_line = time.monotonic()
            out.print(said)
            return
        if job.name not in self.tasks:
            self.tasks[job.name] = self.progress.add_task("", total=None)
        self.progress.update(self.tasks[job.name], description=said[: out.width - 20])

    def ended(self, outcome):
        """Say how a run has ended."""
        self.left -= 1
        if outcome.done:
            how = f"{outcome.summary['wall_s']:.1f} s, R_995 {outcome.summary['R_995']:.4f}"
            how += ", kept from an earlier call" if outcome.reused else ""
        else:
            how = f"failed: {outcome.reason}"
        if self.progress:
            self.progress.update(self.all, advance=1)
            if outcome.job.name in self.tasks:
                self.progress.remove_task(self.tasks.pop(outcome.job.name))
        out.print(f"[{self.whole - self.left}/{self.whole}] {outcome.job.name}: {how}")

    def stop(self):
        """Clear the bars."""
        if self.progress:
            self.progress.stop()


def summary_table(summary: dict) -> Table:
    """The figures of a finished run that a reader wants first."""
    table = Table(show_header=False, box=None, padding=(0, 2))
    words = {
        "R_995": "run-out R_995, radius that holds 99.5 % of the mass",
        "R_connected": "run-out R_connected, farthest point joined to the axis",
        "R_max": "run-out R_max, farthest point of all",
        "eq4": "quasistatic theory, Eq. 4",
        "eq45": "dynamic theory, Eq. 5 in Eq. 4",
        "h_inf": "final height h_inf [m]",
        "volume_ratio": "volume / initial volume",
        "sim_time": "pseudo-time [s]" if summary["mode"] == "implicit" else "simulated time [s]",
        "stop_reason": "stopped by",
        "grid_ke_ratio": "grid kinetic energy / its peak",
        "unbalanced_ratio": "out-of-balance / external forces",
        "newton_iterations": "Newton iterations",
        "failed_steps": "failed steps",
        "wall_s": "time stepping [s]",
        "point_steps_per_s": "point-steps per second",
        "peak_memory_mb": "peak memory [MB]",
    }
    for key, text in words.items():
        value = summary.get(key)  # some are one solver's, others a column's
        if value is not None:
            table.add_row(text, f"{value:,.4g}" if isinstance(value, float) else str(value))
    return table
