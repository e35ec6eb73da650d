"""`repose compare`: implicit against explicit with D = 0.4 and against Eq. 4, from one scene, as a report."""

import hashlib
import tempfile
from pathlib import Path

import numpy as np

from compare.batch import Job, Outcome, Workers, run_all
from compare.checks import quasistatic_checks
from compare.metrics import axis_of, deposit, eq4_profile, profile, profile_distance
from compare.plots.reports import draw_cost, draw_histories, draw_plan_and_section, draw_profiles, strain_limit
from compare.report.page import refuse_another, write_table
from compare.report.sections import (
    WHAT_MEASURES_MEAN,
    about,
    cost_table,
    eq6_section,
    failures,
    figure,
    runs_table,
    setup_section,
    softened_note,
    soil_section,
    stability_table,
    verdict,
)
from compare.studies import refuse_settings
from mpm.body import build
from mpm.errors import SceneError
from mpm.load import load_scene, to_toml
from mpm.runout import front
from mpm.scene import Scene
from mpm.theory import outlook, theory

DAMPING = 0.4  # of the explicit run: what the paper takes for the quasistatic collapse
COLLAPSED = 0.01  # advance of R_995 above which a body has run out
COLOURED = ["displacement", "eps_p_eqv", "volume"]


def plan(reference: str, settings: list[str], device: str) -> list[Job]:
    """Both solvers on the scene's grid and, where the geometry fits it, on one of twice the cell size.

    Raises SceneError for a scene that cannot come to a quasistatic rest, or with every problem of the scene.
    """
    refuse_settings(settings, ("explicit.damping", "explicit.until"), f"a comparison runs to rest with D = {DAMPING}")
    scene = load_scene(reference, settings)
    if scene.loads.gravity == 0:
        raise SceneError(
            f"{scene.name}: without gravity nothing collapses; a comparison needs loads.gravity > 0 [m/s2]"
        )
    fields = list(dict.fromkeys([*scene.output.fields, *COLOURED]))
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


def keep_scene(scene: Scene, directory: Path, device: str, force: bool) -> Path:
    """A file of `scene` among the runs of its comparison in `directory`, whose commands name it.

    Raises SceneError, and writes nothing, where `plan` does and where another study's report is in `directory`.
    """
    text = to_toml(scene)
    name = f"scene-{hashlib.sha256(text.encode()).hexdigest()[:12]}.toml"  # that no other scene's file has
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / name
        file.write_text(text, encoding="utf-8")
        refuse_another(directory, _about_what(plan(str(file), [], device), device), force)
    kept = directory / "runs" / name
    kept.parent.mkdir(parents=True, exist_ok=True)
    kept.write_text(text, encoding="utf-8")
    return kept


def _about_what(jobs: list[Job], device: str) -> dict:
    """What a comparison is about, for `refuse_another`."""
    return {"study": "compare", "scene": jobs[0].scene.model_dump(mode="json"), "device": device}


def compare_solvers(
    directory: Path, force, monitor, command: str, reference: str, settings, device: str, ranks: int = 1
) -> dict:
    """Run or reuse what `plan` asks for, and draw the figures in `directory`; the report (see `compare.report`).

    `reference`: scene file or preset, `settings` KEY=VALUE of it; `ranks`: MPI ranks of each run. `force`, `monitor`,
    `command` and what is raised, beside what `plan` raises: see `compare.studies`.
    """
    jobs = plan(reference, settings, device)
    scene = jobs[0].scene
    about_what = _about_what(jobs, device)
    refuse_another(directory, about_what, force)
    outcomes = run_all(jobs, directory / "runs", Workers(ranks=ranks), force, monitor)
    labels = [_label(one) for one in outcomes]
    deposits = [deposit(one.results) if one.done else None for one in outcomes]
    fine = {one.job.mode: one for one in outcomes[:2] if one.done}
    distances = _distances(fine, scene)
    collapsed = any(_ran_out(one) for one in outcomes if one.done)
    checks = quasistatic_checks(outcomes, deposits, distances, collapsed)
    runs = runs_table(outcomes, labels, deposits)
    sections = [
        soil_section(scene),
        _agreement(outcomes, runs, distances),
        _shape(fine, directory),
        _way_to_rest(fine, directory),
        _cost(outcomes, labels, directory),
        {"title": "Stability", "text": failures(outcomes, labels), "tables": [stability_table(outcomes, labels)]}
        | {"figures": []},
        setup_section(scene),
        {"title": "What the measures mean", "text": WHAT_MEASURES_MEAN, "tables": [], "figures": []},
        eq6_section(),
    ]
    write_table([dict(zip(runs["columns"], row, strict=True)) for row in runs["rows"]], directory)
    return {
        "about": about_what,
        "title": f"{scene.name}: implicit against explicit and theory",
        "lead": _finding(outcomes, labels)
        + f"Collapse of one scene, quasistatic by the implicit solver and damped by the explicit one (local damping "
        f"D = {DAMPING}), cell size {scene.grid.cell:g} m; theory is Eq. 4 of Wyser et al. (2023) with the angle of "
        "friction.",
        "opening": _profiles(outcomes, labels, directory),
        "verdict": verdict(checks),
        "checks": checks,
        "sections": [section for section in sections if section],
        "provenance": about(outcomes, command),
        "failed": failures(outcomes, labels),
        "deposits": dict(zip(labels, deposits, strict=True)),
        "distances": distances,
        "runs": {label: one.summary or {"failed": one.reason} for label, one in zip(labels, outcomes, strict=True)},
    }


def _ran_out(outcome: Outcome) -> bool:
    """Whether the front has advanced from where it stood at the start."""
    measure = build(outcome.job.scene).measure
    start, end = (
        front(x, measure)["R_995"] for x in (outcome.results.read_static("x0"), outcome.results.snapshot(-1)["x"])
    )
    return end - start > COLLAPSED


