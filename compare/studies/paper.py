"""The paper's runs: aspect ratio and damping, beside the implicit solver, theory and experiments."""

from itertools import pairwise
from pathlib import Path

import numpy as np

from compare.batch import Job, Outcome, Workers, run_all
from compare.experiments import measured_runout
from compare.metrics import deposit
from compare.plots.reports import draw_profiles, draw_run_outs
from compare.report.page import refuse_another, write_table
from compare.report.sections import (
    HOW_ENDED,
    WHAT_MEASURES_MEAN,
    about,
    check,
    cost_table,
    eq6_section,
    failures,
    figure,
    made_by,
    percent,
    stability_table,
    verdict,
)
from mpm.errors import SceneError
from mpm.theory import eq4, eq6, eq45, tan_phi

CELLS, QUICK_CELLS = 20, 8  # per r0, of the explicit runs; the paper's resolution is 20
# Of the implicit runs. An implicit run's cost grows with the fifth power of the resolution: half the paper's.
IMPLICIT_CELLS, QUICK_IMPLICIT_CELLS = 10, 5
IMPLICIT_LAMBDA0 = 2.0  # the highest column that the implicit solver is run for
QUASISTATIC, DYNAMIC = 0.4, 0.05  # the damping at which the paper compares with Eq. 4, and with experiments
NEAR_THEORY = 0.10  # relative difference of R_995 from Eq. 4
NEAR_EXPERIMENTS = 0.15  # relative difference of R_max from the experiments on either side, which scatter by 10 %


def plan(lambda0: list[float], damping: list[float], quick: bool, device: str) -> list[Job]:
    """One explicit job of each damping and aspect ratio, and an implicit one of each aspect ratio up to 2."""
    common = ("output.vtk=false", "output.every=2.0", "output.fields=['displacement', 'eps_p_eqv', 'volume']")
    explicit, implicit = (QUICK_CELLS, QUICK_IMPLICIT_CELLS) if quick else (CELLS, IMPLICIT_CELLS)

    def job(name, ratio, mode, count, *more):
        column = (f"name=column_{ratio:g}", f"geometry.aspect_ratio={ratio!r}", f"grid.cell={1.0 / count!r}")
        sized = (*common, *column, "explicit.until=rest", *more)
        return Job(f"{name}-{ratio:g}", "column_1", sized, mode, device if mode == "explicit" else "cpu")

    jobs = [
        job(f"D{value:g}", ratio, "explicit", explicit, f"explicit.damping={value!r}")
        for ratio in lambda0
        for value in damping
    ]
    return jobs + [job("implicit", ratio, "implicit", implicit) for ratio in lambda0 if ratio <= IMPLICIT_LAMBDA0]


def study_paper(
    directory: Path, force, monitor, command: str, lambda0, damping, quick: bool, device: str, workers: Workers
) -> dict:
    """Run or reuse the paper's runs and draw the figures in `directory`; the report (see `compare.report.page`)."""
    if min(lambda0) <= 0 or min(damping) < 0 or max(damping) >= 1:
        raise SceneError("--lambda0: must be > 0 [-]; --damping: must be >= 0 and < 1 [-]")
    about_what = {"study": "paper", "quick": quick, "device": device, "lambda0": lambda0, "damping": damping}
    refuse_another(directory, about_what, force)
    jobs = plan(sorted(set(lambda0)), sorted(set(damping)), quick, device)
    outcomes = run_all(jobs, directory / "runs", workers, force, monitor)
    tangent = tan_phi(jobs[0].scene)
    rows = [_row(one, tangent) for one in outcomes]
    labels = [one.job.name for one in outcomes]
    checks = _checks(rows)
    write_table(rows, directory)
    stability = [stability_table(outcomes, labels), cost_table(outcomes, labels)]
    return {
        "about": about_what,
        "title": "The paper's runs" + (", quick" if quick else ""),
        "lead": "Collapse of columns with local damping D, as in Wyser et al. (2023), beside its theory, the "
        f"experiments it uses and, up to lambda0 = {IMPLICIT_LAMBDA0:g}, the implicit solver. "
        f"tan(phi) = {tangent:.3f}. Explicit runs have {QUICK_CELLS if quick else CELLS} cells per r0, implicit ones "
        f"{QUICK_IMPLICIT_CELLS if quick else IMPLICIT_CELLS}.",
        "verdict": verdict(checks),
        "checks": checks,
        "sections": [
            _run_outs(rows, tangent, directory),
            _profiles(outcomes, directory),
            {"title": "Stability and cost", "text": failures(outcomes, labels), "tables": stability, "figures": []},
            {"title": "What the measures mean", "text": WHAT_MEASURES_MEAN, "tables": [], "figures": []},
            eq6_section(),
        ],
        "provenance": about(outcomes, command),
        "failed": failures(outcomes, labels),
        "rows": rows,
    }


