"""Abaqus input files: parts and their instances, blocks of nodes, and what is refused by name."""

import numpy as np
import pytest

from mpm.abaqus import read_abaqus
from mpm.errors import SceneError
from mpm.mesh_seed import enclosed_volume
from mpm.mesh_surface import read_closed_surface

# A block 2 x 1 x 1, one hexahedron.
NODES = ["1, 0, 0, 0", "2, 2, 0, 0", "3, 2, 1, 0", "4, 0, 1, 0", "5, 0, 0, 1", "6, 2, 0, 1", "7, 2, 1, 1", "8, 0, 1, 1"]
ELEMENT = "*Element, type=C3D8R\n1, 1, 2, 3, 4, 5, 6, 7, 8\n"
PART = "*Part, name=Block\n*Node\n" + "\n".join(NODES) + "\n" + ELEMENT + "*End Part\n"


def read(tmp_path, text):
    (tmp_path / "mesh.inp").write_text(text)
    return read_abaqus(tmp_path / "mesh.inp")


def instance(name, *lines):
    return f"*Instance, name={name}, part=Block\n" + "".join(line + "\n" for line in lines) + "*End Instance\n"


def box_of(points):
    return points.min(axis=0).round(9).tolist(), points.max(axis=0).round(9).tolist()


def test_instances_are_shifted_and_then_turned(tmp_path):
    """By 90 degrees about the vertical through (10, 0): the block at x = 11 to 13, y = 0 to 1 comes to x = 9 to 10."""
    assembly = instance("a") + instance("b", "11., 0., 0.", "10., 0., 0., 10., 0., 5., 90.")
    points, cells = read(tmp_path, PART + "*Assembly, name=A\n" + assembly + "*End Assembly\n")
    assert box_of(points[:8]) == ([0, 0, 0], [2, 1, 1])
    assert box_of(points[8:]) == ([9, 1, 0], [10, 3, 1])
    assert [kind for kind, _ in cells] == ["hexahedron"] * 2
    np.testing.assert_array_equal(np.sort(np.concatenate([block for _, block in cells]).ravel()), np.arange(16))


def test_a_part_that_is_not_instanced_is_left_out_and_without_instances_all_count(tmp_path):
    other = PART.replace("Block", "Other")
    assert len(read(tmp_path, PART + other + instance("a"))[0]) == 8
    assert len(read(tmp_path, PART + other)[0]) == 16


def test_nodes_in_several_blocks_belong_together(tmp_path):
    text = "*NODE, NSET=LOW\n" + "\n".join(NODES[:4]) + "\n** above\n*Node\n" + "\n".join(NODES[4:]) + "\n" + ELEMENT
    (tmp_path / "flat.inp").write_text(text)
    assert enclosed_volume(*read_closed_surface(tmp_path / "flat.inp"), 0.1) == pytest.approx(2.0, rel=1e-14)


def test_elements_over_two_lines_keywords_over_two_lines_and_line_elements(tmp_path):
    text = (
        "*Node\n"
        + "\n".join(NODES)
        + "\n*ELEMENT,\nTYPE = c3d8\n1, 1, 2, 3, 4,\n5, 6, 7, 8\n*Element, type=T3D2\n2, 1, 2\n"
    )
    points, cells = read(tmp_path, text)
    assert len(points) == 8 and [(kind, block.tolist()) for kind, block in cells] == [("hexahedron", [list(range(8))])]


@pytest.mark.parametrize(
    ("name", "kind", "corners"),
    [
        ("C3D4", "tetra", 4),
        ("C3D4H", "tetra", 4),
        ("C3D5", "pyramid", 5),
        ("C3D6", "wedge", 6),
        ("DC3D8", "hexahedron", 8),
        ("SC8R", "hexahedron", 8),
        ("S3R", "triangle", 3),
        ("STRI3", "triangle", 3),
        ("CPS3", "triangle", 3),
        ("S4R5", "quad", 4),
        ("R3D4", "quad", 4),
        ("SFM3D3", "triangle", 3),
    ],
)
def test_elements_are_known_by_their_family_and_number_of_nodes(tmp_path, name, kind, corners):
    numbers = ", ".join(str(k + 1) for k in range(corners))
    _, cells = read(tmp_path, "*Node\n" + "\n".join(NODES) + f"\n*Element, type={name}\n1, {numbers}\n")
    assert [(kind, block.shape) for kind, block in cells] == [(kind, (1, corners))]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (PART + "*Include, input=more.inp\n", r"\*INCLUDE is not read"),
        (PART.replace("*Element", "*System\n0,0,0\n*Element"), r"\*SYSTEM is not read"),
        (PART.replace("*Node\n", "*Node, system=C\n"), r"\*NODE with INPUT or SYSTEM"),
        (PART + "*Ngen\n1, 8\n", r"\*NGEN is not read"),
        (PART + "*Instance, library=old, instance=a\n*End Instance\n", "without a part of this file"),
        (PART + instance("a", "*Node", *NODES), "an instance with nodes of its own"),
        (PART + instance("a").replace("part=Block", "part=Base"), "part BASE, which the file does not have"),
        (PART + instance("a", "0., 0., 0.", "1., 2., 3., 90."), "two points of its axis and an angle"),
        (PART + instance("a", "here"), "no list of numbers"),
        (PART.replace("C3D8R", "C3D20R"), "elements C3D20R are not read"),
        (PART.replace("C3D8R", "C3D4"), "does not have the nodes of its type"),
        (PART.replace("7, 8\n", "7, 9\n"), "refers to a node that its part does not have"),
        (PART.replace("2, 2, 0, 0", "2, two, 0, 0"), r"\*NODE line is no list of numbers: 2, two"),
    ],
)
def test_what_is_not_read_is_refused_by_name(tmp_path, text, reason):
    with pytest.raises(SceneError, match=reason):
        read(tmp_path, text)
