"""Measures of a deposit on solids whose profile, slope, volume and reach are known in closed form."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

from compare.metrics import Profile, axis_of, deposit, eq4_profile, flank_angle, highest, profile, profile_distance
from mpm.errors import SceneError
from mpm.load import parse_scene
from mpm.results import Results
from mpm.theory import eq4, quasistatic_profile

FRICTION_ANGLE = 37.55
TAN = np.tan(np.radians(FRICTION_ANGLE))
FOOT, SLOPE = 1.5, 0.8  # of the cones [m], [-]
ANGLE = np.degrees(np.arctan(SLOPE))
LAMBDA0 = (0.5, 1.0, 2.0)
CELL = 0.05


SAND = {"young": 1e6, "poisson": 0.3, "density": 2000.0, "friction_angle": FRICTION_ANGLE}


def scene(geometry, cell=CELL, **material):
    return parse_scene({"name": "made", "geometry": geometry, "grid": {"cell": cell}, "material": SAND | material})


def column(cell=CELL, lambda0=1.0, symmetry="quarter", radius=1.0, **material):
    geometry = {"shape": "column", "radius": radius, "aspect_ratio": lambda0, "symmetry": symmetry}
    return scene(geometry, cell, **material)


def mesh(cell=CELL, symmetry="full"):
    return scene({"shape": "mesh", "file": "cone.stl", "symmetry": symmetry}, cell)


def box(size, cell=CELL):
    return scene({"shape": "box", "size": size}, cell)


def lattice(size, spacing):
    axes = [(np.arange(int(np.ceil(length / spacing - 1e-9))) + 0.5) * spacing for length in size]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def solid(height_at, foot, height, cell):
    """Lattice points of a quarter of a body of revolution below `height_at(r)`."""
    x = lattice((foot, foot, height), cell / 2)
    return x[x[:, 2] <= height_at(np.hypot(x[:, 0], x[:, 1]))]


def cone(cell, height=FOOT * SLOPE):
    """Cone with its foot at FOOT and the slope SLOPE, its top cut at `height`."""
    return solid(lambda r: np.clip(SLOPE * (FOOT - r), 0.0, height), FOOT, height, cell)


def cone_volume(height=FOOT * SLOPE):
    """Of the quarter: a cone less its tip."""
    tip = FOOT * SLOPE - height
    return np.pi / 12 * (FOOT**2 * FOOT * SLOPE - (tip / SLOPE) ** 2 * tip)


def eq4_solid(lambda0, cell):
    return solid(lambda r: quasistatic_profile(lambda0, TAN, r), 1.0 + float(eq4(lambda0, TAN)), lambda0, cell)


def on_rings(edges, thickness):
    return Profile(np.array(edges, float), np.array(thickness, float), 2, np.pi)


def store(directory, its_scene, x, reference=1.0, axis=(0.0, 0.0), **fields):
    """A run whose one snapshot, in single precision as a run writes it, holds `x` and `fields`."""
    run = Results.create(directory, its_scene, {})
    run.write_static("x0", x)
    run.write_static("extent", np.array([reference, 1.0, *axis]))
    run.write_snapshot(1.0, 10, {name: value.astype(np.float32) for name, value in {"x": x, **fields}.items()})
    return run


def test_profile_of_four_points_by_hand():
    """Rings of a quarter, cell 1: areas pi/4, 3 pi/4, 5 pi/4 and so on; a point is 1/8 m3, its quarters 1/8 m off."""
    x = np.array([[0.3, 0.4, 0.5], [0.6, 0.0, 2.0], [2.0, 1.5, 0.1], [0.0, 2.9, 0.7]])
    found = profile(x, column(cell=1.0))
    np.testing.assert_array_equal(found.edges, [0.0, 1.0, 2.0, 3.0, 4.0])
    np.testing.assert_allclose(found.area, np.pi / 4 * np.array([1.0, 3.0, 5.0, 7.0]))
    # The last point's two outer quarters lie at hypot(1/8, 3.025) > 3.
    held = np.array([0.25, 0.0, 0.125 + 0.0625, 0.0625])
    np.testing.assert_allclose(found.thickness, held / found.area)
    np.testing.assert_array_equal(highest(x, column(cell=1.0)), [2.25, np.nan, 0.95])


def test_profile_of_a_box_by_hand():
    """Strips 1 wide across a width of 3; a point beyond x = 0 is on the first."""
    x = np.array([[-1.2, 2.0, 0.5], [0.5, 0.5, 0.2], [1.5, 2.5, 0.4]])
    found = profile(x, box((2.0, 3.0, 1.0), cell=1.0))
    np.testing.assert_array_equal(found.edges, [0.0, 1.0, 2.0])
    np.testing.assert_allclose(found.area, [3.0, 3.0])
    np.testing.assert_allclose(found.thickness, [0.25 / 3, 0.125 / 3])
    np.testing.assert_allclose(highest(x, box((2.0, 3.0, 1.0), cell=1.0)), [0.75, 0.65])


@pytest.mark.parametrize(
    ("symmetry", "images"), [("half", [(1, 1), (-1, 1)]), ("full", [(1, 1), (-1, 1), (1, -1), (-1, -1)])]
)
@pytest.mark.parametrize("body", [column, mesh])
def test_a_sectors_mirror_images_do_not_change_the_thickness(symmetry, images, body):
    quarter = cone(2 * CELL)
    mirrored = np.concatenate([quarter * [*image, 1] for image in images])
    whole, part = profile(mirrored, body(2 * CELL, symmetry=symmetry)), profile(quarter, column(2 * CELL))
    np.testing.assert_allclose(whole.thickness, part.thickness)
    assert whole.volume == pytest.approx(len(images) * part.volume)
    assert profile_distance(whole, part) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("cell", [2 * CELL, CELL])
@pytest.mark.parametrize("height", [FOOT * SLOPE, 0.6])
def test_profile_holds_every_points_volume(height, cell):
    """And a lattice that fills the solid has its volume: each vertical row ends within half a spacing of it."""
    x = cone(cell, height)
    found = profile(x, column(cell))
    assert found.volume == pytest.approx(len(x) * (cell / 2) ** 3, rel=1e-12)
    assert found.volume == pytest.approx(cone_volume(height), rel=1e-3)


@pytest.mark.parametrize("height", [FOOT * SLOPE, 0.6])
def test_slope_of_a_cone_and_of_a_truncated_cone(height):
    """Heights are known to one spacing over the fitted 75 % of the height; half the cell, half the error."""
    errors = []
    for cell in (2 * CELL, CELL):
        angle = flank_angle(profile(cone(cell, height), column(cell)))
        steepest, flattest = (SLOPE * (1 + sign * 0.5 * cell / (0.75 * height)) for sign in (1, -1))
        assert np.degrees(np.arctan(flattest)) < angle < np.degrees(np.arctan(steepest))
        errors.append(abs(angle - ANGLE))
    assert errors[1] < 0.75 * errors[0]


@pytest.mark.parametrize("height", [FOOT * SLOPE, 0.6])
def test_reach_of_a_cone_and_of_a_truncated_cone(tmp_path, height):
    """The foot is thinner than a point over the last spacing/(2 SLOPE); the mass quantile is finer."""

    def beyond(r):  # volume of the quarter outside r, on the flank
        return np.pi / 2 * SLOPE * quad(lambda s: s * (FOOT - s), r, FOOT)[0]

    quantile = brentq(lambda r: beyond(r) - 0.005 * cone_volume(height), 0.8, FOOT)
    for cell in (2 * CELL, CELL):
        found = deposit(store(tmp_path / f"{cell}", column(cell), cone(cell, height)))
        assert found["R_max"] == pytest.approx(FOOT - 1.0, abs=cell)
        assert found["R_connected"] == found["R_max"]
        assert found["R_995"] == pytest.approx(quantile - 1.0, abs=cell / 8)
        assert found["h_inf"] == pytest.approx(height, abs=cell)


def test_flank_angle_of_a_cones_exact_ring_means_is_exact():
    """Also where the last ring is half covered; for a wedge on strips too."""
    edges = 0.1 * np.arange(21)
    found = eq4_profile(column(lambda0=4.0, radius=0.6), edges)
    assert flank_angle(found) == pytest.approx(FRICTION_ANGLE, abs=1e-9)
    middles = (edges[1:] + edges[:-1]) / 2
    wedge = Profile(edges, np.maximum(0.5 * (1.55 - middles), 0.0), 1, 1.0)
    assert flank_angle(wedge) == pytest.approx(np.degrees(np.arctan(0.5)), abs=1e-9)


def test_flank_angle_leaves_out_loose_grains_the_top_and_what_lies_inward_of_it():
    """Strips 1 m wide, crest on the third; of those outward, the ones at 80, 70 and 60 % are the flank."""
    thickness = np.array([0.3, 0.4, 1.0, 0.95, 0.8, 0.7, 0.6, 0.05, 0.04])
    assert flank_angle(Profile(np.arange(10.0), thickness, 1, 1.0)) == pytest.approx(np.degrees(np.arctan(0.1)))


def test_no_flank_of_three_rings_has_no_angle():
    assert np.isnan(flank_angle(on_rings([0, 1, 2, 3], [1.0, 1.0, 1.0])))  # a column as it stood
    assert np.isnan(flank_angle(on_rings([0, 1, 2, 3], [1.0, 0.6, 0.3])))
    assert not np.isnan(flank_angle(on_rings([0, 1, 2, 3, 4], [1.0, 0.6, 0.4, 0.2])))


@pytest.mark.parametrize("lambda0", LAMBDA0)
def test_eq4_profile_is_the_mean_over_each_ring_and_holds_the_columns_volume(lambda0):
    """Against quadrature, on edges as uneven as they may be; 3 m reach past the foot."""
    half = column(lambda0=lambda0, symmetry="half", radius=1.2)
    edges = np.array([0.0, 0.07, 0.5, 0.81, 1.3, 1.9, 2.0, 3.0])
    found = eq4_profile(half, edges)
    foot = 1.0 + float(eq4(lambda0, TAN))
    kinks = [1.2 * (foot - lambda0 / TAN), 1.2 * foot]
    for inner, outer, thickness in zip(edges[:-1], edges[1:], found.thickness, strict=True):
        volume, _ = quad(
            lambda r: 1.2 * r * float(quasistatic_profile(lambda0, TAN, r / 1.2)), inner, outer, points=kinks
        )
        assert thickness == pytest.approx(2 * volume / (outer**2 - inner**2), rel=1e-7, abs=1e-12)
    assert found.volume == pytest.approx(np.pi * 1.2**2 * (1.2 * lambda0) / 2, rel=1e-12)


def test_eq4_profile_is_for_columns_with_friction():
    for other in (box((1.0, 1.0, 1.0)), column(friction_angle=0.0, cohesion=1e3)):
        with pytest.raises(SceneError, match=r"Eq\. 4"):
            eq4_profile(other, [0.0, 1.0])


@pytest.mark.parametrize("lambda0", LAMBDA0)
def test_a_lattice_that_fills_eq4s_solid_is_measured_as_it(lambda0):
    """Rings cut a square lattice: under 3 % at 20 cells to the radius, and nearer with each halving of the cell."""
    distances = []
    for cell in (4 * CELL, 2 * CELL, CELL):
        scene = column(cell, lambda0)
        found = profile(eq4_solid(lambda0, cell), scene)
        distances.append(profile_distance(found, eq4_profile(scene, cell * np.arange(60))))
        assert found.volume == pytest.approx(np.pi * lambda0 / 4, rel=4e-3)
    assert distances[2] < 0.03
    assert distances[2] < distances[1] < distances[0]
    flank = 0.75 * min(lambda0, TAN * (1.0 + float(eq4(lambda0, TAN))))
    assert flank_angle(found) == pytest.approx(FRICTION_ANGLE, abs=np.degrees(0.5 * CELL / flank))


def test_two_runs_that_end_alike_have_no_distance(tmp_path):
    """The same deposit with its points in another order; a hundredth wider it is another."""
    x = cone(2 * CELL)
    shuffled = np.random.default_rng(1).permutation(x)
    wider = x * [1.01, 1.01, 1.0]
    runs = [store(tmp_path / str(i), column(2 * CELL), points) for i, points in enumerate((x, shuffled, wider))]
    first, second, third = (profile(run.snapshot(-1)["x"], run.scene) for run in runs)
    assert profile_distance(first, second) == 0.0
    assert profile_distance(first, third) > 0.005


@pytest.mark.parametrize("size", [(1.0, 0.2, 0.5), (0.5, 1.0, 0.1)])
def test_a_block_moved_by_one_cell_along_x(size):
    """A strip is empty at its back and one filled at its front: 2 cell/length, whatever its width and height."""
    scene, x = box(size), lattice(size, CELL / 2)
    moved = profile(x + np.array([CELL, 0.0, 0.0]), scene)
    assert profile_distance(moved, profile(x, scene)) == pytest.approx(2 * CELL / size[0], rel=1e-9)
    assert moved.volume == pytest.approx(np.prod(size))


def test_deposits_of_equal_volume_with_no_ring_in_common_are_2_apart():
    """A disc of radius 1 and a ring from 2 to 3, its thickness a fifth; and strips."""
    assert profile_distance(on_rings([0, 1], [1.0]), on_rings([0, 2, 3], [0.0, 0.2])) == pytest.approx(2.0)
    size = (0.5, 0.2, 0.5)
    x = lattice(size, CELL / 2)
    moved = x + np.array([size[0], 0.0, 0.0])
    assert profile_distance(profile(x, box(size)), profile(moved, box(size))) == pytest.approx(2.0)


def test_distance_between_unlike_edges_by_hand():
    """r dr: 2 on [0, 2], against 1 on [0, 3], is 4 of 9 too much and 5 of 9 missing."""
    a, b = on_rings([0, 2], [2.0]), on_rings([0, 1, 3], [1.0, 1.0])
    assert profile_distance(a, b) == pytest.approx((4 * 1.0 + 5 * 1.0) / 9)
    assert profile_distance(b, a) == pytest.approx(9 / 8)


def test_rings_have_no_distance_from_strips():
    with pytest.raises(ValueError, match="strips"):
        profile_distance(on_rings([0, 1], [1.0]), Profile(np.array([0.0, 1.0]), np.array([1.0]), 1, 1.0))


def test_one_solid_at_two_cell_sizes_is_near_and_nearer_the_smaller_they_are():
    """Means of rings of a cone's flank and of its halves differ by SLOPE cell/4 at most: 0.75 cell/FOOT of its
    volume. Rings that cut a square lattice add as much at 15 cells, less with more."""
    profiles = [profile(cone(cell), column(cell)) for cell in (4 * CELL, 2 * CELL, CELL)]
    coarse, fine = (profile_distance(a, b) for a, b in pairwise(profiles))
    assert 0.0 < fine < 1.5 * (0.75 * 2 * CELL / FOOT)
    assert fine < 0.8 * coarse


def test_deposit_of_a_cone(tmp_path):
    """Centre of mass at a quarter of the height; the slope that the profile has; no field "volume", no gain."""
    x = cone(CELL)
    found = deposit(store(tmp_path / "run", column(), x))
    assert set(found) == {
        *("R_max", "R_995", "R_connected", "h_inf"),
        *("flank_angle", "centre_height", "volume_error"),
    }
    assert found["centre_height"] == pytest.approx(FOOT * SLOPE / 4, abs=0.01 * CELL)
    assert found["flank_angle"] == pytest.approx(ANGLE, abs=0.8)
    assert found["volume_error"] is None
    elsewhere = deposit(store(tmp_path / "narrow", column(radius=0.5), x, reference=0.5))
    assert 1.0 + elsewhere["R_max"] == pytest.approx(2 * (1.0 + found["R_max"]))


def test_deposit_of_a_mesh_is_measured_about_its_axis(tmp_path):
    """A cone far from the origin: the same figures as at the origin."""
    quarter = cone(CELL, 1.2)
    x = np.concatenate([quarter * [sx, sy, 1] for sx in (-1, 1) for sy in (-1, 1)])
    at_origin = deposit(store(tmp_path / "origin", mesh(), x))
    away = deposit(
        store(tmp_path / "away", mesh(), x + np.array([40 * CELL, -80 * CELL, 0.0]), axis=(40 * CELL, -80 * CELL))
    )
    assert away.pop("volume_error") is at_origin.pop("volume_error") is None
    assert away == pytest.approx(at_origin, rel=1e-5)
    assert away["R_max"] == pytest.approx(np.hypot(x[:, 0], x[:, 1]).max() + CELL / 4 - 1.0, rel=1e-5)


def test_results_of_earlier_versions_have_their_axis_at_the_origin(tmp_path):
    run = Results.create(tmp_path, column(), {})
    run.write_static("extent", np.array([1.0, 0.5]))
    np.testing.assert_array_equal(axis_of(run), [0.0, 0.0])


def test_deposit_counts_the_volume_gained_and_takes_the_last_snapshot(tmp_path):
    x, volume = cone(2 * CELL), CELL**3
    run = store(tmp_path / "run", column(2 * CELL), x, volume=np.full(len(x), volume))
    assert deposit(run)["volume_error"] == pytest.approx(0.0, abs=1e-7)
    swollen = np.where(x[:, 2] > np.median(x[:, 2]), 1.1, 1.0) * volume
    run.write_snapshot(2.0, 20, {"x": x + np.array([0.0, 0.0, 0.3]), "volume": swollen})
    found = deposit(run)
    assert found["volume_error"] == pytest.approx(swollen.sum() / (len(x) * volume) - 1.0, rel=1e-6)
    assert found["centre_height"] == pytest.approx(x[:, 2].mean() + 0.3)


def test_deposit_of_a_box_runs_out_along_x_alone(tmp_path):
    x = lattice((1.0, 2.0, 0.5), CELL / 2)
    found = deposit(store(tmp_path / "run", box((0.8, 2.0, 0.625)), x, reference=0.8))
    assert found["R_max"] == pytest.approx((1.0 - 0.8) / 0.8, abs=1e-6)
    assert found["h_inf"] == pytest.approx(0.5, abs=1e-6)
    assert found["centre_height"] == pytest.approx(0.25, abs=1e-6)
    assert np.isnan(found["flank_angle"])


def test_a_run_without_a_snapshot_has_no_deposit(tmp_path):
    with pytest.raises(SceneError, match="no snapshot"):
        deposit(Results.create(tmp_path / "run", column(), {}))
