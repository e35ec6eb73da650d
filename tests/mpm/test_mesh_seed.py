"""Mesh bodies: what the reader accepts, which lattice points are inside, and the enclosed volume."""

import re
import subprocess
import sys
from itertools import pairwise, product
from pathlib import Path

import meshio
import numpy as np
import pytest

from mpm import mesh_scan
from mpm.errors import SceneError
from mpm.mesh_seed import enclosed_volume, footprint_centre, overlap_volume, seed_inside, without_mirror_image
from mpm.mesh_surface import read_closed_surface, wind_outwards

SPACING = 0.1  # [m] of the points, where it does not matter
MESHES = Path(__file__).parents[2] / "meshes"

# A box's corners in hexahedron order, and its faces wound outwards.
CORNERS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]])
QUADS = np.array([[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]])


def box(low, high, turn=0):
    """Closed surface of a box; odd `turn` splits each face along its other diagonal."""
    vertices = np.asarray(low) + CORNERS * (np.asarray(high, dtype=float) - low)
    faces = np.roll(QUADS, turn, axis=1)
    return vertices, np.vstack([faces[:, :3], faces[:, [0, 2, 3]]])


def torus(around=60, across=40, radius=1.0, tube=0.4):
    u, v = np.meshgrid(np.arange(around), np.arange(across), indexing="ij")
    u, v = u.ravel(), v.ravel()
    a, b = 2 * np.pi * u / around, 2 * np.pi * v / across
    reach = radius + tube * np.cos(b)
    vertices = np.column_stack([reach * np.cos(a), reach * np.sin(a), tube * np.sin(b)])
    next_u, next_v = (u + 1) % around, (v + 1) % across
    quads = np.column_stack([u * across + v, next_u * across + v, next_u * across + next_v, u * across + next_v])
    return vertices, quads


def normals_of(vertices, triangles):
    a, b, c = np.moveaxis(vertices[triangles], 1, 0)
    return np.cross(b - a, c - a)


def write(path, vertices, **cells):
    meshio.Mesh(vertices, list(cells.items())).write(path)
    return path


def as_set(points, spacing):
    return set(map(tuple, np.rint(points / spacing - 0.5).astype(int)))


# --- lattice points inside


def test_box_between_lattice_centres_holds_exactly_its_cells_in_order():
    points = seed_inside(*box((-0.2, 0.0, 0.1), (0.1, 0.2, 0.5)), 0.1)
    cells = list(product((-2, -1, 0), (0, 1), (1, 2, 3, 4)))
    np.testing.assert_allclose(points, (np.array(cells) + 0.5) * 0.1, rtol=0, atol=1e-15)


@pytest.mark.parametrize("spacing", [0.25, 0.1, 0.3])
@pytest.mark.parametrize("turn", [0, 1])
def test_box_with_faces_edges_and_diagonals_on_lattice_lines(spacing, turn):
    # Corners are lattice centres: the lower faces belong to the box, the upper ones do not.
    low, high = (np.array([[-2, 1, 0], [2, 5, 3]]) + 0.5) * spacing
    points = seed_inside(*box(low, high, turn), spacing)
    assert as_set(points, spacing) == set(product(range(-2, 2), range(1, 5), range(3)))
    assert len(points) == 4 * 4 * 3


def test_box_faces_in_single_precision_are_decided_as_in_double():
    spacing = 0.1
    low, high = (np.array([[3, 3, 3], [9, 9, 9]]) + 0.5) * spacing
    vertices, triangles = box(low, high)
    rounded = vertices.astype(np.float32).astype(np.float64)
    assert (rounded != vertices).any()
    np.testing.assert_array_equal(seed_inside(rounded, triangles, spacing), seed_inside(vertices, triangles, spacing))


