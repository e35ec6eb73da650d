"""Speed against error: wall time and memory of both solvers over resolution, precision, step and stiffness."""

from dataclasses import replace
from pathlib import Path
from statistics import median

import numpy as np

from compare.batch import Job, Outcome, Workers, run_all
from compare.convergence import Limit, richardson
from compare.metrics import deposit, profile, profile_distance
from compare.plots.reports import draw_cost, draw_profiles, draw_stiffness
from compare.report.page import refuse_another, write_table
from compare.report.sections import (
    HOW_ENDED,
    WHAT_MEASURES_MEAN,
    about,
    check,
    figure,
    made_by,
    percent,
    softened_note,
    stability_table,
    verdict,
)
from mpm.errors import SceneError
from mpm.load import load_scene
from mpm.scene import Column

DAMPING = 0.4  # of the explicit runs: the quasistatic collapse that the implicit solver follows
REPEATS = 3  # runs a point is the median of
REPEAT_BELOW = 120.0  # [s] a longer run is made once: it averages over more of the machine's noise itself
STIFFER = (10, 100)  # times the scene's Young's modulus
CFL = (0.25, 1.0)  # beside the scene's own
REACH = (0.15, 0.6)  # cells that points may go in an implicit step, beside the default of 0.3
SOLVERS_AGREE = 0.10  # relative difference of their run-outs
PRECISION_AGREES = 0.01  # relative change of R_995 from float64 to float32
STEP_AGREES = 0.03  # relative change of R_995 with CFL and reach halved or doubled
FLAT = 2.0  # times the time of the softest material that the implicit solver may take for a stiffer one


def ladder(reference: str, settings: list[str], cells: list[float], finer: list[float], device: str) -> list[Job]:
    """One job of each point of the study, the longest first.

    Resolutions `cells` (per r0) of both solvers and precisions, and `finer` ones of the explicit solver alone; at the
    second of `cells` stiffer material, at the third other steps. Raises SceneError where a resolution does not fit.
    """
    scene = load_scene(reference, settings)
    if not isinstance(scene.geometry, Column):
        raise SceneError(f"{scene.name}: speed against error is measured on a column")
    cells, finer = sorted(set(cells)), sorted(set(finer) - set(cells))
    if len(cells) < 3 or min([*cells, *finer]) <= 0:
        raise SceneError("--cells: three different resolutions at least, to extrapolate from, all > 0 [cells per r0]")
    decided = ("explicit.damping", "explicit.until", "grid.cell")
    if taken := [item for item in settings if item.partition("=")[0].strip() in decided]:
        raise SceneError([f"--set {item}: the study sets it itself" for item in taken])
    common = [*settings, f"explicit.damping={DAMPING}", "explicit.until=rest", "output.vtk=false", "output.every=2.0"]
    common.append("output.fields=['displacement', 'eps_p_eqv', 'volume']")

    def job(mode, count, label="", *more, **named):
        sized = (*common, f"grid.cell={scene.geometry.radius / count!r}", *more)
        return Job(f"{mode}-{count:g}{label}", reference, sized, mode, device if mode == "explicit" else "cpu", **named)

    jobs = [job("explicit", count) for count in [*cells, *finer]]
    jobs += [job("explicit", count, "-float32", "explicit.precision=float32") for count in cells]
    jobs += [job("implicit", count) for count in cells]
    for factor in STIFFER:
        young = f"material.young={scene.material.young * factor!r}"
        jobs += [job(mode, cells[1], f"-E{factor}", young) for mode in ("explicit", "implicit")]
    jobs += [job("explicit", cells[2], f"-cfl{cfl}", f"explicit.cfl={cfl}") for cfl in CFL]
    jobs += [job("implicit", cells[2], f"-reach{reach}", regularisation={"reach": reach}) for reach in REACH]
    return sorted(jobs, key=lambda one: one.scene.material.young**0.5 / one.scene.grid.cell**4, reverse=True)


def measure(jobs: list[Job], directory: Path, workers: Workers, force: bool, monitor) -> list[list[Outcome]]:
    """Run the jobs, those of under two minutes `REPEATS` times; the outcomes of each."""
    first = run_all(jobs, directory, workers, force, monitor)
    short = [one for one in first if one.done and one.summary["wall_s"] < REPEAT_BELOW]
    again = [replace(one.job, name=f"{one.job.name}-r{n}", repeat=n) for one in short for n in range(2, REPEATS + 1)]
    repeated = run_all(again, directory, workers, force, monitor)
    outcomes = {id(one): [one] for one in first}
    for number, one in enumerate(short):
        outcomes[id(one)] += repeated[number * (REPEATS - 1) : (number + 1) * (REPEATS - 1)]
    return [outcomes[id(one)] for one in first]


