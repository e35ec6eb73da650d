"""One measurement of `repose bench`, in a process of its own: `python -m compare.bench.worker JOB ANSWER`.

JOB is JSON: mode, aspect, cells, precision, device, phases; ANSWER the file that its figures are written to.
"""

import json
import sys
import time
from pathlib import Path
from statistics import median

from mpm.errors import SceneError

BATCHES = 25  # timed ones; their median counts
# Steps of a batch. On a CPU so many point-steps, but neither very few nor very many: a tenth of a second or a few.
POINT_STEPS_CPU, LEAST_STEPS_CPU, MOST_STEPS_CPU, STEPS_CUDA = 400_000, 4, 200, 200
YARDSTICK_CELLS = 10  # per r0 of a column whose batches are timed in turn with those of the one measured, on a CPU
PHASE_STEPS = 30
IMPLICIT_STEPS = 8  # of a collapse, from its start
COPIES = 10
COPIED = {"cpu": 1 << 26, "cuda": 1 << 29}  # bytes: more than the caches hold


def column(aspect: float, cells: float, precision: str):
    """The body of a quarter column, r0 = 1 m, of `cells` cells per r0. Raises SceneError where these do not fit it."""
    from mpm.body import build
    from mpm.load import load_scene

    if not 0 < cells < float("inf"):
        raise SceneError(f"--cells {cells:g}: must be a number of cells per r0 > 0 [-]")
    settings = [f"geometry.aspect_ratio={aspect!r}", f"explicit.precision={precision}", "explicit.damping=0.05"]
    return build(load_scene("column_0.5", [*settings, f"grid.cell={1.0 / cells!r}"]))


def timed(owner, name: str, seconds: dict[str, float]):
    """Add the time spent in a function or method, less that in others timed within it, to `seconds[name]`."""
    inner = getattr(owner, name)

    def outer(*arguments, **keywords):
        start, others = time.perf_counter(), sum(seconds.values())
        try:
            return inner(*arguments, **keywords)
        finally:
            within = sum(seconds.values()) - others
            seconds[name] = seconds.get(name, 0.0) + time.perf_counter() - start - within

    setattr(owner, name, outer)


def explicit(job: dict) -> dict:
    """A column in motion, at t = sqrt(h0/g): throughput without output, set-up, phases, memory, copy bandwidth.

    `over_yardstick`: the throughput over that of a small column in the same seconds, which a machine that is now slow,
    now fast does not blur; 0 on a GPU, which a small column does not fill.
    """
    begin = time.perf_counter()
    from explicit.phases import time_phases
    from explicit.solver import ExplicitSolver
    from mpm.devices import find_device
    from mpm.provenance import peak_memory_mb

    device = find_device(job["device"])
    imported = time.perf_counter()
    body = column(job["aspect"], job["cells"], job["precision"])
    solver = ExplicitSolver(body, job["device"])
    solver.set_target(1e9)
    solver.advance(0.0)
    ready = time.perf_counter()
    solver.advance(0.0)
    _set_in_motion(solver)
    yardstick = None
    if not device.is_cuda:
        yardstick = ExplicitSolver(column(job["aspect"], YARDSTICK_CELLS, job["precision"]), job["device"])
        yardstick.set_target(1e9)
        _set_in_motion(yardstick)
    rates, ratios = [], []
    for _ in range(BATCHES):
        rates.append(_rate(solver))
        ratios.append(rates[-1] / _rate(yardstick) if yardstick else 0.0)
    answer = {
        "points": solver.points,
        "nodes": solver.grid.stored,
        "point_steps_per_s": median(rates),
        "over_yardstick": median(ratios),
        "slowest": min(rates),
        "fastest": max(rates),
        "bandwidth": copy_bandwidth(device),
        "bytes_per_point": solver.bytes_per_point,
        "bytes_per_node": solver.bytes_per_node,
        "state_mb": solver.bytes / 1e6,
        "memory_mb": peak_memory_mb(),
        "import_s": imported - begin,
        "first_step_s": ready - imported,
    }
    return answer | {"phases": time_phases(solver, PHASE_STEPS) if job["phases"] else {}}


