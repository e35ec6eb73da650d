"""Parts that the reports share: tables of runs, what the measures mean, the misprint of Eq. 6, provenance."""

import numpy as np

from compare.batch import Outcome
from compare.experiments import experiments
from mpm.provenance import installed, provenance
from mpm.scene import Scene, Section
from mpm.theory import eq6, eq6_printed, theory

WHAT_MEASURES_MEAN = [
    "Every run-out is R = (r - r0)/r0, with r0 the body's first radius (of a box, its length along x). R_995: r is "
    "the radius that holds 99.5 % of the mass; it is the measure to compare with theory. R_max: r is the farthest "
    "point of all and its half-length, which is the paper's measure; single grains decide it. R_connected: the "
    "farthest point of the body that is joined to the axis. h_inf is the final height. Cells per r0 is the resolution: "
    "the paper's is 20. Runs whose time step differs by 1 % end within 0.6 % in R_995.",
    "The flank angle is that of a straight line fitted to the azimuthal mean thickness where it is between 10 and 85 % "
    "of its greatest. The distance between two profiles is the volume between their mean thicknesses over the "
    "deposit's: 0 for the same profile, 2 for deposits that do not overlap. Volume gain: points that open swell.",
]
HOW_ENDED = {
    "rest": "at rest",
    "max_time": "time up, not at rest",
    "end_time": "end time",
    "max_steps": "steps up, not at rest",
}


def check(name: str, value: float | None, limit: float, sentence: str) -> dict:
    """A check that holds where |value| is at most `limit`; it could not be judged where `value` is None."""
    holds = None if value is None or not np.isfinite(value) else bool(abs(value) <= limit)
    return {"name": name, "holds": holds, "value": value, "limit": limit, "sentence": sentence}


def verdict(checks: list[dict]) -> dict:
    """How many checks hold, and which do not, by how much."""
    missed = [one["name"] + _by_how_much(one) for one in checks if one["holds"] is False]
    unjudged = [one["name"] for one in checks if one["holds"] is None]
    holding = len(checks) - len(missed) - len(unjudged)
    sentence = f"{holding} of {len(checks)} checks hold."
    if missed:
        sentence += f" These do not: {'; '.join(missed)}."
    if unjudged:
        sentence += f" These could not be judged: {'; '.join(unjudged)}."
    return {"holds": holding == len(checks), "sentence": sentence}


def _by_how_much(one: dict) -> str:
    """Value and limit of a check: a share in percent, a ratio as a number; of a yes or no nothing."""
    value, limit = one["value"], one["limit"]
    if limit == 0.0:
        return ""
    return f" ({value:+.1%}, {limit:.0%} allowed)" if limit < 1.0 else f" ({value:.3g}, {limit:.3g} allowed)"


def runs_table(outcomes: list[Outcome], labels: list[str], deposits: list[dict | None]) -> dict:
    """Run-outs and shape of each run; a failed one with its reason."""
    rows = []
    for outcome, label, found in zip(outcomes, labels, deposits, strict=True):
        if found is None:
            rows.append([label, *[None] * 10, f"failed: {outcome.reason}"])
            continue
        summary = outcome.summary
        rows.append(
            [label, summary["cells_per_radius"], summary["points"],
             found["R_995"], relative(found["R_995"], theory(outcome.job.scene)["eq4"]),
             found["R_connected"], found["R_max"], found["h_inf"], found["flank_angle"], found["centre_height"],
             percent(found["volume_error"]), HOW_ENDED[summary["stop_reason"]]]
        )  # fmt: skip
    columns = ["run", "cells per r0", "points", "R_995", "R_995 over Eq. 4", "R_connected", "R_max", "h_inf [m]",
               "flank angle [°]", "centre of mass [m]", "volume gain", "ended"]  # fmt: skip
    return {"caption": "Run-out and shape of the deposits", "columns": columns, "rows": rows}


def stability_table(outcomes: list[Outcome], labels: list[str]) -> dict:
    """What tells whether a run was sound: how it ended, steps, balance of mass, energy and forces."""
    rows = []
    for outcome, label in zip(outcomes, labels, strict=True):
        if not outcome.done:
            rows.append([label, f"failed: {outcome.reason}", *[None] * 8])
            continue
        s = outcome.summary
        per_step = s["newton_iterations"] / s["steps"] if "newton_iterations" in s else None
        rows.append(
            [label, HOW_ENDED[s["stop_reason"]], s["sim_time"], s["steps"], s.get("failed_steps"), per_step,
             s.get("unbalanced_ratio"), s.get("grid_ke_ratio"), percent(s.get("energy_residual")), s.get("mass_error")]
        )  # fmt: skip
    columns = ["run", "ended", "(pseudo-)time [s]", "steps", "failed steps", "Newton iterations a step",
               "out-of-balance / external force", "grid kinetic energy / peak", "energy residual",
               "mass error"]  # fmt: skip
    return {"caption": "Stability of the runs", "columns": columns, "rows": rows}


