"""Geometry of a scene -> positions of its material points on a regular lattice of half a cell."""

from typing import NamedTuple

import numpy as np

from mpm.config import Box, Column, Mesh
from mpm.errors import SceneError
from mpm.mesh_seed import read_closed_surface, seed_inside


class Seeds(NamedTuple):
    """Point centres `x` (n, 3) [m], in order of x, then y, then z (z fastest); the body's initial `reference`
    radius (box: its length along x) and `height` [m]."""

    x: np.ndarray
    reference: float
    height: float


def seed(geometry: Column | Box | Mesh, cell: float) -> Seeds:
    """Fill a geometry with points half a cell apart.

    A column keeps the centres with x^2 + y^2 <= r0^2, which gives Table 1's counts. Raises SceneError when a
    mesh cannot be read, is open, reaches below z = 0, or holds no point.
    """
    spacing = 0.5 * cell
    if isinstance(geometry, Column):
        return Seeds(_column(geometry, spacing), geometry.radius, geometry.height)
    if isinstance(geometry, Box):
        axes = [(np.arange(round(length / spacing)) + 0.5) * spacing for length in geometry.size]
        return Seeds(_lattice(*axes), geometry.size[0], geometry.size[2])
    vertices, triangles = read_closed_surface(geometry.file)
    if vertices[:, 2].min() < -1e-6 * cell:
        raise SceneError(
            f"geometry.file = {geometry.file}: reaches down to z = {vertices[:, 2].min():g}, "
            "but a body stands on z = 0 [m]"
        )
    if np.any(vertices[:, :2].min(axis=0) > 0) or np.any(vertices[:, :2].max(axis=0) < 0):
        raise SceneError(
            f"geometry.file = {geometry.file}: the axis x = y = 0, from which run-out is measured, misses the body"
        )
    x_min = 0.0 if geometry.symmetry == "quarter" else -np.inf
    y_min = 0.0 if geometry.symmetry in ("quarter", "half") else -np.inf
    x = seed_inside(vertices, triangles, spacing, x_min, y_min)
    return Seeds(x, float(np.hypot(vertices[:, 0], vertices[:, 1]).max()), float(vertices[:, 2].max()))


def scattered(seeds: Seeds, spacing: float, share: float, realisation: int) -> Seeds:
    """Move each point at random, evenly within `share` [-] of its `spacing` [m] along each axis; none leaves the part
    of a cell that it stands for. The same `realisation` gives the same points.

    A collapse stretches the lattice sixfold near the axis of a tall column: its points then stand in stacks with empty
    cells between them, which random places do not (benchmarks/results/scatter_cpu.csv).
    """
    offset = np.random.default_rng(realisation).uniform(-0.5, 0.5, seeds.x.shape)
    return seeds._replace(x=seeds.x + share * spacing * offset)


def _column(column: Column, spacing: float) -> np.ndarray:
    count = int(np.ceil(column.radius / spacing))
    one_side = (np.arange(count) + 0.5) * spacing
    both = np.concatenate([-one_side[::-1], one_side])
    x = one_side if column.symmetry == "quarter" else both
    y = both if column.symmetry == "full" else one_side
    layers = round(column.height / spacing)
    points = _lattice(x, y, (np.arange(layers) + 0.5) * spacing)
    return points[points[:, 0] ** 2 + points[:, 1] ** 2 <= column.radius**2]


def _lattice(x, y, z) -> np.ndarray:
    return np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1).reshape(-1, 3)
