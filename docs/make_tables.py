"""Write the tables of results in README.md and docs/ from the tables of benchmarks/results: python docs/make_tables.py

A table of a page stands between `<!-- table NAME: docs/make_tables.py -->` and `<!-- end of table -->`.
"""

import csv
import json
import re
from math import isfinite
from pathlib import Path
from statistics import mean

from compare.calibration import bisect
from compare.convergence import ensemble_limit
from compare.ensembles import Estimate, estimate, paired
from compare.experiments import measured_runout
from mpm.theory import eq6

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
PLACE = re.compile(r"(<!-- table ([\w-]+): docs/make_tables\.py -->\n)(.*?)(<!-- end of table -->)", re.DOTALL)
DYNAMIC, DAMPED = 0.05, 0.4  # local damping D
MILLION = 1e6
CASE_ENDS = re.compile(r"\((holds|does not hold|undecided)\)")  # of a claim that runs decide, a case each
MOST_CASES = 4


def rows_of(name: str) -> list[dict[str, str]]:
    """The rows of benchmarks/results/NAME."""
    with (ROOT / "benchmarks" / "results" / name).open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def plain(rows: list[dict[str, str]]) -> list[dict[str, str]]:
    """Rows of quarter columns as they stand: no other key, regularisation, turn or shift."""
    usual = {"settings": "", "regularisation": "", "symmetry": "quarter", "shifted": "0 0 0", "precision": "float64"}
    return [row for row in rows if float(row["turned"]) == 0 and all(row[key] == value for key, value in usual.items())]


def updated(page: str) -> str:
    """The text of a page with its tables as the committed results are now. KeyError for a table that is not known."""
    return PLACE.sub(lambda found: found[1] + "\n" + TABLES[found[2]]() + "\n" + found[4], page)


def markdown(columns: list[str], rows: list[list[str]]) -> str:
    """A table of text cells."""
    lines = [f"| {' | '.join(cells)} |" for cells in (columns, *rows)]
    return "\n".join([lines[0], "|---" * len(columns) + "|", *lines[1:]]) + "\n"


def percent(value: float, digits: int = 1) -> str:
    """A share with its sign."""
    return f"{100 * value:+.{digits}f}%"


def explicit_runs() -> dict[tuple[float, float, float], float]:
    """R_995 of the explicit ladder on the GPU at (lambda0, D, cells per r0), the mean of its runs."""
    found: dict[tuple[float, float, float], list[float]] = {}
    for row in plain(rows_of(LADDER)):
        at = (float(row["lambda0"]), float(row["damping"]), float(row["cells"]))
        found.setdefault(at, []).append(float(row["R_995"]))
    return {at: mean(values) for at, values in found.items()}


def implicit_runs() -> list[dict[str, str]]:
    """Rows of the implicit collapses by aspect ratio and resolution."""
    return sorted(plain(rows_of(IMPLICIT)), key=lambda row: (float(row["lambda0"]), float(row["cells"])))


def twenty() -> list[dict[str, str]]:
    """Rows of the paper's twenty runs by aspect ratio and damping."""
    return sorted(plain(rows_of(TWENTY)), key=lambda row: (float(row["lambda0"]), float(row["damping"])))


def over_eq4(row: dict[str, str]) -> float:
    """R_995 over Eq. 4 - 1 of a run."""
    return float(row["R_995"]) / float(row["eq4"]) - 1.0


