"""Vertical lines of a lattice cut by a closed surface: what lies inside is decided along each of them.

The lattice is (i + 1/2, j + 1/2, k + 1/2) spacing for all integers i, j, k. A line (i, j) crosses the surface where it
enters the body (+1) and where it leaves it (-1); the sum of what a line has crossed so far is the winding number, and
where it is above 0 the line is inside. Where two shells overlap it is 2, so that they are united.
"""

from typing import NamedTuple

import numpy as np

from mpm.errors import SceneError

# Lines and centres are looked up this share of a spacing beyond their places (x, y, z), so that a face meant to pass
# through centres is not decided point by point by round-off: a centre on the surface belongs to the body that lies on
# its greater-coordinate side. The three differ, by ratios that are not simple, so that the centres of a sloping face
# such as z = x or z = 2 y are moved off it too.
LATTICE_SHIFT = np.array([1.0e-4, 1.37e-4, 1.73e-4])


class Crossings(NamedTuple):
    """Crossings of lattice lines with a surface, each (n,): line `i`, `j`, height `z` in spacings (centre k is at k),
    `sign` +1 on the way in and -1 on the way out. Ordered by i, then j, then z."""

    i: np.ndarray
    j: np.ndarray
    z: np.ndarray
    sign: np.ndarray

    def gaps(self) -> np.ndarray:
        """Height [spacings] from each crossing to the next one, (n,); 0 for the last of all.

        What leads from the top of a line to the next line lies outside, where nothing is counted.
        """
        return np.append(np.diff(self.z), 0.0)


def cross(vertices, triangles, spacing, low=(-np.inf, -np.inf), high=(np.inf, np.inf)) -> Crossings:
    """Crossings of the lattice's lines with low < (x, y) < high [m] and a closed surface.

    `vertices` is float (n, 3) [m], `triangles` int (m, 3), wound so that the winding number is 1 inside.

    The surface is cut by the planes x = const into segments, the segments by the lines y = const into crossings. Every
    cut is half-open (an edge from a to b is cut at a <= c < b) and neighbouring triangles compute the same point on
    their common edge bit by bit, so no line can slip between them.

    Raises SceneError where a line does not leave the surface as often as it enters: then it is not closed.
    """
    # In these units lattice centres are the integers, and the first at or after `a` is ceil(a).
    scaled = np.asarray(vertices, dtype=np.float64) / spacing - 0.5 - LATTICE_SHIFT
    i, start, end, sign = _cut_triangles(scaled[triangles])
    kept = ((i + 0.5) * spacing > low[0]) & ((i + 0.5) * spacing < high[0])
    i, start, end, sign = i[kept], start[kept], end[kept], sign[kept]

    segment, j = integers_between(start[:, 0], end[:, 0])
    kept = ((j + 0.5) * spacing > low[1]) & ((j + 0.5) * spacing < high[1])
    segment, j = segment[kept], j[kept]
    z = _cut_edges(start[segment], end[segment], j)[:, 0]
    i, sign = i[segment], sign[segment]

    found = _ordered(i, j, z, sign)[0]
    ends = _last_of_each_line(found)
    if np.any(np.cumsum(found.sign)[ends]):
        raise SceneError("the mesh's surface is not closed: a vertical line enters it without leaving")
    return found


def together(first: Crossings, second: Crossings) -> tuple[Crossings, np.ndarray, np.ndarray]:
    """Both lists as one, and the winding numbers of the first and of the second surface behind each crossing."""
    both = [np.concatenate(pair) for pair in zip(first, second, strict=True)]
    found, order = _ordered(*both)
    of_first = order < len(first.z)
    return found, np.cumsum(found.sign * of_first), np.cumsum(found.sign * ~of_first)


def spans(crossings: Crossings) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """What of each line lies inside: line i and j, and from which z to which [spacings], each (s,)."""
    inside = np.concatenate([[False], np.cumsum(crossings.sign) > 0])
    start = np.flatnonzero(~inside[:-1] & inside[1:])
    end = np.flatnonzero(inside[:-1] & ~inside[1:])
    return crossings.i[start], crossings.j[start], crossings.z[start], crossings.z[end]


def integers_between(low, high):
    """All integers c with low <= c < high: for each, the index of its interval and c itself."""
    first = np.ceil(low).astype(np.int64)
    count = np.maximum(np.ceil(high).astype(np.int64) - first, 0)
    owner = np.repeat(np.arange(len(first)), count)
    step = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
    return owner, first[owner] + step


def _ordered(i, j, z, sign):
    order = np.lexsort((z, j, i))
    return Crossings(i[order], j[order], z[order], sign[order]), order


def _last_of_each_line(crossings):
    """Index of the highest crossing of each line."""
    new = (np.diff(crossings.i) != 0) | (np.diff(crossings.j) != 0)
    return np.flatnonzero(np.append(new, True))[: len(crossings.z)]


def _cut_edges(start, end, value):
    """Where edges (n, d) have first coordinate `value` (n,): their other coordinates, (n, d - 1)."""
    share = (value - start[:, 0]) / (end[:, 0] - start[:, 0])
    return start[:, 1:] + share[:, None] * (end[:, 1:] - start[:, 1:])


def _cut_triangles(corners):
    """Cut triangles (m, 3, 3) by the planes x = integer.

    Returns, a segment each: the integer, the (y, z) of its ends, the one with the lesser y first, and +1 where the body
    lies above the segment, -1 where it lies below.
    """
    order = np.argsort(corners[:, :, 0], axis=1, kind="stable")
    # +1 where low, middle, high come in the order in which the triangle lists them: 0 1 2, 1 2 0 or 2 0 1.
    turn = np.where((order[:, 1] - order[:, 0]) % 3 == 1, 1, -1)
    corners = np.take_along_axis(corners, order[:, :, None], axis=1)
    owner, i = integers_between(corners[:, 0, 0], corners[:, 2, 0])
    low, middle, high = np.moveaxis(corners[owner], 1, 0)
    # The plane cuts low-high and one of low-middle, middle-high. Each edge runs towards greater x, in
    # every triangle that has it: that is what makes the common point the same bit by bit.
    beyond = (middle[:, 0] <= i)[:, None]
    one = _cut_edges(low, high, i)
    other = _cut_edges(np.where(beyond, middle, low), np.where(beyond, high, middle), i)
    swap = one[:, :1] > other[:, :1]
    sign = turn[owner] * np.where(swap[:, 0], -1, 1)
    return i, np.where(swap, other, one), np.where(swap, one, other), sign
