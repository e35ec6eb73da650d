"""Seeding of columns, boxes and meshes, and the walls that go with each."""

import re
import tomllib
from pathlib import Path

import meshio
import numpy as np
import pytest

from mpm.body import build
from mpm.errors import SceneError
from mpm.load import load_scene
from mpm.scene import Box, Column, Mesh
from mpm.seed import Seeds, seed
from mpm.walls import FIXED, FREE, NOWHERE, ROLLER, walls_of

CELL = 0.1
SPACING = CELL / 2
MESHES = Path(__file__).parents[2] / "meshes"
SHARE = {"quarter": 0.25, "half": 0.5, "full": 1.0}


def column(symmetry="quarter", radius=1.0, aspect_ratio=0.5):
    return Column(shape="column", radius=radius, aspect_ratio=aspect_ratio, symmetry=symmetry)


def as_set(x):
    """Points as lattice indices, exact to compare."""
    return {tuple(index) for index in np.round(x / SPACING - 0.5).astype(int)}


def assert_on_lattice_in_order(x):
    """Centres of half cells, each once, by x, then y, then z (z fastest)."""
    index = x / SPACING - 0.5
    np.testing.assert_allclose(index, np.round(index), atol=1e-9)
    index = np.round(index).astype(int)
    order = np.lexsort((index[:, 2], index[:, 1], index[:, 0]))
    np.testing.assert_array_equal(order, np.arange(len(x)))
    assert len(np.unique(index, axis=0)) == len(index)


# Columns


@pytest.mark.parametrize("symmetry", SHARE)
def test_column_fills_its_share_of_the_cylinder(symmetry):
    seeds = seed(column(symmetry), CELL)
    assert len(seeds.x) * SPACING**3 == pytest.approx(SHARE[symmetry] * np.pi * 0.5, rel=0.01)
    assert (seeds.reference, seeds.height) == (1.0, 0.5)
    assert_on_lattice_in_order(seeds.x)
    assert np.hypot(seeds.x[:, 0], seeds.x[:, 1]).max() <= 1.0
    assert seeds.x[:, 2].min() == pytest.approx(SPACING / 2)
    assert seeds.x[:, 2].max() == pytest.approx(0.5 - SPACING / 2)


def test_full_column_is_four_quarters_and_half_is_two():
    quarter, half, full = (as_set(seed(column(symmetry), CELL).x) for symmetry in SHARE)
    assert len(full) == 2 * len(half) == 4 * len(quarter)
    assert quarter == {(i, j, k) for i, j, k in full if i >= 0 and j >= 0}
    assert half == {(i, j, k) for i, j, k in full if j >= 0}


def test_full_column_is_symmetric_about_both_planes_and_the_diagonal():
    full = as_set(seed(column("full"), CELL).x)
    assert full == {(-1 - i, j, k) for i, j, k in full}
    assert full == {(i, -1 - j, k) for i, j, k in full}
    assert full == {(j, i, k) for i, j, k in full}


def test_every_centre_within_the_radius_is_taken():
    found = as_set(seed(column("full", radius=0.53, aspect_ratio=0.5), CELL).x)
    expected = {
        (i, j, k)
        for i in range(-20, 20)
        for j in range(-20, 20)
        for k in range(20)
        if np.hypot(i + 0.5, j + 0.5) * SPACING <= 0.53 and (k + 0.5) * SPACING < 0.265
    }
    assert found == expected


@pytest.mark.parametrize(("aspect_ratio", "layers"), [(0.1, 2), (0.5, 10), (0.51, 10), (0.53, 11), (2.0, 40)])
def test_layers_are_those_whose_centres_lie_below_the_top(aspect_ratio, layers):
    z = seed(column(aspect_ratio=aspect_ratio), CELL).x[:, 2]
    np.testing.assert_allclose(np.unique(z.round(9)), (np.arange(layers) + 0.5) * SPACING)


# Random places


