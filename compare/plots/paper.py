"""The paper's figures: run-out over aspect ratio, its error over the coefficient of friction, slopes of deposits."""

from pathlib import Path

import numpy as np

from compare.experiments import experiments
from compare.plots.reports import COLOURS, WIDTH, legend, panel, plain_numbers
from compare.plots.style import BLACK, BLUE, GREEN, ORANGE, RED, new_figure, save, styled
from mpm.theory import EQ2_SWITCH, SQRT3, dynamic_slope, eq2, eq4, eq6, eq6_printed, eq45

IMPLICIT = "implicit"
# The closed forms R(lambda0, tan(theta)) [-]: name, function, colour, line style.
FORMS = {
    "Eq. 2": (eq2, BLACK, ":"),
    "Eq. 4": (eq4, BLACK, "-"),
    "Eq. 5 in Eq. 4": (eq45, BLACK, "--"),
    "Eq. 6, exchanged": (lambda lambda0, _: eq6(lambda0), RED, "-."),
    "Eq. 6, as printed": (lambda lambda0, _: eq6_printed(lambda0), RED, ":"),
}


def draw_theory(tangent: float, path) -> Path:
    """Fig. 7: the closed forms with tan(theta) = `tangent` over the experiments, and below what they miss them by."""
    known = experiments()
    with styled():
        figure = new_figure(WIDTH, 6.4)
        figure.set_layout_engine("constrained")
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
        _draw_forms(above, known[:, 0], tangent)
        above.set(ylabel="run-out R [-]")
        for name, (form, colour, style) in FORMS.items():
            mark = {"marker": "o", "ms": 3.5, "mfc": "white", "lw": 1.0}
            below.plot(known[:, 0], form(known[:, 0], tangent) - known[:, 1], style, color=colour, label=name, **mark)
        below.axhline(0.0, color=BLACK, lw=0.6)
        below.set(xlabel="aspect ratio h0/r0 [-]", ylabel="form - experiment [-]")
        plain_numbers(above.xaxis, above.yaxis)
        legend(above)
        return save(figure, path)


def draw_rmse(mu, curves: dict[str, np.ndarray], best: dict[str, float], stated: dict[str, float], path) -> Path:
    """Fig. 8: RMSE of R [-] over `mu` (n,) [-] of each reading of Eq. 4, its minimum `best`, and values of mu `stated`
    in the paper."""
    with styled():
        figure, axes = panel(3.8)
        for (name, rmse), colour in zip(curves.items(), (BLUE, ORANGE), strict=True):
            axes.plot(mu, rmse, color=colour, label=name)
            least = float(np.interp(best[name], mu, rmse))
            axes.plot(best[name], least, "o", color=colour, label=f"least at mu = {best[name]:.3f}")
        for (name, value), style in zip(stated.items(), ("--", ":"), strict=True):
            axes.axvline(value, color=BLACK, lw=1.0, ls=style, label=f"{name}, mu = {value:g}")
        axes.set(xlabel="mu = tan(phi_y) [-]", ylabel="RMSE of R [-]", ylim=(0, None))
        legend(axes)
        return save(figure, path)


def draw_run_outs(rows, tangent: float, path, measure: str) -> Path:
    """Fig. 10 and A1: run-outs of ensembles over aspect ratio, with intervals, over experiments and closed forms.

    `rows`: lambda0, label and the `compare.ensembles.Estimate` of `measure` ("R_max", "R_995"); a colour a label.
    """
    with styled():
        figure, axes = panel(4.6)
        _draw_forms(axes, [row["lambda0"] for row in rows], tangent)
        for number, (label, mine) in enumerate(_by_label(rows).items()):
            _draw_estimates(axes, mine, label, number, measure)
        axes.set(xlabel="aspect ratio h0/r0 [-]", ylabel=f"run-out {measure} [-]")
        plain_numbers(axes.xaxis, axes.yaxis)
        legend(axes)
        return save(figure, path)


def draw_slopes(rows, tangent: float, path) -> Path:
    """Fig. 11: tan(theta) of the quasistatic and the dynamic theory, and slopes of flanks with their intervals.

    `rows`: lambda0, label and the Estimate of the "slope" [-] of each ensemble.
    """
    with styled():
        figure, axes = panel(3.8)
        fine = np.geomspace(0.9 * min(row["lambda0"] for row in rows), 1.1 * max(row["lambda0"] for row in rows), 200)
        dynamic = np.minimum(dynamic_slope(fine, tangent), tangent)
        axes.fill_between(fine, tangent, dynamic, color=RED, alpha=0.08, lw=0)
        axes.axhline(tangent, color=GREEN, lw=1.2, label="quasistatic: tan(phi)")
        axes.plot(fine, dynamic, color=RED, lw=1.2, label="dynamic: Eq. 5")
        axes.axvline(SQRT3 * tangent, color=BLACK, lw=0.6, ls=":", label="full cones from here on")
        for number, (label, mine) in enumerate(_by_label(rows).items()):
            _draw_estimates(axes, mine, label, number, "slope")
        axes.set(xscale="log", xlabel="aspect ratio h0/r0 [-]", ylabel="tan(theta) [-]", ylim=(0, None))
        plain_numbers(axes.xaxis)
        legend(axes)
        return save(figure, path)


def _draw_forms(axes, ratios, tangent):
    """Experiments and closed forms over the aspect ratios of both, on logarithmic axes. Eq. 2 jumps at its switch."""
    known = experiments()
    ratios = [*ratios, *known[:, 0]]
    fine = np.geomspace(min(ratios) * 0.9, max(ratios) * 1.1, 400)
    axes.loglog(*known.T, "x", color=BLACK, ms=5, label="experiments (digitised)")
    for name, (form, colour, style) in FORMS.items():
        value = form(fine, tangent)
        if form is eq2:
            value = np.where(np.diff(fine < EQ2_SWITCH, prepend=True), np.nan, value)
        axes.loglog(fine, value, style, color=colour, lw=1.2, label=name)


def _by_label(rows) -> dict[str, list[dict]]:
    """Rows of each label in order of the aspect ratio."""
    ordered = sorted(rows, key=lambda row: row["lambda0"])
    return {
        label: [row for row in ordered if row["label"] == label] for label in dict.fromkeys(r["label"] for r in rows)
    }


def _draw_estimates(axes, rows, label, number, measure):
    marker, colour = ("D", BLUE) if label == IMPLICIT else ("o", COLOURS[number % len(COLOURS)])
    known = [row[measure] for row in rows]
    half = [one.half if np.isfinite(one.half) else 0.0 for one in known]
    ratios, means = [row["lambda0"] for row in rows], [one.mean for one in known]
    axes.errorbar(ratios, means, half, fmt=marker, ms=5, color=colour, capsize=3, lw=1.2, label=label)
