"""What runs decide: the deposit (Fig. 9), run-outs (Fig. 10 and A1), slopes (Fig. 11), with the paper's claims."""

import math
from itertools import pairwise
from pathlib import Path

from compare.batch import Outcome
from compare.ensembles import Estimate, Part, difference
from compare.plots.paper import draw_run_outs, draw_slopes
from compare.plots.reports import draw_profiles
from compare.plots.run import plot_morphology
from compare.plots.style import save
from compare.report.sections import figure
from compare.studies.paper.claim import of_runs, sentences
from compare.studies.paper.runs import IMPLICIT, label
from mpm.theory import SQRT3

QUASISTATIC, DYNAMIC = 0.4, 0.05  # the damping at which the paper compares with Eq. 4, and with experiments
SHOWN = (2.0, DYNAMIC)  # lambda0 and D of the paper's Fig. 9
NEAR_THEORY = 0.10  # relative difference of R_995 from Eq. 4
NEAR_EXPERIMENTS = 0.15  # relative difference of R_max from the experiments on either side, which scatter by 10 %
NEAR_SLOPE = 0.10  # relative difference of a flank's slope from tan(phi)
FEW = 0.01  # share of the points that are detached


def fig9(rows: list[dict], outcomes: list[list[Outcome]], directory: Path) -> tuple[list[dict], dict]:
    """Claims and section of Fig. 9: the deposit of lambda0 = 2 at D = 0.05."""
    dynamic = [row for row in rows if row["damping"] == DYNAMIC]
    detached = [_part(row, row["detached"], -math.inf, FEW, "{} of the points", ".2%") for row in dynamic]
    upper = [_part(row, row["upper_strain"], 0.5, math.inf, "{} in the upper half", ".0%") for row in dynamic]
    more = []
    for ratio in dict.fromkeys(row["lambda0"] for row in dynamic):
        light = [row for row in rows if row["lambda0"] == ratio and (row["damping"] or 0.0) <= 2 * DYNAMIC]
        light = sorted((row for row in light if row["damping"] is not None), key=lambda row: row["damping"])
        if len(light) > 1:
            change = _change(light[0], light[-1], "detached")
            more.append(_part(light[0], change, 0.0, math.inf, f"{{}} from {_to(light[-1], light[0])}", "+.2%"))
    few = f"few points are disconnected from the main body (judged: fewer than {FEW:.0%})"
    grows = "the share of disconnected points grows as D falls (judged: from D = 0.1 to 0)"
    surface = "most of the plastic deformation is superficial (judged: in the upper half of the local thickness)"
    claims = [
        of_runs(f"Fig. 9: few points are detached at D = {DYNAMIC:g}", few, detached),
        of_runs("Fig. 9: more points are detached the smaller D is", grows, more),
        of_runs("Fig. 9: plastic strain is superficial", surface, upper),
    ]
    figures = []
    for ensemble in outcomes:
        first = ensemble[0]
        if first.done and first.job.mode == "explicit":
            scene = first.job.scene
            if (scene.geometry.aspect_ratio, scene.explicit.damping) == SHOWN:
                save(plot_morphology(first.results), directory / "fig9.png")
                figures.append(figure("fig9.png", "Fig. 9: the deposit of the first realisation, and a section."))
    return claims, {"title": "Fig. 9: the deposit", "text": sentences(claims), "tables": [], "figures": figures}


