"""Mesh files -> points and cells, by the reader of each format; nothing else of the file is kept."""

import io
import re
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import h5py
import numpy as np

from mpm.abaqus import read_abaqus
from mpm.errors import SceneError
from mpm.surface_files import fan, read_obj, read_stl

# Every face is kept as four corners, a triangle repeating its last one: one table serves all cells.
CELL_FACES = {
    "tetra": [(0, 1, 2, 2), (0, 1, 3, 3), (1, 2, 3, 3), (2, 0, 3, 3)],
    "pyramid": [(0, 1, 2, 3), (0, 1, 4, 4), (1, 2, 4, 4), (2, 3, 4, 4), (3, 0, 4, 4)],
    "wedge": [(0, 1, 2, 2), (3, 4, 5, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)],
    "hexahedron": [(0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)],
}
SURFACE_FACES = {"triangle": [(0, 1, 2, 2)], "quad": [(0, 1, 2, 3)]}
FORMATS = (
    "formats that work: STL, OBJ, PLY and OFF for closed surfaces; VTU, VTK (unstructured grid), Gmsh MSH, MED and "
    "Abaqus INP for volume cells too"
)
# What a file of that kind may hold that is not read, and how to get round it.
NOT_READ = {
    ".vtu": "voxel or polyhedral cells are not read: in ParaView use Tetrahedralize, then save it as .vtu",
    ".vtk": "PolyData and voxel cells are not read: in ParaView use Extract Surface, Triangulate, and save it as .stl",
    ".vtp": "PolyData is not read: in ParaView use Extract Surface and Triangulate, then save it as .stl",
    ".off": "only triangles are read: triangulate it, or save it as .stl",
    ".msh": "save it from Gmsh as version 4.1 or 2.2",
}


def read_cells(path):
    """Read the geometry of a mesh file: `points`, float64 (n, 3) in the file's unit, and its cells by type.

    Cells are blocks (type, int64 (m, corners)) of the types in `CELL_FACES` and `SURFACE_FACES`; points and lines are
    left out. Polygons are split into triangles.

    Raises SceneError, which lists the formats that work, for a file that is missing, not of a known format, damaged,
    without faces, or with other cells (higher order, polyhedra).
    """
    located = Path(path).absolute()
    if not located.is_file():
        raise SceneError(f"{located}: there is no such file")
    suffix = located.suffix.lower()
    try:
        if suffix == ".stl":
            points, blocks = read_stl(located.read_bytes())
        elif suffix == ".obj":
            # Names in the file may be in any encoding, and are not used.
            points, blocks = read_obj(located.read_text(encoding="utf-8", errors="replace"))
        elif suffix == ".inp":
            points, blocks = read_abaqus(located)
        else:
            points, blocks = _by_meshio(located, suffix)
    except SceneError as error:
        raise SceneError(f"{located}: {error}; {FORMATS}") from None
    except OSError as error:
        raise SceneError(f"{located}: {error.strerror}") from None
    blocks = [(kind, np.asarray(cells, dtype=np.int64)) for kind, cells in blocks if len(cells)]
    blocks = [("triangle", fan(cells)) if kind.startswith("polygon") else (kind, cells) for kind, cells in blocks]
    known = CELL_FACES.keys() | SURFACE_FACES.keys()
    others = {kind for kind, _ in blocks if kind not in known and not kind.startswith(("vertex", "line"))}
    if others:
        raise SceneError(
            f"{located}: cell types not supported: {', '.join(sorted(others))}; "
            f"save the mesh with first-order cells ({', '.join(sorted(known))})"
        )
    blocks = [block for block in blocks if block[0] in known]
    if not blocks:
        raise SceneError(f"{located}: the mesh has no triangles, quads or volume cells; {FORMATS}")
    return np.asarray(points, dtype=np.float64), blocks


def _by_meshio(path, suffix):
    import meshio  # slow to import, and only scenes with a mesh need it

    if suffix == ".vtp" or suffix not in meshio.extension_to_filetypes:
        raise SceneError(NOT_READ.get(suffix, f"{suffix or path.name} is no mesh format that is read"))
    if suffix == ".med":
        mesh = _quietly(lambda: meshio.med.read(_med_without_groups(path)), suffix)
    else:
        mesh = _quietly(lambda: meshio.read(path), suffix)
    return mesh.points, [(block.type, block.data) for block in mesh.cells]


def _med_without_groups(path):
    """A MED file's mesh with an empty list of groups: meshio stops at groups that are written in another way."""
    copied = io.BytesIO()
    with h5py.File(path, "r") as file, h5py.File(copied, "w") as copy:
        file.copy("ENS_MAA", copy)
        for name in file["ENS_MAA"]:
            copy.create_group(f"FAS/{name}")
    return copied


def _quietly(read, suffix):
    """What `read` returns; SceneError in plain words for whatever it raises or exits with, and for cells left out."""
    printed = io.StringIO()
    try:
        with redirect_stdout(printed), redirect_stderr(printed):
            mesh = read()
        # meshio leaves out cells that it does not know and only prints their VTK type; poly-vertices and poly-lines
        # (2, 4) are no loss.
        if set(re.findall(r"\(type (\d+)\)", " ".join(printed.getvalue().split()))) - {"2", "4"}:
            raise SceneError(NOT_READ.get(suffix, "some of its cells are not read"))
        return mesh
    except SceneError:
        raise
    except (Exception, SystemExit):
        # A damaged file provokes nearly every kind of error, and meshio exits where one of its readers gives up.
        may_be = f"; {NOT_READ[suffix]}" if suffix in NOT_READ else ""
        raise SceneError(f"cannot be read as a mesh: damaged, cut short, or not {suffix}{may_be}") from None
