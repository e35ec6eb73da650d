"""Pictures of several runs together, for reports: one panel or two above each other, legible on a telephone."""

from pathlib import Path

import numpy as np
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

from compare.metrics import axis_of, profile
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
    last_snapshot,
    new_figure,
    save,
    styled,
)
from mpm.theory import has_eq4, quasistatic_profile, tan_phi, theory

WIDTH = 5.2  # inches: a page 400 pixels wide then still shows 10 points as 10 pixels
LONG_LABEL = 26  # letters of a label, of which two do not fit beside each other
COLOURS = (ORANGE, GREEN, PURPLE, RED, SKY)  # of runs; blue is the implicit solver's
SOLVER = {"implicit": (BLUE, "o", "-"), "explicit": (ORANGE, "s", "--")}  # colour, marker, line


def draw_profiles(outcomes, labels, path) -> Path:
    """Mean thickness over the radius of each run's last snapshot, over Eq. 4's solid. Columns of one scene only."""
    with styled():
        figure, axes = panel(3.6)
        scene = outcomes[0].results.scene
        radius, height = scene.geometry.radius, scene.geometry.height
        farthest = radius
        for number, (outcome, label) in enumerate(zip(outcomes, labels, strict=True)):
            results = outcome.results
            deposit = profile(last_snapshot(results)["x"], results.scene)
            colour, _, style = SOLVER.get(label.split(",")[0], (COLOURS[number % len(COLOURS)], "", "-"))
            axes.stairs(deposit.thickness, deposit.edges, baseline=None, color=colour, ls=style, lw=1.6, label=label)
            farthest = max(farthest, deposit.edges[-1])
        axes.plot([0, radius, radius], [height, height, 0], ":", color=BLACK, label="initial column")
        if has_eq4(scene):
            fine = np.linspace(0.0, farthest, 600)
            solid = radius * quasistatic_profile(height / radius, tan_phi(scene), fine / radius)
            axes.fill_between(fine, solid, color=BLACK, alpha=0.08, linewidth=0)
            axes.plot(fine, solid, color=BLACK, linewidth=1.0, label=EQ4_LABEL)
        axes.set(xlim=(0, farthest), ylim=(0, None), xlabel="radius r [m]", ylabel="mean thickness [m]")
        legend(axes)
        return save(figure, path)


def draw_plan_and_section(outcome, title, path, most) -> Path:
    """The deposit from above and cut through its top; colour: plastic strain up to `most` (None: its 98 % quantile)."""
    results = outcome.results
    last, x0, scene = last_snapshot(results), results.read_static("x0"), results.scene
    x, cell, half = last["x"], scene.grid.cell, scene.grid.half_length
    values, label = colour_values(x, x0, last)
    colours = {"cmap": "viridis", "vmin": 0.0, "vmax": most or np.quantile(values, 0.98) or 1.0, "linewidths": 0}
    wide, deep, high = np.ptp(np.concatenate([x, x0]), axis=0)
    panel = 0.84 * WIDTH
    plan_height, section_height = panel * min(deep / wide, 1.5), panel * np.clip(high / wide, 0.15, 1.5)
    height = 0.45 + plan_height + 1.0 + section_height + 1.15
    with styled():
        figure = new_figure(WIDTH, height)
        plan = figure.add_axes((0.13, 1 - (0.45 + plan_height) / height, 0.84, plan_height / height))
        section = figure.add_axes((0.13, 1.15 / height, 0.84, section_height / height))
        order = np.argsort(x[:, 2])  # the highest last, on top, as seen from above
        plan.set_aspect("equal")
        plan.update_datalim(np.concatenate([x - half, x + half])[:, :2])
        plan.autoscale_view()
        plan.apply_aspect()
        scale = plan.transData.transform([[0, 0], [2 * half, 0]])
        size = (1.2 * (scale[1, 0] - scale[0, 0]) * 72 / DPI) ** 2
        plan.scatter(*x[order, :2].T, c=values[order], s=size, marker="s", **colours)
        plan.set(xlabel="x [m]", ylabel="y [m]")
        plan.set_title(f"{title}, from above", loc="left", weight="bold")
        points = draw_section(section, x, x0, values, cell, half, colours, axis_of(results))
        bar = figure.add_axes((0.13, 0.5 / height, 0.84, 0.1 / height))
        figure.colorbar(points, cax=bar, orientation="horizontal", extend="max", label=label)
        bar.grid(False)
        return save(figure, path)


