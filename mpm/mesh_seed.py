"""Lattice points inside a body given as a mesh file: the reader, the inside test and the body's volume."""

import io
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import numpy as np

from mpm.errors import SceneError

# Every face is kept as four corners, a triangle repeating its last one: one table serves all cells.
CELL_FACES = {
    "tetra": [(0, 1, 2, 2), (0, 1, 3, 3), (1, 2, 3, 3), (2, 0, 3, 3)],
    "pyramid": [(0, 1, 2, 3), (0, 1, 4, 4), (1, 2, 4, 4), (2, 3, 4, 4), (3, 0, 4, 4)],
    "wedge": [(0, 1, 2, 2), (3, 4, 5, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)],
    "hexahedron": [(0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)],
}
SURFACE_FACES = {"triangle": [(0, 1, 2, 2)], "quad": [(0, 1, 2, 3)]}

# Vertices closer than this share of the bounding box's diagonal are one vertex. STL holds single
# precision (6e-8), and CAD exporters round the two sides of a seam separately.
MERGE_TOLERANCE = 1e-6

# The inside test looks this share of a spacing beyond each lattice centre (x, y, z), so that a face
# meant to pass through centres is not decided point by point by round-off: a centre on the surface
# belongs to the body that lies on its greater-coordinate side. The three differ, by ratios that are not
# simple, so that the centres of a sloping face such as z = x or z = 2 y are moved off it too.
LATTICE_SHIFT = np.array([1.0e-4, 1.37e-4, 1.73e-4])

# Lattice cells in a body's bounding box: a mesh in millimetres exceeds this, and would exhaust memory.
MAX_CELLS = 1e9


def read_closed_surface(path):
    """Read a body's closed surface from any mesh format that meshio knows.

    Volume cells (tetra, pyramid, wedge, hexahedron) give their outer boundary, wound outwards, and
    surface cells in the same file are then ignored. A file with triangles and quads only must be closed
    once coincident vertices are merged, and keeps the winding of the file.

    Returns `vertices`, float64 (n, 3) [m], and `triangles`, int64 (m, 3), indices into `vertices`.

    Raises `SceneError` for a missing, unreadable or unsupported file, for other cell types (higher
    order, polygons, polyhedra), for volume cells that overlap, and for a surface that is not closed.
    """
    mesh = _read_mesh(path)
    solid = _cells_in(path, mesh, CELL_FACES)
    surface = _cells_in(path, mesh, SURFACE_FACES)
    if not solid and not surface:
        raise SceneError(f"{path}: the mesh has no triangles, quads or volume cells")

    faces = _faces_of(solid, CELL_FACES) if solid else _faces_of(surface, SURFACE_FACES)
    points = np.asarray(mesh.points, dtype=np.float64)
    _require_sound_vertices(path, points, faces)
    vertices, merged = _merge_coincident(points, faces)
    if solid:
        merged = _outer_faces(path, vertices, merged, _centroid_of_each_face(points, solid))
    triangles = _triangulate(merged)
    if not solid:
        _require_closed(path, triangles)
    return _drop_unused(vertices, triangles)


def seed_inside(vertices, triangles, spacing, x_min=-np.inf, y_min=-np.inf):
    """Centres of the lattice cells of edge `spacing` [m] that lie inside a closed surface.

    The lattice is (i + 1/2, j + 1/2, k + 1/2) * spacing for all integers i, j, k; centres with
    x <= x_min or y <= y_min [m] are left out (symmetry planes). `vertices` is float (n, 3) [m],
    `triangles` int (m, 3), in any winding.

    Returns float64 (p, 3) [m], ordered by x, then y, then z.

    The surface is cut by the lattice's planes x = const into segments, the segments by its lines
    y = const into crossings, and the points between the 1st and 2nd, 3rd and 4th, ... crossing of a line
    are inside. Every cut is half-open (an edge from a to b is cut at a <= c < b) and neighbouring
    triangles compute the same point on their common edge bit by bit, so no line can slip between them.
    For centres on the surface see `LATTICE_SHIFT`.

    Raises `SceneError` if no centre is inside, if the bounding box holds more than `MAX_CELLS` lattice
    cells, or if the surface is seen to be open.
    """
    vertices = np.asarray(vertices, dtype=np.float64)
    # In these units lattice centres are the integers, and the first at or after `a` is ceil(a).
    scaled = vertices / spacing - 0.5 - LATTICE_SHIFT
    cells = np.prod(np.maximum(np.ptp(scaled, axis=0), 1.0))
    if cells > MAX_CELLS:
        raise SceneError(
            f"the mesh's bounding box, {_bounding_box(vertices)}, holds {cells:.1g} lattice cells of spacing "
            f"{spacing:g} m, more than {MAX_CELLS:g}; is the mesh in metres?"
        )

    i, start, end = _cut_triangles(scaled[triangles])
    kept = (i + 0.5) * spacing > x_min
    i, start, end = i[kept], start[kept], end[kept]

    segment, j = _integers_between(start[:, 0], end[:, 0])
    kept = (j + 0.5) * spacing > y_min
    segment, j = segment[kept], j[kept]
    z = _cut_edges(start[segment], end[segment], j)[:, 0]
    i = i[segment]

    order = np.lexsort((z, j, i))
    i, j, z = i[order], j[order], z[order]
    if len(z) % 2 or (i[::2] != i[1::2]).any() or (j[::2] != j[1::2]).any():
        raise SceneError("the mesh's surface is not closed: a vertical line enters it without leaving")

    line, k = _integers_between(z[::2], z[1::2])
    if len(k) == 0:
        raise SceneError(
            f"no point of the lattice with spacing {spacing:g} m falls inside the mesh, whose bounding box "
            f"is {_bounding_box(vertices)} (kept: x > {x_min:g}, y > {y_min:g}); "
            "is the mesh in metres and in the right place?"
        )
    return (np.column_stack([i[::2][line], j[::2][line], k]) + 0.5) * spacing


