"""Speed of the explicit step on MPI ranks: a scene stepped into motion, then timed without output; a CSV row a call.

    mpiexec -n 2 python benchmarks/explicit_ranks.py column_1 [--out benchmarks/results/NAME.csv] [--repeat 3]

Best of `--repeat` batches of 0.06 s of simulated time. Call it in turn with -n 1, which takes the solver for one rank.
"""

import argparse
import csv
import time
from pathlib import Path

from mpi4py import MPI

from explicit.ranks import Domain
from explicit.solver import ExplicitSolver
from mpm.body import build
from mpm.devices import find_device
from mpm.load import load_scene
from mpm.provenance import provenance

IN_MOTION, BATCH = 0.3, 0.06  # s


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--repeat", type=int, default=3)
    options = parser.parse_args()
    comm, body, device = MPI.COMM_WORLD, build(load_scene(options.scene)), find_device("cpu")
    solver = Domain(body, device, comm) if comm.size > 1 else ExplicitSolver(body, device)
    solver.advance_to(IN_MOTION)
    seconds = []
    for _ in range(options.repeat):
        steps = solver.steps
        comm.Barrier()
        started = time.perf_counter()
        solver.advance_to(solver.time + BATCH)
        comm.Barrier()
        seconds.append((time.perf_counter() - started) / (solver.steps - steps))
    nodes, shared = solver.grid.stored, len(solver.halo.nodes) if comm.size > 1 else 0
    loads = comm.gather(solver.points)
    if comm.rank:
        return
    about = provenance("cpu", body.scene.explicit.precision)
    row = {
        "scene": options.scene,
        "ranks": comm.size,
        "points": len(body.x),
        "ms_per_step": f"{1e3 * min(seconds):.3f}",
        "million_point_steps_per_s": f"{len(body.x) / min(seconds) / 1e6:.2f}",
        "heaviest_over_mean": f"{max(loads) * comm.size / sum(loads):.3f}",
        "nodes_of_rank_0": nodes,
        "shared_of_rank_0": shared,
        **{key: about[key] for key in ("device_name", "precision", "warp", "commit", "date")},
    }
    print(row)
    if options.out:
        new = not options.out.exists()
        with options.out.open("a", newline="") as file:
            writer = csv.DictWriter(file, row)
            if new:
                writer.writeheader()
            writer.writerow(row)


if __name__ == "__main__":
    main()