@pytest.mark.parametrize("turn", [0, 1])
def test_half_open_cuts_alone_decide_a_box_on_lattice_lines(monkeypatch, turn):
    # Without the shift, and with numbers that binary holds exactly, every line goes through edges.
    monkeypatch.setattr(mesh_scan, "LATTICE_SHIFT", np.zeros(3))
    points = seed_inside(*box((-0.5, 0.5, 0.5), (3.5, 4.5, 4.5), turn), 1.0)
    assert as_set(points, 1.0) == set(product(range(-1, 3), range(4), range(4)))
    assert len(points) == 64


@pytest.mark.parametrize("shifted", [True, False])
@pytest.mark.parametrize("size", [1, 4, 7])
def test_octahedron_with_vertices_edges_and_faces_through_centres_does_not_leak(monkeypatch, size, shifted):
    if not shifted:
        monkeypatch.setattr(mesh_scan, "LATTICE_SHIFT", np.zeros(3))
    vertices = np.vstack([np.eye(3), -np.eye(3)]) * size + 0.5
    triangles = [[a, b + 1, c + 2] for a, b, c in product((0, 3), repeat=3)]
    found = as_set(seed_inside(vertices, wind_outwards(vertices, np.array(triangles)), 1.0), 1.0)
    near = list(product(range(-size - 2, size + 3), repeat=3))
    strictly_inside = {p for p in near if sum(map(abs, p)) < size}
    on_or_inside = {p for p in near if sum(map(abs, p)) <= size}
    assert strictly_inside <= found <= on_or_inside


@pytest.mark.parametrize("slope", [1, 2])
def test_sloping_face_through_centres_takes_all_of_them_or_none(slope):
    # A wedge under a plane that holds centres (i, j, slope * i) but has its own corners off the lattice.
    spacing, n = 0.1, 30
    x0, x1 = -0.0137, 3.0213
    z0, z1 = (slope * (x - 0.05) + 0.05 for x in (x0, x1))
    vertices = np.array([[x0, 0, z0], [x1, 0, z0], [x1, 0, z1], [x0, 1, z0], [x1, 1, z0], [x1, 1, z1]])
    triangles = [[0, 1, 2], [3, 5, 4], [0, 3, 4], [0, 4, 1], [1, 4, 5], [1, 5, 2], [0, 2, 5], [0, 5, 3]]
    found = as_set(seed_inside(vertices, np.array(triangles), spacing), spacing)
    columns = list(product(range(n), range(10)))
    on_slope = [(i, j, slope * i) in found for i, j in columns]
    assert all(on_slope) or not any(on_slope)
    below = {(i, j, k) for i, j in columns for k in range(-1, slope * i) if (k + 0.5) * spacing > z0}
    assert {p for p in found if p[2] != slope * p[0]} == below


def test_symmetry_planes_keep_the_quarter_of_the_full_set():
    body = read_closed_surface(MESHES / "cylinder.stl")
    full = seed_inside(*body, 0.05)
    quarter = seed_inside(*body, 0.05, x_min=0.0, y_min=0.0)
    assert len(quarter) * 4 == len(full)
    np.testing.assert_array_equal(quarter, full[(full[:, 0] > 0) & (full[:, 1] > 0)])


def test_clip_leaves_out_centres_on_the_plane_itself():
    points = seed_inside(*box((0, 0, 0), (1, 1, 1)), 0.25, x_min=0.375, y_min=0.125)
    assert set(points[:, 0]) == {0.625, 0.875}
    assert set(points[:, 1]) == {0.375, 0.625, 0.875}


def test_quarter_cylinder_matches_the_circle():
    spacing = 0.025
    points = seed_inside(*read_closed_surface(MESHES / "cylinder.stl"), spacing, x_min=0.0, y_min=0.0)
    axis = (np.arange(60) + 0.5) * spacing
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    expected = np.count_nonzero((x**2 + y**2 <= 1.0) & (z < 0.5))
    assert abs(len(points) - expected) < 0.01 * expected
    assert np.hypot(points[:, 0], points[:, 1]).max() < 1.001
    assert points[:, 2].min() == pytest.approx(0.0125) and points[:, 2].max() == pytest.approx(0.4875)