def enclosed_volume(vertices, triangles):
    """Volume [m^3] inside a closed surface, by the divergence theorem; inward or outward winding alike.

    `vertices` is float (n, 3) [m], `triangles` int (m, 3), with each vertex listed once.

    Raises `SceneError` if neighbouring triangles are wound against each other (the sum would be wrong).
    """
    _, imbalance = _edge_use(triangles)
    if imbalance.any():
        raise SceneError(
            f"the mesh's triangles are not wound one way: {np.count_nonzero(imbalance)} edges disagree; "
            "make the normals consistent in a mesh editor"
        )
    # Measured from the body itself: far from the origin the terms would cancel and lose digits.
    a, b, c = np.moveaxis((vertices - np.mean(vertices, axis=0))[triangles], 1, 0)
    return abs(float(np.einsum("ij,ij->", a, np.cross(b, c)))) / 6.0


def _read_mesh(path):
    located = Path(path).absolute()
    if not located.is_file():
        raise SceneError(f"no mesh file at {located}")
    import meshio  # slow to import, and only scenes with a mesh need it

    printed = io.StringIO()
    try:
        with redirect_stdout(printed), redirect_stderr(printed):
            return meshio.read(located)
    except SystemExit:
        # meshio prints the reason and exits where a format's reader gives up.
        reason = printed.getvalue()
    except Exception as error:
        # Its readers let through whatever a damaged file provokes: ValueError, KeyError, struct.error...
        reason = f"{type(error).__name__}: {error}"
    raise SceneError(f"{located}: cannot be read as a mesh: {' '.join(reason.split())}")


def _cells_in(path, mesh, table):
    """Blocks (cell type, node indices) of the types in `table`; raises for a type that no table has."""
    blocks = [block for block in mesh.cells if len(block.data)]
    known = CELL_FACES.keys() | SURFACE_FACES.keys()
    skipped = ("vertex", "line")
    others = {b.type for b in blocks if b.type not in known and not b.type.startswith(skipped)}
    if others:
        raise SceneError(
            f"{path}: cell types not supported: {', '.join(sorted(others))}; "
            f"save the mesh with first-order cells ({', '.join(sorted(known))})"
        )
    return [(block.type, np.asarray(block.data, dtype=np.int64)) for block in blocks if block.type in table]


def _faces_of(blocks, table):
    """Faces (f, 4) of all cells, cell by cell."""
    return np.concatenate([cells[:, table[kind]].reshape(-1, 4) for kind, cells in blocks])


def _centroid_of_each_face(points, blocks):
    """For each face of `_faces_of`, the centroid of its cell: (f, 3)."""
    centroids = [points[cells].mean(axis=1).repeat(len(CELL_FACES[kind]), axis=0) for kind, cells in blocks]
    return np.concatenate(centroids)


def _require_sound_vertices(path, points, faces):
    if faces.min() < 0 or faces.max() >= len(points):
        raise SceneError(f"{path}: a cell refers to a vertex that the file does not have")
    if points.shape[1] != 3 or not np.isfinite(points).all():
        raise SceneError(f"{path}: every vertex must have three finite coordinates")


def _merge_coincident(points, faces):
    """Give coincident vertices one index: returns `points` and the renumbered `faces`.

    Groups are split where the sorted x have a gap above the tolerance, then within each group by y, then
    by z. Rounding to a grid instead would part two vertices that lie either side of a grid line.
    """
    used = points[np.unique(faces)]
    tolerance = MERGE_TOLERANCE * np.linalg.norm(np.ptp(used, axis=0))
    group = np.zeros(len(points), dtype=np.int64)
    for axis in range(3):
        order = np.lexsort((points[:, axis], group))
        gap = np.diff(points[order, axis]) > tolerance
        starts = gap | (np.diff(group[order]) != 0)
        group[order] = np.concatenate([[0], np.cumsum(starts)])
    _, first, group = np.unique(group, return_index=True, return_inverse=True)
    return points[first], group[faces]


