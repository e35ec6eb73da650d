"""Pictures of one run, made from its results store alone.

Each function draws into a matplotlib Figure of its own (no pyplot, so nothing global is left behind) and returns it.
"""

import numpy as np
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import proj3d
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

from compare.metrics import axis_of, half_length, highest, profile
from compare.plots.style import (
    BLACK,
    BLUE,
    DPI,
    EQ4_LABEL,
    GREEN,
    ORANGE,
    PURPLE,
    RED,
    SKY,
    colour_values,
    draw_section,
    hull,
    last_snapshot,
    new_figure,
    styled,
    tan_theta,
)
from implicit.pseudo_time import REST_UNBALANCED
from mpm.errors import SceneError
from mpm.results import Results
from mpm.theory import eq4, has_eq4, quasistatic_profile

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


def plot_morphology(results: Results) -> Figure:
    """The deposit of the last snapshot in 3D and in a vertical section, as in Fig. 9 of Wyser et al. 2023.

    Colour is the equivalent plastic strain, or the displacement [m] where there is none (elastic scenes).
    The initial body's convex hull is a blue shell, dashed in the section. SceneError without a snapshot.
    """
    last = last_snapshot(results)
    x, x0 = last["x"], results.read_static("x0")
    values, label = colour_values(x, x0, last)
    cell, half = results.scene["grid"]["cell"], half_length(results.scene)
    colours = {"cmap": "viridis", "vmin": 0.0, "vmax": np.quantile(values, 0.98) or 1.0, "linewidths": 0}
    with styled():
        figure = new_figure(11.0, 4.6)
        view = figure.add_axes((0.0, 0.05, 0.5, 0.92), projection="3d", computed_zorder=False)
        section = figure.add_axes((0.58, 0.13, 0.31, 0.74), anchor="W")
        _draw_view(view, x, x0, values, cell, half, colours)
        points = draw_section(section, x, x0, values, cell, half, colours, axis_of(results))
        scale = figure.add_axes((0.925, 0.13, 0.014, 0.74))
        figure.colorbar(points, cax=scale, label=label, extend="max")
        scale.grid(False)
        figure.text(0.02, 0.95, f"{results.scene['name']}, t = {last['time']:.3g} s", weight="bold")
        return figure


def plot_profile(results: Results) -> Figure:
    """Height of the last snapshot's deposit over the radius, against Eq. 4's solid and the initial column.

    Raises SceneError for a scene that is not a column, and without a snapshot.
    """
    scene, last = results.scene, last_snapshot(results)
    if scene["geometry"]["shape"] != "column":
        raise SceneError(f"{results.directory}: only a column has a radial profile")
    deposit = profile(last["x"], scene)
    edges = deposit.edges
    top = highest(last["x"], scene)
    middles = (np.arange(len(top)) + 0.5) * scene["grid"]["cell"]
    radius = scene["geometry"]["radius"]
    height = radius * scene["geometry"]["aspect_ratio"]
    fine = np.linspace(0.0, edges[-1], 600)
    with styled():
        figure = new_figure(8.0, 4.2)
        axes = figure.add_axes((0.09, 0.14, 0.88, 0.76))
        axes.plot([0, radius, radius], [height, height, 0], "--", color=SKY, label="initial column")
        if has_eq4(scene):
            solid = radius * quasistatic_profile(height / radius, tan_theta(scene), fine / radius)
            axes.fill_between(fine, solid, color=BLACK, alpha=0.08, linewidth=0)
            axes.plot(fine, solid, color=BLACK, label=EQ4_LABEL)
        axes.plot(middles, top, "o", color=ORANGE, markersize=4, label="highest point in the ring")
        mean_label = "mean thickness (initial volume / ring area)"
        axes.stairs(deposit.thickness, edges, baseline=None, color=BLUE, linewidth=1.6, label=mean_label)
        axes.set(xlim=(0, edges[-1]), ylim=(0, None), xlabel="radius r [m]", ylabel="height [m]")
        axes.set_title(f"{scene['name']}, t = {last['time']:.3g} s", loc="left", weight="bold")
        axes.legend(frameon=False)
        return figure


