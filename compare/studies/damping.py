"""`repose study damping`: which local damping D meets a run-out, and what D does that the quasistatic solver does
without."""

from itertools import pairwise
from pathlib import Path

from compare.batch import Job, Outcome
from compare.calibration import HIGHEST, LOWEST, Calibration, bisect
from compare.ensembles import SETS, Estimate, estimate, flat, run_ensembles
from compare.plots.reports import draw_calibration
from compare.report.page import refuse_another, write_table
from compare.report.sections import WHAT_MEASURES_MEAN, about, check, failures, figure, made_by, verdict
from compare.solvers import runs_of
from compare.studies import refuse_settings
from mpm.body import build
from mpm.errors import SceneError
from mpm.load import load_scene
from mpm.precheck import refusals
from mpm.scene import Scene
from mpm.theory import theory

EQ4 = "eq4"
MEASURES = ("R_995", "R_max")
SPENT = {"damped": "W_damping", "decayed": "W_decay", "plastic": "W_plastic"}  # share of gravity's work: its column
SHARES = (*SPENT, "peak_motion")
ESTIMATES = (*MEASURES, *SHARES)


def target_of(target: str, scene: Scene) -> float:
    """The run-out [-] asked for: a number, or "eq4" for that of Eq. 4. Raises SceneError for anything else."""
    if target == EQ4:
        known = theory(scene)[EQ4]
        if known is None:
            raise SceneError("--target eq4: Eq. 4 is for a column that only friction holds; give a number > 0 [-]")
        return known
    try:
        value = float(target)
    except ValueError:
        value = 0.0
    if not 0 < value < float("inf"):
        raise SceneError(f"--target {target}: must be a run-out R_995 > 0 [-], or eq4")
    return value


def study_damping(
    directory: Path, force, monitor, command: str, reference, settings, target: str, realisations: int, device, workers
) -> dict:
    """Run or reuse ensembles of ever nearer D and draw the figure in `directory`; the report (see `compare.report`).

    `reference`: scene file or preset, `settings` KEY=VALUE of it; `target`: see `target_of`.
    `force`, `monitor`, `command`, `workers` and what is raised: see `compare.studies`.
    """
    scene = load_scene(reference, settings)
    refuse_settings(settings, ("explicit.damping", "explicit.until", *SETS))
    wanted = target_of(target, scene)
    about_what = {"study": "damping", "scene": scene.model_dump(mode="json"), "device": device, "target": target}
    about_what |= {"realisations": list(range(realisations))}
    refuse_another(directory, about_what, force)
    runs = directory / "runs"
    common = (*settings, "output.vtk=false", "explicit.until=rest")
    made: dict[float, list[Outcome]] = {}

    def run_outs(damping: float) -> Estimate | None:
        job = Job(f"D{damping:g}", reference, (*common, f"explicit.damping={damping!r}"), "explicit", device)
        (made[damping],) = run_ensembles([job], realisations, runs, workers, force, monitor)
        return _measure(made[damping], "R_995")

    found = bisect(run_outs, wanted)
    quasistatic, refused = [], _refused(scene)
    if not refused:
        job = Job("implicit", reference, (*settings, "output.vtk=false"), "implicit")
        (quasistatic,) = run_ensembles([job], realisations, runs, workers, force, monitor)
    rows = [_row(f"D = {damping:.4g}", damping, made[damping]) for damping in sorted(made)]
    rows += [_row("implicit", None, quasistatic)] if quasistatic else []
    write_table([flat(row, ESTIMATES) for row in rows], directory)
    everything = [one for outcomes in (*made.values(), quasistatic) for one in outcomes]
    # Runs held up by too much damping come to no result: they only tell where the search must not go.
    of_use = [made[damping] for damping in {LOWEST, *found.tried}]
    counted = [one for outcomes in (*of_use, quasistatic) for one in outcomes]
    failed, told = (failures(runs, [one.job.name for one in runs]) for runs in (counted, everything))
    checks = [_check(found, wanted, failed)]
    return {
        "about": about_what,
        "title": f"{scene.name}: local damping that meets a run-out of {wanted:.4g}",
        "lead": f"D in [{LOWEST:g}, {HIGHEST:g}] by bisection, {realisations} realisations of each, until the 95 % "
        "interval of their mean R_995 covers the target. The interval of D holds all D whose run-outs, on straight "
        "lines between those tried, have intervals that cover it.",
        "verdict": verdict(checks),
        "checks": checks,
        "sections": [
            _calibrated(found, wanted, rows, directory),
            _without(found, wanted, rows, refused),
            {"title": "Runs without a result", "text": told or ["None."], "tables": [], "figures": []},
            {"title": "What the measures mean", "text": WHAT_MEASURES_MEAN, "tables": [], "figures": []},
        ],
        "provenance": about(everything, command),
        "failed": failed,
        "damping": {"value": found.damping, "low": found.low, "high": found.high, "target": wanted},
        "rows": [flat(row, ESTIMATES) for row in rows],
    }


