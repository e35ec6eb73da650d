"""Speed against error: wall time and memory of both solvers over resolution, precision, step and stiffness."""

from pathlib import Path
from statistics import median

from compare.batch import Job, Outcome, Workers
from compare.convergence import EnsembleLimit, ensemble_limit
from compare.ensembles import SETS, Estimate, Part, estimate, flat, joined, paired, relative, run_ensembles
from compare.metrics import deposit, profile, profile_distance
from compare.plots.reports import draw_cost, draw_profiles
from compare.report.page import refuse_another, write_table
from compare.report.sections import (
    HOW_ENDED,
    WHAT_MEASURES_MEAN,
    about,
    check,
    failures,
    figure,
    made_by,
    percent,
    stability_table,
    verdict,
)
from compare.studies import refuse_settings
from compare.studies.stiffness import FACTORS, SOFTENED, softened_settings, stiffness_check, stiffness_section
from mpm.errors import SceneError
from mpm.load import load_scene
from mpm.scene import Column

DAMPING = 0.4  # of the explicit runs: the paper's choice for a collapse near the quasistatic one
CFL = 0.5  # Courant number of the explicit runs
OTHER_CFL = (0.25, 1.0)  # beside it
REACH = (0.15, 0.6)  # cells that points may go in an implicit step, beside the default of 0.3
SOLVERS = ("explicit", "implicit")
SOLVERS_AGREE = 0.10  # relative difference of their run-outs
PRECISION_AGREES = 0.01  # relative change of R_995 from float64 to float32
STEP_AGREES = 0.03  # relative change of R_995 with CFL and reach halved or doubled
ESTIMATES = ("R_995", "R_max", "volume_gain")


def ladder(reference: str, settings: list[str], cells: list[float], finer: list[float], device: str) -> list[Job]:
    """One job of each point of the study, the longest first.

    Resolutions `cells` (per r0) of both solvers and precisions, and `finer` ones of the explicit solver alone; at the
    second of `cells` stiffer material, and the explicit run of the moduli that the implicit solver then takes; at the
    third other steps. Raises SceneError where a resolution does not fit, for a body that is no column and for settings
    that the study decides.
    """
    scene = load_scene(reference, settings)
    if not isinstance(scene.geometry, Column):
        raise SceneError(f"{scene.name}: speed against error is measured on a column")
    cells, finer = sorted(set(cells)), sorted(set(finer) - set(cells))
    if len(cells) < 3 or min([*cells, *finer]) <= 0:
        raise SceneError("--cells: three different resolutions at least, to extrapolate from, all > 0 [cells per r0]")
    decided = {"explicit.damping": DAMPING, "explicit.until": "rest", "explicit.precision": "float64"}
    decided["explicit.cfl"] = CFL  # given, as a scene file may have another
    refuse_settings(settings, (*decided, "grid.cell", *SETS))
    if fixed := scene.explicit.time_step:
        raise SceneError(
            f"explicit.time_step = {fixed:g} [s]: a fixed step ignores explicit.cfl, which the study sets; leave it out"
        )
    common = [*settings, *(f"{key}={value}" for key, value in decided.items()), "output.vtk=false", "output.every=2.0"]
    common.append("output.fields=['displacement', 'eps_p_eqv', 'volume']")

    def job(mode, count, label="", *more, **named):
        sized = (*common, f"grid.cell={scene.geometry.radius / count!r}", *more)
        return Job(f"{mode}-{count:g}{label}", reference, sized, mode, device if mode == "explicit" else "cpu", **named)

    jobs = [job("explicit", count) for count in [*cells, *finer]]
    jobs += [job("explicit", count, "-float32", "explicit.precision=float32") for count in cells]
    jobs += [job("implicit", count) for count in cells]
    for factor in FACTORS:
        young = f"material.young={scene.material.young * factor!r}"
        jobs += [job(mode, cells[1], f"-E{factor}", young) for mode in SOLVERS]
    if softened := softened_settings(reference, settings):
        jobs.append(job("explicit", cells[1], f"-{SOFTENED}", *softened))
    jobs += [job("explicit", cells[2], f"-cfl{cfl}", f"explicit.cfl={cfl}") for cfl in OTHER_CFL]
    jobs += [job("implicit", cells[2], f"-reach{reach}", regularisation={"reach": reach}) for reach in REACH]
    return sorted(jobs, key=lambda one: one.scene.material.young**0.5 / one.scene.grid.cell**4, reverse=True)


