"""The picture of a hard case: its figures over their limits, and where its runs ended."""

import textwrap
from pathlib import Path

import numpy as np

from compare.plots.reports import WIDTH
from compare.plots.style import BLACK, GREEN, ORANGE, RED, draw_section, new_figure, save, styled
from mpm.run import Run

COLOURS = {"stable": GREEN, "degraded": RED, "refused": ORANGE}
LEAST, MOST = 1e-3, 1e2  # figure over limit at the ends of the scale
BAR, SECTION = 0.42, 2.2  # inches
MOST_SHOWN = 6  # runs


def draw_case(rows: list[dict], runs: dict[str, Run], path) -> Path:
    """Bars of value over limit on a logarithmic scale, and a vertical section of each of up to six `runs`.

    `rows`: what, solver, outcome, value and limit of each finding (see `compare.hard.case.judge`).
    """
    shown = list(runs.items())[:MOST_SHOWN]
    high = BAR * len(rows) + 0.7
    with styled():
        figure = new_figure(WIDTH, high + SECTION * len(shown))
        figure.set_layout_engine("constrained")
        bars, *sections = figure.subplots(
            1 + len(shown), 1, height_ratios=[high, *[SECTION] * len(shown)], squeeze=False
        )[:, 0]
        _draw_bars(bars, rows)
        for axes, (what, run) in zip(sections, shown, strict=True):
            _draw_end(axes, what, run)
        return save(figure, path)


def over_limit(row: dict) -> float:
    """Value over limit, within the ends of the scale; at the upper end where the limit is 0 and the value is not."""
    value, limit = row["value"], row["limit"]
    if value is None or not np.isfinite(value):
        return MOST
    if limit == 0:
        return LEAST if value <= 0 else MOST
    return float(np.clip(value / limit, LEAST, MOST))


def _draw_bars(axes, rows):
    for number, row in enumerate(rows):
        end, colour = over_limit(row), COLOURS[row["outcome"]]
        axes.plot([LEAST, end], [number, number], color=colour, lw=5, solid_capstyle="butt")
        axes.plot(end, number, "o", color=colour, ms=6, clip_on=False)
        named = f"{row['what']} ({row['solver']})" if row["solver"] else row["what"]
        axes.text(LEAST, number - 0.25, " " + textwrap.shorten(named, 75), size=8, va="bottom")
    axes.axvline(1.0, color=BLACK, lw=1.0)
    axes.set(xscale="log", xlim=(LEAST, MOST), ylim=(len(rows) - 0.5, -0.8), xlabel="figure over its limit [-]")
    axes.set_yticks([])
    axes.grid(axis="y", visible=False)


def _draw_end(axes, what, run):
    scene, x, x0 = run.body.scene, run.x, run.body.x
    moved = np.linalg.norm(x - x0, axis=1)
    colours = {"cmap": "viridis", "vmin": 0.0, "vmax": moved.max() or 1.0, "linewidths": 0}
    draw_section(axes, x, x0, moved, scene.grid.cell, scene.grid.half_length, colours, run.body.measure.axis)
    axes.set_title(textwrap.shorten(what, 60), loc="left")
