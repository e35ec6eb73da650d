"""The regular background grid: spacing, walls as node indices, and the extents of the paper's Table 1.

Node (i, j, k) sits at (i, j, k) h; the origin is a node, so walls at multiples of h are node planes.
"""

from dataclasses import dataclass

from mpm.scene import Box, Scene

# What a wall holds of a velocity or a displacement increment; a kind of wall is the sum of these.
NORMAL, TANGENTIAL = 1, 2
FREE, ROLLER, FIXED = 0, NORMAL, NORMAL + TANGENTIAL
KINDS = {"free": FREE, "roller": ROLLER, "fixed": FIXED}
NOWHERE = 2**30  # a wall index that no node reaches


@dataclass(frozen=True)
class Walls:
    """Planes x, y, z = const that carry a condition, as node indices per axis, with a kind per face.

    A condition holds on its wall's nodes and on every node beyond.
    """

    low: tuple[int, ...]
    high: tuple[int, ...]
    low_kind: tuple[int, ...]
    high_kind: tuple[int, ...]


def walls_of(scene: Scene) -> Walls:
    """Walls of a scene: a box's own; for columns and meshes a rough base and the planes of symmetry."""
    shape, cell = scene.geometry, scene.grid.cell
    if isinstance(shape, Box):
        kinds = {face: KINDS[kind] for face, kind in shape.walls.model_dump().items()}
        low_kind = tuple(kinds[f"{axis}_min"] for axis in "xyz")
        high_kind = tuple(kinds[f"{axis}_max"] for axis in "xyz")
        ends = tuple(round(length / cell) for length in shape.size)
    else:
        on_x = ROLLER if shape.symmetry == "quarter" else FREE
        on_y = ROLLER if shape.symmetry in ("quarter", "half") else FREE
        low_kind, high_kind, ends = (on_x, on_y, FIXED), (FREE, FREE, FREE), (0, 0, 0)
        if scene.grid.extent == "paper":
            side, top = round(4.0 * shape.height / cell), round(shape.height / cell)
            high_kind, ends = (ROLLER, ROLLER, FREE), (side, side, top)
    low = tuple(-NOWHERE if kind == FREE else 0 for kind in low_kind)
    high = tuple(NOWHERE if kind == FREE else end for kind, end in zip(high_kind, ends, strict=True))
    return Walls(low, high, low_kind, high_kind)


def paper_grid(radius_cells: int, aspect_ratio: float) -> tuple[int, int]:
    """Elements and nodes (n_el, n_no) of the paper's grid for a quarter column (Table 1).

    Two ghost cells surround x, y in [0, 4 h0] and z in [0, h0]; `radius_cells` = r0/h.
    """
    height = round(radius_cells * aspect_ratio)
    side, depth = 4 * height + 4, height + 4
    return side * side * depth, (side + 1) ** 2 * (depth + 1)
