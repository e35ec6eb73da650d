"""Run-out and height of a cloud of points; which measure is which is said once, here."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from mpm.reductions import largest, quantile

QUANTILE = 0.995
REST_WINDOW = 2.0  # time in sqrt(h0/g) over which the front's advance tells whether a body is at rest


@dataclass(frozen=True)
class Measure:
    """How a body's run-out is measured.

    `axes`: coordinates that make the distance (x and y: radius from the axis; x alone: plane strain).
    `reference` r0 [m]: initial radius or length; `half_length` [m] of a point; `cell` [m]. `axis` (x, y) [m]: where the
    vertical axis, or the plane x = const, stands.
    """

    axes: tuple[int, ...]
    reference: float
    half_length: float
    cell: float
    axis: tuple[float, float] = (0.0, 0.0)

    def distance(self, x):
        """Distance [m] of points `x` (n, 3) from the axis or plane."""
        away = [np.asarray(x[:, axis], float) - self.axis[axis] for axis in self.axes]
        return np.sqrt(sum(part * part for part in away))

    def runout(self, distance):
        """(r - r0)/r0 [-]."""
        return float((distance - self.reference) / self.reference)


def connected(x, cell, axis=(0.0, 0.0)):
    """Mask (n,) of the points in the component nearest the vertical `axis` (x, y) [m].

    Points belong together when their cells touch, corners included: then their uGIMP domains share nodes.
    """
    cells, cell_of = np.unique(np.floor(np.asarray(x) / cell).astype(int), axis=0, return_inverse=True)
    pairs = cKDTree(cells).query_pairs(1.0, p=np.inf, output_type="ndarray")
    links = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(cells), len(cells)))
    label = connected_components(links, directed=False)[1]
    centre = np.argmin(np.linalg.norm(cells[:, :2] + 0.5 - np.divide(axis, cell), axis=1))
    return (label == label[centre])[np.ravel(cell_of)]


def front(x, measure: Measure, comm=None) -> dict[str, float]:
    """The cheap measures, for every history row: R_max, R_995 [-] and height [m].

    R_max: farthest centre plus the point's half-length. R_995: 99.5 % mass quantile of the centres' distance
    (all points of a scene have the same mass). `comm`: of the ranks that `x` is spread over, where it is.
    """
    distance = measure.distance(x)
    return front_of(largest(distance, comm), quantile(distance, QUANTILE, comm), largest(x[:, 2], comm), measure)


def front_of(farthest: float, outer: float, top: float, measure: Measure) -> dict[str, float]:
    """The measures of `front`, of the `farthest` centre's distance, the `outer` quantile of them and the `top` centre's
    height, all [m]."""
    return {
        "R_max": measure.runout(farthest + measure.half_length),
        "R_995": measure.runout(outer),
        "height": top + measure.half_length,
    }


def run_out(x, measure: Measure) -> dict[str, float]:
    """All measures of points `x` (n, 3) [m]: R_max, R_995, R_connected [-] and h_inf [m].

    R_connected: farthest point (plus half-length) of the component connected to the axis; h_inf: that
    component's top.
    """
    body = np.asarray(x)[connected(x, measure.cell, measure.axis)]
    return {
        **{key: value for key, value in front(x, measure).items() if key != "height"},
        "R_connected": measure.runout(measure.distance(body).max() + measure.half_length),
        "h_inf": float(body[:, 2].max() + measure.half_length),
    }