def test_scattered_points_stay_in_their_part_of_a_cell_and_fill_it_evenly():
    body = build(load_scene("column_small", ["grid.scatter=0.5"]))
    lattice = build(load_scene("column_small")).x
    spacing = 0.5 * body.scene.grid.cell
    offset = (body.x - lattice) / spacing
    assert np.abs(offset).max() <= 0.25
    # even within +-1/4: mean 0, standard deviation 1/2 over sqrt(12), each to four standard errors
    error = 4 / np.sqrt(offset.size)
    assert abs(offset.mean()) < error * 0.5 / np.sqrt(12)
    assert offset.std() == pytest.approx(0.5 / np.sqrt(12), rel=error)


def test_a_realisation_can_be_had_again_and_another_is_another():
    first, again, other = (
        build(load_scene("column_small", ["grid.scatter=1", f"grid.realisation={which}"])).x for which in (3, 3, 4)
    )
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 0.01


def test_a_resumed_run_does_not_scatter_its_points_again():
    """It starts from the points that the run kept."""
    scene = load_scene("column_small", ["grid.scatter=1"])
    x = build(scene).x
    np.testing.assert_array_equal(build(scene, Seeds(x, 1.0, 0.5)).x, x)


# Boxes


def test_box_is_filled_exactly():
    """An odd number of half cells too, and lengths that binary numbers do not hold."""
    seeds = seed(Box(shape="box", size=(0.3, 0.35, 1.1)), CELL)
    assert len(seeds.x) == 6 * 7 * 22
    assert as_set(seeds.x) == {(i, j, k) for i in range(6) for j in range(7) for k in range(22)}
    assert len(seeds.x) * SPACING**3 == pytest.approx(0.3 * 0.35 * 1.1)
    assert (seeds.reference, seeds.height) == (0.3, 1.1)
    assert_on_lattice_in_order(seeds.x)


# Meshes


def mesh(path, symmetry="full", **keys):
    return Mesh(shape="mesh", file=str(path), symmetry=symmetry, **keys)


