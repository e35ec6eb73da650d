"""Quasistatic collapses to rest by the implicit solver: run-out, effort and where the time goes, one row a run.

    python benchmarks/implicit_runs.py SCENE [--set KEY=VALUE ...] [--reg NAME=VALUE ...] [--table FILE] [--max-steps N]

NAME is one of `implicit.pseudo_time.Regularisation`. Seconds are those of one core; run nothing beside it for timing.
"""

import argparse
import time
from pathlib import Path

from compare.bench.worker import timed
from compare.report.page import add_rows
from implicit import newton
from implicit.pseudo_time import Regularisation, Rest
from implicit.solver import ImplicitSolver
from implicit.system import System
from mpm.body import build
from mpm.devices import start_warp
from mpm.errors import NumericalError
from mpm.load import load_scene
from mpm.provenance import provenance
from mpm.runout import front, run_out
from mpm.theory import theory


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--reg", action="append", default=[], metavar="NAME=VALUE")
    parser.add_argument("--table", type=Path, default=Path("benchmarks/results/implicit_runs_cpu.csv"))
    parser.add_argument("--max-steps", type=int, default=1000)
    options = parser.parse_args()

    start_warp()
    body = build(load_scene(options.scene, options.set))
    changed = {key: float(value) for key, value in (item.split("=") for item in options.reg)}
    solver = ImplicitSolver(body, Regularisation(**changed))
    seconds: dict[str, float] = {}
    for name in ("_residual", "tangent"):
        timed(System, name, seconds)
    timed(newton, "_solve", seconds)

    rest, stopped = Rest(body.time_scale), "max_steps"
    started = time.perf_counter()
    try:
        while solver.steps < options.max_steps:
            solver.advance()
            now = front(solver.x, body.measure)
            if solver.steps % 5 == 0:
                print(
                    f"{options.scene} {options.set} {options.reg}: step {solver.steps}, dt {solver.time_step:.3g}, "
                    f"R_995 {now['R_995']:.4f}, unbalanced {solver.unbalanced_ratio:.1e}, "
                    f"Newton {solver.newton_iterations}, failed {solver.failed_steps}, "
                    f"{time.perf_counter() - started:.0f} s",
                    flush=True,
                )
            if rest(solver.time, now["R_995"], solver.unbalanced_ratio):
                stopped = "rest"
                break
    except NumericalError as error:
        print(error)
        stopped = "failed"
    wall = time.perf_counter() - started

    described = provenance("cpu", "float64")
    eq4, measures = theory(body.scene)["eq4"], run_out(solver.x, body.measure)
    assembly = seconds["_residual"] + seconds["tangent"]
    row = {
        "scene": options.scene,
        "set": " ".join(options.set),
        "regularisation": " ".join(options.reg),
        "points": solver.points,
        "unknowns": 3 * solver.nodes_solved_max,
        "stopped": stopped,
        "steps": solver.steps,
        "failed_steps": solver.failed_steps,
        "newton_iterations": solver.newton_iterations,
        "linear_iterations": solver.linear_iterations,
        "unbalanced_ratio": f"{solver.unbalanced_ratio:.2e}",
        **{key: f"{value:.4f}" for key, value in measures.items()},
        "R_995_over_eq4": f"{measures['R_995'] / eq4 - 1:+.3f}" if eq4 else "",
        "volume_ratio": f"{solver.material_points.jacobian.numpy().mean():.4f}",
        "wall_s": f"{wall:.1f}",
        "assembly_s": f"{assembly:.1f}",
        "linear_s": f"{seconds['_solve']:.1f}",
        "device": described["device_name"],
        "commit": described["commit"],
    }
    add_rows(options.table, [row])
    print(row)


if __name__ == "__main__":
    main()
