"""Files that other programs write: what is read of them, and what is said of those that are not."""

from pathlib import Path

import meshio
import numpy as np
import pytest

from mpm.errors import SceneError
from mpm.mesh_file import read_cells
from mpm.mesh_seed import enclosed_volume
from mpm.mesh_surface import read_closed_surface
from mpm.scene import Mesh
from mpm.seed import seed

CASES = Path(__file__).parent / "cases"
CELL = 0.25


def points_in(path, **keys):
    return seed(Mesh(shape="mesh", file=str(path), **keys), CELL).x


def volume_of(path):
    return enclosed_volume(*read_closed_surface(path), CELL / 2)


@pytest.mark.parametrize("name", ["uv14.obj", "rel.obj", "upper.stl"])
def test_box_of_2_m3_is_read_whatever_its_format_adds(name):
    """Texture coordinates and normals; indices from the end; capitals."""
    assert volume_of(CASES / name) == pytest.approx(2.0, rel=1e-12)
    assert len(points_in(CASES / name)) == 1024


def test_parts_of_an_abaqus_file_keep_their_own_nodes():
    assert volume_of(CASES / "two_parts.inp") == pytest.approx(2.5, rel=1e-12)
    assert len(points_in(CASES / "two_parts.inp")) == 1280


def test_block_above_the_floor_is_refused_by_how_much_and_allowed_where_it_is_asked_for():
    with pytest.raises(
        SceneError, match=r"does not stand on z = 0: its lowest point lies 1 m above it; geometry\.offset"
    ):
        points_in(CASES / "raised.stl")
    assert len(points_in(CASES / "raised.stl", base="as_is")) == 1024


