"""How far a quasistatic heap creeps while what is out of balance falls: R_995 of the implicit solver at each level.

python benchmarks/creep.py --lambda0 0.5 1 --cells 8 16 --out benchmarks/results/implicit_creep_cpu.csv
"""

import argparse
from pathlib import Path

from compare.report.page import add_rows
from implicit.pseudo_time import Regularisation
from implicit.solver import ImplicitSolver
from mpm.body import build
from mpm.devices import start_warp
from mpm.load import load_scene
from mpm.provenance import provenance
from mpm.runout import front

LEVELS = (1e-2, 5e-3, 2e-3, 1e-3)  # out-of-balance over external force
MOST_STEPS = 600


def follow(lambda0: str, cells: str):
    """A row when the run first falls below each level."""
    settings = [f"geometry.aspect_ratio={float(lambda0)!r}", f"grid.cell={1 / float(cells)!r}"]
    solver = ImplicitSolver(build(load_scene("column_1", settings)), Regularisation())
    levels = list(LEVELS)
    while levels and solver.steps < MOST_STEPS:
        solver.advance()
        while levels and solver.unbalanced_ratio <= levels[0]:
            yield {
                "lambda0": lambda0,
                "cells": cells,
                "unbalanced": levels.pop(0),
                "R_995": front(solver.x, solver.body.measure)["R_995"],
                "pseudo_time": solver.time,
                "steps": solver.steps,
                "newton_iterations": solver.newton_iterations,
                "failed_steps": solver.failed_steps,
            }


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--lambda0", nargs="+", default=["0.5"])
    parser.add_argument("--cells", nargs="+", default=["8"], help="per r0")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    start_warp()
    machine = provenance("cpu", "float64")
    for lambda0 in options.lambda0:
        for cells in options.cells:
            for row in follow(lambda0, cells):
                row |= {key: machine[key] for key in ("device_name", "commit", "date")}
                add_rows(options.out, [row])
                print(row, flush=True)


if __name__ == "__main__":
    main()