def fig10(rows: list[dict], tangent: float, directory: Path) -> tuple[list[dict], dict]:
    """Claims and section of Fig. 10 and A1: run-outs over aspect ratio and damping, and the implicit solver's."""
    near, over, under, quasistatic, implicit = [], [], [], [], []
    for row in rows:
        known, damping = row["experiments"], row["damping"]
        if known and damping is not None:
            off = row["R_max"] and row["R_max"].over(known)
            said = f"R_max {_said(row['R_max'])} against {known:.3f}, {{}}"
            if damping == DYNAMIC:
                near.append(_part(row, off, -NEAR_EXPERIMENTS, NEAR_EXPERIMENTS, said))
            elif damping < DYNAMIC:
                over.append(_part(row, off, 0.0, math.inf, f"D = {damping:g}: {said}"))
            elif damping <= 2 * DYNAMIC:
                under.append(_part(row, off, -math.inf, 0.0, f"D = {damping:g}: {said}"))
        if damping in (QUASISTATIC, None):
            off = row["R_995"] and row["R_995"].over(row["eq4"])
            said = f"R_995 {_said(row['R_995'])} against {row['eq4']:.3f}, {{}}"
            part = _part(row, off, -NEAR_THEORY, NEAR_THEORY, said)
            (implicit if damping is None else quasistatic).append(part)
    falls = [
        _part(less, _change(heavy, less, "R_995"), -math.inf, 0.0, f"{{}} from {_to(less, heavy)}", "+.3f")
        for less, heavy in _damped(rows)
    ]
    agrees = f"for D = {DYNAMIC:g} the farthest point agrees with them ({NEAR_EXPERIMENTS:.0%} is allowed)"
    close = f"for D = {QUASISTATIC:g} the run-out is close to Eq. 4 ({NEAR_THEORY:.0%} is allowed)"
    closer = "the more damping, the closer to the quasistatic solution (judged: R_995 falls from each D to the next)"
    asked = f"an implicit formulation should resolve the quasistatic collapse (judged: R_995 within {NEAR_THEORY:.0%})"
    claims = [
        of_runs(f"Fig. 10: D = {DYNAMIC:g} agrees with the experiments", agrees, near),
        of_runs("Fig. 10: less damping runs too far", "below D = 0.05 the run-out is overestimated", over),
        of_runs("Fig. 10: more damping stops too early", "above D = 0.05 (at 0.1) it is underestimated", under),
        of_runs(f"Fig. A1: D = {QUASISTATIC:g} is the quasistatic solution", close, quasistatic),
        of_runs("Fig. A1: run-out falls with D", closer, falls),
        of_runs("The implicit solver ends near Eq. 4", asked, implicit),
    ]
    figures = []
    for measure, file, caption in (
        ("R_max", "fig10.png", "Fig. 10 and A1: run-out of the farthest point, the paper's measure."),
        ("R_995", "figA1.png", "The same of 99.5 % of the mass, the measure to hold against Eq. 4."),
    ):
        if done := [row for row in rows if row[measure]]:
            draw_run_outs(done, tangent, directory / file, measure)
            figures.append(figure(file, f"{caption} Bars: 95 % intervals of the mean."))
    columns = ["lambda0", "runs", "n", "cells per r0", "R_995", "over Eq. 4", "R_max", "experiments"]
    columns += ["over experiments", "Eq. 4", "Eq. 5 in Eq. 4", "Eq. 6", "h_inf [m]", "volume gain", "at rest"]
    table = []
    for row in rows:
        known, mass, farthest = row["experiments"], row["R_995"], row["R_max"]
        table.append(
            [row["lambda0"], row["label"], mass.n if mass else 0, row["cells"], _said(mass),
             _said(mass and mass.over(row["eq4"]), "+.1%"), _said(farthest), known,
             _said(farthest and known and farthest.over(known), "+.1%"), row["eq4"], row["eq45"], row["eq6"],
             _said(row["h_inf"]), _said(row["volume_error"], "+.2%"), row["at_rest"]]
        )  # fmt: skip
    text = [
        *sentences(claims),
        "Experiments: the straight line between the two digitised collapses on either side of the aspect ratio. Eq. 6 "
        "here with prefactor and exponent exchanged. ±: half of the 95 % interval of the mean over realisations.",
    ]
    tables = [{"caption": "Run-outs beside theory and experiments", "columns": columns, "rows": table}]
    return claims, {"title": "Fig. 10 and A1: run-out", "text": text, "tables": tables, "figures": figures}