def study_error(
    directory: Path, force, monitor, command: str, reference: str, settings, cells, finer, device: str, workers: Workers
) -> dict:
    """Run or reuse the ladder and draw the figures in `directory`; the report (see `compare.report.page`)."""
    jobs = ladder(reference, settings, cells, finer, device)
    about_what = {"study": "error", "scene": load_scene(reference, settings).model_dump(mode="json"), "device": device}
    about_what |= {"cells": sorted(cells), "finer": sorted(finer)}
    refuse_another(directory, about_what, force)
    measured = measure(jobs, directory / "runs", workers, force, monitor)
    rows = sorted(
        (_row(outcomes) for outcomes in measured), key=lambda row: (row["family"], row["cells"], row["young"])
    )
    base = min(row["young"] for row in rows)
    plain = [row for row in rows if row["changed"] == ""]
    limits = {solver: _limit([row for row in plain if row["family"] == solver]) for solver in ("explicit", "implicit")}
    for row in rows:
        known = limits[row["solver"]]
        row["error"] = abs(row["R_995"] / known["value"] - 1.0) if known and row["R_995"] else None
        if known and row["R_995"] == known["value"]:
            row["error"] = None  # the reference itself
    checks = _checks(rows, plain, limits, base)
    sections = [
        _against_error(rows, plain, limits, measured, directory),
        _against_stiffness(rows, base, measured, directory),
        _all_rows(rows, measured, directory),
        {"title": "What the measures mean", "text": WHAT_MEASURES_MEAN, "tables": [], "figures": []},
    ]
    name = jobs[0].scene.name
    return {
        "about": about_what,
        "title": f"{name}: speed against error",
        "lead": f"Quasistatic collapse to rest by the explicit solver (D = {DAMPING}) and by the implicit one, over "
        f"resolution, precision, step and stiffness. Runs at a time: {workers.runs}, each on {_ranks(workers)}.",
        "verdict": verdict(checks),
        "checks": checks,
        "sections": sections,
        "provenance": about([one for outcomes in measured for one in outcomes], command),
        "failed": [f"{one.job.name} failed: {one.reason}" for outcomes in measured for one in outcomes if not one.done],
        "limits": limits,
        "rows": rows,
    }


def _ranks(workers: Workers) -> str:
    return f"{workers.ranks} MPI ranks where its solver takes several" if workers.ranks > 1 else "one core"


def _row(outcomes: list[Outcome]) -> dict:
    """One point of the study from its repeats: medians of times, the rest from the first (the repeats are equal)."""
    first = outcomes[0]
    job, scene = first.job, first.job.scene
    label = job.name.partition("-")[2].partition("-")[2]  # what follows MODE-CELLS
    row = {
        "solver": job.mode,
        "family": "explicit, float32" if label == "float32" else job.mode,
        "changed": "" if label == "float32" else label,
        "cells": round(scene.geometry.radius / scene.grid.cell, 6),
        "young": scene.material.young,
        "precision": scene.explicit.precision if job.mode == "explicit" else "float64",
        "failed": None if first.done else first.reason,
    }
    done = [one.summary for one in outcomes if one.done]
    measured = ("points", "steps", "newton_iterations", "R_995", "R_max", "eq4", "stop_reason")
    row |= {key: done[0].get(key) if done else None for key in measured}
    row["young_used"] = done[0].get("young_used", row["young"]) if done else None
    for key, source in (("seconds", "wall_s"), ("setup", "setup_s"), ("memory_mb", "peak_memory_mb")):
        row[key] = median(one[source] for one in done) if done else None
    times = [one["wall_s"] for one in done]
    row |= {"repeats": len(done), "fastest": min(times, default=None), "slowest": max(times, default=None)}
    row["volume_gain"] = deposit(first.results)["volume_error"] if done else None
    return row | made_by(first)


def _limit(rows: list[dict]) -> dict | None:
    """What R_995 of these resolutions tends to: Richardson's limit, or the finest run's value and why."""
    if len(rows) < 3 or any(row["R_995"] is None for row in rows):
        return None
    found: Limit = richardson([1.0 / row["cells"] for row in rows], [row["R_995"] for row in rows])
    finest = max(rows, key=lambda row: row["cells"])
    value = found.value if found.converged else finest["R_995"]
    of = ", ".join(f"{row['cells']:g}" for row in sorted(rows, key=lambda row: row["cells"])[-3:])
    return {"value": value, "order": found.order, "converged": found.converged, "reason": found.reason} | {
        "resolutions": of,
        "finest": finest["R_995"],
        "finest_cells": finest["cells"],
    }


