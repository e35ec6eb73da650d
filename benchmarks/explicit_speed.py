"""Speed of the explicit step: a scene stepped into motion, then timed without output; prints a JSON line.

    python benchmarks/explicit_speed.py column_0.5 [--device cpu] [--precision float64] [--from-time 0.3]
        [--steps 300] [--repeat 5] [--cold]

`--cold` compiles the kernels into an empty cache first and reports the seconds. One CPU core is used: Warp's
CPU device runs kernels on one thread. Throughputs are over `--repeat` timed batches: best, median, worst.
"""

import argparse
import json
import os
import shlex
import sys
import tempfile
import time


def options():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--precision", default="float64")
    parser.add_argument("--from-time", type=float, default=0.3, help="simulated time [s] before timing starts")
    parser.add_argument("--steps", type=int, default=300, help="steps in a timed batch (at least)")
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--cold", action="store_true")
    return parser.parse_args()


def measure(given) -> dict:
    begin = time.perf_counter()
    from explicit.solver import ExplicitSolver
    from mpm.body import build
    from mpm.devices import find_device
    from mpm.load import load_scene
    from mpm.provenance import peak_memory_mb, provenance

    device = find_device(given.device)
    imported = time.perf_counter()
    scene = load_scene(given.scene, [f"explicit.precision={given.precision}"])
    solver = ExplicitSolver(build(scene), given.device)
    solver.set_target(1e9)
    solver.advance(0.0)
    solver.energies()
    ready = time.perf_counter()
    memory_at_start = peak_memory_mb()
    while solver.time < given.from_time:
        solver.advance(given.from_time)
    rates = []
    for _ in range(given.repeat):
        first, start = solver.steps, time.perf_counter()
        while solver.steps < first + given.steps:
            solver.advance(solver.time + given.steps * solver.time_step)
        rates.append(solver.points * (solver.steps - first) / (time.perf_counter() - start))
    rates.sort()
    return {
        "scene": scene.name,
        "points": solver.points,
        "nodes_stored": solver.grid.stored,
        "bytes_per_point": solver.bytes_per_point,
        "state_mb": solver.bytes / 1e6,
        "point_steps_per_s_best": rates[-1],
        "point_steps_per_s_median": rates[len(rates) // 2],
        "point_steps_per_s_worst": rates[0],
        "us_per_step_median": 1e6 * solver.points / rates[len(rates) // 2],
        "cold": given.cold,
        "import_s": imported - begin,
        "first_step_s": ready - imported,
        "peak_memory_mb_at_start": memory_at_start,
        **provenance(device.alias, given.precision),
        "command": shlex.join(["python", *sys.argv]),
    }


if __name__ == "__main__":
    given = options()
    with tempfile.TemporaryDirectory() as empty:
        if given.cold:
            os.environ["WARP_CACHE_PATH"] = empty
        print(json.dumps(measure(given)))