def cost_table(outcomes: list[Outcome], labels: list[str]) -> dict:
    """Time and memory of each run that ended."""
    figures = ("precision", "setup_s", "wall_s", "peak_memory_mb", "device")
    rows = [
        [label, *(s[name] for name in figures), s.get("ranks", 1), outcome.job.command]
        for outcome, label in zip(outcomes, labels, strict=True)
        if (s := outcome.summary)
    ]
    columns = ["run", "precision", "set-up [s]", "time stepping [s]", "peak memory [MB]", "device", "ranks", "command"]
    return {"caption": "Cost: a core for each MPI rank, or the GPU named", "columns": columns, "rows": rows}


def failures(outcomes: list[Outcome], labels: list[str]) -> list[str]:
    """A sentence for each run that failed."""
    return [f"{label} failed: {one.reason}" for one, label in zip(outcomes, labels, strict=True) if not one.done]


def soil_section(scene: Scene) -> dict:
    """The soil and the body that were computed."""
    tables = [_values("Soil", "material", scene.material), _values("Body", "geometry", scene.geometry)]
    return {"title": "Soil and body", "text": [], "tables": tables, "figures": []}


def setup_section(scene: Scene) -> dict:
    """Gravity, initial stress and grid."""
    tables = [_values("Gravity and initial stress", "loads", scene.loads), _values("Grid", "grid", scene.grid)]
    return {"title": "Loads and grid", "text": [], "tables": tables, "figures": []}


def _values(caption: str, section: str, model: Section) -> dict:
    """A table of a scene's section: what each value is, its unit and its key in a scene file."""
    rows: list[list] = []
    for key, field in type(model).model_fields.items():
        value, extra = getattr(model, key), field.json_schema_extra
        if isinstance(value, Section):
            rows += _values("", f"{section}.{key}", value)["rows"]
            continue
        unit = extra.get("unit") if isinstance(extra, dict) else None
        what = (field.description or "").removesuffix(f" [{unit}]")
        if unit == "Pa":  # as one reads them in a report on a soil
            value, unit = (value / 1e6, "MPa") if value >= 1e6 else (value / 1e3, "kPa")
        shown = value if isinstance(value, str | int | float | None) else ", ".join(f"{one:g}" for one in value)
        rows.append([what, shown, None if unit == "-" else unit, f"{section}.{key}"])
    return {"caption": caption, "columns": ["what", "value", "unit", "key"], "rows": rows}


def softened_note(outcomes: list[Outcome]) -> list[str]:
    """A sentence where the implicit solver followed the collapse of a stiff material with a smaller modulus."""
    for one in outcomes:
        used = (one.summary or {}).get("young_used", np.inf)
        if used < 0.999 * one.job.scene.material.young:
            return [
                "The implicit solver follows a cohesionless collapse with E of at most 600 rho g h0: here "
                f"{used / 1e6:.3g} instead of {one.job.scene.material.young / 1e6:.3g} MPa. Its time does not grow "
                "with E for that reason; the stress at rest balances gravity all the same."
            ]
    return []


def eq6_section() -> dict:
    """The misprint of Eq. 6, with the evidence."""
    lambda0, known = experiments().T
    exchanged, printed = (float(np.sqrt(np.mean((form(lambda0) - known) ** 2))) for form in (eq6, eq6_printed))
    text = (
        "The paper prints its power law for the experiments, Eq. 6, as R = 0.63 lambda0^1.30 and gives a root mean "
        f"square error of 0.13. As printed it misses the {len(known)} digitised experiments by {printed:.3f}; with "
        f"prefactor and exponent exchanged, R = 1.30 lambda0^0.63, by {exchanged:.3f}. Repose uses the exchanged form."
    )
    rows = [["1.30 lambda0^0.63 (exchanged)", exchanged], ["0.63 lambda0^1.30 (as printed)", printed]]
    table = {"caption": "Both forms against the experiments", "columns": ["Eq. 6", "RMSE of R [-]"], "rows": rows}
    return {"title": "The misprint of Eq. 6", "text": [text], "tables": [table], "figures": []}


def about(outcomes: list[Outcome], command: str) -> dict:
    """Versions and machine of this report and of the runs in it."""
    libraries = {one.name: one.version or "not installed" for one in installed()}
    here = provenance("cpu", "float64") | libraries
    del here["precision"], here["device"], here["device_name"]
    of_runs = [one.results.provenance for one in outcomes if one.done]
    for name in ("commit", "code", "device_name", "cpu", "warp"):
        here[f"{name} of the runs"] = ", ".join(sorted({str(one[name]) for one in of_runs})) or "none ended"
    dates = sorted(one["date"] for one in of_runs)
    here["dates of the runs"] = " to ".join(dict.fromkeys((dates[0], dates[-1]))) if dates else "none ended"
    return here | {"report made by": command}


def figure(name: str, caption: str) -> dict:
    """A figure of a section, whose caption also says what there is to see."""
    return {"file": name, "caption": caption, "alt": caption}


def made_by(outcome: Outcome) -> dict:
    """Machine, commit and command of a run, for a row of a table; None where it has no results."""
    known = outcome.results.provenance if outcome.done else {}
    return {name: known.get(name) for name in ("device_name", "commit")} | {"command": outcome.job.command}


def relative(value: float, reference: float | None) -> str | None:
    """`value` over `reference` - 1, in percent."""
    return percent(value / reference - 1.0) if reference else None


def percent(value: float | None) -> str | None:
    """A share in percent, with its sign."""
    return None if value is None else f"{value:+.1%}"