def strain_limit(outcomes) -> float | None:
    """98 % quantile of the plastic strain of all runs together, so that their pictures share one scale."""
    strains = [last["eps_p_eqv"] for one in outcomes if "eps_p_eqv" in (last := last_snapshot(one.results))]
    return float(np.quantile(np.concatenate(strains), 0.98)) if strains else None


def draw_histories(outcomes, labels, time_scale, path) -> Path:
    """Run-out R_995 over time in sqrt(h0/g), and below it what is left to come to rest, of each run."""
    with styled():
        figure = new_figure(WIDTH, 5.6)
        figure.set_layout_engine("constrained")
        run_out, unrest = figure.subplots(2, 1, sharex=True)
        for outcome, label in zip(outcomes, labels, strict=True):
            history, mode = outcome.results.history(), outcome.job.mode
            colour, _, style = SOLVER[mode]
            time = history["time"] / time_scale
            run_out.plot(time, history["R_995"], style, color=colour, label=label)
            if mode == "implicit":
                unrest.semilogy(time, history["unbalanced"], style, color=colour, label="implicit: out-of-balance")
            else:
                ratio = history["KE_grid"] / history["KE_grid"].max()
                unrest.semilogy(time, ratio, style, color=colour, label="explicit: grid kinetic energy / peak")
        scene = outcomes[0].results.scene
        if limit := theory(scene)["eq4"]:
            run_out.axhline(limit, color=BLACK, linewidth=1.0, label=EQ4_LABEL)
        run_out.set(ylabel="run-out R_995 [-]")
        unrest.set(xlabel="(pseudo-)time / sqrt(h0/g) [-]", ylabel="unrest [-]", ylim=(1e-6, None))
        legend(run_out)
        legend(unrest)
        return save(figure, path)


def draw_cost(points, path, ylabel) -> Path:
    """Error over wall time on one pair of axes; `points`: rows with solver, label, seconds and error.

    One line a solver's label; the Pareto front of all points is ringed: none of the others is both faster and closer.
    """
    with styled():
        figure, axes = panel(4.0)
        for number, label in enumerate(dict.fromkeys(row["label"] for row in points)):
            rows = sorted((row for row in points if row["label"] == label), key=lambda row: row["seconds"])
            colour, marker, style = SOLVER[rows[0]["solver"]]
            colour = colour if label in SOLVER else COLOURS[1 + number % 4]
            seconds, errors = ([row[key] for row in rows] for key in ("seconds", "error"))
            axes.loglog(seconds, errors, style if len(rows) > 1 else "", marker=marker, color=colour, label=label)
            for row in rows:
                axes.annotate(row["note"], (row["seconds"], row["error"]), (4, 4), textcoords="offset points", size=8)
        front = pareto_front(points)
        ringed = [[row[key] for row in front] for key in ("seconds", "error")]
        axes.loglog(*ringed, "o", ms=13, mfc="none", mec=BLACK, mew=0.8, label="Pareto front")
        axes.set(xlabel="time stepping, wall time [s]", ylabel=ylabel)
        axes.margins(0.12)
        plain_numbers(axes.xaxis, axes.yaxis)
        legend(axes)
        return save(figure, path)


def draw_growth(points, ylabel, path) -> Path:
    """Seconds over points, (points, seconds) each, beside the line along which a point costs what it costs at first."""
    with styled():
        figure, axes = panel(3.6)
        count, seconds = zip(*points, strict=True)
        axes.loglog(count, seconds, "o-", color=BLUE, label="measured")
        equal = [seconds[0] * each / count[0] for each in count]
        axes.loglog(count, equal, "--", color=BLACK, lw=0.9, label="same cost per point")
        axes.set(xlabel="points", ylabel=ylabel)
        axes.margins(0.1)
        legend(axes)
        return save(figure, path)


