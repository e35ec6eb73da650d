"""What those who judge a running body look at for every history row, also of one that is spread over MPI ranks."""

from typing import NamedTuple

import numpy as np

from mpm.body import Body
from mpm.reductions import mean
from mpm.runout import front


class Beyond(NamedTuple):
    """The point that lies farthest beyond a wall: by how many cells (below 0: within), its number and `x` (3,) [m]."""

    cells: float
    point: int
    x: np.ndarray


class Look(NamedTuple):
    """A body's front (see `mpm.runout.front`), its mean volume over the initial one, and the point farthest beyond a
    wall."""

    front: dict[str, float]
    volume_ratio: float
    beyond: Beyond


def farthest_beyond(x, body: Body, ids=None, comm=None) -> Beyond:
    """Of points `x` (n, 3) [m] of a body, the one that lies farthest beyond a wall.

    `comm`: of the ranks that the points are spread over, each of which has those of numbers `ids` (n,).
    """
    walls, at = body.walls, x / body.scene.grid.cell
    cells = np.maximum(np.array(walls.low) - at, at - np.array(walls.high)).max(axis=1)
    if comm is None:
        point = int(cells.argmax())
        return Beyond(float(cells[point]), point, x[point])
    worst = int(cells.argmax()) if len(cells) else None
    found = comm.allgather(None if worst is None else Beyond(float(cells[worst]), int(ids[worst]), x[worst]))
    return max((one for one in found if one), key=lambda one: one.cells)


def look(x, volume_ratio, body: Body, ids=None, comm=None) -> Look:
    """Look at a body's points at `x` (n, 3) [m], of `volume_ratio` (n,) [-]; `ids`, `comm`: see `farthest_beyond`."""
    measured = front(x, body.measure, comm)
    return Look(measured, mean(volume_ratio, comm), farthest_beyond(x, body, ids, comm))