def _label(outcome: Outcome) -> str:
    coarse = ", twice the cell" if outcome.job.name.endswith("-coarse") else ""
    return outcome.job.mode + (f", D = {DAMPING:g}" if outcome.job.mode == "explicit" else "") + coarse


def _distances(fine: dict[str, Outcome], scene: Scene) -> dict[str, float]:
    """L1 distance between the profiles of the runs on the scene's own grid, and from Eq. 4's solid."""
    profiles = {mode: profile(one.results.snapshot(-1)["x"], scene, axis_of(one.results)) for mode, one in fine.items()}
    found = {}
    if len(profiles) == 2:
        found["implicit from explicit"] = profile_distance(profiles["implicit"], profiles["explicit"])
    if known := theory(scene)["eq4"]:
        cell = scene.grid.cell
        for mode, one in profiles.items():
            # To Eq. 4's foot at least: beyond a deposit that stops short its volume counts as well.
            foot = scene.geometry.radius * (1.0 + known)
            edges = cell * np.arange(np.ceil(max(one.edges[-1], foot) / cell - 1e-9) + 1)
            found[f"{mode} from Eq. 4"] = profile_distance(one, eq4_profile(scene, edges))
    return found


def _finding(outcomes, labels) -> str:
    """What came out, in a sentence: run-outs of the runs on the scene's own grid, and of Eq. 4."""
    run_outs = [
        f"{one.summary['R_995']:.2f} ({label})" for one, label in zip(outcomes[:2], labels[:2], strict=True) if one.done
    ]
    if known := theory(outcomes[0].job.scene)["eq4"]:
        run_outs.append(f"{known:.2f} (Eq. 4)")
    return f"99.5 % of the mass comes to rest within this many first radii of where it stood: {', '.join(run_outs)}. "


def _profiles(outcomes, labels, directory) -> list[dict]:
    """The deposits' profiles beside Eq. 4's solid, where there are any."""
    done = [(one, label) for one, label in zip(outcomes[:2], labels[:2], strict=True) if one.done]
    if not done or outcomes[0].job.scene.geometry.shape != "column":
        return []
    ended, names = zip(*done, strict=True)
    draw_profiles(ended, names, directory / "profiles.png")
    return [figure("profiles.png", "Azimuthal mean thickness over the radius: mass in a ring over its area.")]


def _agreement(outcomes, runs, distances) -> dict:
    tables = [runs]
    scene = outcomes[0].job.scene
    if known := theory(scene)["eq4"]:
        text = [
            f"Eq. 4: R = {known:.4f}; flank angle {scene.material.friction_angle:g} degrees. One number stands for "
            "all run-outs of Eq. 4: its foot is sharp."
        ]
    else:
        text = ["Eq. 4 is for a column that only friction holds: it says nothing of this scene."]
        text += [f"{said[0].upper()}{said[1:]}." for said in [outlook(build(scene))] if said]
    if len(outcomes) == 2:
        text.append("Twice the cell size does not fit this geometry: how far the grid decides was not tried.")
    text += softened_note(outcomes)
    if distances:
        rows = [[name, f"{value:.1%}"] for name, value in distances.items()]
        tables.append({"caption": "Distance between profiles", "columns": ["profile", "volume between"], "rows": rows})
    return {"title": "How far the deposits agree", "text": text, "tables": tables, "figures": []}


def _shape(fine, directory) -> dict | None:
    if not fine:
        return None
    most, figures = strain_limit(list(fine.values())), []
    for mode, one in fine.items():
        name = f"deposit-{mode}.png"
        draw_plan_and_section(one, mode, directory / name, most)
        figures.append(figure(name, f"{mode}: the deposit from above and in a vertical cut."))
    return {"title": "Shape of the deposits", "text": [], "tables": [], "figures": figures}


def _way_to_rest(fine, directory) -> dict | None:
    if not fine:
        return None
    runs = list(fine.values())
    time_scale = build(runs[0].job.scene).time_scale
    draw_histories(runs, list(fine), time_scale, directory / "histories.png")
    text = (
        "The explicit run's time is physical, slowed down by damping; the implicit run's is a pseudo-time that orders "
        "its steps. Only where they end can be compared."
    )
    drawn = figure("histories.png", "Run-out, and below it what is left before rest.")
    return {"title": "On the way to rest", "text": [text], "tables": [], "figures": [drawn]}


def _cost(outcomes, labels, directory) -> dict:
    figures, points = [], []
    for one in outcomes:
        if one.done and (known := theory(one.job.scene)["eq4"]):
            off = abs(one.summary["R_995"] / known - 1.0)
            row = {"solver": one.job.mode, "label": one.job.mode, "seconds": one.summary["wall_s"], "error": off}
            points.append(row | {"note": f"{one.summary['cells_per_radius']:g}"})
    if points:
        draw_cost(points, directory / "cost.png", "|R_995 / Eq. 4 - 1|")
        figures.append(figure("cost.png", "Distance from Eq. 4 over wall time; the numbers are cells per r0."))
    text = [
        "Set-up, kernel compilation included where nothing was cached, is apart from time stepping; each run was made "
        "once. `repose study error` measures speed against error over a ladder of resolutions, by ensembles."
    ]
    implicit, explicit = (one.summary for one in outcomes[:2])
    if implicit and explicit:
        ratio = implicit["wall_s"] / explicit["wall_s"]
        text.insert(0, f"The implicit run took {ratio:.2f} times the explicit run's time.")
    return {"title": "Cost", "text": text, "tables": [cost_table(outcomes, labels)], "figures": figures}