def _said(limit: dict | None) -> str:
    if limit is None:
        return "a run of the ladder failed"
    if limit["converged"]:
        return (
            f"R_995 tends to {limit['value']:.4f} with order {limit['order']:.2f} (from {limit['resolutions']} per r0)"
        )
    return f"not converged at {limit['resolutions']} cells per r0: {limit['reason']}"


def _checks(rows, plain, limits, base) -> list[dict]:
    checks = []
    for solver, limit in limits.items():
        off = None if limit is None else float(not limit["converged"])
        checks.append(check(f"{solver} run-out converges", off, 0.0, f"{_said(limit)}."))
    pair = [limits[solver] for solver in ("implicit", "explicit")]
    off = pair[0]["finest"] / pair[1]["finest"] - 1.0 if all(pair) else None
    said = (
        "a run failed"
        if off is None
        else f"R_995 {pair[0]['finest']:.4f} (implicit, {pair[0]['finest_cells']:g} cells per r0) and "
        f"{pair[1]['finest']:.4f} (explicit, {pair[1]['finest_cells']:g}), {off:+.1%}"
    )
    checks.append(
        check("solvers agree on their finest grids", off, SOLVERS_AGREE, f"{said}; {SOLVERS_AGREE:.0%} is allowed.")
    )

    def changes(name, limit, pairs):
        ended = [(label, a["R_995"] / b["R_995"] - 1.0) for label, a, b in pairs if a["R_995"] and b["R_995"]]
        # A failed run is no agreement.
        worst = max((off for _, off in ended), key=abs) if len(ended) == len(pairs) else None
        listed = ", ".join(f"{label}: {off:+.1%}" for label, off in ended) or "no such run ended"
        listed += "" if worst is not None else "; others failed"
        checks.append(check(name, worst, limit, f"R_995 changes, {listed}; {limit:.0%} is allowed."))

    def at(family, cells, changed=""):
        return next(row for row in rows if (row["family"], row["cells"], row["changed"]) == (family, cells, changed))

    single = [row for row in plain if row["family"] == "explicit, float32"]
    pairs = [(f"{row['cells']:g} cells", row, at("explicit", row["cells"])) for row in single]
    changes("float32 gives the run-out of float64", PRECISION_AGREES, pairs)
    for solver, of in (("explicit", "cfl"), ("implicit", "reach")):
        varied = [row for row in rows if row["solver"] == solver and row["changed"].startswith(of)]
        pairs = [(f"{of} {row['changed'].removeprefix(of)}", row, at(solver, row["cells"])) for row in varied]
        changes(f"{solver} run-out hardly depends on the step", STEP_AGREES, pairs)
    stiff = _stiffness_rows(rows, base)
    mine = {row["young"]: row["seconds"] for row in stiff if row["solver"] == "implicit"}
    worst = max(mine.values()) / mine[base] if len(mine) == 1 + len(STIFFER) else None
    said = "a run failed" if worst is None else f"the slowest takes {worst:.1f} times the softest's time"
    checks.append(
        check("implicit cost hardly depends on stiffness", worst, FLAT, f"{said}; {FLAT:g} times is allowed.")
    )
    return checks


def _stiffness_rows(rows, base) -> list[dict]:
    """Rows of the resolution at which stiffness was varied that ended."""
    at = next((row["cells"] for row in rows if row["young"] > base), None)
    plain = ("", *(f"E{factor}" for factor in STIFFER))
    return [
        row
        for row in rows
        if row["cells"] == at and row["precision"] == "float64" and row["changed"] in plain and row["seconds"]
    ]


def _against_error(rows, plain, limits, measured, directory) -> dict:
    text = [f"{solver.capitalize()}: {_said(limit)}." for solver, limit in limits.items()]
    text.append(
        "The error of a run is its relative distance in R_995 from that limit, or, where there is none, from the "
        "finest run of its solver in float64, which then has no error of its own and is left out. Numbers beside "
        "points are cells per r0. Runs whose time step differs by 1 % end within 0.3 %."
    )
    shown = [row | {"label": row["family"], "note": f"{row['cells']:g}"} for row in plain]
    points = [row for row in shown if row["error"]]
    theory = [row | {"error": abs(row["R_995"] / row["eq4"] - 1.0)} for row in shown if row["R_995"] and row["eq4"]]
    figures = []
    if points:
        draw_cost(points, directory / "speed-error.png", "error of R_995 [-]")
        caption = "Error of the run-out, each solver against its own limit or finest run (see above), over wall time."
        figures.append(figure("speed-error.png", caption))
    if theory:
        draw_cost(theory, directory / "speed-theory.png", "|R_995 / Eq. 4 - 1|")
        figures.append(figure("speed-theory.png", "Distance from Eq. 4 over wall time."))
    finest = {}
    for outcomes in measured:
        one = outcomes[0]
        changed = one.job.name.count("-") > 1
        if one.done and not changed:
            known = finest.get(one.job.mode)
            if known is None or one.job.scene.grid.cell < known.job.scene.grid.cell:
                finest[one.job.mode] = one
    if len(finest) == 2:
        draw_profiles(list(finest.values()), list(finest), directory / "finest.png")
        figures.append(figure("finest.png", "Profiles of the finest run of each solver."))
        a, b = (profile(one.results.snapshot(-1)["x"], one.results.scene) for one in finest.values())
        text.append(f"{profile_distance(a, b):.1%} of the deposit's volume lies between the finest profiles of both.")
    return {"title": "Speed against error", "text": text, "tables": [], "figures": figures}


