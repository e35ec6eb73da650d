"""The surface of a deposit in 3D: its top as one sheet, its sides down to the ground, coloured by a field."""

import numpy as np


def deposit_surface(x, values, cell: float, half: float):
    """Faces (m, 4, 3) [m] of the surface of points `x` (n, 3) [m], and the mean of `values` (n,) behind each (m,).

    Seen from above the body is cut into squares of edge `cell` [m]. A square is as high as its highest point plus the
    points' `half` length [m], a corner as high as the squares around it on average. Sides stand where a square has no
    neighbour, in layers of one cell, so that colours show what is behind them.
    """
    index = np.floor(np.asarray(x, float) / cell + 1e-9).astype(int)
    origin = index.min(axis=0) - [1, 1, 0]  # an empty square all around
    i, j, k = (index - origin).T
    shape = (i.max() + 2, j.max() + 2)
    top, bottom = np.full(shape, -np.inf), np.full(shape, np.inf)
    np.maximum.at(top, (i, j), x[:, 2] + half)
    np.minimum.at(bottom, (i, j), x[:, 2] - half)
    full = np.isfinite(top)
    corner = _around(np.where(full, top, 0.0)) / np.maximum(_around(full.astype(float)), 1.0)
    layer, count = np.zeros((*shape, k.max() + 2)), np.zeros((*shape, k.max() + 2))
    np.add.at(layer, (i, j, k), values)
    np.add.at(count, (i, j, k), 1.0)
    layer = _filled(layer, count)

    faces, colours = [], []
    for a, b in np.argwhere(full):
        at = [(a, b), (a + 1, b), (a + 1, b + 1), (a, b + 1)]  # the square's corners, around it
        ring = [np.array([(p + origin[0]) * cell, (q + origin[1]) * cell, corner[p, q]]) for p, q in at]
        faces.append(ring)
        colours.append(layer[a, b, -1])
        beside = [(a, b - 1), (a + 1, b), (a, b + 1), (a - 1, b)]  # across the edge from one corner to the next
        for side, other in enumerate(beside):
            if not full[other]:
                for face, level in _wall(ring[side], ring[(side + 1) % 4], bottom[a, b], cell):
                    faces.append(face)
                    colours.append(layer[a, b, np.clip(level - origin[2], 0, layer.shape[2] - 1)])
    return np.array(faces), np.array(colours)


def _around(squares):
    """Sum over the up to four squares at each corner; corner (i, j) is the lower one of square (i, j)."""
    padded = np.pad(squares, 1)
    return padded[1:, 1:] + padded[:-1, 1:] + padded[1:, :-1] + padded[:-1, :-1]


def _filled(total, count):
    """Means over the layers of each square; layers without points take the next below that has some, or above."""
    mean = np.divide(total, count, out=np.full_like(total, np.nan), where=count > 0)
    for k in range(1, mean.shape[2]):
        mean[:, :, k] = np.where(np.isnan(mean[:, :, k]), mean[:, :, k - 1], mean[:, :, k])
    for k in range(mean.shape[2] - 2, -1, -1):
        mean[:, :, k] = np.where(np.isnan(mean[:, :, k]), mean[:, :, k + 1], mean[:, :, k])
    return mean


def _wall(one, other, bottom, cell):
    """Faces between `bottom` and the edge from `one` to `other`, in layers of about a cell, with their numbers."""
    height = 0.5 * (one[2] + other[2]) - bottom
    parts = max(round(height / cell), 1)
    for part in range(parts):
        low, high = part / parts, (part + 1) / parts
        face = [(x, y, bottom + share * (z - bottom)) for share, ends in ((low, (one, other)), (high, (other, one)))
                for x, y, z in ends]  # fmt: skip
        yield face, int(np.floor((bottom + 0.5 * (low + high) * height) / cell))
