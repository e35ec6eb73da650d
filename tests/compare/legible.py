"""Four scenes whose pictures and pages are hard to lay out, and whether a picture's words can be read."""

import itertools

import pytest
from matplotlib.text import Text

CELL = 0.25
# Scene and sections that differ from it.
CASES = {
    "column 0.5": ("column_small", {}),
    "column 8": ("column_1", {"geometry": {"aspect_ratio": 8.0}}),
    "box one cell wide": ("elastic_bar", {"geometry": {"size": [CELL, CELL, 4.0]}}),
    "mesh off the centre": ("off_centre.toml", {}),
}
OFF_CENTRE = """
name = "off_centre"
geometry = { shape = "mesh", file = "block.obj" }
grid = { cell = 0.25 }
material = { young = 1e6, poisson = 0.3, density = 1800.0, friction_angle = 32.0 }
loads = { initial_stress = "geostatic" }
"""


def write_off_centre(folder):
    """Write a scene with a closed block whose footprint is far from the origin into `folder`."""
    corners = [(x, y, z) for x in (3.0, 4.5) for y in (-2.0, -1.0) for z in (0.0, 0.5)]
    faces = [(1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4)]
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + ["f {} {} {} {}".format(*face) for face in faces]
    (folder / "block.obj").write_text("\n".join(lines))
    (folder / "off_centre.toml").write_text(OFF_CENTRE)


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


def assert_legible(figure, name):
    """No words of `figure` are cut or overlap."""
    written = words(figure)
    assert len(written) > 5
    for text, box in written:
        inside = box.x0 >= 0 and box.y0 >= 0 and box.x1 <= figure.bbox.x1 and box.y1 <= figure.bbox.y1
        assert inside, f"{name}: {text!r} is cut"
    for (one, box), (other, another) in itertools.combinations(written, 2):
        width = min(box.x1, another.x1) - max(box.x0, another.x0)
        height = min(box.y1, another.y1) - max(box.y0, another.y0)
        assert width <= 1 or height <= 1, f"{name}: {one!r} overlaps {other!r}"