def test_stl_that_ends_before_its_triangles_do_is_said_to_be_cut_short(tmp_path):
    with pytest.raises(SceneError, match="cut short: it has 534 bytes, and 684 would hold its 12 triangles"):
        points_in(CASES / "truncated.stl")
    text = (CASES / "upper.stl").read_text()
    (tmp_path / "ascii.stl").write_text(text[: len(text) // 2])
    with pytest.raises(SceneError, match="cut short: its last line is not `endsolid`"):
        points_in(tmp_path / "ascii.stl")


def test_med_of_gmsh_gives_its_tetrahedra():
    """A cylinder of radius 1 m and height 0.5 m in 487 tetrahedra: a little less than pi/2 m3."""
    points, blocks = read_cells(CASES / "tetrahedra.med")
    assert points.shape == (170, 3)
    assert {kind: len(cells) for kind, cells in blocks} == {"tetra": 487, "triangle": 306}
    corners = points[dict(blocks)["tetra"]]
    volumes = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6
    assert volume_of(CASES / "tetrahedra.med") == pytest.approx(np.abs(volumes).sum(), rel=1e-12)
    assert volume_of(CASES / "tetrahedra.med") == pytest.approx(np.pi / 2, rel=0.02)


PENTAGON = [(0, 0), (1, 0), (1.5, 1), (0.5, 2), (-0.5, 1)]  # 2.5 m2


def test_obj_with_n_gons_groups_names_in_another_encoding_and_a_broken_line(tmp_path):
    vertices = [f"v {x} {y} {z}" for z in (0, 1) for x, y in PENTAGON]
    faces = ["f 5 4 3 2 1", "g top", "usemtl b", "f 6 7 8 9 10", "s 1", "f 1//1 2//1 7//1 6//1", "f 2 3 \\", " 8 7"]
    faces += ["f -8/1 -7/1 -2/1 -3/1", "f 4 5 10 9", "f 5 1 6 10", "l 1 2"]
    text = "\r\n".join(["o Böschung", "mtllib missing.mtl", *vertices, "vt 0 0", "vn 0 -1 0", *faces])
    (tmp_path / "body.obj").write_bytes(text.encode("latin-1"))
    assert volume_of(tmp_path / "body.obj") == pytest.approx(2.5, rel=1e-12)


def test_n_gon_with_a_notch_keeps_it(tmp_path):
    """A fan from a corner covers the notch twice, in both windings."""
    outline = [(0, 0), (2, 0), (2, 2), (1, 0.5), (0, 2)]
    vertices = [f"v {x} {y} {z}" for z in (0, 1) for x, y in outline]
    sides = [f"f {k + 1} {(k + 1) % 5 + 1} {(k + 1) % 5 + 6} {k + 6}" for k in range(5)]
    (tmp_path / "notch.obj").write_text("\n".join([*vertices, "f 5 4 3 2 1", "f 6 7 8 9 10", *sides]))
    assert volume_of(tmp_path / "notch.obj") == pytest.approx(2.5, rel=1e-12)
    x = points_in(tmp_path / "notch.obj")
    assert not (x[:, 1] > np.interp(x[:, 0], [0, 1, 2], [2, 0.5, 2])).any()


@pytest.mark.parametrize("indent", ["", "\t", "      "])
def test_ascii_stl_in_any_spacing(tmp_path, indent):
    words = (CASES / "upper.stl").read_text().lower().split("\n")
    lines = [indent + "   ".join(line.split()) for line in words if line.strip()]
    (tmp_path / "spaced.STL").write_text("\r\n\r\n".join(lines))
    assert volume_of(tmp_path / "spaced.STL") == pytest.approx(2.0, rel=1e-12)


def test_ascii_stl_with_a_name_in_another_encoding(tmp_path):
    data = (CASES / "upper.stl").read_bytes().replace(b"SOLID PART", "SOLID Böschung".encode("latin-1"), 1)
    (tmp_path / "named.stl").write_bytes(data)
    assert volume_of(tmp_path / "named.stl") == pytest.approx(2.0, rel=1e-12)


def test_several_solids_of_one_file_are_all_read(tmp_path):
    text = (CASES / "upper.stl").read_text()
    (tmp_path / "two.stl").write_text(text + text.replace(" 1.000000E+00", " 3.000000E+00").replace("-1.0", " 2.0"))
    assert volume_of(tmp_path / "two.stl") == pytest.approx(2.0 + 0.5, rel=1e-12)
    lines = (CASES / "rel.obj").read_text().splitlines()
    vertices, faces = ([line for line in lines if line.startswith(key)] for key in ("v ", "f "))
    moved = [line.replace(" 1.0", " 3.0").replace("-1.0", "2.0") for line in vertices]
    text = "\n".join(["o a", "usemtl x", *vertices, *faces, "o b", "usemtl y", *moved, *faces])
    (tmp_path / "two.obj").write_text(text)
    assert volume_of(tmp_path / "two.obj") == pytest.approx(2.0 + 0.5, rel=1e-12)


def test_ply_of_polygons(tmp_path):
    header = "ply\nformat ascii 1.0\nelement vertex 10\nproperty float x\nproperty float y\nproperty float z\n"
    header += "element face 7\nproperty list uchar int vertex_indices\nend_header\n"
    vertices = [f"{x} {y} {z}" for z in (0, 1) for x, y in PENTAGON]
    sides = [f"4 {k} {(k + 1) % 5} {(k + 1) % 5 + 5} {k + 5}" for k in range(5)]
    (tmp_path / "body.ply").write_text(header + "\n".join([*vertices, "5 4 3 2 1 0", "5 5 6 7 8 9", *sides]) + "\n")
    assert volume_of(tmp_path / "body.ply") == pytest.approx(2.5, rel=1e-12)


VTU = """<VTKFile type="UnstructuredGrid" version="0.1" byte_order="LittleEndian"><UnstructuredGrid>
<Piece NumberOfPoints="8" NumberOfCells="1"><Points><DataArray type="Float64" NumberOfComponents="3" format="ascii">
0 0 0 1 0 0 0 1 0 1 1 0 0 0 1 1 0 1 0 1 1 1 1 1</DataArray></Points><Cells>
<DataArray type="Int64" Name="connectivity" format="ascii">0 1 2 3 4 5 6 7</DataArray>
<DataArray type="Int64" Name="offsets" format="ascii">8</DataArray>
<DataArray type="UInt8" Name="types" format="ascii">11</DataArray></Cells></Piece></UnstructuredGrid></VTKFile>"""


VTK = """# vtk DataFile Version 3.0
sand
ASCII
DATASET UNSTRUCTURED_GRID
POINTS 8 float
0 0 0 1 0 0 0 1 0 1 1 0 0 0 1 1 0 1 0 1 1 1 1 1
CELLS 1 9
8 0 1 2 3 4 5 6 7
CELL_TYPES 1
11
"""


def test_voxel_cells_are_refused_with_the_remedy(tmp_path):
    (tmp_path / "voxel.vtk").write_text(VTK)
    with pytest.raises(SceneError, match=r"voxel cells are not read: in ParaView use Extract Surface.*work: STL"):
        read_cells(tmp_path / "voxel.vtk")
    (tmp_path / "voxel.vtu").write_text(VTU)
    with pytest.raises(
        SceneError, match=r"voxel or polyhedral cells are not read: in ParaView use Tetrahedralize.*work: STL"
    ):
        read_cells(tmp_path / "voxel.vtu")


def test_hexahedra_of_the_same_file_are_read(tmp_path):
    text = VTU.replace("0 1 2 3 4 5 6 7<", "0 1 3 2 4 5 7 6<").replace(">11<", ">12<")
    (tmp_path / "hexahedron.vtu").write_text(text)
    assert volume_of(tmp_path / "hexahedron.vtu") == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize("suffix", ["vtu", "vtk", "msh", "med", "stl", "obj", "ply", "off", "inp"])
def test_formats_that_are_said_to_work_do(tmp_path, suffix):
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
    faces = [("triangle", np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]))]
    cells = faces if suffix in ("stl", "obj", "ply", "off") else [("tetra", np.array([[0, 1, 2, 3]]))]
    file_format = {"msh": "gmsh", "inp": "abaqus"}.get(suffix, suffix)
    meshio.Mesh(points, cells).write(tmp_path / f"body.{suffix}", file_format=file_format)
    assert volume_of(tmp_path / f"body.{suffix}") == pytest.approx(1 / 6, rel=1e-6)