def cube(path, shift=(0.0, 0.0, 0.0), size=(1.0, 1.0, 1.0)):
    """A closed surface, of edge 1 m where nothing else is said, written as an STL file."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float) * size + shift
    faces = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    triangles = np.array([[f[a] for a in half] for f in faces for half in ((0, 1, 2), (0, 2, 3))])
    meshio.Mesh(corners, [("triangle", triangles)]).write(path, file_format="stl", binary=True)
    return path


def test_mesh_cube_is_seeded_as_the_box_is(tmp_path):
    seeds = seed(mesh(cube(tmp_path / "cube.stl")), CELL)
    assert as_set(seeds.x) == as_set(seed(Box(shape="box", size=(1.0, 1.0, 1.0)), CELL).x)
    assert_on_lattice_in_order(seeds.x)
    assert seeds.axis == pytest.approx((0.5, 0.5), abs=1e-3)
    assert seeds.reference == pytest.approx(np.sqrt(0.5), abs=1e-3)
    assert seeds.height == pytest.approx(1.0)


@pytest.mark.parametrize(("symmetry", "share"), SHARE.items(), ids=SHARE)
def test_mesh_symmetry_cuts_at_the_planes(tmp_path, symmetry, share):
    path = cube(tmp_path / "cube.stl", (-0.5, -0.5, 0.0))
    x = seed(mesh(path, symmetry), CELL).x
    assert len(x) == share * 20**3
    assert x[:, 1].min() > 0 or symmetry == "full"
    assert x[:, 0].min() > 0 or symmetry != "quarter"


@pytest.mark.parametrize(("lift", "said"), [(-0.25, r"0\.25 m below it"), (0.5, r"0\.5 m above it")])
def test_mesh_that_does_not_stand_on_the_floor_is_refused_and_the_offset_named_puts_it_there(tmp_path, lift, said):
    path = cube(tmp_path / "cube.stl", (0.0, 0.0, lift))
    with pytest.raises(SceneError, match=rf"cube\.stl: .*not stand on z = 0: its lowest point lies {said}") as caught:
        seed(mesh(path, offset=(0.0, 0.0, 0.0)), CELL)
    offset = tomllib.loads(re.search(r"geometry\.(offset = \[.*?\])", str(caught.value))[1])["offset"]
    assert len(seed(mesh(path, offset=tuple(offset)), CELL).x) == 20**3


def test_mesh_above_the_floor_is_accepted_where_it_is_asked_for(tmp_path):
    path = cube(tmp_path / "cube.stl", (0.0, 0.0, 0.5))
    seeds = seed(mesh(path, base="as_is"), CELL)
    assert len(seeds.x) == 20**3 and seeds.x[:, 2].min() == pytest.approx(0.5 + SPACING / 2)
    assert seeds.height == pytest.approx(1.5)


def test_mesh_below_the_floor_is_refused_even_as_it_is(tmp_path):
    with pytest.raises(SceneError, match=r"0\.2 m below it; geometry\.offset = .* puts it there$"):
        seed(mesh(cube(tmp_path / "cube.stl", (0.0, 0.0, -0.2)), base="as_is"), CELL)


def test_mesh_a_rounding_error_below_the_base_is_accepted(tmp_path):
    path = cube(tmp_path / "cube.stl", (0.0, 0.0, -1e-9))
    assert len(seed(mesh(path), CELL).x) == 20**3


@pytest.mark.parametrize(("unit", "metres"), [("m", 1.0), ("cm", 0.01), ("mm", 0.001)])
def test_mesh_coordinates_are_scaled_by_the_unit_and_then_moved_by_the_offset(tmp_path, unit, metres):
    path = cube(tmp_path / "cube.stl", np.array([1.0, 2.0, 3.0]) / metres, np.ones(3) / metres)
    seeds = seed(mesh(path, unit=unit, offset=(-1.0, -2.0, -3.0)), CELL)
    assert as_set(seeds.x) == as_set(seed(Box(shape="box", size=(1.0, 1.0, 1.0)), CELL).x)


def test_mesh_in_another_unit_is_refused_and_the_key_named(tmp_path):
    path = cube(tmp_path / "cube.stl", size=(1e4, 1e4, 1e3))
    with pytest.raises(SceneError, match=r"cube\.stl: .*is the mesh in metres\? \(geometry\.unit = 'mm'"):
        seed(mesh(path), CELL)
    assert len(seed(mesh(path, unit="mm"), 0.5).x) == 40 * 40 * 4


def test_mesh_points_are_held_against_the_body(tmp_path):
    """1.03 m of a box at spacing 0.05: 21 layers of 20.6 in x, and 20 of 20.2 in z (centres at 1.025 and 1.025)."""
    fit = seed(mesh(cube(tmp_path / "cube.stl", size=(1.03, 1.0, 1.01))), CELL).fit
    assert fit.seeded == pytest.approx(21 * 20 * 20 * SPACING**3)
    assert fit.enclosed == pytest.approx(1.03 * 1.01, rel=1e-6) and fit.overlap == 0.0
    assert fit.off == pytest.approx(1.05 / (1.03 * 1.01) - 1, rel=1e-5)
    np.testing.assert_allclose(fit.body, [[0, 0, 0], [1.03, 1.0, 1.01]], atol=1e-6)
    np.testing.assert_allclose(fit.points, [[0, 0, 0], [1.05, 1.0, 1.0]], atol=1e-9)
    np.testing.assert_allclose(fit.misfit, [0.4, 0.0, 0.2], atol=1e-5)
    volumes, boxes, lattice = fit.lines()
    assert volumes == "points fill 1.05 m3, the mesh encloses 1.04 m3: +0.9%"
    assert boxes == "body (0, 0, 0) to (1.03, 1, 1.01) m, points (0, 0, 0) to (1.05, 1, 1) m, lowest point z = 0 m"
    assert lattice.startswith("bounding box off the lattice by 0.4, 0, 0.2 ") or "off the lattice" in lattice


def test_fit_is_of_the_part_that_symmetry_keeps(tmp_path):
    fit = seed(mesh(cube(tmp_path / "cube.stl", (-0.5, -0.5, 0.0)), "quarter"), CELL).fit
    assert fit.enclosed == pytest.approx(0.25, rel=1e-6) and fit.seeded == pytest.approx(0.25)
    np.testing.assert_allclose(fit.body, [[0, 0, 0], [0.5, 0.5, 1.0]], atol=1e-6)


def test_mesh_too_thin_for_the_cell_is_refused_and_the_cell_named_would_do(tmp_path):
    """0.13 m at spacing 0.1: one layer, 23 % short."""
    path = cube(tmp_path / "slab.stl", size=(1.0, 1.0, 0.13))
    with pytest.raises(
        SceneError, match=r"slab\.stl: .*-23\.1% \(5% allowed\): grid\.cell = 0\.2 is too coarse"
    ) as caught:
        seed(mesh(path), 0.2)
    cell = float(re.search(r"grid\.cell = (\S+) \[m\] would do", str(caught.value))[1])
    assert 0.02 < cell < 0.2 and abs(seed(mesh(path), cell).fit.off) <= 0.05


def test_parts_without_a_point_are_counted(tmp_path):
    """A block and two needles that stand between the lattice's lines."""
    bodies = [cube(tmp_path / "a.stl"), *(cube(tmp_path / f"{x}.stl", (x, 2.0, 0.0), (0.02, 3.0, 2.0)) for x in (2, 3))]
    bodies = [meshio.read(path) for path in bodies]
    points = np.concatenate([body.points for body in bodies])
    starts = np.cumsum([0, *(len(body.points) for body in bodies)])
    cells = np.concatenate([body.cells[0].data + start for body, start in zip(bodies, starts, strict=False)])
    meshio.Mesh(points, [("triangle", cells)]).write(tmp_path / "all.stl", binary=True)
    with pytest.raises(SceneError, match=r"-19\.4%.*2 of 3 separate parts hold no point"):
        seed(mesh(tmp_path / "all.stl"), CELL)