def _row(outcome: Outcome, tangent: float) -> dict:
    """One run beside theory and experiment."""
    scene = outcome.job.scene
    ratio, implicit = scene.geometry.aspect_ratio, outcome.job.mode == "implicit"
    row = {"lambda0": ratio, "label": "implicit" if implicit else f"D = {scene.explicit.damping:g}"}
    row |= {"damping": None if implicit else scene.explicit.damping, "cells": round(1.0 / scene.grid.cell, 6)}
    found = deposit(outcome.results) if outcome.done else {}
    names = ("R_995", "R_max", "R_connected", "h_inf", "flank_angle", "volume_error")
    row |= {name: found.get(name) for name in names}
    known = measured_runout(ratio)
    row |= {"eq4": float(eq4(ratio, tangent)), "eq45": float(eq45(ratio, tangent)), "eq6": float(eq6(ratio))}
    row |= {"experiments": None if np.isnan(known) else known}
    summary = outcome.summary or {}
    row |= {key: summary.get(key) for key in ("points", "sim_time", "steps", "stop_reason", "wall_s", "setup_s")}
    return row | {"failed": outcome.reason} | made_by(outcome)


def _checks(rows) -> list[dict]:
    """The paper's claims, each for every aspect ratio that was run."""
    checks = []

    def near(name, row, measure, reference, of, limit):
        value = row[measure]
        off = None if value is None or reference is None else value / reference - 1.0
        said = "the run failed" if value is None else "no experiments on either side"
        if off is not None:
            said = f"{measure} {value:.3f} against {reference:.3f}, {off:+.1%} ({row['cells']:g} cells per r0)"
        checks.append(check(name, off, limit, f"{said}; {limit:.0%} of {of} is allowed."))

    for row in rows:
        at = f"at lambda0 = {row['lambda0']:g}"
        if row["damping"] == QUASISTATIC:
            near(f"D = {QUASISTATIC:g} ends near Eq. 4 {at}", row, "R_995", row["eq4"], "Eq. 4", NEAR_THEORY)
        elif row["damping"] == DYNAMIC:
            name = f"D = {DYNAMIC:g} ends near the experiments {at}"
            near(name, row, "R_max", row["experiments"], "the experiments", NEAR_EXPERIMENTS)
        elif row["damping"] is None:
            near(f"implicit ends near Eq. 4 {at}", row, "R_995", row["eq4"], "Eq. 4", NEAR_THEORY)
    for ratio in dict.fromkeys(row["lambda0"] for row in rows):
        damped = [row for row in rows if row["lambda0"] == ratio and row["damping"] is not None]
        if len(damped) < 2:
            continue
        run_outs = [row["R_995"] for row in sorted(damped, key=lambda row: row["damping"])]
        rises = None
        if None not in run_outs:
            rises = float(sum(later >= earlier for earlier, later in pairwise(run_outs)))
        listed = ", ".join("failed" if one is None else f"{one:.3f}" for one in run_outs)
        dampings = ", ".join(f"{value:g}" for value in sorted(row["damping"] for row in damped))
        sentence = f"R_995 for D = {dampings}: {listed}."
        checks.append(check(f"run-out falls with D at lambda0 = {ratio:g}", rises, 0.0, sentence))
    return checks


def _run_outs(rows, tangent, directory) -> dict:
    done = [row for row in rows if row["R_995"] is not None]
    figures = []
    for measure, file, caption in (
        ("R_max", "run-out-farthest.png", "Run-out of the farthest point, the paper's measure (its Fig. 10 and A1)."),
        ("R_995", "run-out-mass.png", "Run-out of 99.5 % of the mass, the measure to hold against Eq. 4."),
    ):
        if done:
            draw_run_outs(done, tangent, directory / file, measure)
            figures.append(figure(file, caption))
    columns = ["lambda0", "run", "cells per r0", "R_995", "over Eq. 4", "R_max", "experiments", "over experiments",
               "Eq. 4", "Eq. 5 in Eq. 4", "Eq. 6", "h_inf [m]", "flank angle [°]", "ended"]  # fmt: skip
    table = []
    for row in rows:
        known = row["experiments"]
        over = percent(row["R_max"] / known - 1.0) if known and row["R_max"] else None
        off = percent(row["R_995"] / row["eq4"] - 1.0) if row["R_995"] is not None else None
        ended = HOW_ENDED[row["stop_reason"]] if row["failed"] is None else f"failed: {row['failed']}"
        table.append(
            [row["lambda0"], row["label"], row["cells"], row["R_995"], off, row["R_max"], known, over, row["eq4"],
             row["eq45"], row["eq6"], row["h_inf"], row["flank_angle"], ended]
        )  # fmt: skip
    text = [
        "Experiments: the straight line between the two digitised collapses on either side of the aspect ratio. Eq. 2, "
        "the older semi-empirical form, jumps at lambda0 = 0.74; both of its branches are drawn."
    ]
    tables = [{"caption": "Run-outs beside theory and experiments", "columns": columns, "rows": table}]
    return {"title": "Run-out over aspect ratio", "text": text, "tables": tables, "figures": figures}


def _profiles(outcomes, directory) -> dict:
    figures = []
    for ratio in dict.fromkeys(one.job.scene.geometry.aspect_ratio for one in outcomes):
        mine = [one for one in outcomes if one.done and one.job.scene.geometry.aspect_ratio == ratio]
        if not mine:
            continue
        labels = [
            "implicit" if one.job.mode == "implicit" else f"D = {one.job.scene.explicit.damping:g}" for one in mine
        ]
        file = f"profiles-{ratio:g}.png"
        draw_profiles(mine, labels, directory / file)
        figures.append(figure(file, f"Azimuthal mean thickness at lambda0 = {ratio:g}, over Eq. 4's solid."))
    return {"title": "Profiles", "text": [], "tables": [], "figures": figures}