def reproduces() -> str:
    """README: both solvers beside theory and experiments."""
    full = {(float(row["lambda0"]), float(row["damping"])): row for row in twenty()}
    finest = {float(row["lambda0"]): row for row in implicit_runs()}
    rows = []
    for ratio, implicit in finest.items():
        share = f"{percent(over_eq4(implicit))[:-1]} %"
        cells = [f"{ratio:g}", f"{float(implicit['R_995']):.3f} ({share}, {implicit['cells']} cells)"]
        if (ratio, DAMPED) in full:
            damped, dynamic = full[ratio, DAMPED], full[ratio, DYNAMIC]
            cells += [f"{float(damped['R_995']):.3f} ({percent(over_eq4(damped))[:-1]} %)"]
            cells += [
                f"{float(dynamic['R_995']):.3f} to {float(dynamic['R_max']):.3f}",
                f"{measured_runout(ratio):.3f}",
            ]
        rows.append(cells + [""] * (5 - len(cells)))
    columns = ["lambda0", "implicit, finest grid", "explicit, D = 0.4, 20 cells"]
    return markdown([*columns, "explicit, D = 0.05, 20 cells: R_995 to R_max", "experiments"], rows)


def paper() -> str:
    """docs/paper.md: the paper's twenty runs."""
    rows = []
    for row in twenty():
        ratio, measures = float(row["lambda0"]), [float(row[key]) for key in ("R_995", "R_max")]
        rows.append(
            [row["lambda0"], row["damping"], f"{measures[0]:.3f}", percent(over_eq4(row)), f"{measures[1]:.3f}",
             f"{measured_runout(ratio):.3f}", f"{eq6(ratio):.3f}", percent(float(row["volume_ratio"]) - 1.0, 2),
             f"{float(row['sim_time']):.2f}", f"{100 * float(row['energy_residual']):.2f}%"]
        )  # fmt: skip
    columns = ["lambda0", "D", "R_995", "R_995 / Eq. 4 - 1", "R_max", "experiments", "Eq. 6", "volume"]
    return markdown([*columns, "at rest after [s]", "energy residual"], rows)


def paper_ensembles() -> str:
    """docs/paper.md: the paper's twenty runs and the implicit ones, each several times."""
    rows = []
    for row in rows_of("study_paper_cpu.csv"):
        known = {measure: measured(row, measure) for measure in ("R_995", "R_max", "slope")}
        over = known["R_995"].over(float(row["eq4"]))
        shown = f"{100 * over.mean:+.1f} ± {100 * over.half:.1f} %"
        rows.append(
            [row["lambda0"], row["label"], row["cells"].removesuffix(".0"), known["R_995"].said(), shown,
             known["R_max"].said(), f"{float(row['experiments']):.3f}", known["slope"].said(".2f"),
             f"{row['at_rest']} of {known['R_995'].n}"]
        )  # fmt: skip
    columns = ["lambda0", "run", "cells per r0", "R_995", "over Eq. 4", "R_max", "experiments", "tan of the flank"]
    return markdown([*columns, "came to rest"], rows)


def claims() -> str:
    """docs/paper.md: what the paper says beside what `repose study paper` found."""
    report = json.loads((ROOT / "docs" / "study_paper" / "report.json").read_text(encoding="utf-8"))
    rows = []
    for one in report["checks"]:
        figure = one["name"].rpartition(": ")[0]
        said, found = one["sentence"].removeprefix("The paper: ").split(". Found: ")
        cases = CASE_ENDS.findall(found)
        if len(cases) > MOST_CASES:  # the page has them all
            how_many = {end: cases.count(end) for end in dict.fromkeys(cases)}
            found = f"of {len(cases)} cases: " + ", ".join(f"{count} {end}" for end, count in how_many.items())
        holds = {True: "yes", False: "**no**", None: "undecided"}[one["holds"]]
        rows.append([figure or "Future work", said, found.removesuffix("."), holds])
    return markdown(["figure", "the paper says", "found", "holds"], rows)


def paper_grid() -> str:
    """docs/paper.md: explicit run-outs over the grid."""
    known, rows = explicit_runs(), []
    for ratio, damping in ((0.5, DAMPED), (0.5, DYNAMIC), (1.0, DAMPED), (1.0, DYNAMIC)):
        values = [known.get((ratio, damping, cells)) for cells in (8, 10, 16, 20, 32)]
        last, before = [value for value in values if value][:-3:-1]
        shown = ["" if value is None else f"{value:.3f}" for value in values]
        rows.append([f"{ratio:g}", f"{damping:g}", *shown, f"{percent(last / before - 1.0)[:-1]} %"])
    columns = ["lambda0", "D", "8", "10", "16", "20", "32 cells per r0", "change of the last refinement"]
    return markdown(columns, rows)


