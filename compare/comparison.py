"""`repose compare`: implicit against explicit with D = 0.4 and against Eq. 4, from one scene, as a report."""

import csv
from pathlib import Path

from compare.batch import Job, Outcome, run_all
from compare.drawing import has_eq4
from compare.figures import draw_cost, draw_histories, draw_plan_and_section, draw_profiles, strain_limit
from compare.metrics import deposit, eq4_profile, profile, profile_distance
from compare.report import refuse_another
from compare.sections import (
    WHAT_MEASURES_MEAN,
    about,
    check,
    cost_table,
    eq6_section,
    failures,
    figure,
    runs_table,
    stability_table,
    verdict,
)
from implicit.relaxation import REST_UNBALANCED
from mpm.config import load_scene
from mpm.errors import SceneError
from mpm.scene import build

DAMPING = 0.4  # of the explicit run: the paper's quasistatic collapse
RUN_OUT_AGREES = 0.10  # relative difference in R_995; the collapse is chaotic, and its scatter alone is 1.5 %
PROFILE_AGREES = 0.10  # volume between two profiles over the deposit's
VOLUME_KEPT = 0.05  # gain over the initial volume: psi = 0 asks for none, 2 to 6 % are usual and fall with the cell
GRID_AGREES = 0.10  # relative change of R_995 from twice the cell size
COLLAPSED = 0.01  # R_connected above which a body has run out
FEW_FAILED = 0.05  # failed over all steps of the implicit run
COLOURED = ["displacement", "eps_p_eqv", "volume"]


def plan(reference: str, settings: list[str], device: str) -> list[Job]:
    """Both solvers on the scene's grid and, where the geometry fits it, on one of twice the cell size.

    Raises SceneError for a scene that cannot come to a quasistatic rest, or with every problem of the scene.
    """
    scene = load_scene(reference, settings)
    if scene.loads.gravity == 0:
        raise SceneError(
            f"{scene.name}: without gravity nothing collapses; a comparison needs loads.gravity > 0 [m/s2]"
        )
    fields = [name for name in dict.fromkeys([*scene.output.fields, *COLOURED])]
    if scene.material.model == "elastic":
        fields.remove("eps_p_eqv")
    common = [*settings, f"explicit.damping={DAMPING}", "explicit.until=rest", f"output.fields={fields}"]
    twice = [*common, f"grid.cell={2 * scene.grid.cell!r}"]
    try:
        build(load_scene(reference, twice))
        grids = {"": common, "-coarse": twice}
    except SceneError:
        grids = {"": common}
    return [
        Job(f"{mode}{suffix}", reference, tuple(grid), mode, device if mode == "explicit" else "cpu")
        for suffix, grid in grids.items()
        for mode in ("implicit", "explicit")
    ]


def compare_solvers(directory: Path, force, monitor, command: str, reference: str, settings, device: str) -> dict:
    """Run or reuse what `plan` asks for, and draw the figures in `directory`; the report (see `compare.report`)."""
    jobs = plan(reference, settings, device)
    scene = jobs[0].scene.model_dump(mode="json")
    about_what = {"study": "compare", "scene": scene, "device": device}
    refuse_another(directory, about_what, force)
    outcomes = run_all(jobs, directory / "runs", 1, force, monitor)
    labels = [_label(one) for one in outcomes]
    deposits = [deposit(one.results) if one.done else None for one in outcomes]
    fine = {one.job.mode: one for one in outcomes[:2] if one.done}
    distances = _distances(fine, scene)
    checks = _checks(outcomes, deposits, distances, scene)
    sections = [
        _agreement(outcomes, labels, deposits, distances, directory),
        _shape(fine, directory),
        _way_to_rest(fine, directory),
        _cost(outcomes, labels, scene, directory),
        {"title": "Stability", "text": failures(outcomes, labels), "tables": [stability_table(outcomes, labels)]}
        | {"figures": []},
        {"title": "What the measures mean", "text": WHAT_MEASURES_MEAN, "tables": [], "figures": []},
        eq6_section(),
    ]
    rows = runs_table(outcomes, labels, deposits)
    _write_table(rows, directory / "table.csv")
    cells = outcomes[0].job.scene.grid.cell
    return {
        "about": about_what,
        "title": f"{scene['name']}: implicit against explicit and theory",
        "lead": f"Quasistatic collapse of one scene by the implicit solver and by the explicit one with local damping "
        f"D = {DAMPING}, cell size {cells:g} m; theory is Eq. 4 of Wyser et al. (2023) with the friction angle.",
        "verdict": verdict(checks),
        "checks": checks,
        "sections": [section for section in sections if section],
        "provenance": about(outcomes, command),
        "failed": failures(outcomes, labels),
        "deposits": dict(zip(labels, deposits, strict=True)),
        "distances": distances,
        "runs": {label: one.summary or {"failed": one.reason} for label, one in zip(labels, outcomes, strict=True)},
    }