def draw_scaling(curves, path) -> Path:
    """Speed over one rank's over ranks; `curves`: for each name [(ranks, measured, by the model), ...]."""
    with styled():
        figure, axes = panel(3.6)
        most = max(ranks for points in curves.values() for ranks, *_ in points)
        axes.plot([1, most], [1, most], "-", color=BLACK, lw=0.9, label="as many times as ranks")
        for (name, points), colour in zip(curves.items(), (BLUE, *COLOURS), strict=False):
            ranks, measured, predicted = zip(*points, strict=True)
            axes.plot(ranks, measured, "o-", color=colour, label=name)
            axes.plot(ranks, predicted, ":", color=colour, lw=1.2)
        axes.plot([], [], ":", color=BLACK, lw=1.2, label="by the model")
        axes.set(xlabel="MPI ranks", ylabel="speed over one rank's")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.margins(0.1)
        legend(axes)
        return save(figure, path)


def pareto_front(points) -> list[dict]:
    """Those of `points` (rows with seconds and error) than which no other is both as fast and as close."""
    front, best = [], np.inf
    for row in sorted(points, key=lambda row: (row["seconds"], row["error"])):
        if row["error"] < best:
            front.append(row)
            best = row["error"]
    return front


def draw_stiffness(rows, alike, crossover, path) -> Path:
    """Wall time over Young's modulus of both solvers; `rows` have solver, young [Pa] and seconds.

    `alike`: none, or the row of an explicit run with the moduli that the implicit solver takes for stiffer material.
    """
    with styled():
        figure, axes = panel(3.6)
        for solver, (colour, marker, style) in SOLVER.items():
            mine = sorted((row for row in rows if row["solver"] == solver), key=lambda row: row["young"])
            stiffness = np.array([row["young"] for row in mine]) / 1e6
            seconds = [row["seconds"] for row in mine]
            axes.loglog(stiffness, seconds, style, marker=marker, color=colour, label=solver)
            if solver == "explicit" and mine:
                root = seconds[0] * np.sqrt(stiffness / stiffness[0])
                axes.loglog(stiffness, root, ":", color=BLACK, linewidth=1.0, label="square root of E")
        for row in alike:
            axes.axhline(row["seconds"], color=PURPLE, lw=1.2, ls="-.", label="explicit, softened as the implicit one")
        if crossover:
            axes.axvline(crossover / 1e6, color=GREEN, linewidth=1.0, label=f"as fast at {crossover / 1e6:.3g} MPa")
        axes.set(xlabel="Young's modulus E [MPa]", ylabel="time stepping, wall time [s]")
        plain_numbers(axes.xaxis, axes.yaxis)
        legend(axes)
        return save(figure, path)


def draw_calibration(tried, target, low, high, path) -> Path:
    """Run-outs over damping D with their intervals, the `target` [-] and the interval of D, or None, that meets it.

    `tried`: measure ("R_995", "R_max") -> {D: `compare.ensembles.Estimate`}.
    """
    with styled():
        figure, axes = panel(3.6)
        for (measure, known), colour in zip(tried.items(), (BLUE, ORANGE), strict=True):
            ordered = sorted(known)
            means, halves = ([getattr(known[one], what) for one in ordered] for what in ("mean", "half"))
            axes.errorbar(ordered, means, halves, fmt="o-", ms=4, lw=1.0, capsize=3, color=colour, label=measure)
        axes.axhline(target, color=BLACK, lw=1.0, ls="--", label=f"target {target:.3f}")
        if low is not None:
            axes.axvspan(low, high, color=GREEN, alpha=0.25, lw=0, label=f"D from {low:.3f} to {high:.3f}")
        axes.set(xlabel="local damping D [-]", ylabel="run-out R [-]")
        legend(axes)
        return save(figure, path)


def panel(height):
    """A figure with one panel; room for the legend above it is made when it is drawn."""
    figure = new_figure(WIDTH, height)
    figure.set_layout_engine("constrained")
    return figure, figure.subplots()


def legend(axes):
    """The legend above the panel, where it hides nothing: in two columns where its labels leave room for that."""
    columns = 1 if max(map(len, axes.get_legend_handles_labels()[1]), default=0) > LONG_LABEL else 2
    place = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "ncols": columns}
    axes.legend(frameon=False, columnspacing=1.2, borderpad=0.2, **place)


def plain_numbers(*axes):
    """Label logarithmic axes with 0.5, 1, 2 and so on instead of powers of ten."""
    for axis in axes:
        low, high = axis.get_view_interval()
        wide = np.log10(high / low) > 2.5
        axis.set_major_locator(LogLocator(subs=(1.0,) if wide else (1.0, 2.0, 5.0)))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter(NullFormatter())
