"""How a body fills space: its volume, what bears no pressure, how many points share a cell."""

import numpy as np

from mpm.body import Body

POINTS_IN_A_CELL = 8  # at the start
DEEP = 2  # cells
# Of rho g h0: a point with less bears no pressure.
PRESSURELESS = 1e-6


def packing(x, volume, pressure, body: Body) -> dict[str, float | None]:
    """Figures for `summary.json` from points `x` (n, 3) [m], their `volume` (n,) [m3] and `pressure` (n,) [Pa].

    `volume_ratio` [-]: volume over the initial one. `pressureless_share` [-] of the points. `most_points_in_a_cell`.
    `full_cell_ratio` [-]: mean number of points in cells that have material, or a wall, in every cell within two of
    them, over the 8 of the start; None where there is no such cell. Nearer to the surface cells are filled in part.
    """
    cells = np.floor(np.asarray(x, float) / body.scene.grid.cell).astype(int)
    cells = np.clip(cells, np.array(body.walls.low), np.array(body.walls.high) - 1)  # hardly beyond a wall
    cells, count = np.unique(cells, axis=0, return_counts=True)
    inside = count[_full(cells, body)]
    return {
        "volume_ratio": float(np.sum(volume) / (body.point_volume * len(body.x))),
        "pressureless_share": float(np.mean(np.asarray(pressure) <= PRESSURELESS * body.overburden)),
        "most_points_in_a_cell": int(count.max()),
        "full_cell_ratio": float(inside.mean() / POINTS_IN_A_CELL) if inside.size else None,
    }


def _full(cells, body: Body) -> np.ndarray:
    """Mask of the occupied `cells` (m, 3) around which all within DEEP are occupied too, or lie beyond a wall."""
    key = _key(cells)
    order = np.sort(key)
    low, high = np.array(body.walls.low), np.array(body.walls.high)
    full = np.arange(len(cells))
    for offset in np.ndindex(*(2 * DEEP + 1,) * 3):
        near = cells[full] + np.array(offset) - DEEP
        wanted = _key(near)
        there = order[np.minimum(np.searchsorted(order, wanted), len(order) - 1)] == wanted
        full = full[there | ((near < low) | (near >= high)).any(axis=1)]
    return full


def _key(cells) -> np.ndarray:
    """One number for each cell (m, 3), of indices within a million of the origin."""
    return ((cells[:, 0] << 21) + cells[:, 1] << 21) + cells[:, 2]