def implicit() -> str:
    """docs/implicit.md: implicit collapses beside Eq. 4 and the explicit solver."""
    known, rows = explicit_runs(), []
    from_none = {(row["lambda0"], row["cells"]): row for row in plain(rows_of(FROM_NONE))}
    for row in implicit_runs():
        ratio, cells, run_out = float(row["lambda0"]), float(row["cells"]), float(row["R_995"])
        other = known.get((ratio, DAMPED, cells))
        beside = [f"{other:.3f}", percent(run_out / other - 1.0)] if other else ["", ""]
        rows.append(
            [row["lambda0"], row["cells"], f"{run_out:.3f}", percent(over_eq4(row)), *beside,
             percent(float(row["volume_ratio"]) - 1.0, 2), f"{float(row['h_inf']):.3f}", row["steps"],
             row["newton_iterations"], from_none[row["lambda0"], row["cells"]]["newton_iterations"]]
        )  # fmt: skip
    columns = ["lambda0", "cells per r0", "R_995", "over Eq. 4", "explicit, D = 0.4", "over explicit", "volume"]
    return markdown([*columns, "h_inf [m]", "steps", "Newton iterations", "from u = 0"], rows)


def creep() -> str:
    """docs/implicit.md: R_995 as what is out of balance falls."""
    found: dict[tuple[str, str], dict[float, str]] = {}
    for row in rows_of("implicit_creep_cpu.csv"):
        of = found.setdefault((row["lambda0"], row["cells"]), {})
        of[float(row["unbalanced"])] = f"{float(row['R_995']):.3f}"
    shares = {"1e-2": 1e-2, "5e-3": 5e-3, "2e-3": 2e-3, "1e-3": 1e-3}
    rows = [[*at, *(of[share] for share in shares.values())] for at, of in found.items()]
    return markdown(["lambda0", "cells per r0", *shares], rows)


def regularisation() -> str:
    """docs/implicit.md: what each part of the regularisation does to R_995 at lambda0 = 0.5."""
    usual = {row["cells"]: float(row["R_995"]) for row in implicit_runs() if row["lambda0"] == "0.5"}
    found: dict[str, dict[str, dict[str, str]]] = {}
    for row in rows_of("implicit_regularisation_cpu.csv"):
        if row["lambda0"] == "0.5":
            found.setdefault(row["regularisation"], {})[row["cells"]] = row
    rows = []
    for changed, of in found.items():
        changes = [percent(float(of[n]["R_995"]) / usual[n] - 1.0) if n in of else "" for n in ("8", "16")]
        rows.append([changed, *changes, of["8"]["steps"], of["8"]["newton_iterations"]])
    return markdown(["lambda0 = 0.5", "8 cells per r0", "16", "steps (8)", "Newton iterations (8)"], rows)


def ensembles() -> dict[tuple[str, float, str], dict[float, list[dict[str, str]]]]:
    """Rows of the ensembles by solver ("implicit", "D = 0.4", ...), aspect ratio and precision, of each resolution."""
    found: dict[tuple[str, float, str], dict[float, list[dict[str, str]]]] = {}
    for row in sorted(rows_of(ENSEMBLES), key=lambda row: (float(row["lambda0"]), row["damping"], float(row["cells"]))):
        solver = f"D = {row['damping']}" if row["damping"] else "implicit"
        of = found.setdefault((solver, float(row["lambda0"]), row["precision"]), {})
        of.setdefault(float(row["cells"]), []).append(row)
    return found


