"""Figures of how a body fills space, on lattices of points whose answer is known."""

import numpy as np
import pytest

from mpm.body import build
from mpm.load import load_scene
from mpm.packing import packing

CUBE = ["geometry.size=[1.0, 1.0, 1.0]", "grid.cell=0.125", "geometry.walls={z_min='fixed'}"]


def of(x, body, pressure=1.0):
    return packing(x, np.full(len(x), body.point_volume), np.full(len(x), pressure), body)


def test_a_lattice_is_full():
    body = build(load_scene("self_weight", CUBE))
    figures = of(body.x, body)
    assert figures["volume_ratio"] == pytest.approx(1.0)
    assert figures["most_points_in_a_cell"] == 8
    assert figures["full_cell_ratio"] == 1.0
    assert figures["pressureless_share"] == 0.0 and of(body.x, body, 0.0)["pressureless_share"] == 1.0


def test_points_taken_out_of_the_inside_are_missed():
    body = build(load_scene("self_weight", CUBE))
    inside = (np.abs(body.x[:, :2] - 0.5) < 0.25).all(axis=1) & (body.x[:, 2] < 0.5)
    thinned = body.x[~inside | (np.arange(len(body.x)) % 2 == 0)]
    assert of(thinned, body)["full_cell_ratio"] < 0.8


def test_one_point_under_the_floor_and_one_far_away_change_nothing_else():
    body = build(load_scene("self_weight", CUBE))
    x = np.vstack([body.x, [[0.5, 0.5, -0.01], [3e4, 3e4, 3e4]]])
    figures = of(x, body)
    assert figures["full_cell_ratio"] == pytest.approx(1.0, abs=0.01)
    assert figures["most_points_in_a_cell"] == 9


def test_a_thin_sheet_has_no_full_cell():
    body = build(load_scene("self_weight", ["geometry.size=[0.5, 0.5, 0.25]", "grid.cell=0.125"]))
    assert of(body.x + np.array([0.0, 0.0, 1.0]), body)["full_cell_ratio"] is None