def study_error(
    directory: Path, force, monitor, command: str, reference, settings, cells, finer, realisations: int, device, workers
) -> dict:
    """Run or reuse the ladder and draw the figures in `directory`; the report (see `compare.report.page`).

    `reference`: scene file or preset of a column, `settings` KEY=VALUE of it; `cells` and `finer` [cells per r0]: see
    `ladder`. `force`, `monitor`, `command`, `workers` and what is raised: see `compare.studies`.
    """
    jobs = ladder(reference, settings, cells, finer, device)
    scene = load_scene(reference, settings)
    about_what = {"study": "error", "scene": scene.model_dump(mode="json"), "device": device}
    about_what |= {"cells": sorted(cells), "finer": sorted(finer), "realisations": list(range(realisations))}
    refuse_another(directory, about_what, force)
    ensembles = run_ensembles(jobs, realisations, directory / "runs", workers, force, monitor)
    rows = [_row(job, outcomes) for job, outcomes in zip(jobs, ensembles, strict=True)]
    rows.sort(key=lambda row: (row["family"], row["cells"], row["young"]))
    plain = [row for row in rows if row["changed"] == ""]
    limits = {solver: _limit([row for row in plain if row["family"] == solver]) for solver in SOLVERS}
    for row in rows:
        row |= _errors(row, limits, plain)
    base = scene.material.young
    first = [outcomes[0] for outcomes in ensembles]
    checks = [*_checks(rows, plain, limits), stiffness_check(rows, base)]
    table = [flat({key: value for key, value in row.items() if key != "each"}, ESTIMATES) for row in rows]
    write_table(table, directory)
    everything = [one for outcomes in ensembles for one in outcomes]
    return {
        "about": about_what,
        "title": f"{scene.name}: speed against error",
        "lead": f"Collapse to rest, quasistatic by the implicit solver and damped by the explicit one (D = {DAMPING}), "
        f"over resolution, precision, step and stiffness, {realisations} realisations of each. Runs at a time: "
        f"{workers.runs}, each on {_ranks(workers)}.",
        "verdict": verdict(checks),
        "checks": checks,
        "sections": [
            _against_error(plain, limits, jobs, first, directory),
            stiffness_section(rows, base, first, directory),
            _all_rows(rows, first),
            {"title": "What the measures mean", "text": WHAT_MEASURES_MEAN, "tables": [], "figures": []},
        ],
        "provenance": about(everything, command),
        "failed": failures(everything, [one.job.name for one in everything]),
        "limits": {solver: vars(limit) for solver, limit in limits.items()},
        "rows": table,
    }


def _ranks(workers: Workers) -> str:
    return f"{workers.ranks} MPI ranks where its solver takes several" if workers.ranks > 1 else "one core"