def test_volume_mesh_and_surface_mesh_give_the_same_points():
    surface = seed_inside(*read_closed_surface(MESHES / "cylinder.stl"), 0.04)
    volume = seed_inside(*read_closed_surface(MESHES / "cylinder_volume.vtu"), 0.04)
    assert len(surface) > 20_000
    np.testing.assert_array_equal(surface, volume)


def test_cone_by_point_count_has_the_column_volume():
    points = seed_inside(*read_closed_surface(MESHES / "cone.stl"), 0.025)
    assert len(points) * 0.025**3 == pytest.approx(0.5 * np.pi, rel=0.01)
    height_left = 0.77 * np.cbrt(1.5 / 0.77) - 0.77 * np.hypot(points[:, 0], points[:, 1])
    assert (points[:, 2] < height_left + 1e-3).all()


def test_torus_has_its_volume_and_an_empty_hole(tmp_path):
    vertices, quads = torus()
    body = read_closed_surface(write(tmp_path / "torus.ply", vertices, quad=quads))
    points = seed_inside(*body, 0.04)
    assert enclosed_volume(*body, SPACING) == pytest.approx(2 * np.pi**2 * 1.0 * 0.4**2, rel=0.01)
    assert len(points) * 0.04**3 == pytest.approx(enclosed_volume(*body, SPACING), rel=0.01)
    assert np.hypot(points[:, 0], points[:, 1]).min() > 0.59


def test_l_shape_of_hexahedra_leaves_the_notch_empty(tmp_path):
    columns = [(0, 0), (1, 0), (0, 1)]
    vertices = np.vstack([CORNERS + np.array([x, y, 0.0]) for x, y in columns])
    body = read_closed_surface(write(tmp_path / "l.vtu", vertices, hexahedron=np.arange(24).reshape(3, 8)))
    assert len(body[0]) == 16 and len(body[1]) == 2 * 14
    assert enclosed_volume(*body, SPACING) == pytest.approx(3.0, rel=1e-14)
    points = seed_inside(*body, 0.25)
    assert len(points) == 3 * 64
    assert not ((points[:, 0] > 1) & (points[:, 1] > 1)).any()


def test_cavity_is_left_empty():
    outer, triangles = box((0, 0, 0), (1, 1, 1))
    inner, _ = box((0.25, 0.25, 0.25), (0.75, 0.75, 0.75))
    body = np.vstack([outer, inner]), np.vstack([triangles, triangles[:, ::-1] + 8])
    assert len(seed_inside(*body, 0.125)) == 8**3 - 4**3
    assert enclosed_volume(*body, SPACING) == pytest.approx(1 - 0.125, rel=1e-14)


def test_no_point_inside_names_the_spacing_and_the_bounding_box():
    with pytest.raises(SceneError, match=r"spacing 2 m .*\(0\.1, 0\.1, 0\.1\) to \(0\.3, 0\.3, 0\.4\) m"):
        seed_inside(*box((0.1, 0.1, 0.1), (0.3, 0.3, 0.4)), 2.0)


def test_mesh_in_millimetres_is_refused_before_it_fills_the_memory():
    with pytest.raises(SceneError, match=r"\(0, 0, 0\) to \(1000, 1000, 500\) m.* is the mesh in metres"):
        seed_inside(*box((0, 0, 0), (1000, 1000, 500)), 0.025)


def test_everything_clipped_off_is_an_error_too():
    with pytest.raises(SceneError, match="x > 1"):
        seed_inside(*box((0, 0, 0), (1, 1, 1)), 0.1, x_min=1.0)


def test_seeding_an_open_surface_is_refused():
    vertices, triangles = box((0, 0, 0), (1, 1, 1))
    with pytest.raises(SceneError, match="not closed"):
        seed_inside(vertices, triangles[1:], 0.1)


# --- volume


def test_volume_does_not_depend_on_winding_or_place():
    vertices, triangles = box((0.1, 0.2, 0.3), (2.1, 3.2, 0.8))
    assert enclosed_volume(vertices, triangles, SPACING) == pytest.approx(3.0, rel=1e-14)
    inwards = wind_outwards(vertices, triangles[:, ::-1])
    assert enclosed_volume(vertices, inwards, SPACING) == pytest.approx(3.0, rel=1e-14)
    assert enclosed_volume(vertices + 1e5, triangles, SPACING) == pytest.approx(3.0, rel=1e-9)