# The axis that run-out is measured about


def test_axis_of_a_mesh_is_the_centroid_of_its_footprint(tmp_path):
    seeds = seed(mesh(cube(tmp_path / "cube.stl", (3.0, -2.0, 0.0), (2.0, 1.0, 1.0))), CELL)
    assert seeds.axis == pytest.approx((4.0, -1.5), abs=5e-3)
    assert seeds.reference == pytest.approx(np.hypot(1.0, 0.5), abs=5e-3)


def test_axis_of_parts_far_apart_is_found(tmp_path):
    """Two needles 0.2 m wide and 300 m apart, of which one is twice as long."""
    bodies = [meshio.read(cube(tmp_path / f"{x}.stl", (x, 0.0, 0.0), (0.2, y, 1.0))) for x, y in ((0, 0.2), (300, 0.4))]
    points = np.concatenate([body.points for body in bodies])
    cells = np.concatenate([bodies[0].cells[0].data, bodies[1].cells[0].data + len(bodies[0].points)])
    meshio.Mesh(points, [("triangle", cells)]).write(tmp_path / "both.stl", binary=True)
    assert seed(mesh(tmp_path / "both.stl"), CELL).axis == pytest.approx((200.1, 0.5 / 3), abs=0.02)


def test_axis_of_a_symmetric_mesh_lies_on_its_planes(tmp_path):
    half = seed(mesh(cube(tmp_path / "half.stl", (3.0, -0.5, 0.0)), "half"), CELL)
    assert half.axis == (pytest.approx(3.5, abs=5e-3), 0.0)
    assert seed(mesh(cube(tmp_path / "quarter.stl", (-0.5, -0.5, 0.0)), "quarter"), CELL).axis == (0.0, 0.0)


