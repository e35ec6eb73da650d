"""Run-out measures on solids whose radii, mass quantiles and heights are known in closed form."""

import numpy as np
import pytest
from scipy.optimize import brentq

from mpm.runout import Measure, connected, front, run_out

CELL = 0.05
SPACING = CELL / 2
HALF_LENGTH = CELL / 4
R0 = 0.8  # the radius that run-outs are counted from
RADIAL = Measure((0, 1), R0, HALF_LENGTH, CELL)
PLANE_STRAIN = Measure((0,), R0, HALF_LENGTH, CELL)
LATTICE_ERROR = SPACING / R0  # a lattice shows a solid's edge to one spacing


def lattice(x, y, z):
    """Points half a cell apart that fill x, y, z in [0, given)."""
    axes = [(np.arange(round(length / SPACING)) + 0.5) * SPACING for length in (x, y, z)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def solid(height_at, radius, height):
    """Lattice points of a quarter of a body of revolution below `height_at(r)`."""
    x = lattice(radius, radius, height)
    r = np.hypot(x[:, 0], x[:, 1])
    return x[(r <= radius) & (x[:, 2] <= height_at(r))]


CYLINDER = solid(lambda r: np.full_like(r, 0.5), 1.5, 0.5)
CONE = solid(lambda r: 1.2 * (1 - r / 1.5), 1.5, 1.2)
TOP, BASE = 0.7, 1.5  # radii of the truncated cone
TRUNCATED = solid(lambda r: np.clip(0.6 * (BASE - r) / (BASE - TOP), 0.0, 0.6), BASE, 0.6)


def run_out_of(radius):
    return (radius - R0) / R0


def truncated_cone_mass_inside(r):
    """Volume inside radius r > TOP, over 2 pi h: the flat part, then the flank."""
    flank = (BASE * (r**2 - TOP**2) / 2 - (r**3 - TOP**3) / 3) / (BASE - TOP)
    return TOP**2 / 2 + flank


def test_cylinder():
    """Mass inside r goes as r^2."""
    found = run_out(CYLINDER, RADIAL)
    assert found["R_max"] == pytest.approx(run_out_of(1.5), abs=LATTICE_ERROR)
    assert found["R_995"] == pytest.approx(run_out_of(1.5 * np.sqrt(0.995)), abs=0.25 * LATTICE_ERROR)
    assert found["R_connected"] == found["R_max"]
    assert found["h_inf"] == pytest.approx(0.5)


def test_cone():
    """Mass inside r = s R goes as 3 s^2 - 2 s^3."""
    s = brentq(lambda s: 3 * s**2 - 2 * s**3 - 0.995, 0.5, 1.0)
    found = run_out(CONE, RADIAL)
    assert found["R_995"] == pytest.approx(run_out_of(1.5 * s), abs=0.25 * LATTICE_ERROR)
    assert found["R_max"] == pytest.approx(run_out_of(1.5), abs=2 * LATTICE_ERROR)  # its edge is thin
    assert found["h_inf"] == pytest.approx(1.2, abs=2 * SPACING)


def test_truncated_cone():
    total = truncated_cone_mass_inside(BASE)
    quantile = brentq(lambda r: truncated_cone_mass_inside(r) - 0.995 * total, TOP, BASE)
    found = run_out(TRUNCATED, RADIAL)
    assert found["R_995"] == pytest.approx(run_out_of(quantile), abs=0.25 * LATTICE_ERROR)
    assert found["R_max"] == pytest.approx(run_out_of(BASE), abs=2 * LATTICE_ERROR)
    assert found["h_inf"] == pytest.approx(0.6)


def test_the_farthest_point_counts_with_its_half_length():
    x = np.array([[0.0, 0.0, 0.1], [3.0, 4.0, 0.2]])
    assert front(x, RADIAL)["R_max"] == pytest.approx(run_out_of(5.0 + HALF_LENGTH))
    assert front(x, RADIAL)["height"] == pytest.approx(0.2 + HALF_LENGTH)


def test_a_body_that_has_not_moved_has_run_out_zero():
    x = lattice(R0, CELL, 0.5)
    assert front(x, PLANE_STRAIN)["R_max"] == pytest.approx(0.0, abs=1e-12)


CLUSTER = lattice(2 * CELL, 2 * CELL, 2 * CELL)


def test_a_detached_cluster_is_left_out_of_r_connected_alone():
    """64 of 80,000 points: too few for the 99.5 % quantile to see."""
    cluster = CLUSTER + np.array([2.5, 0.5, 0.0])
    assert len(cluster) < 0.002 * len(CYLINDER)
    alone, both = run_out(CYLINDER, RADIAL), run_out(np.concatenate([cluster, CYLINDER]), RADIAL)
    assert both["R_connected"] == alone["R_connected"]
    assert both["h_inf"] == alone["h_inf"]
    corner = np.hypot(2.6 - SPACING / 2, 0.6 - SPACING / 2) + HALF_LENGTH
    assert both["R_max"] == pytest.approx(run_out_of(corner))
    assert both["R_995"] == pytest.approx(run_out_of(1.5 * np.sqrt(0.995)), abs=0.5 * LATTICE_ERROR)


def test_a_grain_in_the_air_above_the_axis_does_not_count_as_the_body():
    x = np.concatenate([[[0.01, 0.01, 3.0]], CYLINDER])
    assert run_out(x, RADIAL)["h_inf"] == pytest.approx(0.5)
    assert not connected(x, CELL)[0]


@pytest.mark.parametrize(
    ("shift", "joined"),
    [
        ((1, 0, 0), True),  # a face in common
        ((1, 1, 0), True),  # an edge
        ((1, 1, 1), True),  # a corner: the points' domains still share a node
        ((2, 0, 0), False),  # an empty cell between
        ((0, 0, 2), False),
        ((2, 2, 2), False),
    ],
)
def test_points_belong_together_when_their_cells_touch(shift, joined):
    x = np.array([[0.5, 0.5, 0.5], np.add(shift, 0.5)]) * CELL
    np.testing.assert_array_equal(connected(x, CELL), [True, joined])


def test_a_chain_joins_its_ends():
    x = (np.arange(100)[:, None] + 0.5) * CELL * [1.0, 0.0, 0.0]
    assert connected(x, CELL).all()
    assert connected(np.delete(x, 50, axis=0), CELL).sum() == 50


def test_plane_strain_counts_the_distance_along_x_only():
    """Mass inside x = s L goes as s for a block and as 2 s - s^2 for a wedge, whatever its width."""
    block = lattice(1.5, 1.0, 0.5)
    found = run_out(block, PLANE_STRAIN)
    assert found["R_max"] == pytest.approx(run_out_of(1.5))
    assert found["R_995"] == pytest.approx(run_out_of(1.5 * 0.995), abs=0.5 * LATTICE_ERROR)
    wedge = lattice(1.5, 0.5, 1.2)
    wedge = wedge[wedge[:, 2] <= 1.2 * (1 - wedge[:, 0] / 1.5)]
    found = run_out(wedge, PLANE_STRAIN)
    assert found["R_995"] == pytest.approx(run_out_of(1.5 * (1 - np.sqrt(0.005))), abs=0.5 * LATTICE_ERROR)
    assert run_out(block, RADIAL)["R_max"] > found["R_max"] + 0.1


def test_a_body_away_from_the_origin_is_measured_about_its_own_axis():
    """Moved by whole cells: the same figures, and the component nearest the axis, not the origin, is the body."""
    shift = np.array([40 * CELL, -60 * CELL, 0.0])
    moved = Measure((0, 1), R0, HALF_LENGTH, CELL, axis=(shift[0], shift[1]))
    at_origin = np.concatenate([CLUSTER + np.array([0.1, 0.1, 0.0]), CYLINDER + shift])
    assert run_out(CYLINDER + shift, moved) == pytest.approx(run_out(CYLINDER, RADIAL), abs=1e-9)
    assert run_out(at_origin, moved)["h_inf"] == pytest.approx(0.5)
    np.testing.assert_array_equal(
        connected(at_origin, CELL, (shift[0], shift[1])), np.arange(len(at_origin)) >= len(CLUSTER)
    )


def test_points_on_both_sides_of_the_axis_count_alike():
    mirrored = np.concatenate([CYLINDER, CYLINDER * [-1, 1, 1], CYLINDER * [1, -1, 1], CYLINDER * [-1, -1, 1]])
    quarter, full = run_out(CYLINDER, RADIAL), run_out(mirrored, RADIAL)
    assert full == pytest.approx(quarter, abs=1e-5)