def _label(outcome: Outcome) -> str:
    coarse = ", twice the cell" if outcome.job.name.endswith("-coarse") else ""
    return outcome.job.mode + (f", D = {DAMPING:g}" if outcome.job.mode == "explicit" else "") + coarse


def _distances(fine: dict[str, Outcome], scene: dict) -> dict[str, float]:
    """L1 distance between the profiles of the runs on the scene's own grid, and from Eq. 4's solid."""
    profiles = {mode: profile(one.results.snapshot(-1)["x"], scene) for mode, one in fine.items()}
    found = {}
    if len(profiles) == 2:
        found["implicit from explicit"] = profile_distance(profiles["implicit"], profiles["explicit"])
    if has_eq4(scene):
        for mode, one in profiles.items():
            found[f"{mode} from Eq. 4"] = profile_distance(one, eq4_profile(scene, one.edges))
    return found


def _checks(outcomes, deposits, distances, scene) -> list[dict]:
    """What is asked of a quasistatic collapse, with what was measured; None where a run failed."""
    implicit, explicit = deposits[:2]
    summaries = [one.summary or {} for one in outcomes[:2]]
    found = []

    def run_out(name, value, reference, of):
        off = value / reference - 1.0 if value and reference else None
        said = "a run failed" if off is None else f"R_995 {value:.3f} against {reference:.3f}, {off:+.1%}"
        found.append(check(name, off, RUN_OUT_AGREES, f"{said}; {RUN_OUT_AGREES:.0%} of {of} is allowed."))

    # What stands has no run-out to compare.
    collapsed = any(one and one["R_connected"] > COLLAPSED for one in deposits)
    r_implicit, r_explicit = (one and one["R_995"] for one in (implicit, explicit))
    if collapsed:
        run_out("implicit run-out agrees with explicit", r_implicit, r_explicit, "the explicit run-out")
    if collapsed and has_eq4(scene):
        theory = (summaries[0] or summaries[1]).get("eq4")
        run_out("implicit run-out agrees with Eq. 4", r_implicit, theory, "Eq. 4")
        run_out("explicit run-out agrees with Eq. 4", r_explicit, theory, "Eq. 4")
    apart = distances.get("implicit from explicit")
    said = "a run failed" if apart is None else f"{apart:.1%} of the deposit's volume lies between them"
    found.append(check("profiles agree", apart, PROFILE_AGREES, f"{said}; {PROFILE_AGREES:.0%} is allowed."))
    for one, summary in zip(outcomes[:2], summaries, strict=True):
        mode = one.job.mode
        stopped = summary.get("stop_reason")
        moving = None if not stopped else float(stopped != "rest")
        measure = {"implicit": ("out-of-balance force over external", "unbalanced_ratio"),
                   "explicit": ("grid kinetic energy over its peak", "grid_ke_ratio")}[mode]  # fmt: skip
        said = f"{measure[0]} {summary[measure[1]]:.1e}" if stopped else "the run failed"
        limit = f"{REST_UNBALANCED:g}" if mode == "implicit" else "1e-4"
        sentence = f"{said}; rest asks for {limit} and a front that moves by less than 0.1 % in sqrt(h0/g)."
        found.append(check(f"{mode} run came to rest", moving, 0.0, sentence))
    share = summaries[0]["failed_steps"] / summaries[0]["steps"] if summaries[0].get("steps") else None
    said = "the run failed" if share is None else f"{summaries[0]['failed_steps']} of {summaries[0]['steps']} steps"
    found.append(
        check(
            "implicit steps succeed", share, FEW_FAILED, f"{said} had to be tried again; {FEW_FAILED:.0%} is allowed."
        )
    )
    for one, measured in zip(outcomes[:2], deposits[:2], strict=True):
        gain = measured and measured["volume_error"]
        said = "the run failed" if gain is None else f"the deposit gained {gain:+.1%}"
        found.append(
            check(f"{one.job.mode} keeps its volume", gain, VOLUME_KEPT, f"{said}; {VOLUME_KEPT:.0%} is allowed.")
        )
    pairs = zip(outcomes[2:], deposits[2:], deposits[:2], strict=False) if collapsed else ()
    for one, coarse, measured in pairs:
        off = coarse["R_995"] / measured["R_995"] - 1.0 if coarse and measured else None
        said = "a run failed" if off is None else f"with twice the cell R_995 is {coarse['R_995']:.3f}, {off:+.1%}"
        name = f"{one.job.mode} run-out hardly depends on the grid"
        found.append(check(name, off, GRID_AGREES, f"{said}; {GRID_AGREES:.0%} is allowed."))
    return found