def on_ranks(aspect: float, cells: float, precision: str) -> dict:
    """A column in motion, at t = sqrt(h0/g), on the ranks that the program was started on: points, and what each rank
    has of them (see `explicit.ranks.Domain.share`), point-steps/s of the fastest batch and their median."""
    from explicit.ranks import RankedSolver
    from explicit.solver import ExplicitSolver
    from mpm.devices import find_device
    from mpm.ranks import world

    find_device("cpu")
    body, comm = column(aspect, cells, precision), world()
    solver = RankedSolver(body, "cpu", comm) if comm else ExplicitSolver(body)
    solver.set_target(1e9)
    _set_in_motion(solver)
    rates = [_rate(solver) for _ in range(BATCHES)]
    alone = {"points": solver.points, "nodes": solver.grid.stored, "shared": 0, "peers": 0, "sent": 0}
    parts = solver.shares() if comm else [alone]
    return {"points": solver.points, "fastest": max(rates), "point_steps_per_s": median(rates), "parts": parts}


def _set_in_motion(solver):
    """Step to t = sqrt(h0/g)."""
    while solver.time < solver.body.time_scale:
        solver.advance(solver.body.time_scale)


def _rate(solver) -> float:
    """Point-steps per second of one batch."""
    on_cpu = min(max(LEAST_STEPS_CPU, POINT_STEPS_CPU // solver.points), MOST_STEPS_CPU)
    wanted = STEPS_CUDA if solver.device.is_cuda else on_cpu
    first, start = solver.steps, time.perf_counter()
    while solver.steps < first + wanted:
        solver.advance(solver.time + (first + wanted - solver.steps) * solver.time_step)
    return solver.points * (solver.steps - first) / (time.perf_counter() - start)


def copy_bandwidth(device) -> float:
    """Bytes per second that one copy on the device reads and writes, the best of ten."""
    import warp as wp

    size = COPIED["cuda" if device.is_cuda else "cpu"]
    one, other = (wp.zeros(size, dtype=wp.uint8, device=device) for _ in range(2))
    best = float("inf")
    for _ in range(COPIES):
        wp.synchronize_device(device)
        start = time.perf_counter()
        wp.copy(other, one)
        wp.synchronize_device(device)
        best = min(best, time.perf_counter() - start)
    return 2.0 * size / best


def implicit(job: dict) -> dict:
    """The first steps of a collapse: seconds a Newton iteration, what they go into, memory."""
    from implicit import newton
    from implicit.solver import ImplicitSolver
    from implicit.system import System
    from mpm.devices import start_warp
    from mpm.provenance import peak_memory_mb

    begin = time.perf_counter()
    start_warp()
    solver = ImplicitSolver(column(job["aspect"], job["cells"], "float64"))
    ready = time.perf_counter()
    before = peak_memory_mb()
    seconds = {"_residual": 0.0, "tangent": 0.0, "_solve": 0.0}
    timed(System, "_residual", seconds)
    timed(System, "tangent", seconds)
    timed(newton, "_solve", seconds)
    start = time.perf_counter()
    for _ in range(IMPLICIT_STEPS):
        solver.advance()
    spent = time.perf_counter() - start
    return {
        "points": solver.points,
        "unknowns": 3 * solver.nodes_solved_max,
        "newton_iterations": solver.newton_iterations,
        "linear_iterations": solver.linear_iterations,
        "seconds": spent,
        "phases": {
            "residual": seconds["_residual"],
            "tangent": seconds["tangent"],
            "linear solve": seconds["_solve"],
            "the rest": spent - sum(seconds.values()),
        },
        "setup_s": ready - begin,
        "memory_mb": peak_memory_mb(),
        "bytes_per_point": 1e6 * (peak_memory_mb() - before) / solver.points,
    }


if __name__ == "__main__":
    job = json.loads(sys.argv[1])
    figures = implicit(job) if job["mode"] == "implicit" else explicit(job)
    Path(sys.argv[2]).write_text(json.dumps(figures), encoding="utf-8")