def _outer_faces(path, vertices, faces, inner):
    """The faces that only one cell has, wound away from that cell's centroid `inner` (f, 3)."""
    keys = np.sort(faces, axis=1)
    # A repeated corner counts once, so that a collapsed quad matches its neighbour's triangle.
    keys[:, 1:][np.diff(keys, axis=1) == 0] = len(vertices)
    keys.sort(axis=1)
    areal = keys[:, 2] < len(vertices)
    faces, inner = faces[areal], inner[areal]
    _, first, count = np.unique(keys[areal], axis=0, return_index=True, return_counts=True)
    outer = np.sort(first[count == 1])
    if (count > 2).any() or len(outer) == 0:
        raise SceneError(f"{path}: volume cells overlap: a face may belong to two cells at most")

    faces, inner = faces[outer], inner[outer]
    a, b, c, d = np.moveaxis(vertices[faces], 1, 0)
    inward = np.einsum("ij,ij->i", np.cross(c - a, d - b), a - inner) < 0
    faces[inward] = faces[inward, ::-1]
    return faces


def _triangulate(faces):
    """Split four-cornered faces (f, 4) into triangles (m, 3), leaving out those without area."""
    triangles = faces[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)
    a, b, c = triangles.T
    return triangles[(a != b) & (b != c) & (c != a)]


def _drop_unused(vertices, triangles):
    used, triangles = np.unique(triangles, return_inverse=True)
    return vertices[used], triangles.reshape(-1, 3).astype(np.int64)


def _edge_use(triangles):
    """For each edge: how many triangles have it, and how many more walk it one way than the other."""
    edges = np.asarray(triangles)[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2).astype(np.int64)
    low, high = edges.min(axis=1), edges.max(axis=1)
    _, edge = np.unique(low * (high.max() + 1) + high, return_inverse=True)
    direction = np.where(edges[:, 0] == low, 1, -1)
    return np.bincount(edge), np.bincount(edge, weights=direction).astype(np.int64)


def _require_closed(path, triangles):
    if len(triangles) == 0:
        raise SceneError(f"{path}: every triangle of the mesh is collapsed to a line or a point")
    count, _ = _edge_use(triangles)
    single, crowded = np.count_nonzero(count == 1), np.count_nonzero(count > 2)
    if single or crowded:
        raise SceneError(
            f"{path}: the surface is not closed: of {len(count)} edges, {single} are open (one triangle "
            f"only) and {crowded} have more than two triangles; fill the holes and remove inner or doubled "
            "faces in a mesh editor, or give a volume mesh"
        )


def _integers_between(low, high):
    """All integers c with low <= c < high: for each, the index of its interval and c itself."""
    first = np.ceil(low).astype(np.int64)
    count = np.maximum(np.ceil(high).astype(np.int64) - first, 0)
    owner = np.repeat(np.arange(len(first)), count)
    step = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
    return owner, first[owner] + step


def _cut_edges(start, end, value):
    """Where edges (n, d) have first coordinate `value` (n,): their other coordinates, (n, d - 1)."""
    share = (value - start[:, 0]) / (end[:, 0] - start[:, 0])
    return start[:, 1:] + share[:, None] * (end[:, 1:] - start[:, 1:])


def _cut_triangles(corners):
    """Cut triangles (m, 3, 3) by the planes x = integer.

    Returns, a segment each: the integer, and the (y, z) of its ends, the one with the lesser y first.
    """
    corners = np.take_along_axis(corners, np.argsort(corners[:, :, :1], axis=1), axis=1)
    owner, i = _integers_between(corners[:, 0, 0], corners[:, 2, 0])
    low, middle, high = np.moveaxis(corners[owner], 1, 0)
    # The plane cuts low-high and one of low-middle, middle-high. Each edge runs towards greater x, in
    # every triangle that has it: that is what makes the common point the same bit by bit.
    beyond = (middle[:, 0] <= i)[:, None]
    one = _cut_edges(low, high, i)
    other = _cut_edges(np.where(beyond, middle, low), np.where(beyond, high, middle), i)
    swap = one[:, :1] > other[:, :1]
    return i, np.where(swap, other, one), np.where(swap, one, other)


def _bounding_box(vertices):
    low, high = (", ".join(f"{x:g}" for x in corner) for corner in (vertices.min(axis=0), vertices.max(axis=0)))
    return f"({low}) to ({high}) m"
