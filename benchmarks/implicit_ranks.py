"""Speed of the implicit solver on MPI ranks: the first steps of a collapse, without output; a CSV row a call.

    mpiexec -n 2 python benchmarks/implicit_ranks.py column_1 --set grid.cell=0.0625 [--steps 4] [--out FILE.csv]

Call it in turn with -n 1, which takes the solver for one rank. `cpu_s`: of the rank that computed longest, on a machine
with other work a better measure than `wall_s`; what a rank waits for another is in both.
"""

import argparse
import time
from pathlib import Path

from compare.report.page import add_rows
from implicit._dolfinx import MPI
from implicit.pseudo_time import Regularisation
from implicit.ranks import Domain
from implicit.solver import ImplicitSolver
from mpm.body import build
from mpm.devices import start_warp
from mpm.load import load_scene
from mpm.provenance import provenance


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--steps", type=int, default=4)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    start_warp()
    comm, body = MPI.COMM_WORLD, build(load_scene(options.scene, options.set))
    solver = Domain(body, Regularisation(), comm) if comm.size > 1 else ImplicitSolver(body)
    comm.Barrier()
    wall, cpu = time.perf_counter(), time.process_time()
    for _ in range(options.steps):
        solver.advance()
    cpu = max(comm.allgather(time.process_time() - cpu))
    wall = time.perf_counter() - wall
    system = solver.system
    loads, nodes = comm.allgather(solver.points), comm.allgather((system.owned, system.count))
    if comm.rank:
        return
    about = provenance("cpu", "float64")
    row = {
        "scene": options.scene,
        "set": " ".join(options.set),
        "ranks": comm.size,
        "points": len(body.x),
        "unknowns": 3 * system.total,
        "steps": options.steps,
        "newton": solver.newton_iterations,
        "linear": solver.linear_iterations,
        "wall_s": f"{wall:.2f}",
        "cpu_s": f"{cpu:.2f}",
        "cpu_s_per_newton": f"{cpu / solver.newton_iterations:.4f}",
        "most_points_over_mean": f"{max(loads) * comm.size / sum(loads):.3f}",
        "most_nodes_owned": max(own for own, _ in nodes),
        "most_nodes_kept": max(kept for _, kept in nodes),
        **{key: about[key] for key in ("device_name", "warp", "commit", "date")},
    }
    print(row)
    if options.out:
        add_rows(options.out, [row])


if __name__ == "__main__":
    main()