def _against_stiffness(rows, base, measured, directory) -> dict:
    stiff = _stiffness_rows(rows, base)
    if not stiff:
        return {"title": "Speed against stiffness", "text": ["No such run ended."], "tables": [], "figures": []}
    crossover, sentence = _crossover(stiff)
    draw_stiffness(stiff, crossover, directory / "stiffness.png")
    table = {
        "caption": f"Stiffness at {stiff[0]['cells']:g} cells per r0",
        "columns": ["solver", "E [MPa]", "E used [MPa]", "time stepping [s]", "steps", "Newton iterations", "R_995"],
        "rows": [
            [
                row["solver"],
                row["young"] / 1e6,
                row["young_used"] / 1e6,
                row["seconds"],
                row["steps"],
                row["newton_iterations"],
                row["R_995"],
            ]
            for row in stiff
        ],
    }
    caption = "Wall time over Young's modulus; the explicit time step shrinks with the square root of E."
    return {
        "title": "Speed against stiffness",
        "text": [sentence, *softened_note([outcomes[0] for outcomes in measured])],
        "tables": [table],
        "figures": [figure("stiffness.png", caption)],
    }


def _crossover(stiff) -> tuple[float | None, str]:
    """Young's modulus [Pa] at which both solvers take the same time, on straight lines in a log-log plot."""
    seconds = {
        solver: {row["young"]: row["seconds"] for row in stiff if row["solver"] == solver}
        for solver in ("explicit", "implicit")
    }
    young = sorted(set(seconds["explicit"]) & set(seconds["implicit"]))
    if len(young) < 2:
        return None, "Too few runs ended to say which solver is faster on stiff material."
    ratio = np.log([seconds["implicit"][one] / seconds["explicit"][one] for one in young])
    listed = ", ".join(f"{np.exp(r):.2f} at {one / 1e6:g} MPa" for r, one in zip(ratio, young, strict=True))
    said = f"Implicit over explicit time: {listed}."
    for i in range(len(young) - 1):
        if ratio[i] * ratio[i + 1] < 0:
            where = ratio[i] / (ratio[i] - ratio[i + 1])
            crossover = float(np.exp(np.log(young[i]) + where * np.log(young[i + 1] / young[i])))
            first = "implicit" if ratio[i] < 0 else "explicit"
            return (
                crossover,
                f"{said} They cross at E = {crossover / 1e6:.3g} MPa, below which the {first} one is faster.",
            )
    faster = "implicit" if ratio[0] < 0 else "explicit"
    return None, f"{said} There is no crossover: the {faster} solver is the faster one all over this range."


def _all_rows(rows, measured, directory) -> dict:
    write_table(rows, directory)
    columns = ["run", "cells per r0", "changed", "points", "R_995", "over Eq. 4", "error", "volume gain",
               "time stepping [s]", "fastest", "slowest", "runs", "set-up [s]", "memory [MB]", "ended"]  # fmt: skip
    table = []
    for row in rows:
        if row["failed"]:
            table.append([row["family"], row["cells"], row["changed"], *[None] * 11, f"failed: {row['failed']}"])
            continue
        off = percent(row["R_995"] / row["eq4"] - 1.0) if row["eq4"] else None
        table.append(
            [row["family"], row["cells"], row["changed"] or "-", row["points"], row["R_995"], off,
             None if row["error"] is None else f"{row['error']:.1%}", percent(row["volume_gain"]),
             row["seconds"], row["fastest"], row["slowest"], row["repeats"], row["setup"], row["memory_mb"],
             HOW_ENDED[row["stop_reason"]]]
        )  # fmt: skip
    text = [
        f"Times are medians of {REPEATS} runs; a run of more than {REPEAT_BELOW / 60:g} minutes was made once, for it "
        "averages the machine's noise itself. Compilation and set-up are apart."
    ]
    first = [outcomes[0] for outcomes in measured]
    tables = [{"caption": "All points", "columns": columns, "rows": table}]
    tables.append(stability_table(first, [one.job.name for one in first]))
    return {"title": "All runs", "text": text, "tables": tables, "figures": []}