def _agreement(outcomes, labels, deposits, distances, directory) -> dict:
    done = [(one, label) for one, label in zip(outcomes[:2], labels[:2], strict=True) if one.done]
    tables = [runs_table(outcomes, labels, deposits)]
    theory = next((one.summary["eq4"] for one in outcomes if one.done), None)
    if theory:
        scene = outcomes[0].job.scene
        text = [
            f"Eq. 4: R = {theory:.4f}; flank angle {scene.material.friction_angle:g} degrees. One number stands for "
            "all run-outs of Eq. 4: its foot is sharp."
        ]
    else:
        text = ["Eq. 4 is for a column with friction: it says nothing of this scene."]
    if distances:
        rows = [[name, f"{value:.1%}"] for name, value in distances.items()]
        tables.append({"caption": "Distance between profiles", "columns": ["profile", "volume between"], "rows": rows})
    figures = []
    if done and outcomes[0].job.scene.geometry.shape == "column":
        draw_profiles(*zip(*done, strict=True), directory / "profiles.png")
        figures.append(
            figure("profiles.png", "Azimuthal mean thickness over the radius: mass in a ring over its area.")
        )
    return {"title": "How far the deposits agree", "text": text, "tables": tables, "figures": figures}


def _shape(fine, directory) -> dict | None:
    if not fine:
        return None
    most, figures = strain_limit(list(fine.values())), []
    for mode, one in fine.items():
        name = f"deposit-{mode}.png"
        draw_plan_and_section(one, mode, directory / name, most)
        figures.append(figure(name, f"{mode}: the deposit from above and cut along y = 0, one colour scale for both."))
    return {"title": "Shape of the deposits", "text": [], "tables": [], "figures": figures}


def _way_to_rest(fine, directory) -> dict | None:
    if not fine:
        return None
    runs = list(fine.values())
    time_scale = build(runs[0].job.scene).time_scale
    draw_histories(runs, list(fine), time_scale, directory / "histories.png")
    text = (
        "The explicit run's time is physical, slowed down by damping; the implicit run's is a pseudo-time that orders "
        "its equilibria. Only where they end can be compared."
    )
    drawn = figure("histories.png", "Run-out, and below it what is left before rest.")
    return {"title": "On the way to rest", "text": [text], "tables": [], "figures": [drawn]}


def _cost(outcomes, labels, scene, directory) -> dict:
    figures, points = [], []
    for one in outcomes:
        if one.done and has_eq4(scene):
            off = abs(one.summary["R_995"] / one.summary["eq4"] - 1.0)
            row = {"solver": one.job.mode, "label": one.job.mode, "seconds": one.summary["wall_s"], "error": off}
            points.append(row | {"note": f"{one.summary['cells_per_radius']:g}"})
    if points:
        draw_cost(points, directory / "cost.png", "|R_995 / Eq. 4 - 1|")
        figures.append(figure("cost.png", "Distance from Eq. 4 over wall time; the numbers are cells per r0."))
    text = [
        "Set-up, kernel compilation included where nothing was cached, is apart from time stepping; each run was made "
        "once. `repose study error` measures speed against error over a ladder of resolutions, with repeats."
    ]
    implicit, explicit = (one.summary for one in outcomes[:2])
    if implicit and explicit:
        ratio = implicit["wall_s"] / explicit["wall_s"]
        text.insert(0, f"The implicit run took {ratio:.2f} times the explicit run's time.")
    return {"title": "Cost", "text": text, "tables": [cost_table(outcomes, labels)], "figures": figures}


def _write_table(table: dict, path: Path):
    with open(path, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(table["columns"])
        writer.writerows(table["rows"])