def _refused(scene: Scene) -> str:
    """Why the implicit solver would not run the scene; "" where it would."""
    try:
        runs_of("implicit")
    except SceneError as error:
        return str(error)
    return "; ".join(refusals(build(scene), "implicit"))


def _measure(outcomes: list[Outcome], key: str) -> Estimate | None:
    return estimate(one.summary[key] for one in outcomes if one.done)


def _row(label: str, damping: float | None, outcomes: list[Outcome]) -> dict:
    """One ensemble: run-outs, and of explicit runs the shares of gravity's work that went into damping, into the decay
    of what the grid does not see of velocities (where histories have it), plastic flow and, at its peak, motion."""
    done = [one for one in outcomes if one.done]
    row = {"run": label, "damping": damping, **{name: _measure(outcomes, name) for name in MEASURES}}
    histories = [one.results.history() for one in done] if damping is not None else []
    for key, column in SPENT.items():
        row[key] = estimate(history[column][-1] / history["W_ext"][-1] for history in histories if column in history)
    row["peak_motion"] = estimate(history["KE_grid"].max() / history["W_ext"][-1] for history in histories)
    row["at_rest"] = sum(one.summary["stop_reason"] == "rest" for one in done)
    return row | made_by(outcomes[0])


def _check(found: Calibration, wanted: float, failed: list[str]) -> dict:
    """Whether a D was found; not judged where runs failed."""
    if found.damping is None:
        return check("a D meets the target", None if failed else 1.0, 0.0, f"{found.said[0].upper()}{found.said[1:]}.")
    said = f"D = {found.damping:.4g} ({found.low:.4g} to {found.high:.4g}) for R_995 = {wanted:.4g}: {found.said}."
    return check("a D meets the target", 0.0, 0.0, said)


def _calibrated(found, wanted, rows, directory) -> dict:
    tried = [row for row in rows if row["damping"] is not None]
    known = {name: {row["damping"]: row[name] for row in tried if row[name]} for name in MEASURES}
    text, figures = [], []
    if known["R_995"]:
        draw_calibration(known, wanted, found.low, found.high, directory / "damping.png")
        caption = "Run-out over D. Bars: 95 % intervals of the mean; the band: D that meets the target."
        figures.append(figure("damping.png", caption))
    if found.damping is not None and (farthest := known["R_max"].get(found.damping)):
        text.append(f"There the farthest point, the paper's measure, ends at R_max = {farthest.said()}.")
    for (less, far), (more, near) in pairwise(sorted(known["R_max"].items())):
        if far.mean >= wanted > near.mean:
            other = less + (far.mean - wanted) / (far.mean - near.mean) * (more - less)
            text.append(f"By R_max the target would be met at about D = {other:.2g}, on a straight line between means.")
    columns = ["D", "n", "R_995", "R_max", "at rest"]
    table = [
        [row["damping"], row["R_995"].n if row["R_995"] else 0, *(row[name] and row[name].said() for name in MEASURES),
         row["at_rest"]]
        for row in tried
    ]  # fmt: skip
    tables = [{"caption": "All D that were tried", "columns": columns, "rows": table}]
    return {"title": "D that meets the target", "text": text, "tables": tables, "figures": figures}


def _without(found, wanted, rows, refused) -> dict:
    """What D stands for, by the energy ledger, and where the solver without it ends."""
    text = [
        "Local damping takes a share D of the out-of-balance force from every node, against its motion. It stands for "
        "what a collapse loses in collisions of grains, which the law of the material does not have, and is a choice: "
        "its share of gravity's work is in the table. The implicit solver has no D: a step balances forces and "
        "carries no momentum over. Where it declares rest is a choice too: heaps creep on, and it moves R_995 by "
        "several per cent.",
    ]
    implicit = next((row["R_995"] for row in rows if row["damping"] is None), None)
    if implicit:
        over = implicit.over(wanted).said("+.1%")
        text.append(f"It ends at R_995 = {implicit.said()}, {over} from the target.")
    elif refused:
        text.append(f"It was not run: {refused}.")
    columns = ["run", "R_995", "damping over gravity's work", "decay of unseen velocities"]
    columns += ["plastic flow", "kinetic energy at its peak"]
    table = [
        [row["run"], row["R_995"] and row["R_995"].said(), *(row[key] and row[key].said(".1%") for key in SHARES)]
        for row in rows
    ]
    tables = [{"caption": "Where gravity's work goes", "columns": columns, "rows": table}]
    return {"title": "What D does, and the solver without it", "text": text, "tables": tables, "figures": []}
