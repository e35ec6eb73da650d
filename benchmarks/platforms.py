"""A line of `results/platforms.csv`: what `repose demo` gave on this system, with which versions, in how long.

SECONDS=0; ./repose demo; .venv/bin/python benchmarks/platforms.py runs/demo $SECONDS
"""

import csv
import platform
import sys
from pathlib import Path

from mpm.results import Results


def main():
    """Print the table's heading and the line of this system. Arguments: the demo's folder, its time [s]."""
    folder, seconds = Path(sys.argv[1]), sys.argv[2]
    runs = [Results.open(path.parent) for path in folder.glob("runs/*/results.h5")]
    runs.sort(key=lambda run: run.summary()["points"])
    # The finest of each solver: the demo repeats both on a coarser grid.
    explicit, implicit = (
        [run for run in runs if run.provenance["mode"] == mode][-1] for mode in ("explicit", "implicit")
    )
    used = implicit.provenance
    line = {"scene": implicit.scene.name}
    line |= {"system": platform.freedesktop_os_release()["PRETTY_NAME"]}
    line |= {name: used[name] for name in ("cpu", "python", "numpy", "warp", "dolfinx", "petsc", "mpi")}
    line |= {f"R_995 {run.summary()['mode']}": f"{run.summary()['R_995']:.4f}" for run in (explicit, implicit)}
    line |= {"Newton iterations": implicit.summary()["newton_iterations"], "demo [s]": seconds}
    table = csv.DictWriter(sys.stdout, line, lineterminator="\n")
    table.writeheader()
    table.writerow(line)


if __name__ == "__main__":
    main()