@pytest.mark.parametrize("turned", [[0], [0, 3, 4, 7, 11], list(range(11)), list(range(12))])
def test_triangles_wound_in_any_mixture_are_wound_outwards(turned):
    vertices, triangles = box((0, 0, 0), (1, 1, 1))
    mixed = triangles.copy()
    mixed[turned] = mixed[turned, ::-1]
    assert (normals_of(vertices, wind_outwards(vertices, mixed)) == normals_of(vertices, triangles)).all()


def test_surface_with_one_side_is_refused():
    """A Klein bottle: a torus of 6 x 6 quads whose last ring joins the first one turned over."""
    n = 6
    rings = [np.arange(n) + n * ring for ring in range(n)] + [(-np.arange(n)) % n]
    quads = [
        (lower[k], lower[(k + 1) % n], upper[(k + 1) % n], upper[k])
        for lower, upper in pairwise(rings)
        for k in range(n)
    ]
    triangles = np.array([[q[a] for a in half] for q in quads for half in ((0, 1, 2), (0, 2, 3))])
    with pytest.raises(SceneError, match="one side only"):
        wind_outwards(np.random.default_rng(0).random((n * n, 3)), triangles)


# --- several shells


def joined(*bodies):
    """Several bodies as one surface."""
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in bodies)])
    faces = [triangles + start for (_, triangles), start in zip(bodies, starts, strict=False)]
    vertices, triangles = np.vstack([vertices for vertices, _ in bodies]), np.vstack(faces)
    return vertices, wind_outwards(vertices, triangles)


def turned_over(body):
    return body[0], body[1][:, ::-1]


@pytest.mark.parametrize("turn", [lambda body: body, turned_over])
def test_overlapping_shells_are_united(turn):
    """Two boxes of 1 m3 that share half: 1.5 m3, whichever way the second is wound."""
    body = joined(box((0, 0, 0), (1, 1, 1)), turn(box((0.5, 0, 0), (1.5, 1, 1))))
    assert len(seed_inside(*body, 0.125)) == 12 * 8 * 8
    assert enclosed_volume(*body, SPACING) == pytest.approx(1.5, rel=3e-3)
    assert overlap_volume(*body, SPACING) == pytest.approx(0.5, rel=1e-2)


def test_three_shells_over_each_other_count_once():
    body = joined(*(box((shift, shift, 0), (1 + shift, 1 + shift, 1)) for shift in (0, 0.25, 0.5)))
    volume = 3 - 2 * 0.75**2 - 0.5**2 + 0.5**2  # inclusion and exclusion; the outer two share what all three do
    assert enclosed_volume(*body, SPACING) == pytest.approx(volume, rel=2e-3)
    assert len(seed_inside(*body, 0.125)) == pytest.approx(volume * 8**3, rel=1e-12)


def test_shells_that_touch_are_both_filled():
    body = joined(box((0, 0, 0), (1, 1, 0.5)), box((0.25, 0.25, 0.5), (0.75, 0.75, 1)))
    assert len(seed_inside(*body, 0.125)) == 8 * 8 * 4 + 4 * 4 * 4
    assert overlap_volume(*body, SPACING) == pytest.approx(0.0, abs=1e-12)


OUTER, INNER, ISLAND = box((0, 0, 0), (1, 1, 1)), box((0.125,) * 3, (0.875,) * 3), box((0.25,) * 3, (0.75,) * 3)


