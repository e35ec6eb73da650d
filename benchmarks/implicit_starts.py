"""Newton's counts on MPI ranks: an implicit collapse to rest from each of many random starts; a CSV row each.

    python benchmarks/implicit_starts.py column_small --ranks 2 [--starts 30] [--set KEY=VALUE] [--out FILE.csv]
    python benchmarks/implicit_starts.py column_small --ranks 1 ...

It starts the ranks itself. `cpu_s`: of the first rank, in which it also waits for the others.
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path

from compare import launch
from compare.cli.ranks import take_part
from compare.ensembles import SCATTER
from compare.report.page import add_rows
from implicit._dolfinx import libraries
from implicit.run import run
from mpm.load import load_scene
from mpm.provenance import provenance
from mpm.ranks import started


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--ranks", type=int, default=1)
    parser.add_argument("--starts", type=int, default=30)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    if options.ranks > 1 and not started():
        sys.exit(launch.start(options.ranks, sys.argv).wait())
    take_part(lambda: count(options))


def count(options):
    """Count for each start; on the first rank."""
    for start in range(options.starts):
        row = row_of(options, start)
        print(row, flush=True)
        if options.out:
            add_rows(options.out, [row])


def row_of(options, start: int) -> dict:
    """The row of one start."""
    realisation = (f"grid.scatter={SCATTER}", f"grid.realisation={start}", "output.vtk=false")
    with tempfile.TemporaryDirectory() as folder:
        began = time.process_time()
        summary = run(load_scene(options.scene, [*options.set, *realisation]), Path(folder) / "run")
        cpu = time.process_time() - began
    about = provenance("cpu", "float64") | libraries()
    return {
        "scene": options.scene,
        "set": " ".join(options.set),
        "ranks": options.ranks,
        "start": start,
        **{key: summary[key] for key in ("stop_reason", "steps", "failed_steps")},
        "newton": summary["newton_iterations"],
        "linear": summary["linear_iterations"],
        "R_995": f"{summary['R_995']:.6f}",
        "h_inf": f"{summary['h_inf']:.6f}",
        "cpu_s": f"{cpu:.2f}",
        **{key: about[key] for key in ("dolfinx", "petsc", "device_name", "commit", "date")},
    }


if __name__ == "__main__":
    main()
