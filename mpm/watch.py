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
    walls, cell, found = body.walls, body.scene.grid.cell, []
    # Axis by axis: NumPy takes ten times as long along rows of three.
    for axis, (low, high) in enumerate(zip(walls.low, walls.high, strict=True) if len(x) else ()):
        at = x[:, axis]
        lowest, highest = int(at.argmin()), int(at.argmax())
        found += [(low - at[lowest] / cell, lowest), (at[highest] / cell - high, highest)]
    if comm is None:
        cells, point = max(found)
        return Beyond(float(cells), point, x[point])
    mine = [Beyond(float(cells), int(ids[point]), x[point]) for cells, point in found]
    return max((one for theirs in comm.allgather(mine) for one in theirs), key=lambda one: one.cells)


def look(x, volume_ratio, body: Body, ids=None, comm=None) -> Look:
    """Look at a body's points at `x` (n, 3) [m], of `volume_ratio` (n,) [-]; `ids`, `comm`: see `farthest_beyond`."""
    measured = front(x, body.measure, comm)
    return Look(measured, mean(volume_ratio, comm), farthest_beyond(x, body, ids, comm))