@pytest.mark.parametrize(
    ("bodies", "cells"),
    [
        ((OUTER, INNER), 512),  # wound alike: united
        ((turned_over(OUTER), turned_over(INNER)), 512),
        ((OUTER, turned_over(INNER)), 512 - 216),  # against each other: a cavity
        ((turned_over(OUTER), INNER), 512 - 216),
        ((INNER, turned_over(OUTER)), 512 - 216),  # in any order
        ((OUTER, turned_over(INNER), ISLAND), 512 - 216 + 64),  # a body inside the cavity
    ],
)
def test_a_shell_inside_another_is_a_cavity_where_they_are_wound_against_each_other(bodies, cells):
    body = joined(*bodies)
    assert len(seed_inside(*body, 0.125)) == cells
    assert enclosed_volume(*body, SPACING) == pytest.approx(cells / 512, rel=5e-3)


def test_a_shell_inside_another_whose_triangles_disagree_is_united():
    mixed = INNER[1].copy()
    mixed[::2] = mixed[::2, ::-1]
    assert len(seed_inside(*joined(OUTER, (INNER[0], mixed)), 0.125)) == 512


# --- footprint and mirror image


def test_centre_of_the_footprint_of_an_l():
    """An L of three unit squares; a tall block and a flat one weigh alike in plan."""
    body = joined(box((5, 5, 0), (7, 6, 1)), box((5, 6, 0), (6, 7, 3)))
    np.testing.assert_allclose(footprint_centre(*body, SPACING), [5 + 2.5 / 3, 5 + 2.5 / 3], atol=2e-3)


@pytest.mark.parametrize(("shift", "share"), [(0.0, 0.0), (0.05, 0.05), (0.5, 0.5), (3.0, 1.0)])
def test_share_without_a_mirror_image(shift, share):
    """A box 2 m wide, moved by s: its image covers all but 2 s of it."""
    body = box((-1 + shift, -1, 0), (1 + shift, 1, 1))
    assert without_mirror_image(*body, SPACING, 0) == pytest.approx(share, abs=5e-3)
    assert without_mirror_image(*body, SPACING, 1) == pytest.approx(0.0, abs=1e-12)


def test_a_body_as_thick_on_both_sides_but_at_other_heights_has_no_mirror_image():
    body = joined(box((-1, -1, 0), (0.01, 1, 1)), box((-0.01, -1, 1), (1, 1, 2)))
    assert without_mirror_image(*body, SPACING, 0) == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("name", ["cylinder.stl", "cone.stl", "cylinder_volume.vtu"])
def test_committed_bodies_enclose_the_column_volume(name):
    # Single precision in the STL files.
    assert enclosed_volume(*read_closed_surface(MESHES / name), SPACING) == pytest.approx(0.5 * np.pi, rel=1e-6)


# --- reading

UNIT_CUBES = {
    "hexahedron": [range(8)],
    "wedge": [(0, 1, 2, 4, 5, 6), (0, 2, 3, 4, 6, 7)],
    "pyramid": [(*quad, 8) for quad in QUADS],
    "tetra": [(0, 1, 2, 6), (0, 2, 3, 6), (0, 3, 7, 6), (0, 7, 4, 6), (0, 4, 5, 6), (0, 5, 1, 6)],
}


@pytest.mark.parametrize("kind", UNIT_CUBES)
def test_each_volume_cell_type_gives_the_cube_wound_outwards(tmp_path, kind):
    vertices = np.vstack([CORNERS, [[0.5, 0.5, 0.5]]])
    cells = np.array([list(cell) for cell in UNIT_CUBES[kind]])
    path = write(tmp_path / "cube.vtu", vertices, **{kind: cells})
    body = vertices, triangles = read_closed_surface(path)
    assert (vertices.dtype, triangles.dtype) == (np.float64, np.int64)
    assert len(vertices) == 8 and len(triangles) == 12
    a, b, c = np.moveaxis(vertices[triangles], 1, 0)
    assert (np.einsum("ij,ij->i", np.cross(b - a, c - a), a - 0.5) > 0).all()
    assert enclosed_volume(*body, SPACING) == pytest.approx(1.0, rel=1e-14)
    assert len(seed_inside(*body, 0.25)) == 64


