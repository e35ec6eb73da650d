"""Pictures of one run, made from its results store alone.

Each function draws into a Figure of its own (no pyplot, so nothing global is left behind) and returns the
path it wrote.
"""

from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import proj3d
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection
from scipy.spatial import ConvexHull

from implicit.relaxation import REST_UNBALANCED
from mpm.analytic import eq4, quasistatic_profile
from mpm.errors import SceneError
from mpm.results import Results

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
# Okabe and Ito's colours, told apart with every common colour blindness.
BLACK, ORANGE, SKY, GREEN = "#000000", "#E69F00", "#56B4E9", "#009E73"
BLUE, RED, PURPLE = "#0072B2", "#D55E00", "#CC79A7"
# Column, label, colour, line style.
RUN_OUTS = (
    ("R_max", "farthest point", ORANGE, "-"),
    ("R_995", "99.5 % of the mass", BLUE, "-"),
    ("R_connected", "connected to the axis", GREEN, "--"),  # often the farthest point itself
)
ENERGIES = (
    ("W_ext", "work of gravity", BLACK, "-"),
    ("KE_points", "kinetic, points", ORANGE, "-"),
    ("KE_grid", "kinetic, grid", SKY, "-"),
    ("E_elastic", "elastic", GREEN, "-"),
    ("W_plastic", "plastic dissipation", BLUE, "-"),
    ("W_damping", "damping", PURPLE, "-"),
    ("residual", "residual", RED, ":"),
)
EQ4_LABEL = "Eq. 4 (quasistatic)"
# The part of the full circle that the scene holds.
SECTOR = {"full": 1.0, "half": 0.5, "quarter": 0.25}


def plot_morphology(results: Results, path) -> Path:
    """The deposit of the last snapshot in 3D and in a vertical section, as in Fig. 9 of Wyser et al. 2023.

    Colour is the equivalent plastic strain, or the displacement [m] where there is none (elastic scenes).
    The initial body's convex hull is a blue shell, dashed in the section. SceneError without a snapshot.
    """
    last = _last_snapshot(results)
    x, x0 = last["x"], results.read_static("x0")
    values, label = _colour_values(x, x0, last)
    cell, half_length = _lengths(results.scene)
    colours = {"cmap": "viridis", "vmin": 0.0, "vmax": np.quantile(values, 0.98) or 1.0, "linewidths": 0}
    with rc_context(STYLE):
        figure = _figure(11.0, 4.6)
        view = figure.add_axes((0.0, 0.05, 0.5, 0.92), projection="3d", computed_zorder=False)
        section = figure.add_axes((0.58, 0.13, 0.31, 0.74), anchor="W")
        _draw_view(view, x, x0, values, cell, half_length, colours)
        points = _draw_section(section, x, x0, values, cell, half_length, colours)
        scale = figure.add_axes((0.925, 0.13, 0.014, 0.74))
        figure.colorbar(points, cax=scale, label=label, extend="max")
        scale.grid(False)
        figure.text(0.02, 0.95, f"{results.scene['name']}, t = {last['time']:.3g} s", weight="bold")
        return _save(figure, path)


def plot_profile(results: Results, path) -> Path:
    """Height of the last snapshot's deposit over the radius, against Eq. 4's solid and the initial column.

    Raises SceneError for a scene that is not a column, and without a snapshot.
    """
    scene, last = results.scene, _last_snapshot(results)
    if scene["geometry"]["shape"] != "column":
        raise SceneError(f"{results.directory}: only a column has a radial profile")
    cell, half_length = _lengths(scene)
    sector = SECTOR[scene["geometry"]["symmetry"]]
    edges, highest, thickness = _radial_profile(last, cell, half_length, sector)
    middles = (edges[1:] + edges[:-1]) / 2
    radius = scene["geometry"]["radius"]
    height = radius * scene["geometry"]["aspect_ratio"]
    fine = np.linspace(0.0, edges[-1], 600)
    with rc_context(STYLE):
        figure = _figure(8.0, 4.2)
        axes = figure.add_axes((0.09, 0.14, 0.88, 0.76))
        axes.plot([0, radius, radius], [height, height, 0], "--", color=SKY, label="initial column")
        if _has_eq4(scene):
            solid = radius * quasistatic_profile(height / radius, _tan_theta(scene), fine / radius)
            axes.fill_between(fine, solid, color=BLACK, alpha=0.08, linewidth=0)
            axes.plot(fine, solid, color=BLACK, label=EQ4_LABEL)
        axes.plot(middles, highest, "o", color=ORANGE, markersize=4, label="highest point in the ring")
        mean_label = "mean thickness (volume / ring area)"
        axes.stairs(thickness, edges, baseline=None, color=BLUE, linewidth=1.6, label=mean_label)
        axes.set(xlim=(0, edges[-1]), ylim=(0, None), xlabel="radius r [m]", ylabel="height [m]")
        axes.set_title(f"{scene['name']}, t = {last['time']:.3g} s", loc="left", weight="bold")
        axes.legend(frameon=False)
        return _save(figure, path)


