"""Time over Young's modulus, of `repose study error`: each solver with the modulus asked for, and like with like."""

from pathlib import Path

import numpy as np

from compare.batch import Outcome
from compare.plots.reports import draw_stiffness
from compare.report.sections import check, figure, softened_note
from implicit.pseudo_time import Regularisation
from mpm.body import build
from mpm.load import load_scene

FACTORS = (10, 100)  # times the scene's Young's modulus
SOFTENED = "soft"  # explicit run of the moduli that the implicit solver follows the stiffest body with
FLAT = 2.0  # times the time of the softest material that the implicit solver may take for a stiffer one


def softened_settings(reference: str, settings: list[str]) -> tuple[str, ...]:
    """Scene settings of the moduli that the implicit solver takes for the stiffest body; none where it keeps its own.

    The implicit solver follows a stiff cohesionless collapse with smaller moduli
    (`implicit.pseudo_time.Regularisation.limit_stiffness`). Its time compares with that of an explicit run of the same.
    """
    scene = load_scene(reference, settings)
    body = build(load_scene(reference, [*settings, f"material.young={scene.material.young * max(FACTORS)!r}"]))
    used = Regularisation().limit_stiffness(body).constants
    if used == body.constants:
        return ()
    bulk, shear = used.bulk, used.shear
    poisson = (3 * bulk - 2 * shear) / (2 * (3 * bulk + shear))
    return f"material.young={used.young!r}", f"material.poisson={poisson!r}"


def stiffness_rows(rows: list[dict], base: float) -> list[dict]:
    """Rows of the resolution at which stiffness was varied that ended. `base`: Young's modulus [Pa] of the scene."""
    at = next((row["cells"] for row in rows if row["young"] > base and row["changed"].startswith("E")), None)
    plain = ("", *(f"E{factor}" for factor in FACTORS))
    return [
        row
        for row in rows
        if row["cells"] == at and row["precision"] == "float64" and row["changed"] in plain and row["seconds"]
    ]


def stiffness_check(rows: list[dict], base: float) -> dict:
    """Whether the implicit solver's time hardly grows with E, and where that says nothing as E is not what it used."""
    mine = {row["young"]: row for row in stiffness_rows(rows, base) if row["solver"] == "implicit"}
    whole = len(mine) == 1 + len(FACTORS)
    worst = max(row["seconds"] for row in mine.values()) / mine[base]["seconds"] if whole else None
    said = "a run failed" if worst is None else f"the slowest takes {worst:.1f} times the softest's time"
    sentence, name = f"{said}; {FLAT:g} times is allowed.", "implicit cost hardly depends on stiffness"
    if softened := [row for row in mine.values() if _is_softened(row)]:
        name += ", after softening"
        asked = " and ".join(f"{row['young'] / 1e6:g}" for row in softened)
        used = " and ".join(dict.fromkeys(f"{row['young_used'] / 1e6:.3g}" for row in softened))
        sentence += f" E = {asked} MPa are followed with {used} MPa: runs of one modulus are one computation."
    return check(name, worst, FLAT, sentence)


def stiffness_section(rows: list[dict], base: float, first: list[Outcome], directory: Path) -> dict:
    """Figure and table of time over E. `first`: an outcome of each row."""
    stiff = stiffness_rows(rows, base)
    if not stiff:
        return {"title": "Speed against stiffness", "text": ["No such run ended."], "tables": [], "figures": []}
    crossing, sentence = crossover(stiff)
    alike = [row for row in rows if row["changed"] == SOFTENED and row["seconds"]]
    draw_stiffness(stiff, alike, crossing, directory / "stiffness.png")
    columns = ["solver", "E [MPa]", "E used [MPa]", "time stepping [s]", "steps", "Newton iterations", "R_995"]
    table = [
        [
            row["solver"] + (", softened alike" if row["changed"] == SOFTENED else ""),
            row["young"] / 1e6,
            row["young_used"] / 1e6,
            row["seconds"],
            row["steps"],
            row["newton_iterations"],
            row["R_995"].said(".4f"),
        ]
        for row in [*stiff, *alike]
    ]
    caption = "Wall time over Young's modulus; the explicit time step shrinks with the square root of E."
    return {
        "title": "Speed against stiffness",
        "text": [sentence, *like_with_like(stiff, alike), *softened_note(first)],
        "tables": [{"caption": f"Stiffness at {stiff[0]['cells']:g} cells per r0", "columns": columns, "rows": table}],
        "figures": [figure("stiffness.png", caption)],
    }


def like_with_like(stiff: list[dict], alike: list[dict]) -> list[str]:
    """A sentence on both solvers' times for the same softened body; none where the implicit one keeps its modulus."""
    softened = [row for row in stiff if row["solver"] == "implicit" and _is_softened(row)]
    if not softened or not alike:
        return []
    known = alike[0]["seconds"]
    ratios = ", ".join(f"{row['seconds'] / known:.2f} at {row['young'] / 1e6:g} MPa" for row in softened)
    return [
        f"Like with like: with E = {alike[0]['young'] / 1e6:.3g} MPa in both solvers, as the implicit one takes it for "
        f"stiffer material, implicit over explicit time is {ratios}. What softening alone saves, the explicit solver "
        "saves too."
    ]


def _is_softened(row: dict) -> bool:
    return row["young_used"] < 0.999 * row["young"]


def crossover(stiff: list[dict]) -> tuple[float | None, str]:
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
            crossing = float(np.exp(np.log(young[i]) + where * np.log(young[i + 1] / young[i])))
            first = "implicit" if ratio[i] < 0 else "explicit"
            return (
                crossing,
                f"{said} They cross at E = {crossing / 1e6:.3g} MPa, below which the {first} one is faster.",
            )
    faster = "implicit" if ratio[0] < 0 else "explicit"
    return None, f"{said} There is no crossover: the {faster} solver is the faster one all over this range."
