"""Pictures of one run, made from its results store alone.

Each function draws into a matplotlib Figure of its own (no pyplot, so nothing global is left behind) and returns it.
"""

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

from compare.metrics import axis_of, highest
from compare.plots.style import (
    BLACK,
    BLUE,
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
    title_of,
)
from compare.plots.surface import deposit_surface
from implicit.pseudo_time import REST_UNBALANCED
from mpm.errors import SceneError
from mpm.results import Results
from mpm.scene import Column
from mpm.theory import has_eq4, quasistatic_profile, tan_phi, theory

NO_TICKS = 0.15  # of the longest axis' length: numbers on one that is shorter would overlap
EDGES = (0.0, 0.0, 0.0, 0.25)
# Column, label, colour, line style.
RUN_OUTS = (
    ("R_max", "farthest point", ORANGE, "-"),
    ("R_995", "99.5 % of the mass", BLUE, "-"),
    ("R_connected", "connected to the axis", GREEN, "--"),  # often the farthest point itself
)
SUPPLIED_AND_SPENT = (
    ("W_ext", "work of gravity", BLACK, "-"),
    ("W_plastic", "plastic dissipation", BLUE, "-"),
    ("W_damping", "damping", PURPLE, "-"),
    ("W_decay", "decay of unseen velocities", PURPLE, "--"),
)
HELD = (
    ("KE_points", "kinetic, points", ORANGE, "-"),
    ("KE_grid", "kinetic, grid", SKY, "-"),
    ("E_elastic", "elastic", GREEN, "-"),
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
    cell, half = results.scene.grid.cell, results.scene.grid.half_length
    colours = {"cmap": "viridis", "vmin": 0.0, "vmax": np.quantile(values, 0.98) or 1.0, "linewidths": 0}
    with styled():
        figure = new_figure(11.0, 4.6)
        view = figure.add_axes((0.0, 0.05, 0.5, 0.92), projection="3d", computed_zorder=False)
        section = figure.add_axes((0.57, 0.13, 0.30, 0.74), anchor="W")
        _draw_view(view, x, x0, values, cell, half, colours)
        points = draw_section(section, x, x0, values, cell, half, colours, axis_of(results))
        scale = figure.add_axes((0.905, 0.13, 0.014, 0.74))
        figure.colorbar(points, cax=scale, label=label, extend="max")
        scale.grid(False)
        figure.text(0.02, 0.95, title_of(results, last["time"]), weight="bold")
        return figure


def plot_profile(results: Results) -> Figure:
    """Height of the last snapshot's deposit over the radius, against Eq. 4's solid and the initial column.

    Raises SceneError for a scene that is not a column, and without a snapshot.
    """
    scene, last = results.scene, last_snapshot(results)
    if not isinstance(scene.geometry, Column):
        raise SceneError(f"{results.directory}: only a column has a radial profile")
    top = highest(last["x"], scene)
    edges = np.arange(len(top) + 1) * scene.grid.cell
    radius, height = scene.geometry.radius, scene.geometry.height
    fine = np.linspace(0.0, edges[-1], 600)
    with styled():
        figure = new_figure(8.0, 4.2)
        axes = figure.add_axes((0.09, 0.14, 0.88, 0.76))
        axes.plot([0, radius, radius], [height, height, 0], "--", color=SKY, label="initial column")
        if has_eq4(scene):
            solid = radius * quasistatic_profile(height / radius, tan_phi(scene), fine / radius)
            axes.fill_between(fine, solid, color=BLACK, alpha=0.08, linewidth=0)
            axes.plot(fine, solid, color=BLACK, label=EQ4_LABEL)
        middles = (edges[1:] + edges[:-1]) / 2
        axes.plot(middles, top, "o-", color=BLUE, markersize=3, label="top of the deposit, rings one cell wide")
        axes.set(xlim=(0, edges[-1]), ylim=(0, None), xlabel="radius r [m]", ylabel="height [m]")
        axes.set_title(title_of(results, last["time"]), loc="left", weight="bold")
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
        run_out = figure.add_axes((0.08, 0.14, 0.355, 0.74))
        _draw_columns(run_out, history, RUN_OUTS)
        if limit := theory(scene)["eq4"]:
            run_out.axhline(limit, color=BLACK, linestyle="--", label=EQ4_LABEL)
        if "unbalanced" in history:
            lowest = figure.add_axes((0.52, 0.14, 0.30, 0.74))
            _draw_balance(lowest, history)
            time = "pseudo-time [s]"
        else:
            lowest, time = _draw_energies(figure, history), "time [s]"
        lowest.set(xlabel=time)
        run_out.set(xlabel=time, ylabel="run-out $(r - r_0)/r_0$ [-]")
        figure.text(0.08, 0.94, title_of(results), weight="bold")
        run_out.legend(frameon=False)
        return figure


def _draw_energies(figure, history):
    """What gravity supplies and where it goes; below, on a scale of its own, what is held and what is missed. The lower
    axes."""
    upper, lower = figure.add_axes((0.52, 0.55, 0.27, 0.33)), figure.add_axes((0.52, 0.14, 0.27, 0.33))
    for axes, columns in ((upper, SUPPLIED_AND_SPENT), (lower, HELD)):
        _draw_columns(axes, history, columns)
        axes.set(ylabel="energy [J]")
        axes.legend(frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
    upper.tick_params(labelbottom=False)
    return lower


def _draw_view(axes, x, x0, values, cell, half, colours):
    """The deposit's surface within the translucent initial shell."""
    both = np.concatenate([x, x0])
    low, high = both.min(axis=0) - half, both.max(axis=0) + half
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(high - low, zoom=0.88)
    axes.view_init(elev=22, azim=-60)
    _draw_shell(axes, x0, half)
    faces, behind = deposit_surface(x, values, cell, half)
    shade = ScalarMappable(Normalize(colours["vmin"], colours["vmax"]), colours["cmap"]).to_rgba(behind)
    # Above the shell: where the deposit is inside it the colours keep their meaning.
    axes.add_collection3d(Poly3DCollection(faces, facecolors=shade, edgecolors=EDGES, linewidths=0.3, zorder=2))
    length = (high - low) / (high - low).max()
    if max(length[:2]) < NO_TICKS:  # the axis' numbers would lie behind the body; the section has them
        length[2] = 0.0
    for axis, name, share in zip((axes.xaxis, axes.yaxis, axes.zaxis), "xyz", length, strict=True):
        _few_ticks(axis, name, share)
    # The x axis ends where the y axis starts, and y ends where z starts: their numbers stay apart.
    margin = 0.1 * (high - low)[1]
    axes.set_yticks([tick for tick in axes.get_yticks() if low[1] + margin < tick < high[1] - margin])


def _few_ticks(axis, name, share):
    """Ticks and a label of an axis that is `share` of the longest one long: as many as there is room for."""
    if share < NO_TICKS:
        axis.set_ticks([])
        axis.set_label_text("")
        return
    axis.set_major_locator(MaxNLocator(nbins=max(int(4 * share), 1)))
    axis.set_label_text(f"{name} [m]")
    axis.labelpad = 14


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
