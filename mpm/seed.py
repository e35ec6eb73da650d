"""Geometry of a scene -> positions of its material points on a regular lattice of half a cell."""

from typing import NamedTuple

import numpy as np

from mpm.errors import SceneError
from mpm.fit import MOST_OFF, Fit, fit_of
from mpm.mesh_seed import enclosed_volume, footprint_centre, overlap_volume, seed_inside, without_mirror_image
from mpm.mesh_surface import read_closed_surface, shells
from mpm.scene import Box, Column, Mesh

METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001}
SHARE = {"full": 1.0, "half": 0.5, "quarter": 0.25}  # of the body that is computed
ON_FLOOR = 0.01  # cells between the body's lowest point and z = 0 that still count as standing on it
MOST_ALONE = 0.02  # share of a symmetric body that may have no mirror image: flat facets do not meet their images
MOST_PARTS = 100  # parts that are looked at one by one, to say why a body is not filled
MOST_TRIED = 1e7  # lattice cells of the finest lattice that is tried for a remedy


class Seeds(NamedTuple):
    """Point centres `x` (n, 3) [m], in order of x, then y, then z (z fastest); the body's initial `reference`
    radius (box: its length along x) and `height` [m].

    `axis` (x, y) [m]: where the vertical axis stands that run-out is measured about; a mesh body's own is the centroid
    of its projection onto z = 0, on the planes of symmetry where it has them. `fit`: a mesh's points held against it.
    """

    x: np.ndarray
    reference: float
    height: float
    axis: tuple[float, float] = (0.0, 0.0)
    fit: Fit | None = None


def seed(geometry: Column | Box | Mesh, cell: float) -> Seeds:
    """Fill a geometry with points half a cell apart.

    A column keeps the centres with x^2 + y^2 <= r0^2, which gives Table 1's counts. Raises SceneError when a
    mesh cannot be read, is open, does not stand on z = 0, is not as symmetric as it is said to be, or is not filled.
    """
    spacing = 0.5 * cell
    if isinstance(geometry, Column):
        return Seeds(_column(geometry, spacing), geometry.radius, geometry.height)
    if isinstance(geometry, Box):
        axes = [(np.arange(round(length / spacing)) + 0.5) * spacing for length in geometry.size]
        return Seeds(_lattice(*axes), geometry.size[0], geometry.size[2])
    return _mesh(geometry, cell)


def _mesh(mesh: Mesh, cell: float) -> Seeds:
    """Points of a mesh body, held against it; every problem is a SceneError that names the file."""
    try:
        vertices, triangles = read_closed_surface(mesh.file)
    except SceneError as error:  # starts with the file's path
        raise SceneError([f"geometry.file = {problem}" for problem in error.problems]) from None
    vertices = vertices * METRES[mesh.unit] + mesh.offset
    planes = (0.0 if mesh.symmetry == "quarter" else -np.inf, 0.0 if mesh.symmetry != "full" else -np.inf)
    spacing = 0.5 * cell
    try:
        _require_on_floor(mesh, vertices, cell)
        x = seed_inside(vertices, triangles, spacing, *planes)
        _require_symmetric(mesh, vertices, triangles, spacing)
        enclosed = enclosed_volume(vertices, triangles, spacing) * SHARE[mesh.symmetry]
        fit = fit_of(vertices, x, spacing, enclosed, overlap_volume(vertices, triangles, spacing), planes)
        if abs(fit.off) > MOST_OFF:
            raise SceneError(_why_off(fit, vertices, triangles, cell, planes))
        axis = footprint_centre(vertices, triangles, spacing)
    except SceneError as error:
        raise SceneError([f"geometry.file = {mesh.file}: {problem}" for problem in error.problems]) from None
    axis[np.isfinite(planes)] = 0.0
    radius = np.linalg.norm(vertices[:, :2] - axis, axis=1).max()
    return Seeds(x, float(radius), float(vertices[:, 2].max()), (float(axis[0]), float(axis[1])), fit)


def _require_on_floor(mesh, vertices, cell):
    lowest = vertices[:, 2].min()
    above = lowest > ON_FLOOR * cell and mesh.base == "floor"
    if not above and lowest > -ON_FLOOR * cell:
        return
    shift = [round(float(value), 9) for value in np.array(mesh.offset) - [0.0, 0.0, lowest]]
    wanted = ", or geometry.base = 'as_is' if it is meant to fall" if above else ""
    raise SceneError(
        f"the body does not stand on z = 0: its lowest point lies {abs(lowest):.4g} m {'above' if above else 'below'} "
        f"it; geometry.offset = {shift} [m] puts it there{wanted}"
    )


def _require_symmetric(mesh, vertices, triangles, spacing):
    for axis, parts in (("x", ("quarter",)), ("y", ("quarter", "half"))):
        if mesh.symmetry not in parts:
            continue
        alone = without_mirror_image(vertices, triangles, spacing, "xy".index(axis))
        if alone > MOST_ALONE:
            raise SceneError(
                f"geometry.symmetry = '{mesh.symmetry}' needs a body symmetric about the plane {axis} = 0, and "
                f"{alone:.1%} of this one has no mirror image there ({MOST_ALONE:.0%} allowed); move it by "
                "geometry.offset or use geometry.symmetry = 'full'"
            )


def _why_off(fit, vertices, triangles, cell, planes):
    """Why the points do not fill the body: parts without any, and the cell that would do."""
    part = shells(triangles)
    parts = [triangles[part == number] for number in range(min(part.max() + 1, MOST_PARTS))]
    lost = sum(not _holds_points(vertices, its, cell, planes) for its in parts) if len(parts) > 1 else 0
    losses = f"; {lost} of {len(parts)} separate parts hold no point" if lost else ""
    remedy = "no smaller cell that was tried does better; look at the body in a mesh editor"
    for finer in (float(f"{cell / parts:.3g}") for parts in (1.5, 2, 3, 4, 6, 8)):
        if np.prod(np.ptp(vertices, axis=0) / (0.5 * finer) + 1.0) > MOST_TRIED:
            break
        filled = len(seed_inside(vertices, triangles, 0.5 * finer, *planes)) * (0.5 * finer) ** 3
        if abs(filled / fit.enclosed - 1.0) <= MOST_OFF:
            remedy = f"grid.cell = {finer:g} [m] would do"
            break
    return (
        f"the points fill {fit.seeded:.4g} m3 and the mesh encloses {fit.enclosed:.4g} m3, {fit.off:+.1%} "
        f"({MOST_OFF:.0%} allowed): grid.cell = {cell:g} is too coarse for it{losses}; {remedy}"
    )


def _holds_points(vertices, triangles, cell, planes):
    try:
        return len(seed_inside(vertices, triangles, 0.5 * cell, *planes)) > 0
    except SceneError:
        return False


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
