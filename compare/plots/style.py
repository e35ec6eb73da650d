"""What every picture shares: style, colours, figures without pyplot, what a scene's points are coloured by."""

import io
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from scipy.spatial import ConvexHull

from mpm.errors import SceneError
from mpm.scene import Column

STYLE = {
    "font.size": 10,
    "axes.titlesize": 10,
    "legend.fontsize": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "lines.linewidth": 1.6,
}
DPI = 150
NARROW = 0.6  # inches of an axis that a number takes
# Okabe and Ito's colours, told apart with every common colour blindness.
BLACK, ORANGE, SKY, GREEN = "#000000", "#E69F00", "#56B4E9", "#009E73"
BLUE, RED, PURPLE = "#0072B2", "#D55E00", "#CC79A7"
EQ4_LABEL = "Eq. 4 (quasistatic)"


def styled():
    """A context in which figures are drawn in the house's style."""
    return rc_context(STYLE)


class ShownFigure(Figure):
    """A Figure that a notebook shows, as it shows those of pyplot."""

    def _repr_png_(self) -> bytes:
        """What IPython asks of an object that it is to show."""
        png = io.BytesIO()
        self.savefig(png)
        return png.getvalue()


def new_figure(width, height):
    """A figure of that size in inches, drawn by Agg, at the resolution it is saved in."""
    figure = ShownFigure(figsize=(width, height), dpi=DPI)
    FigureCanvasAgg(figure)
    return figure


def save(figure, path) -> Path:
    """Write the figure; the path it was written to."""
    figure.savefig(path)
    return Path(path)


def title_of(results, at: float | None = None) -> str:
    """What a picture of a run is headed by: scene, solver, damping, resolution and the time `at` [s] it shows."""
    scene, mode = results.scene, results.provenance.get("mode", "explicit")
    how = "quasistatic" if mode == "implicit" else f"D = {scene.explicit.damping:g}"
    body, cell = scene.geometry, scene.grid.cell
    size = f"{body.radius / cell:.3g} cells per r0" if isinstance(body, Column) else f"cell {cell:.3g} m"
    time = "" if at is None else f", {'pseudo-time' if mode == 'implicit' else 't ='} {at:.3g} s"
    return f"{scene.name}: {mode}, {how}, {size}{time}"


def last_snapshot(results) -> dict:
    """The last snapshot of a run. Raises SceneError where there is none."""
    if results.snapshot_count == 0:
        raise SceneError(f"{results.directory} has no snapshot to plot")
    return results.snapshot(-1)


def colour_values(x, x0, snapshot):
    """What to colour the points by, shape [n], and its label."""
    if "eps_p_eqv" in snapshot:
        return snapshot["eps_p_eqv"], "equivalent plastic strain [-]"
    return np.linalg.norm(x - x0, axis=1), "displacement [m]"


def draw_section(axes, x, x0, values, cell, half, colours, axis):
    """Points within one cell of a plane y = const through the initial body's top: of its highest points the one
    nearest the `axis` (x, y) [m] gives the plane, or the axis itself where that is less than a cell away."""
    tops = x0[x0[:, 2] > x0[:, 2].max() - half, 1]
    nearest = tops[np.argmin(np.abs(tops - axis[1]))]
    middle = axis[1] if abs(nearest - axis[1]) < cell else nearest
    inside, inside0 = (np.abs(points[:, 1] - middle) < cell for points in (x, x0))
    outline_hull = hull(x0[inside0][:, [0, 2]], half)
    outline = outline_hull.points[np.append(outline_hull.vertices, outline_hull.vertices[0])]
    axes.plot(*outline.T, "--", color=BLUE, linewidth=1.2, zorder=3)
    x, values = x[inside], values[inside]
    axes.set(xlabel="x [m]", ylabel="z [m]")
    axes.set_aspect("equal")
    axes.update_datalim(x[:, [0, 2]])
    axes.autoscale_view()
    axes.apply_aspect()
    width = axes.get_position().width * axes.figure.get_figwidth()
    if width < NARROW:
        axes.set_xticks([axes.get_xlim()[1]], [f"{axes.get_xlim()[1]:.3g}"])
    else:
        axes.locator_params(axis="x", nbins=int(width / NARROW) + 1)
    scale = axes.transData.transform([[0, 0], [2 * half, 0]])
    size = (scale[1, 0] - scale[0, 0]) * 72 / DPI
    points = axes.scatter(x[:, 0], x[:, 2], c=values, s=(1.2 * size) ** 2, marker="s", zorder=2, **colours)
    axes.set_title(f"section at y = {middle:.3g} m\ndashed: initial outline", loc="left")
    return points


def hull(x, half):
    """Convex hull of the points' domains: cubes (squares in 2D) of the half-length around them."""
    corners = half * (2.0 * np.indices((2,) * x.shape[1]).reshape(x.shape[1], -1).T - 1.0)
    return ConvexHull((x[:, None] + corners).reshape(-1, x.shape[1]))