def plot_history(results: Results) -> Figure:
    """Run-out measures over time, beside them energies (explicit) or balance and Newton's iterations (implicit).

    Raises SceneError where no history was written.
    """
    history, scene = results.history(), results.scene
    if not history:
        raise SceneError(f"{results.directory} has no history to plot")
    with styled():
        figure = new_figure(11.0, 4.4)
        run_out = figure.add_axes((0.065, 0.14, 0.37, 0.76))
        beside = figure.add_axes((0.52, 0.14, 0.30, 0.76))
        _draw_columns(run_out, history, RUN_OUTS)
        if has_eq4(scene):
            limit = eq4(scene["geometry"]["aspect_ratio"], tan_theta(scene))
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
        return figure


def _draw_view(axes, x, x0, values, cell, half, colours):
    """The deposit's surface as points sorted by depth, over the translucent initial shell."""
    # All but the outer points are hidden, and 200,000 markers are slow: draw those of surface cells only.
    shown = _on_surface(x, cell)
    both = np.concatenate([x, x0])
    low, high = both.min(axis=0) - half, both.max(axis=0) + half
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(high - low, zoom=0.88)
    axes.view_init(elev=22, azim=-60)
    size = _spacing_in_points(axes, (low + high) / 2, 2 * half)
    _draw_shell(axes, x0, half)
    # Above the shell: where the deposit is inside it the colours keep their meaning.
    points = x[shown]
    axes.scatter(*points.T, c=values[shown], s=(1.3 * size) ** 2, depthshade=False, zorder=2, **colours)
    axes.locator_params(nbins=4)
    # The x axis ends where the y axis starts: without y's first tick their numbers stay apart.
    axes.set_yticks([tick for tick in axes.get_yticks() if low[1] + 0.1 * (high - low)[1] < tick < high[1]])
    axes.set_xlabel("x [m]", labelpad=8)
    axes.set_ylabel("y [m]", labelpad=8)
    axes.set_zlabel("z [m]", labelpad=8)


def _draw_shell(axes, x0, half):
    """The convex hull of the initial points' domains: faces in translucent blue, and its sharp edges."""
    shell = hull(x0, half)
    faces = shell.points[shell.simplices]
    axes.add_collection3d(Poly3DCollection(faces, color=SKY, alpha=0.18, linewidths=0, zorder=0))
    edges = []
    for face, (neighbours, normal) in enumerate(zip(shell.neighbors, shell.equations[:, :3], strict=True)):
        for corner, other in enumerate(neighbours):
            if other > face and normal @ shell.equations[other, :3] < 0.7:
                edges.append(shell.points[np.delete(shell.simplices[face], corner)])
    axes.add_collection3d(Line3DCollection(edges, colors=BLUE, linewidths=1.0, zorder=1))


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


def _on_surface(x, cell):
    """Whether each point lies in a cell with an empty face neighbour, shape [n]."""
    index = np.floor(x / cell).astype(np.int64)
    index -= index.min(axis=0) - 1  # one empty layer around, so that neighbours never wrap
    shape = index.max(axis=0) + 2
    strides = np.array([shape[1] * shape[2], shape[2], 1])
    key = index @ strides
    occupied = np.unique(key)
    return ~np.all([np.isin(key + step, occupied) for step in (*strides, *-strides)], axis=0)


def _spacing_in_points(axes, centre, length):
    """How long `length` [m] at `centre` is on a 3D view's paper, in points (1/72 inch)."""
    # Along an axis seen at a slant it shrinks: the largest of the three is the true scale.
    ends = np.vstack([centre, centre + length * np.eye(3)])
    flat = np.column_stack(proj3d.proj_transform(*ends.T, axes.get_proj())[:2])
    pixels = axes.transData.transform(flat)
    return np.linalg.norm(pixels[1:] - pixels[0], axis=1).max() * 72 / DPI