def test_cells_numbered_in_either_sense_give_the_same_body(tmp_path):
    tetra = np.array(UNIT_CUBES["tetra"])
    tetra[::2, :2] = tetra[::2, 1::-1]
    body = read_closed_surface(write(tmp_path / "cube.vtu", CORNERS.astype(float), tetra=tetra))
    assert enclosed_volume(*body, SPACING) == pytest.approx(1.0, rel=1e-14)


def test_hexahedron_collapsed_to_a_wedge_joins_a_wedge_by_a_triangle(tmp_path):
    base = np.array([[0, 0], [1, 0], [0, 1]])
    vertices = np.vstack([np.column_stack([base, np.full(3, z)]) for z in (0.0, 1.0, 2.0)])
    collapsed, wedge = np.array([[0, 1, 1, 2, 3, 4, 4, 5]]), np.array([[3, 4, 5, 6, 7, 8]])
    path = write(tmp_path / "prism.vtu", vertices, hexahedron=collapsed, wedge=wedge)
    vertices, triangles = read_closed_surface(path)
    assert len(triangles) == 2 + 2 * 3 * 2  # two ends and three walls of two quads; none inside
    assert enclosed_volume(vertices, triangles, SPACING) == pytest.approx(1.0, rel=1e-14)


def test_hexahedra_collapsed_onto_an_axis_give_the_prism_around_it(tmp_path):
    angle = np.arange(6) * np.pi / 3
    section = np.vstack([[[0, 0]], np.column_stack([np.cos(angle), np.sin(angle)])])
    vertices = np.vstack([np.column_stack([section, np.full(7, z)]) for z in (0.0, 1.0)])
    a, b, axis = 1 + np.arange(6), 1 + (np.arange(6) + 1) % 6, np.zeros(6, dtype=int)
    cells = np.column_stack([axis, a, b, axis, axis + 7, a + 7, b + 7, axis + 7])
    body = read_closed_surface(write(tmp_path / "prism.vtu", vertices, hexahedron=cells))
    assert len(body[1]) == 6 + 6 + 12
    assert enclosed_volume(*body, SPACING) == pytest.approx(1.5 * np.sqrt(3), rel=1e-14)


def test_surface_cells_beside_volume_cells_are_ignored(tmp_path):
    cells = {"triangle": np.array([[0, 1, 2]]), "hexahedron": np.array([range(8)])}
    _, triangles = read_closed_surface(write(tmp_path / "cube.vtu", CORNERS.astype(float), **cells))
    assert len(triangles) == 12


def test_coincident_vertices_are_merged_across_round_off(tmp_path):
    vertices, triangles = box((0, 0, 0), (1, 1, 1))
    noise = np.random.default_rng(1).uniform(-1e-7, 1e-7, (36, 3))
    loose = np.arange(36).reshape(12, 3)
    path = write(tmp_path / "loose.ply", vertices[triangles].reshape(-1, 3) + noise, triangle=loose)
    merged, kept = read_closed_surface(path)
    assert len(merged) == 8 and len(kept) == 12
    assert enclosed_volume(merged, kept, SPACING) == pytest.approx(1.0, rel=1e-6)


def test_close_but_distinct_vertices_stay_apart(tmp_path):
    vertices, triangles = box((0, 0, 0), (1, 1, 1e-4))
    read, _ = read_closed_surface(write(tmp_path / "sheet.ply", vertices, triangle=triangles))
    assert len(read) == 8


def test_open_surface_is_named_with_its_open_edges(tmp_path):
    vertices, triangles = box((0, 0, 0), (1, 1, 1))
    path = write(tmp_path / "open.stl", vertices, triangle=triangles[1:])
    with pytest.raises(SceneError, match=r"open\.stl: .*not closed.* 3 are open .*fill the holes"):
        read_closed_surface(path)


def test_doubled_triangle_is_refused(tmp_path):
    vertices, triangles = box((0, 0, 0), (1, 1, 1))
    doubled = np.vstack([triangles, triangles[:1]])
    with pytest.raises(SceneError, match=r"0 are open .* 3 have more than two"):
        read_closed_surface(write(tmp_path / "doubled.ply", vertices, triangle=doubled))


