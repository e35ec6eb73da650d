"""How a body fills space: its volume, what bears no pressure, how many points share a cell."""

import numpy as np
from scipy.ndimage import minimum_filter

from mpm.scene import Body

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
    corner = cells.min(axis=0)
    shape = cells.max(axis=0) + 1 - corner
    count = np.zeros(shape, int)
    np.add.at(count, tuple((cells - corner).T), 1)
    there = np.pad(count > 0, DEEP)
    for axis in range(3):
        ahead = np.moveaxis(there, axis, 0)
        ahead[:DEEP] = corner[axis] == body.walls.low[axis]
        ahead[-DEEP:] = corner[axis] + shape[axis] == body.walls.high[axis]
    full = minimum_filter(there, size=2 * DEEP + 1)[(slice(DEEP, -DEEP),) * 3]
    inside = count[full]
    weight = body.constants.density * body.scene.loads.gravity * body.height
    return {
        "volume_ratio": float(np.sum(volume) / (body.point_volume * len(body.x))),
        "pressureless_share": float(np.mean(np.asarray(pressure) <= PRESSURELESS * weight)),
        "most_points_in_a_cell": int(count.max()),
        "full_cell_ratio": float(inside.mean() / POINTS_IN_A_CELL) if inside.size else None,
    }
