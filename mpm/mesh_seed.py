"""Lattice points inside a closed surface, and what the body measures: volume, footprint, mirror image.

A surface here is `vertices`, float (n, 3) [m], and `triangles`, int (m, 3), wound as `mpm.mesh_surface` gives it: the
winding number is above 0 inside. `spacing` [m] is that of the points; measures are integrated along vertical lines of a
finer lattice, exactly along each.
"""

import numpy as np

from mpm.errors import SceneError
from mpm.mesh_scan import cross, integers_between, spans, together

# Lattice cells in a body's bounding box: a mesh in millimetres exceeds this, and would exhaust memory.
MAX_CELLS = 1e9
FINE_LINES = 256**2  # vertical lines through the body's bounding box by which its measures are integrated


def seed_inside(vertices, triangles, spacing, x_min=-np.inf, y_min=-np.inf):
    """Centres of the lattice cells of edge `spacing` [m] that lie inside a closed surface (see `mpm.mesh_scan`).

    Centres with x <= x_min or y <= y_min [m] are left out (symmetry planes). Returns float64 (p, 3) [m], ordered by x,
    then y, then z.

    Raises SceneError if no centre is inside, if the bounding box holds more than `MAX_CELLS` lattice cells, or if the
    surface is seen to be open.
    """
    cells = np.prod(np.maximum(np.ptp(vertices, axis=0) / spacing, 1.0))
    if cells > MAX_CELLS:
        raise SceneError(
            f"the mesh's bounding box, {_bounding_box(vertices)}, holds {cells:.1g} lattice cells of spacing "
            f"{spacing:g} m, more than {MAX_CELLS:g}; is the mesh in metres? (geometry.unit = 'mm' reads millimetres)"
        )
    i, j, low, high = spans(cross(vertices, triangles, spacing, low=(x_min, y_min)))
    line, k = integers_between(low, high)
    if len(k) == 0:
        raise SceneError(
            f"no point of the lattice with spacing {spacing:g} m falls inside the mesh, whose bounding box "
            f"is {_bounding_box(vertices)} (kept: x > {x_min:g}, y > {y_min:g}); "
            "is grid.cell small enough, the mesh in metres (geometry.unit) and in the right place (geometry.offset)?"
        )
    return (np.column_stack([i[line], j[line], k]) + 0.5) * spacing


def enclosed_volume(vertices, triangles, spacing):
    """Volume [m3] inside a closed surface: the sum of its shells' (divergence theorem) less what overlaps."""
    # Measured from the body itself: far from the origin the terms would cancel and lose digits.
    a, b, c = np.moveaxis((vertices - np.mean(vertices, axis=0))[triangles], 1, 0)
    volume = float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6.0
    return volume - overlap_volume(vertices, triangles, spacing)


def overlap_volume(vertices, triangles, spacing):
    """Volume [m3] that the sum of the shells' volumes counts too much, from fine vertical lines; 0 where no two
    shells overlap."""
    spacing = _fine_spacing(vertices, spacing)
    found = cross(vertices, triangles, spacing)
    winding = np.cumsum(found.sign)
    return float((winding - (winding > 0)) @ found.gaps()) * spacing**3


def footprint_centre(vertices, triangles, spacing):
    """Centroid (x, y) [m] of the body's projection onto z = 0, from fine vertical lines."""
    spacing = _fine_spacing(vertices, spacing)
    i, j, _, _ = spans(cross(vertices, triangles, spacing))
    lines = np.unique(np.column_stack([i, j]), axis=0)
    return (lines.mean(axis=0) + 0.5) * spacing


def without_mirror_image(vertices, triangles, spacing, axis):
    """Share [-] of the body whose mirror image in the plane x = 0 (`axis` 0) or y = 0 (1) lies outside it."""
    spacing = _fine_spacing(vertices, spacing)
    mirrored = np.array(vertices)
    mirrored[:, axis] *= -1.0
    body = cross(vertices, triangles, spacing)
    image = cross(mirrored, np.asarray(triangles)[:, ::-1], spacing)
    both, of_body, of_image = together(body, image)
    inside, alone = of_body > 0, (of_body > 0) & (of_image <= 0)
    return float(alone @ both.gaps() / (inside @ both.gaps()))


def _fine_spacing(vertices, spacing):
    """Spacing [m] of a lattice that has `FINE_LINES` vertical lines or more through the bounding box.

    It is an odd part of the points' `spacing` [m], so that their lines are among its lines: what holds points is seen.
    """
    x, y, _ = np.ptp(vertices, axis=0)
    parts = int(np.ceil(spacing / np.sqrt(max(x * y, 1e-6 * max(x, y) ** 2) / FINE_LINES)))
    return spacing / (parts + 1 - parts % 2)


def _bounding_box(vertices):
    low, high = (", ".join(f"{x:g}" for x in corner) for corner in (vertices.min(axis=0), vertices.max(axis=0)))
    return f"({low}) to ({high}) m"