def run_out(rows: list[dict[str, str]]) -> Estimate:
    """R_995 of an ensemble."""
    known = estimate(float(row["R_995"]) for row in rows)
    assert known is not None
    return known


def ensemble_grid() -> str:
    """docs/paper.md: run-outs of ensembles over the grid, and what they tend to."""
    rows = []
    of_float64 = {at: of for at, of in ensembles().items() if at[2] == "float64"}
    resolutions = sorted({cells for of in of_float64.values() for cells in of})
    for (solver, ratio, _), of in of_float64.items():
        known = {cells: run_out(its) for cells, its in of.items()}
        limit = ensemble_limit([1.0 / cells for cells in known], list(known.values()))
        tends = "undecided" if limit.undecided else "not converged"
        if limit.known:
            order = f"order {limit.order:.1f}" if isfinite(limit.order) else "grids agree within 3 %"
            tends = f"{limit.value:.3f} ({limit.low:.3f} to {limit.high:.3f}), {order}"
        shown = [known[cells].said() if cells in known else "" for cells in resolutions]
        rows.append([f"{ratio:g}", solver, *shown, tends])
    first, *others = (f"{cells:g}" for cells in resolutions)
    return markdown(["lambda0", "run", f"{first} cells per r0", *others, "tends to"], rows)


def speed_error() -> str:
    """docs/speed.md: what each grid costs and how far its ensemble is from those of the finest, of both solvers."""
    rows = []
    everything = ensembles()
    other = {"implicit": "D = 0.4", "D = 0.4": "implicit"}
    for (solver, ratio, precision), of in everything.items():
        if precision != "float64" or solver not in other:
            continue
        known, finest = {cells: run_out(its).mean for cells, its in of.items()}, max(of)
        of_other = everything[other[solver], ratio, precision]
        theirs = run_out(of_other[max(of_other)]).mean
        for cells, its in of.items():
            off = percent(known[cells] / known[finest] - 1.0) if cells < finest else ""
            seconds = f"{mean(float(row['cpu_s']) for row in its):.1f}"
            apart = percent(known[cells] / theirs - 1.0)
            rows.append([f"{ratio:g}", solver, f"{cells:g}", str(len(its)), run_out(its).said(), off, apart, seconds])
    columns = ["lambda0", "run", "cells per r0", "runs", "R_995", "off its finest grid", "off the other's finest"]
    return markdown([*columns, "CPU s"], rows)


def scaling() -> str:
    """docs/speed.md: the explicit solver on MPI ranks, measured and by the model."""
    rows = []
    for row in rows_of("scaling_cpu.csv"):
        many = int(row["ranks"]) > 1
        over = [f"{float(row[key]):.2f}" if many else "" for key in ("over_one_rank", "predicted_over_one_rank")]
        shared = f"{int(row['shared']):,} of {int(row['nodes']):,}" if many else ""
        rate = f"{float(row['point_steps_per_s']) / MILLION:.2f}"
        rows.append([row["kind"], f"{int(row['points']):,}", row["ranks"], rate, *over, shared])
    columns = ["scaling", "points", "ranks", "million point-steps/s", "over one rank", "by the model"]
    return markdown([*columns, "of the nodes stored, shared"], rows)


def implicit_ranks() -> str:
    """docs/speed.md: the implicit solver on MPI ranks, runs in turn."""
    found: dict[str, list[dict[str, str]]] = {}
    for row in rows_of("implicit_ranks_cpu.csv"):
        found.setdefault(row["ranks"], []).append(row)
    rows = [[ranks, ", ".join(row["wall_s"] for row in its), its[0]["linear"]] for ranks, its in found.items()]
    return markdown(["ranks", "s", "sweeps of GMRES"], rows)