def fig11(rows: list[dict], tangent: float, directory: Path) -> tuple[list[dict], dict]:
    """Claims and section of Fig. 11: the slope tan(theta_c) of quasistatic and dynamic deposits."""
    quasistatic = [
        _part(row, row["slope"] and row["slope"].over(tangent), -NEAR_SLOPE, NEAR_SLOPE, f"{_said(row['slope'])}, {{}}")
        for row in rows
        if row["label"] == IMPLICIT
    ]
    dynamic = [row for row in rows if row["damping"] == DYNAMIC]
    falls = []
    for lower, taller in pairwise(sorted(dynamic, key=lambda row: row["lambda0"])):
        change = _change(taller, lower, "slope")
        where = f"lambda0 = {lower['lambda0']:g} to {taller['lambda0']:g}"
        falls.append(Part(where, change, -math.inf, 0.0, _said(change, "+.3f") or "a run failed"))
    same = (
        f"quasistatic deposits have tan(theta_c) = {tangent:.3f} whatever lambda0 "
        f"(judged: the implicit solver's flanks within {NEAR_SLOPE:.0%})"
    )
    flatter = f"dynamic deposits get flatter as lambda0 grows (judged: flanks at D = {DYNAMIC:g})"
    claims = [
        of_runs("Fig. 11: the quasistatic slope is tan(phi)", same, quasistatic),
        of_runs("Fig. 11: the dynamic slope falls with lambda0", flatter, falls),
    ]
    shown = [row for row in rows if row["slope"] and row["damping"] in (None, DYNAMIC, QUASISTATIC)]
    figures = []
    if shown:
        draw_slopes(shown, tangent, directory / "fig11.png")
        caption = "Fig. 11: tan(theta_c) of theory, and slopes of flanks. Bars: 95 % intervals of the mean."
        figures.append(figure("fig11.png", caption))
    table = [[row["lambda0"], row["label"], _said(row["slope"]), *_ratio(row)] for row in shown]
    columns = ["lambda0", "runs", "slope of the flank", "h_inf over r_inf"]
    text = [
        *sentences(claims),
        "A flank is where the mean thickness is between 10 and 85 % of its greatest. h_inf over r_inf, with R_995 for "
        f"r_inf, is the same number for a full cone alone, which Eq. 4 has from lambda0 = {SQRT3 * tangent:.2f} on.",
    ]
    tables = [{"caption": "Slopes", "columns": columns, "rows": table}]
    return claims, {"title": "Fig. 11: slopes", "text": text, "tables": tables, "figures": figures}


def profiles(outcomes: list[list[Outcome]], directory: Path) -> dict:
    """Profiles of the first realisation of each ensemble, one figure an aspect ratio."""
    figures, first = [], [ensemble[0] for ensemble in outcomes if ensemble[0].done]
    for ratio in dict.fromkeys(one.job.scene.geometry.aspect_ratio for one in first):
        mine = [one for one in first if one.job.scene.geometry.aspect_ratio == ratio]
        file = f"profiles-{ratio:g}.png"
        draw_profiles(mine, [label(one.job) for one in mine], directory / file)
        figures.append(figure(file, f"Azimuthal mean thickness at lambda0 = {ratio:g}, over Eq. 4's solid."))
    text = ["Of the first realisation of each ensemble."]
    return {"title": "Profiles", "text": text, "tables": [], "figures": figures}


def _damped(rows):
    """Rows of one aspect ratio whose D follow each other, the smaller D first."""
    for ratio in dict.fromkeys(row["lambda0"] for row in rows):
        mine = [row for row in rows if row["lambda0"] == ratio and row["damping"] is not None]
        yield from pairwise(sorted(mine, key=lambda row: row["damping"]))


def _to(one: dict, other: dict) -> str:
    return f"{one['label']} to {other['damping']:g}"


def _change(row: dict, other: dict, measure: str) -> Estimate | None:
    """The measure of `row` less that of `other`; None where the runs of one failed."""
    return difference(row[measure], other[measure]) if row[measure] and other[measure] else None


def _part(row: dict, value: Estimate | None, low: float, high: float, said: str, form: str = "+.1%") -> Part:
    return Part(f"lambda0 = {row['lambda0']:g}", value, low, high, said.format(_said(value, form) or "a run failed"))


def _said(value: Estimate | None, form: str = ".3f") -> str | None:
    return value.said(form) if value else None


def _ratio(row: dict) -> list[float | None]:
    """h_inf over r_inf = r0 (1 + R_995), r0 = 1 m."""
    return [row["h_inf"].mean / (1.0 + row["R_995"].mean)] if row["R_995"] else [None]