def plot_history(results: Results, path) -> Path:
    """Run-out measures over time, beside them energies (explicit) or balance and Newton's iterations (implicit).

    Raises SceneError where no history was written.
    """
    history, scene = results.history(), results.scene
    if not history:
        raise SceneError(f"{results.directory} has no history to plot")
    with rc_context(STYLE):
        figure = _figure(11.0, 4.4)
        run_out = figure.add_axes((0.065, 0.14, 0.37, 0.76))
        beside = figure.add_axes((0.52, 0.14, 0.30, 0.76))
        _draw_columns(run_out, history, RUN_OUTS)
        if _has_eq4(scene):
            limit = eq4(scene["geometry"]["aspect_ratio"], _tan_theta(scene))
            run_out.axhline(limit, color=BLACK, linestyle="--", label=EQ4_LABEL)
        if "unbalanced" in history:
            _draw_balance(beside, history)
            time = "pseudo-time [s]"
        else:
            _draw_columns(beside, history, ENERGIES)
            beside.set(ylabel="energy [J]")
            beside.legend(frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
            time = "time [s]"
        beside.set(xlabel=time)
        run_out.set(xlabel=time, ylabel="run-out $(r - r_0)/r_0$ [-]")
        run_out.set_title(scene["name"], loc="left", weight="bold")
        run_out.legend(frameon=False)
        return _save(figure, path)


def _draw_view(axes, x, x0, values, cell, half_length, colours):
    """The deposit's surface as points sorted by depth, over the translucent initial shell."""
    # All but the outer points are hidden, and 200,000 markers are slow: draw those of surface cells only.
    shown = _on_surface(x, cell)
    both = np.concatenate([x, x0])
    low, high = both.min(axis=0) - half_length, both.max(axis=0) + half_length
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(high - low, zoom=0.88)
    axes.view_init(elev=22, azim=-60)
    size = _spacing_in_points(axes, (low + high) / 2, 2 * half_length)
    _draw_shell(axes, x0, half_length)
    # Above the shell: where the deposit is inside it the colours keep their meaning.
    points = x[shown]
    axes.scatter(*points.T, c=values[shown], s=(1.3 * size) ** 2, depthshade=False, zorder=2, **colours)
    axes.locator_params(nbins=4)
    # The x axis ends where the y axis starts: without y's first tick their numbers stay apart.
    axes.set_yticks([tick for tick in axes.get_yticks() if low[1] + 0.1 * (high - low)[1] < tick < high[1]])
    axes.set_xlabel("x [m]", labelpad=8)
    axes.set_ylabel("y [m]", labelpad=8)
    axes.set_zlabel("z [m]", labelpad=8)


def _draw_shell(axes, x0, half_length):
    """The convex hull of the initial points' domains: faces in translucent blue, and its sharp edges."""
    hull = _hull(x0, half_length)
    faces = hull.points[hull.simplices]
    axes.add_collection3d(Poly3DCollection(faces, color=SKY, alpha=0.18, linewidths=0, zorder=0))
    edges = []
    for face, (neighbours, normal) in enumerate(zip(hull.neighbors, hull.equations[:, :3], strict=True)):
        for corner, other in enumerate(neighbours):
            if other > face and normal @ hull.equations[other, :3] < 0.7:
                edges.append(hull.points[np.delete(hull.simplices[face], corner)])
    axes.add_collection3d(Line3DCollection(edges, colors=BLUE, linewidths=1.0, zorder=1))


def _draw_section(axes, x, x0, values, cell, half_length, colours):
    """Points within one cell of the plane y = 0 or, for a body off it, of the first one that meets it."""
    nearest = x0[np.argmin(np.abs(x0[:, 1])), 1]
    middle = 0.0 if abs(nearest) < cell else nearest
    inside, inside0 = (np.abs(points[:, 1] - middle) < cell for points in (x, x0))
    hull = _hull(x0[inside0][:, [0, 2]], half_length)
    outline = hull.points[np.append(hull.vertices, hull.vertices[0])]
    axes.plot(*outline.T, "--", color=BLUE, linewidth=1.2, zorder=3)
    x, values = x[inside], values[inside]
    axes.set(xlabel="x [m]", ylabel="z [m]")
    axes.set_aspect("equal")
    axes.update_datalim(x[:, [0, 2]])
    axes.autoscale_view()
    axes.apply_aspect()
    scale = axes.transData.transform([[0, 0], [2 * half_length, 0]])
    size = (scale[1, 0] - scale[0, 0]) * 72 / DPI
    points = axes.scatter(x[:, 0], x[:, 2], c=values, s=(1.2 * size) ** 2, marker="s", zorder=2, **colours)
    axes.set_title(f"section at y = {middle:.3g} m\ndashed: initial outline", loc="left")
    return points


def _draw_columns(axes, history, columns):
    for name, label, colour, style in columns:
        if name in history:
            axes.plot(history["time"], history[name], style, color=colour, label=label)


def _draw_balance(axes, history):
    """Out-of-balance over external forces, with the bound for rest, and Newton's iterations of each step."""
    axes.semilogy(history["time"], history["unbalanced"], color=BLUE, label="out-of-balance")
    axes.axhline(REST_UNBALANCED, color=BLACK, linestyle="--", label="bound for rest")
    low, high = axes.get_ylim()  # a decade about the bound at least: within one, an axis has hardly a label
    axes.set_ylim(min(low, 0.1 * REST_UNBALANCED), max(high, 10 * REST_UNBALANCED))
    axes.set(ylabel="out-of-balance / external forces [-]")
    counts = axes.twinx()
    counts.plot(history["time"][1:], history["newton"][1:], ".", color=ORANGE, label="Newton iterations")
    counts.set(ylabel="Newton iterations of the step [-]", ylim=(0, None))
    counts.spines.right.set_visible(True)
    counts.locator_params(axis="y", integer=True)
    counts.grid(False)
    lines = [*axes.lines, *counts.lines]
    labels = [line.get_label() for line in lines]
    axes.legend(lines, labels, frameon=False, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, columnspacing=1.0)


def _radial_profile(snapshot, cell, half_length, sector):
    """Ring edges [m], highest point per ring (NaN where empty) and mean thickness [m], rings one cell wide.

    sector: the part of the full circle that the scene holds.
    """
    x = snapshot["x"]
    ring = (np.hypot(x[:, 0], x[:, 1]) / cell).astype(int)
    edges = cell * np.arange(ring.max() + 2)
    highest = np.full(len(edges) - 1, -np.inf)
    np.maximum.at(highest, ring, x[:, 2] + half_length)
    highest[np.isinf(highest)] = np.nan
    # Without the field: points keep their initial volume, which they nearly do.
    volume = np.broadcast_to(snapshot.get("volume", (2 * half_length) ** 3), len(x))
    area = sector * np.pi * np.diff(edges**2)
    return edges, highest, np.bincount(ring, weights=volume, minlength=len(area)) / area


def _has_eq4(scene):
    """Whether Eq. 4 speaks of this scene: a column that yields by friction."""
    material = scene["material"]
    return scene["geometry"]["shape"] == "column" and material["model"] != "elastic" and _tan_theta(scene) > 0


def _tan_theta(scene):
    """Eq. 4's slope [-]: the angle of repose is taken to be the friction angle."""
    return np.tan(np.radians(scene["material"]["friction_angle"]))


def _last_snapshot(results):
    if results.snapshot_count == 0:
        raise SceneError(f"{results.directory} has no snapshot to plot")
    return results.snapshot(-1)


def _lengths(scene):
    """Cell size and a point's half-length [m]."""
    cell = scene["grid"]["cell"]
    return cell, cell / (2 * scene["grid"]["points_per_cell"])


def _colour_values(x, x0, snapshot):
    """What to colour the points by, shape [n], and its label."""
    if "eps_p_eqv" in snapshot:
        return snapshot["eps_p_eqv"], "equivalent plastic strain [-]"
    return np.linalg.norm(x - x0, axis=1), "displacement [m]"


def _on_surface(x, cell):
    """Whether each point lies in a cell with an empty face neighbour, shape [n]."""
    index = np.floor(x / cell).astype(np.int64)
    index -= index.min(axis=0) - 1  # one empty layer around, so that neighbours never wrap
    shape = index.max(axis=0) + 2
    strides = np.array([shape[1] * shape[2], shape[2], 1])
    key = index @ strides
    occupied = np.unique(key)
    return ~np.all([np.isin(key + step, occupied) for step in (*strides, *-strides)], axis=0)


def _hull(x, half_length):
    """Convex hull of the points' domains: cubes (squares in 2D) of the half-length around them."""
    corners = half_length * (2.0 * np.indices((2,) * x.shape[1]).reshape(x.shape[1], -1).T - 1.0)
    return ConvexHull((x[:, None] + corners).reshape(-1, x.shape[1]))


def _spacing_in_points(axes, centre, length):
    """How long `length` [m] at `centre` is on a 3D view's paper, in points (1/72 inch)."""
    # Along an axis seen at a slant it shrinks: the largest of the three is the true scale.
    ends = np.vstack([centre, centre + length * np.eye(3)])
    flat = np.column_stack(proj3d.proj_transform(*ends.T, axes.get_proj())[:2])
    pixels = axes.transData.transform(flat)
    return np.linalg.norm(pixels[1:] - pixels[0], axis=1).max() * 72 / DPI


def _figure(width, height):
    """A figure of that size in inches, drawn by Agg, at the resolution it is saved in."""
    figure = Figure(figsize=(width, height), dpi=DPI)
    FigureCanvasAgg(figure)
    return figure


def _save(figure, path):
    figure.savefig(path)
    return Path(path)