def implicit_starts() -> str:
    """docs/speed.md: Newton's counts on MPI ranks over those of one, from the same starts."""
    found: dict[tuple[str, int], list[dict[str, str]]] = {}
    for row in rows_of("implicit_starts_cpu.csv"):
        found.setdefault((row["petsc"], int(row["ranks"])), []).append(row)
    rows = []
    for (petsc, ranks), its in sorted(found.items()):
        newton, linear = ([float(row[key]) for row in its] for key in ("newton", "linear"))
        over = paired(newton, (float(row["newton"]) for row in found[petsc, 1]))
        said = f"{100 * over.mean:+.1f} ± {100 * over.half:.1f} %" if ranks > 1 else ""
        rows.append([petsc, str(ranks), f"{mean(newton):.1f}", said, f"{sum(linear) / sum(newton):.1f}"])
    columns = ["PETSc", "ranks", "Newton iterations a collapse", "over one rank", "sweeps an iteration of Newton"]
    return markdown(columns, rows)


def gpu() -> str:
    """docs/speed.md: throughput of the explicit solver on a GPU."""
    found: dict[int, dict[str, float]] = {}
    for row in rows_of("bench_explicit_h200.csv"):
        found.setdefault(int(row["points"]), {})[row["precision"]] = float(row["point_steps_per_s"])
    rows = []
    for points, of in found.items():
        cells = [f"{points:,}"]
        for precision in ("float32", "float64"):
            rate = of.get(precision)
            cells += [f"{rate / MILLION:,.0f}", f"{points / rate * MILLION:,.0f}"] if rate else ["not measured", ""]
        rows.append(cells)
    columns = ["points", "float32, million point-steps/s", "microseconds a step"]
    return markdown([*columns, "float64", "microseconds a step"], rows)


def damping() -> str:
    """docs/paper.md: the D that meets a run-out, by bisection over committed ensembles."""
    rows = []
    everything = rows_of("damping_cpu.csv")
    for target in dict.fromkeys(row["target"] for row in everything):
        known = {float(row["damping"]): row for row in everything if row["target"] == target and row["damping"]}
        found = bisect(lambda value, known=known: measured(known[value], "R_995"), float(target))
        there = known[found.damping]
        shown = [measured(there, measure).said() for measure in ("R_995", "R_max")]
        interval = f"{found.low:.3f} to {found.high:.3f}"
        rows.append(
            [f"{float(target):.3f}", f"{found.damping:.3f}", interval, *shown, f"{100 * float(there['damped']):.0f} %"]
        )
    columns = ["target", "D", "its interval", "R_995 there", "R_max there", "of gravity's work goes into damping"]
    return markdown(columns, rows)


def measured(row: dict[str, str], measure: str) -> Estimate | None:
    """The estimate that a row of a study's table tells; None where no run came to a result."""
    count = int(row[f"{measure}_n"])
    if count < 2:
        return None
    mean, half = float(row[measure]), float(row[f"{measure}_half"])
    return Estimate(mean, half / Estimate(0.0, 1.0, count - 1.0, count).half, count - 1.0, count)


LADDER, TWENTY = "explicit_ladder_h200.csv", "explicit_twenty_h200.csv"
IMPLICIT, ENSEMBLES = "implicit_collapses_cpu.csv", "ensembles_cpu.csv"
FROM_NONE = "implicit_from_none_cpu.csv"  # runs of the same collapses in which Newton started from u = 0
TABLES = {
    "reproduces": reproduces,
    "paper": paper,
    "paper-ensembles": paper_ensembles,
    "claims": claims,
    "paper-grid": paper_grid,
    "ensemble-grid": ensemble_grid,
    "implicit": implicit,
    "creep": creep,
    "regularisation": regularisation,
    "speed-error": speed_error,
    "scaling": scaling,
    "implicit-ranks": implicit_ranks,
    "implicit-starts": implicit_starts,
    "gpu": gpu,
    "damping": damping,
}

if __name__ == "__main__":
    for path in PAGES:
        path.write_text(updated(path.read_text(encoding="utf-8")), encoding="utf-8")
