"""How often the points of a warp add to nodes on a GPU, counted on the positions of a collapse: no GPU is needed.

    python benchmarks/gpu_groups.py [--cell 0.05] [--out benchmarks/results/gpu_groups.csv]

Each time the stored nodes follow the points of `column_0.5`, the points are sorted by the cell that their stencils
start in. The table has a row an order: the points as sorted just now, as sorted the time before, and in the body's
order. It has means over the run and the worst of the groups of a warp (points that reach the same 27 nodes), of the
runs that these are where only neighbours count, and of the nodes that are added to, over the number of points: each
group's nodes once, or each point's own.
"""

import argparse
import csv
from pathlib import Path

import numpy as np

from explicit.kernels.warps import WARP
from explicit.solver import ExplicitSolver
from mpm.body import build
from mpm.devices import start_warp
from mpm.gimp import HALF_LENGTH_IN_CELLS
from mpm.load import load_scene

SQRT_H0_G = 5.0  # how long the collapse is watched, in this unit


def stencils(x, cell: float) -> tuple[np.ndarray, np.ndarray]:
    """Number of the first node of each point's stencil (n,), and how many nodes it reaches along each axis (n, 3)."""
    start = x / cell - HALF_LENGTH_IN_CELLS
    first = np.floor(start).astype(int)
    i, j, k = (first - first.min(axis=0)).T
    number = (i * (j.max() + 1) + j) * (k.max() + 1) + k
    return number, np.where(start - first > 1.0 - 2.0 * HALF_LENGTH_IN_CELLS, 3, 2)


def counts(number, reach, order) -> tuple[float, float, float, float]:
    """Groups and runs a warp, nodes added to a point by groups, and by each point on its own."""
    warp = np.arange(len(order)) // WARP
    group = warp * (int(number.max()) + 1) + number[order]
    by_group = np.argsort(group, kind="stable")
    _, starts = np.unique(group[by_group], return_index=True)
    widest = np.maximum.reduceat(reach[order][by_group], starts)
    of_groups, of_points = (int(each.prod(axis=1).sum()) for each in (widest, reach))
    warps, runs = warp[-1] + 1, 1 + np.count_nonzero(np.diff(group))
    return len(starts) / warps, runs / warps, of_groups / len(order), of_points / len(order)


class Counted(ExplicitSolver):
    """A solver that counts each time its stored nodes follow the points."""

    order: np.ndarray | None = None

    def fit_grid(self):
        """See `ExplicitSolver.fit_grid`."""
        super().fit_grid()
        number, reach = stencils(self.x.numpy().astype(float), self.body.scene.grid.cell)
        now = np.argsort(number, kind="stable")
        if self.order is None:
            self.found = {"sorted": [], "sorted at the last fit": [], "body's order": []}
        else:
            for order, name in zip((now, self.order, np.arange(len(now))), self.found, strict=True):
                self.found[name].append(counts(number, reach, order))
        self.order = now


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cell", type=float, default=0.05, help="grid.cell [m]")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    start_warp()
    body = build(load_scene("column_0.5", [f"grid.cell={options.cell}"]))
    solver = Counted(body)
    solver.advance_to(SQRT_H0_G * body.time_scale)
    rows = []
    for name, found in solver.found.items():
        mean, worst = np.mean(found, axis=0), np.max(found, axis=0)
        row = {"points": solver.points, "fits": len(found), "order": name}
        for k, what in enumerate(
            ("groups_a_warp", "runs_a_warp", "nodes_a_point_by_groups", "nodes_a_point_by_points")
        ):
            row |= {what: f"{mean[k]:.2f}", f"{what}_worst": f"{worst[k]:.2f}"}
        rows.append(row)
        print("  ".join(f"{key} {value}" for key, value in row.items()))
    if options.out:
        with options.out.open("w", newline="") as file:
            writer = csv.DictWriter(file, list(rows[0]))
            writer.writeheader()
            writer.writerows(rows)


if __name__ == "__main__":
    main()
