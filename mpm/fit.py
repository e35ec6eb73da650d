"""How well the points of a mesh body fill it: the record that `repose validate` prints."""

from typing import NamedTuple

import numpy as np

MOST_OFF = 0.05  # of the body's volume that the points may miss or exceed


class Fit(NamedTuple):
    """Points held against the body that a mesh file encloses; of the part that symmetry keeps.

    `seeded` and `enclosed`: volume [m3] of the points and of the body; `overlap`: volume [m3] that the whole body's
    shells share and that counts once. `body` and `points`: lowest and greatest x, y, z [m], (2, 3), a point taken as a
    cube of one spacing. `misfit`: how far the body's bounding box lies off the planes between points, along x, y and z
    and in spacings of points, the greater of both sides: 0 where faces lie between points, 0.5 through their centres.
    """

    seeded: float
    enclosed: float
    overlap: float
    body: np.ndarray
    points: np.ndarray
    misfit: np.ndarray

    @property
    def off(self) -> float:
        """Volume of the points over the body's, less 1 [-]."""
        return self.seeded / self.enclosed - 1.0

    def lines(self) -> list[str]:
        """The record in words, a line each."""
        overlap = f"; {self.overlap:.4g} m3 lies in several shells and counts once" if self.overlap > 0 else ""
        x, y, z = self.misfit
        return [
            f"points fill {self.seeded:.4g} m3, the mesh encloses {self.enclosed:.4g} m3: {self.off:+.1%}{overlap}",
            f"body {_corners(self.body)}, points {_corners(self.points)}, lowest point z = {self.body[0, 2]:.4g} m",
            f"bounding box off the lattice by {x:.2g}, {y:.2g}, {z:.2g} of a spacing in x, y, z (0 fits, 0.5 at most)",
        ]


def fit_of(vertices, x, spacing, enclosed, overlap, planes) -> Fit:
    """The record of points `x` (n, 3) [m], one `spacing` [m] apart, in a body with `vertices` (v, 3) [m].

    `enclosed` and `overlap` as in `Fit`; `planes`: least x and y [m] that symmetry keeps, -inf where it keeps all.
    """
    body = np.array([vertices.min(axis=0), vertices.max(axis=0)])
    body[0, :2] = np.maximum(body[0, :2], planes)
    points = np.array([x.min(axis=0) - spacing / 2, x.max(axis=0) + spacing / 2])
    in_spacings = body / spacing
    misfit = np.abs(in_spacings - np.round(in_spacings)).max(axis=0)
    return Fit(len(x) * spacing**3, enclosed, overlap, body, points, misfit)


def _corners(box):
    low, high = (", ".join(f"{x + 0.0:.4g}" for x in np.round(corner, 9)) for corner in box)
    return f"({low}) to ({high}) m"
