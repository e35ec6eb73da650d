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


def beyond_walls(extreme, x, body: Body) -> list[Beyond]:
    """How far the `extreme` (6,) points of a body, at `x` (6, 3) [m], lie beyond the wall that is on their side: by
    number, those lowest along x, y and z, then the highest."""
    walls, cell, found = body.walls, body.scene.grid.cell, []
    for side, (point, at) in enumerate(zip(extreme, x, strict=True)):
        axis = side % 3
        cells = walls.low[axis] - at[axis] / cell if side < 3 else at[axis] / cell - walls.high[axis]
        found.append(Beyond(float(cells), int(point), at))
    return found


def farthest_of(found: list[Beyond]) -> Beyond:
    """The one of `found` that is farthest beyond its wall; of some that are as far, the one with the highest number."""
    return max(found, key=lambda one: (one.cells, one.point))


def farthest_beyond(x, body: Body, ids=None, comm=None) -> Beyond:
    """Of points `x` (n, 3) [m] of a body, the one that lies farthest beyond a wall.

    `comm`: of the ranks that the points are spread over, each of which has those of numbers `ids` (n,).
    """
    # Axis by axis: NumPy takes ten times as long along rows of three.
    axes = [x[:, axis] for axis in range(3)] if len(x) else []
    extreme = [int(at.argmin()) for at in axes] + [int(at.argmax()) for at in axes]
    found = beyond_walls(extreme if comm is None else ids[extreme], x[extreme], body)
    if comm is None:
        return farthest_of(found)
    return farthest_of([one for theirs in comm.allgather(found) for one in theirs])


def look(x, volume_ratio, body: Body, ids=None, comm=None) -> Look:
    """Look at a body's points at `x` (n, 3) [m], of `volume_ratio` (n,) [-]; `ids`, `comm`: see `farthest_beyond`."""
    measured = front(x, body.measure, comm)
    return Look(measured, mean(volume_ratio, comm), farthest_beyond(x, body, ids, comm))