def _row(job: Job, outcomes: list[Outcome]) -> dict:
    """One point of the study from the realisations of its job: estimates of measures, medians of times."""
    scene = job.scene
    label = job.name.partition("-")[2].partition("-")[2]  # what follows MODE-CELLS
    done = [one for one in outcomes if one.done]
    summaries = [one.summary for one in done]
    deposits = [deposit(one.results) for one in done]
    row = {
        "solver": job.mode,
        "family": "explicit, float32" if label == "float32" else job.mode,
        "changed": "" if label == "float32" else label,
        "cells": round(scene.geometry.radius / scene.grid.cell, 6),
        "young": scene.material.young,
        "precision": scene.explicit.precision if job.mode == "explicit" else "float64",
        "failed": "; ".join(dict.fromkeys(one.reason for one in outcomes if not one.done)) or None,
        "R_995": estimate(one["R_995"] for one in summaries),
        "each": [one.summary["R_995"] if one.done else None for one in outcomes],
        "R_max": estimate(one["R_max"] for one in summaries),
        "volume_gain": estimate(one["volume_error"] for one in deposits),
    }
    typical = ("points", "steps", "newton_iterations", "wall_s", "setup_s", "peak_memory_mb")
    names = dict(zip(typical, ("points", "steps", "newton_iterations", "seconds", "setup", "memory_mb"), strict=True))
    for key, name in names.items():
        known = [one[key] for one in summaries if one.get(key) is not None]
        row[name] = median(known) if known else None
    times = [one["wall_s"] for one in summaries]
    row |= {"fastest": min(times, default=None), "slowest": max(times, default=None)}
    row |= {"eq4": summaries[0]["eq4"] if done else None}
    row["young_used"] = summaries[0].get("young_used", row["young"]) if done else None
    row["stop_reason"] = " ".join(dict.fromkeys(one["stop_reason"] for one in summaries)) or None
    return row | made_by(outcomes[0])


def _limit(rows: list[dict]) -> EnsembleLimit:
    """What R_995 of these resolutions tends to (see `compare.convergence.ensemble_limit`)."""
    if len(rows) < 3 or any(row["R_995"] is None for row in rows):
        nothing = float("nan")
        return EnsembleLimit(nothing, nothing, nothing, nothing, "not converged: a resolution has no run that ended")
    return ensemble_limit([1.0 / row["cells"] for row in rows], [row["R_995"] for row in rows])


def _finest(rows: list[dict], family: str) -> Estimate | None:
    """R_995 on the finest grid of `family`."""
    mine = [row for row in rows if row["family"] == family and row["R_995"]]
    return max(mine, key=lambda row: row["cells"])["R_995"] if mine else None


def _errors(row: dict, limits: dict[str, EnsembleLimit], plain: list[dict]) -> dict:
    """`error`: relative distance of R_995 from its solver's limit, None where that has none; `error_other`: from the
    other solver's limit, or from its finest ensemble; `error_half`: half of the interval of R_995, relative too."""
    known, other = limits[row["solver"]], limits[SOLVERS[1 - SOLVERS.index(row["solver"])]]
    finest = _finest(plain, SOLVERS[1 - SOLVERS.index(row["solver"])])
    against = other.value if other.known else finest.mean if finest else None
    found = row["R_995"]
    return {
        "error": abs(found.mean / known.value - 1.0) if found and known.known else None,
        "error_other": abs(found.mean / against - 1.0) if found and against else None,
        "error_half": found.half / found.mean if found else None,
    }


def _checks(rows, plain, limits) -> list[dict]:
    checks = [
        check(
            f"{solver} run-out converges",
            None if limit.undecided else float(not limit.known),
            0.0,
            f"R_995 {limit.said}.",
        )
        for solver, limit in limits.items()
    ]

    def judged(name, allowed, changes):
        parts = []
        for where, change in changes:
            parts.append(Part(where, change, -allowed, allowed, change.said("+.1%") if change else "a run failed"))
        holds, cases = joined(parts)
        found = check(
            name, None if holds is None else float(not holds), 0.0, f"R_995 {cases}; {allowed:.0%} is allowed."
        )
        checks.append(found)

    def at(family, cells):
        return next(r["each"] for r in rows if (r["family"], r["cells"], r["changed"]) == (family, cells, ""))

    finest = [_finest(plain, solver) for solver in ("implicit", "explicit")]
    apart = relative(*finest) if all(finest) else None
    judged("solvers agree on their finest grids", SOLVERS_AGREE, [("implicit over explicit", apart)])
    single = [row for row in plain if row["family"] == "explicit, float32"]
    changes = [(f"{row['cells']:g} cells", paired(row["each"], at("explicit", row["cells"]))) for row in single]
    judged("float32 gives the run-out of float64", PRECISION_AGREES, changes)
    for solver, of in (("explicit", "cfl"), ("implicit", "reach")):
        varied = [row for row in rows if row["solver"] == solver and row["changed"].startswith(of)]
        changes = [
            (f"{of} {row['changed'].removeprefix(of)}", paired(row["each"], at(solver, row["cells"]))) for row in varied
        ]
        judged(f"{solver} run-out hardly depends on the step", STEP_AGREES, changes)
    return checks


