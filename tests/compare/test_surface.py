"""The surface that a deposit is drawn with, and pictures whose words neither overlap nor are cut."""

import itertools

import numpy as np
import pytest
from matplotlib.text import Text

import repose
from compare.plots.surface import deposit_surface

CELL = 0.25
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


CASES = {
    "column 0.5": ("column_small", {}),
    "column 8": ("column_1", {"geometry": {"aspect_ratio": 8.0}}),
    "box one cell wide": ("elastic_bar", {"geometry": {"size": [0.25, 0.25, 4.0]}}),
    "mesh off the centre": ("off_centre.toml", {}),
}
OFF_CENTRE = """
name = "off_centre"
geometry = { shape = "mesh", file = "block.obj" }
grid = { cell = 0.25 }
material = { young = 1e6, poisson = 0.3, density = 1800.0, friction_angle = 32.0 }
loads = { initial_stress = "geostatic" }
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Holds a scene with a closed block whose footprint is far from the origin."""
    folder = tmp_path_factory.mktemp("mesh")
    corners = [(x, y, z) for x in (3.0, 4.5) for y in (-2.0, -1.0) for z in (0.0, 0.5)]
    faces = [(1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4)]
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + ["f {} {} {} {}".format(*face) for face in faces]
    (folder / "block.obj").write_text("\n".join(lines))
    (folder / "off_centre.toml").write_text(OFF_CENTRE)
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


def words(figure):
    """What is written when a figure is drawn, with its bounding box in pixels."""
    written, draw = [], Text.draw

    def noted(text, renderer):
        if text.get_visible() and text.get_text().strip():
            written.append((text.get_text(), text.get_window_extent(renderer)))
        draw(text, renderer)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Text, "draw", noted)
        figure.canvas.draw()
    return written


def test_no_words_of_a_picture_are_cut_or_overlap(pictures):
    for name, figure in pictures.items():
        written = words(figure)
        assert len(written) > 5
        for text, box in written:
            inside = box.x0 >= 0 and box.y0 >= 0 and box.x1 <= figure.bbox.x1 and box.y1 <= figure.bbox.y1
            assert inside, f"{name}: {text!r} is cut"
        for (one, box), (other, another) in itertools.combinations(written, 2):
            width = min(box.x1, another.x1) - max(box.x0, another.x0)
            height = min(box.y1, another.y1) - max(box.y0, another.y0)
            assert width <= 1 or height <= 1, f"{name}: {one!r} overlaps {other!r}"
