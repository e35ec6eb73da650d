"""STL and OBJ files -> points and polygons; texture, normals, groups, names and materials are passed over."""

import re

import numpy as np

from mpm.errors import SceneError

STL_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
STL_HEADER = 84  # bytes before the triangles of a binary STL: a name and their number


def read_stl(data):
    """Points (n, 3) in the file's unit and cells of an STL file's bytes, binary or ASCII in any case and spacing.

    Raises SceneError for a file that is neither, or ends before its triangles do.
    """
    count = int.from_bytes(data[80:84], "little")
    length = STL_HEADER + STL_TRIANGLE.itemsize * count
    lower = data.lower()
    if len(data) != length and lower.lstrip().startswith(b"solid") and b"facet" in lower:
        return _cells_of(_ascii_corners(lower))
    if len(data) < length and b"\0" in data:
        raise SceneError(
            f"the file is cut short: it has {len(data):,} bytes, and {length:,} would hold its {count:,} triangles; "
            "export it again"
        )
    if len(data) < length:
        raise SceneError("it is no STL file")
    return _cells_of(np.frombuffer(data, STL_TRIANGLE, count, STL_HEADER)["corners"].astype(float))


def read_obj(text):
    """Points (n, 3) in the file's unit and cells of an OBJ file's text; a polygon is split into triangles.

    Raises SceneError where a vertex or face has no numbers.
    """
    points, polygons = [], {}
    for line in text.replace("\\\r\n", " ").replace("\\\n", " ").splitlines():
        key, *words = line.split() or [""]
        try:
            if key == "v":
                x, y, z = words[:3]
                points.append((float(x), float(y), float(z)))
            elif key == "f":
                corners = [int(word.partition("/")[0]) for word in words]
                # Counted from 1, or backwards from the vertex before this line.
                corners = [corner - 1 if corner > 0 else len(points) + corner for corner in corners]
                polygons.setdefault(len(corners), []).append(corners)
        except ValueError:
            raise SceneError(f"not a line of an OBJ file: {line.strip()[:60]}") from None
    cells = [("triangle", fan(np.array(corners))) for count, corners in polygons.items() if count > 2]
    return np.array(points).reshape(-1, 3), cells


def fan(polygons):
    """Triangles (m (k - 2), 3) of polygons (m, k) with k corners, all from the first corner.

    Where a polygon has a notch some lie over it, as often in one winding as in the other: the winding number is right.
    """
    first, second, third = polygons[:, :1], polygons[:, 1:-1], polygons[:, 2:]
    return np.stack([np.broadcast_to(first, second.shape), second, third], axis=-1).reshape(-1, 3)


def _ascii_corners(lower):
    if b"endsolid" not in lower[-1000:]:
        raise SceneError("the file is cut short: its last line is not `endsolid`; export it again")
    try:
        found = re.findall(rb"vertex\s+(\S+)\s+(\S+)\s+(\S+)", lower)
        return np.array(found, dtype=float).reshape(-1, 3, 3)
    except ValueError:
        raise SceneError("the file is damaged: a facet does not have three vertices of three numbers") from None


def _cells_of(corners):
    """Points and cells of triangles (m, 3, 3) that share no vertices."""
    return corners.reshape(-1, 3), [("triangle", np.arange(3 * len(corners)).reshape(-1, 3))]