def _against_error(plain, limits, jobs, first, directory) -> dict:
    text = [f"{solver.capitalize()}: R_995 {limit.said}." for solver, limit in limits.items()]
    text.append(
        "The error of a point is the relative distance of its mean R_995 from its solver's limit; where there is none "
        "it has no error. Against the other solver: from that one's limit, or from its finest grid. An error below "
        "half of the interval of the mean (table below) is none that these runs can tell. Numbers beside points are "
        "cells per r0."
    )
    figures = []
    shown = [row | {"label": row["family"], "note": f"{row['cells']:g}"} for row in plain if row["seconds"]]
    theory = [row["R_995"] and row["eq4"] and abs(row["R_995"].mean / row["eq4"] - 1.0) for row in shown]
    for file, errors, label, caption in (
        ("speed-error.png", [row["error"] for row in shown], "error of R_995 [-]", "each solver against its own limit"),
        ("speed-other.png", [row["error_other"] for row in shown], "distance from the other solver [-]",
         "each solver against the other"),
        ("speed-theory.png", theory, "|R_995 / Eq. 4 - 1|", "each solver against Eq. 4"),
    ):  # fmt: skip
        if points := [row | {"error": error} for row, error in zip(shown, errors, strict=True) if error]:
            draw_cost(points, directory / file, label)
            figures.append(figure(file, f"Error of the run-out over wall time, {caption}."))
    done = {job.name: one for job, one in zip(jobs, first, strict=True) if one.done}
    names = {solver: [f"{solver}-{row['cells']:g}" for row in plain if row["family"] == solver] for solver in SOLVERS}
    finest = {solver: [done[name] for name in mine if name in done][-1:] for solver, mine in names.items()}
    if all(finest.values()):
        pair = [one for (one,) in finest.values()]
        draw_profiles(pair, SOLVERS, directory / "finest.png")
        figures.append(figure("finest.png", "Profiles of the finest run of each solver."))
        a, b = (profile(one.results.snapshot(-1)["x"], one.results.scene) for one in pair)
        text.append(f"{profile_distance(a, b):.1%} of the deposit's volume lies between the finest profiles of both.")
    return {"title": "Speed against error", "text": text, "tables": [], "figures": figures}


def _all_rows(rows, first) -> dict:
    columns = ["run", "cells per r0", "changed", "n", "points", "R_995", "over Eq. 4", "error", "half of the interval",
               "from the other solver", "volume gain", "time stepping [s]", "fastest", "slowest", "set-up [s]",
               "memory [MB]", "ended"]  # fmt: skip
    table = []
    for row in rows:
        found = row["R_995"]
        if found is None:
            table.append([row["family"], row["cells"], row["changed"], 0, *[None] * 12, f"failed: {row['failed']}"])
            continue
        ended = ", ".join(HOW_ENDED[one] for one in row["stop_reason"].split())
        shares = [None if row[key] is None else f"{row[key]:.1%}" for key in ("error", "error_half", "error_other")]
        table.append(
            [row["family"], row["cells"], row["changed"] or "-", found.n, row["points"], found.said(".4f"),
             percent(found.mean / row["eq4"] - 1.0) if row["eq4"] else None, *shares, percent(row["volume_gain"].mean),
             row["seconds"], row["fastest"], row["slowest"], row["setup"], row["memory_mb"],
             ended + (f"; others failed: {row['failed']}" if row["failed"] else "")]
        )  # fmt: skip
    text = ["Times are medians over the realisations. Compilation and set-up are apart."]
    tables = [{"caption": "All points", "columns": columns, "rows": table}]
    tables.append(stability_table(first, [one.job.name for one in first]))
    return {"title": "All runs", "text": text, "tables": tables, "figures": []}