@pytest.mark.parametrize(
    ("symmetry", "shift", "plane"),
    [("quarter", (-0.4, -0.5, 0.0), "x"), ("quarter", (-0.5, 2.0, 0.0), "y"), ("half", (-0.5, -0.47, 0.0), "y")],
)
def test_symmetry_of_a_mesh_that_has_none_is_refused(tmp_path, symmetry, shift, plane):
    with pytest.raises(
        SceneError, match=rf"'{symmetry}' needs a body symmetric about the plane {plane} = 0.*\(2% allowed\)"
    ):
        seed(mesh(cube(tmp_path / "cube.stl", shift), symmetry), CELL)


def test_half_of_a_mesh_may_lie_anywhere_along_x(tmp_path):
    assert len(seed(mesh(cube(tmp_path / "cube.stl", (7.0, -0.5, 0.0)), "half"), CELL).x) == 20 * 10 * 20


# Walls


def walls(*overrides, preset="column_small"):
    return walls_of(load_scene(preset, list(overrides)))


@pytest.mark.parametrize(
    ("symmetry", "kinds", "planes"),
    [
        ("quarter", (ROLLER, ROLLER, FIXED), (0, 0, 0)),
        ("half", (FREE, ROLLER, FIXED), (-NOWHERE, 0, 0)),
        ("full", (FREE, FREE, FIXED), (-NOWHERE, -NOWHERE, 0)),
    ],
)
def test_a_column_stands_on_a_rough_base_between_its_planes_of_symmetry(symmetry, kinds, planes):
    found = walls(f"geometry.symmetry={symmetry}")
    assert (found.low_kind, found.low) == (kinds, planes)
    assert found.high_kind == (FREE, FREE, FREE)
    assert found.high == (NOWHERE, NOWHERE, NOWHERE)


def test_a_mesh_has_a_columns_walls(tmp_path):
    text = (
        'name = "body"\ngeometry = {shape = "mesh", file = "cube.stl", symmetry = "half"}\ngrid = {cell = 0.1}\n'
        "[material]\nyoung = 1e6\npoisson = 0.3\ndensity = 2000\nfriction_angle = 30\n"
    )
    (tmp_path / "scene.toml").write_text(text)
    assert walls(preset=str(tmp_path / "scene.toml")) == walls("geometry.symmetry=half")


def test_a_box_has_the_walls_it_is_given():
    """elastic_bar: 2 x 2 x 40 cells, rollers all round, on a fixed base, free at the top."""
    found = walls(preset="elastic_bar")
    assert found.low_kind == (ROLLER, ROLLER, FIXED)
    assert found.low == (0, 0, 0)
    assert found.high_kind == (ROLLER, ROLLER, FREE)
    assert found.high == (2, 2, NOWHERE)
    found = walls("geometry.walls.x_min=free", "geometry.walls.z_max=fixed", preset="elastic_bar")
    assert (found.low_kind[0], found.low[0]) == (FREE, -NOWHERE)
    assert (found.high_kind[2], found.high[2]) == (FIXED, 40)


def test_a_boxs_own_walls_are_a_fixed_base_and_nothing_else():
    box = Box(shape="box", size=(1.0, 1.0, 1.0))
    scene = load_scene("elastic_bar").model_copy(update={"geometry": box})
    found = walls_of(scene)
    assert (found.low_kind, found.high_kind) == ((FREE, FREE, FIXED), (FREE, FREE, FREE))


@pytest.mark.parametrize(("preset", "side", "top"), [("column_0.5", 40, 10), ("column_4", 320, 80)])
def test_paper_extent_puts_rollers_at_4_h0(preset, side, top):
    found = walls("grid.extent=paper", preset=preset)
    assert (found.low_kind, found.low) == ((ROLLER, ROLLER, FIXED), (0, 0, 0))
    assert found.high_kind == (ROLLER, ROLLER, FREE)
    assert found.high == (side, side, NOWHERE)
    assert side * 0.05 == pytest.approx(4 * top * 0.05)
