"""The surface that a deposit is drawn with, and pictures whose words neither overlap nor are cut."""

import numpy as np
import pytest
from legible import CASES, CELL, assert_legible, write_off_centre

import repose
from compare.plots.surface import deposit_surface

HALF = CELL / 4


def block(size):
    """Points half a cell apart that fill a box from the origin to `size` [m]."""
    axes = [(np.arange(round(2 * length / CELL)) + 0.5) * CELL / 2 for length in size]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def areas(faces):
    diagonals = faces[:, 2] - faces[:, 0], faces[:, 3] - faces[:, 1]
    return 0.5 * np.linalg.norm(np.cross(*diagonals), axis=1)


def test_the_surface_of_a_block_is_its_top_and_its_four_sides():
    x = block((1.0, 0.5, 0.75))
    faces, behind = deposit_surface(x, x[:, 2], CELL, HALF)
    flat = np.ptp(faces[:, :, 2], axis=1) == 0
    assert areas(faces[flat]).sum() == pytest.approx(1.0 * 0.5)
    assert areas(faces[~flat]).sum() == pytest.approx(2 * (1.0 + 0.5) * 0.75)
    np.testing.assert_allclose(faces.reshape(-1, 3).min(axis=0), 0.0, atol=1e-12)
    np.testing.assert_allclose(faces.reshape(-1, 3).max(axis=0), [1.0, 0.5, 0.75])
    # a side's colour is the mean height of the points in its layer: the layer's middle
    np.testing.assert_allclose(behind[~flat], faces[~flat].mean(axis=1)[:, 2])


def test_a_step_is_sloped_over_one_cell_and_nothing_hangs_above_the_points():
    x = block((1.0, 0.5, 0.75))
    x = x[(x[:, 2] < 0.25) | (x[:, 0] < 0.5)]
    faces, _ = deposit_surface(x, x[:, 2], CELL, HALF)
    top = faces[np.abs(np.cross(faces[:, 2] - faces[:, 0], faces[:, 3] - faces[:, 1])[:, 2]) > 1e-9]
    corners = top.reshape(-1, 3)
    assert set(np.round(corners[:, 2], 6)) == {0.25, 0.5, 0.75}
    np.testing.assert_allclose(corners[np.isclose(corners[:, 2], 0.5), 0], 0.5)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Holds the scene of the mesh."""
    folder = tmp_path_factory.mktemp("mesh")
    write_off_centre(folder)
    return folder


@pytest.fixture(scope="module", params=CASES)
def pictures(request, folder):
    scene, sections = CASES[request.param]
    short = {"grid": {"cell": CELL}, "explicit": {"until": 0.1}, "output": {"history_every": 0.01}}
    result = repose.run(
        repose.load_scene(folder / scene if ".toml" in scene else scene, **short | sections), progress=False
    )
    drawn = {"morphology": result.plot_morphology(), "history": result.plot_history()}
    if result.scene.geometry.shape == "column":
        drawn["profile"] = result.plot_profile()
    return drawn


def test_no_words_of_a_picture_are_cut_or_overlap(pictures):
    for name, figure in pictures.items():
        assert_legible(figure, name)