def test_overlapping_volume_cells_are_refused(tmp_path):
    cells = np.array([range(8), range(8), range(8)])
    with pytest.raises(SceneError, match="overlap"):
        read_closed_surface(write(tmp_path / "thrice.vtu", CORNERS.astype(float), hexahedron=cells))


def test_missing_file_names_the_absolute_path(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SceneError) as caught:
        read_closed_surface("bodies/none.stl")
    assert str(tmp_path / "bodies" / "none.stl") in str(caught.value)


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("notes.txt", b"not a mesh", r"\.txt is no mesh format that is read"),
        ("body", b"not a mesh", "body is no mesh format that is read"),
        ("body.vtp", b"<VTKFile", "PolyData is not read: in ParaView use"),
        ("broken.ply", b"not a mesh\n", "cannot be read"),
        ("broken.stl", b"not a mesh\n" * 20, "it is no STL file"),
        ("broken.obj", b"not a mesh\n", "has no triangles"),
        ("broken.off", b"not a mesh\n", "cannot be read"),
        ("broken.vtu", b"<VTKFile", "cannot be read"),
        ("broken.vtk", b"# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\n", "PolyData and voxel cells are not"),
        ("broken.med", b"not HDF5", "cannot be read"),
        ("broken.msh", b"$MeshFormat\n9 0 8\n", "cannot be read"),
    ],
)
def test_unreadable_files_give_one_line_with_the_reason_and_the_formats_that_work(
    tmp_path, capfd, name, content, reason
):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(SceneError, match=reason) as caught:
        read_closed_surface(tmp_path / name)
    message = str(caught.value)
    assert name in message and "\n" not in message and "formats that work: STL, OBJ" in message
    assert not re.search(r"Error|Exception|meshio|trimesh|h5py", message)
    assert capfd.readouterr() == ("", "")


def test_second_order_cells_are_refused_by_name(tmp_path):
    corners = np.vstack([np.eye(3), [[0, 0, 0]]])
    middles = [(corners[a] + corners[b]) / 2 for a, b in [(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)]]
    path = write(tmp_path / "curved.vtu", np.vstack([corners, middles]), tetra10=np.array([range(10)]))
    with pytest.raises(SceneError, match=r"not supported: tetra10; .*first-order"):
        read_closed_surface(path)


def test_mesh_without_faces_is_refused(tmp_path):
    path = write(tmp_path / "wire.vtu", CORNERS.astype(float), line=np.array([[0, 1], [1, 2]]))
    with pytest.raises(SceneError, match="no triangles, quads or volume cells"):
        read_closed_surface(path)


def test_vertex_that_is_not_a_number_is_refused(tmp_path):
    vertices, triangles = box((0, 0, 0), (1, 1, 1))
    vertices[3, 1] = np.nan
    with pytest.raises(SceneError, match="three finite coordinates"):
        read_closed_surface(write(tmp_path / "nan.ply", vertices, triangle=triangles))


def test_vertex_that_does_not_exist_is_refused(tmp_path):
    vertices, triangles = box((0, 0, 0), (1, 1, 1))
    path = write(tmp_path / "short.vtu", vertices[:7], triangle=triangles)
    with pytest.raises(SceneError, match="vertex that the file does not have"):
        read_closed_surface(path)


# --- the files in meshes/


def test_committed_meshes_are_what_the_script_makes(tmp_path):
    subprocess.run([sys.executable, MESHES / "make_meshes.py", "--out", tmp_path], check=True)
    made = sorted(path.name for path in tmp_path.iterdir())
    assert made == ["cone.stl", "cylinder.stl", "cylinder_volume.vtu"]
    for name in made:
        new, committed = meshio.read(tmp_path / name), meshio.read(MESHES / name)
        np.testing.assert_allclose(new.points, committed.points, rtol=0, atol=1e-6)
        assert new.cells_dict.keys() == committed.cells_dict.keys()
        for kind, cells in new.cells_dict.items():
            np.testing.assert_array_equal(cells, committed.cells_dict[kind])
        assert (MESHES / name).stat().st_size < 200_000
