"""Cells of a mesh file -> the closed surface of a body, wound so that the winding number is above 0 inside."""

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from mpm.errors import SceneError
from mpm.mesh_file import CELL_FACES, SURFACE_FACES, read_cells
from mpm.mesh_scan import cross, together

# Vertices closer than this share of the bounding box's diagonal are one vertex. STL holds single
# precision (6e-8), and CAD exporters round the two sides of a seam separately.
MERGE_TOLERANCE = 1e-6


def read_closed_surface(path):
    """Read a body's closed surface from a mesh file (see `mpm.mesh_file` for the formats).

    Volume cells (tetra, pyramid, wedge, hexahedron) give their outer boundary, wound outwards, and
    surface cells in the same file are then ignored. A file with triangles and quads only must be closed
    once coincident vertices are merged, and is wound by `wind_outwards`.

    Returns `vertices`, float64 (n, 3) in the file's unit, and `triangles`, int64 (m, 3), indices into `vertices`.

    Raises `SceneError` for a missing, unreadable or unsupported file, for other cell types (higher
    order, polyhedra), for volume cells that overlap, and for a surface that is not closed or has one side.
    """
    points, blocks = read_cells(path)
    solid = [block for block in blocks if block[0] in CELL_FACES]
    faces = _faces_of(solid, CELL_FACES) if solid else _faces_of(blocks, SURFACE_FACES)
    _require_sound_vertices(path, points, faces)
    vertices, merged = _merge_coincident(points, faces)
    if solid:
        merged = _outer_faces(path, vertices, merged, _centroid_of_each_face(points, solid))
    triangles = _triangulate(merged)
    if not solid:
        _require_closed(path, triangles)
        triangles = _wound(path, vertices, triangles)
    return _drop_unused(vertices, triangles)


def shells(triangles):
    """Number (m,) of the part that each triangle belongs to: those that share vertices are one."""
    used, corners = np.unique(triangles, return_inverse=True)
    corners = corners.reshape(-1, 3)
    ends = corners[:, [0, 1]], corners[:, [1, 2]]
    pairs = np.concatenate(ends)
    links = coo_matrix((np.ones(len(pairs)), tuple(pairs.T)), shape=(len(used), len(used)))
    return connected_components(links, directed=False)[1][corners[:, 0]]


def wind_outwards(vertices, triangles):
    """The triangles of a closed surface in one winding a shell, so that the winding number is above 0 inside.

    A shell is what hangs together by edges; each edge has two triangles. Every shell is wound outwards but cavities:
    a shell wholly inside another that the file winds the other way than the outermost shell around it. One that is
    wound the same way, or whose own triangles disagree, is united with what is around it.

    Raises SceneError for a surface with one side (a Klein bottle).
    """
    shell, flip = _consistent(triangles)
    a, b, c = np.moveaxis((vertices - np.mean(vertices, axis=0))[triangles], 1, 0)
    volume = np.bincount(shell, np.where(flip, -1.0, 1.0) * np.einsum("ij,ij->i", a, np.cross(b, c)))
    flip = flip ^ (volume < 0)[shell]
    flipped_share = np.bincount(shell, flip) / np.bincount(shell)
    outwards = np.where(flip[:, None], triangles[:, ::-1], triangles)
    cavity = _cavities(vertices, outwards, shell, np.abs(volume), np.where(flipped_share == 1.0, -1, 1))
    return np.where(cavity[shell][:, None], outwards[:, ::-1], outwards)


def _wound(path, vertices, triangles):
    try:
        return wind_outwards(vertices, triangles)
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from None


def _consistent(triangles):
    """The shell (m,) of each triangle, and which triangles (m,) to turn over so that each shell has one winding.

    Each triangle is two nodes of a graph, as it is and turned over; an edge links those of its triangles that are wound
    one way. A shell is then two components, one for each winding, and either will do.
    """
    count = len(triangles)
    edges = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    key = np.sort(edges, axis=1)
    order = np.lexsort((key[:, 1], key[:, 0]))
    first, second = order.reshape(-1, 2).T
    against = edges[first, 0] == edges[second, 0]  # wound one way, neighbours walk their edge in opposite senses
    first, second = first // 3, second // 3
    pairs = np.concatenate(
        [
            np.column_stack([first, second + count * against]),
            np.column_stack([first + count, second + count * ~against]),
        ]
    )
    links = coo_matrix((np.ones(len(pairs)), tuple(pairs.T)), shape=(2 * count, 2 * count))
    label = connected_components(links, directed=False)[1]
    as_is, turned = label[:count], label[count:]
    if np.any(as_is == turned):
        raise SceneError("the surface has one side only (like a Moebius strip) and encloses no body")
    return np.unique(np.minimum(as_is, turned), return_inverse=True)[1], as_is > turned


def _cavities(vertices, triangles, shell, volume, side):
    """Mask (s,) of the shells that are cavities; `triangles` are wound outwards, `side` (s,) is -1 where the file
    winds a shell inwards and `volume` (s,) is any measure of the shells' size."""
    cavity = np.zeros(len(side), dtype=bool)
    if np.all(side == side[0]):
        return cavity
    corners = vertices[triangles]
    low = np.full((len(side), 3), np.inf)
    high = -low
    np.minimum.at(low, shell, corners.min(axis=1))
    np.maximum.at(high, shell, corners.max(axis=1))
    for inner in range(len(side)):
        around = (low <= low[inner]).all(axis=1) & (high >= high[inner]).all(axis=1) & (volume > volume[inner])
        for outer in sorted(np.flatnonzero(around), key=lambda other: -volume[other]):
            if _is_inside(vertices, triangles[shell == inner], triangles[shell == outer]):
                cavity[inner] = side[inner] != side[outer]
                break
    return cavity


def _is_inside(vertices, inner, outer):
    """Whether shell `inner` lies wholly inside `outer`, as seen on 32 x 32 vertical lines through it."""
    corners = vertices[np.unique(inner), :2]
    low, high = corners.min(axis=0), corners.max(axis=0)
    spacing = (high - low).max() / 32
    within = cross(vertices, inner, spacing, low, high)
    _, of_inner, of_outer = together(within, cross(vertices, outer, spacing, low, high))
    return len(within.z) > 0 and bool(np.all(of_outer[of_inner > 0] > 0))


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


def _require_closed(path, triangles):
    if len(triangles) == 0:
        raise SceneError(f"{path}: every triangle of the mesh is collapsed to a line or a point")
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2).astype(np.int64), axis=1)
    _, count = np.unique(edges[:, 0] * (edges.max() + 1) + edges[:, 1], return_counts=True)
    single, crowded = np.count_nonzero(count == 1), np.count_nonzero(count > 2)
    if single or crowded:
        raise SceneError(
            f"{path}: the surface is not closed: of {len(count)} edges, {single} are open (one triangle "
            f"only) and {crowded} have more than two triangles; fill the holes and remove inner or doubled "
            "faces in a mesh editor, or give a volume mesh"
        )
