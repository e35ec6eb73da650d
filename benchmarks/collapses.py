"""Collapses to rest by either solver over aspect ratio, damping, cells per r0 and settings: a CSV row each, and means.

    python benchmarks/collapses.py run --mode explicit --lambda0 0.5 1 --damping 0.05 0.4 --cells 8 10 16 20 \
        --realisations 3 --jobs 2 --out benchmarks/results/NAME.csv [--set material.poisson=0.49] [--turned 45] \
        [--shifted 0.1429 0.1429 0] [--symmetry full] [--device cuda:0] [--reg ghost=0.2]
    python benchmarks/collapses.py means benchmarks/results/NAME.csv ...
    python benchmarks/collapses.py limits benchmarks/results/NAME.csv ...

`means` gives means over realisations with half of their 95 % interval, `limits` what R_995 tends to as the cell shrinks
and how far float32 is from float64, likewise with intervals (`compare.ensembles`).

`--realisations` k shows what round-off and small changes do: k runs, the r-th with a Courant number (explicit) or a
longest step (implicit) that is r % smaller; where `--set grid.scatter=S` starts points at random places, with others.
Rows that are there already are not run again. `wall_s` is clean where `--jobs` is 1 and nothing else runs; `cpu_s`,
the seconds that the process computed, hardly depends on that.
"""

import argparse
import csv
import itertools
import multiprocessing
import shlex
import sys
import time
from pathlib import Path
from statistics import mean

from compare.report.page import add_rows, refuse_other_columns

CASE = (
    "mode", "lambda0", "damping", "cells", "precision", "settings", "turned", "shifted", "symmetry", "regularisation",
    "realisation",
)  # fmt: skip
FIGURES = (
    "points", "R_max", "R_995", "R_connected", "h_inf", "eq4", "stop_reason", "sim_time", "steps", "wall_s", "cpu_s",
    "volume_ratio", "pressureless_share", "most_points_in_a_cell", "full_cell_ratio", "energy_residual",
    "grid_ke_ratio", "newton_iterations", "linear_iterations", "failed_steps", "unbalanced_ratio", "young_used",
)  # fmt: skip
MACHINE = ("device_name", "warp", "commit", "date")


def cases(options) -> list[dict[str, str]]:
    settings = " ".join(options.set)
    regularisation = " ".join(options.reg)
    damping = options.damping if options.mode == "explicit" else [""]
    product = itertools.product(
        [options.mode], options.lambda0, damping, options.cells, options.precision, [settings], [options.turned],
        [" ".join(options.shifted)], [options.symmetry], [regularisation], range(options.realisations),
    )  # fmt: skip
    return [dict(zip(CASE, (str(value) for value in values), strict=True)) for values in product]


def compute(job) -> dict:
    """The row of one case."""
    case, device, command = job
    from compare.hard.collapse import finish
    from mpm.devices import start_warp
    from mpm.errors import NumericalError
    from mpm.load import load_scene
    from mpm.provenance import provenance
    from mpm.runout import run_out
    from mpm.theory import theory

    start_warp()
    cell, less = 1.0 / float(case["cells"]), 1.0 - 0.01 * int(case["realisation"])
    settings = [
        f"geometry.aspect_ratio={float(case['lambda0'])!r}",
        f"grid.cell={cell!r}",
        f"geometry.symmetry={case['symmetry']}",
        *case["settings"].split(),
    ]
    changed = {key: float(value) for key, value in (item.split("=") for item in case["regularisation"].split())}
    if "grid.scatter=" in case["settings"]:
        settings.append(f"grid.realisation={case['realisation']}")
        less = 1.0
    if case["mode"] == "explicit":
        settings += [f"explicit.damping={case['damping']}", f"explicit.precision={case['precision']}"]
        settings += [f"explicit.cfl={0.5 * less!r}"] if less < 1 else []
    elif less < 1:
        from implicit.pseudo_time import Regularisation

        changed["cap"] = changed.get("cap", Regularisation().cap) * less
    shift = [float(part) * cell for part in case["shifted"].split()]
    started, used = time.perf_counter(), time.process_time()
    try:
        run = finish(
            case["mode"], "column_1", *settings, turned=float(case["turned"]), shifted=shift, device=device, **changed
        )
        row = run.summary()
        if any(shift):  # measured about the axis, wherever it was moved to
            row |= run_out(run.x - [shift[0], shift[1], 0.0], run.body.measure)
    except NumericalError as error:
        row = {"stop_reason": str(error).splitlines()[0]}
    row |= {"wall_s": time.perf_counter() - started, "cpu_s": time.process_time() - used}
    row |= theory(load_scene("column_1", settings))
    machine = provenance(device, case["precision"])
    return case | {key: row.get(key, "") for key in FIGURES} | {key: machine[key] for key in MACHINE} | command


def run(options):
    """Compute what is missing in the table and add it, row by row."""
    command = {"command": shlex.join(["python", *sys.argv])}
    refuse_other_columns(options.out, [*CASE, *FIGURES, *MACHINE, "command"])
    done = list(csv.DictReader(options.out.open())) if options.out.exists() else []
    missing = [case for case in cases(options) if not any(all(row[key] == case[key] for key in CASE) for row in done)]
    with multiprocessing.get_context("spawn").Pool(options.jobs) as pool:
        for row in pool.imap_unordered(compute, [(case, options.device, command) for case in missing]):
            add_rows(options.out, [{k: f"{v:.6g}" if isinstance(v, float) else v for k, v in row.items()}])
            told = ("lambda0", "damping", "cells", "settings", "realisation", "R_995", "R_max", "stop_reason", "wall_s")
            print({key: row[key] for key in told}, flush=True)


def rows_of(tables) -> list[dict[str, str]]:
    return [row for path in tables for row in csv.DictReader(path.read_text().splitlines())]


def limits(options):
    """Limits of R_995 over the grid, and float32 over float64, of each case with two realisations or more."""
    from compare.convergence import ensemble_limit
    from compare.ensembles import estimate, paired

    found: dict[tuple[str, ...], dict[tuple[str, float], dict[str, float]]] = {}
    for row in rows_of(options.tables):
        if row["R_995"]:
            case = tuple(row[key] for key in CASE if key not in ("cells", "precision", "realisation"))
            at = (row["precision"], float(row["cells"]))
            found.setdefault(case, {}).setdefault(at, {})[row["realisation"]] = float(row["R_995"])
    for case, values in found.items():
        known, lines = {at: estimate(runs.values()) for at, runs in values.items()}, []
        for precision in sorted({precision for precision, _ in known}, reverse=True):
            cells = sorted(count for at, count in known if at == precision)
            if len(cells) >= 3:
                limit = ensemble_limit([1.0 / count for count in cells], [known[precision, count] for count in cells])
                lines.append(
                    f"{precision}, {', '.join(f'{count:g}' for count in cells[-3:])} cells per r0: {limit.said}"
                )
        for count in sorted(count for precision, count in known if precision == "float32"):
            single, double = (values.get((precision, count), {}) for precision in ("float32", "float64"))
            both = sorted(single.keys() & double.keys())
            if change := paired((single[one] for one in both), (double[one] for one in both)):
                lines.append(f"float32 over float64, {count:g} cells per r0: {change.said('+.2%')}")
        if lines:
            print("\n  ".join([" ".join(filter(None, case)), *lines]))


def means(options):
    """Mean, half of its 95 % interval and number of realisations of R_995 and R_max, as Markdown."""
    from compare.ensembles import estimate

    rows = rows_of(options.tables)
    key = CASE[:-1]
    order = sorted(rows, key=lambda r: (float(r["lambda0"]), float(r["cells"]), *(r[k] for k in key)))
    print("| mode | lambda0 | D | cells | changed | n | R_995 | over Eq. 4 | R_max | volume | no p | most | full cell "
          "| residual | t [s] | steps | Newton | failed | ended by |\n" + "|---" * 19 + "|")  # fmt: skip
    for case, members in itertools.groupby(order, key=lambda r: tuple(r[k] for k in key)):
        group, about = list(members), dict(zip(key, case, strict=True))
        good = [row for row in group if row["R_995"]]
        changed = " ".join(filter(None, (
            about["settings"], about["regularisation"],
            "" if float(about["turned"]) == 0 else f"turned {about['turned']}",
            f"shifted {about['shifted']}" if about["shifted"] != "0 0 0" else "",
            about["precision"] if about["precision"] != "float64" else "", about["symmetry"].replace("quarter", ""),
        )))  # fmt: skip
        front = [about["mode"], about["lambda0"], about["damping"], about["cells"], changed, str(len(good))]
        ends = ", ".join(sorted({row["stop_reason"] for row in group}))
        if not good:
            print("| " + " | ".join([*front, *[""] * 12, ends]) + " |")
            continue

        def average(name, good=good):
            return mean(float(row[name] or "nan") for row in good)

        cells = [
            estimate(float(row["R_995"]) for row in good).said(".4f"),
            f"{average('R_995') / average('eq4') - 1:+.1%}",
            estimate(float(row["R_max"]) for row in good).said(".4f"),
            f"{average('volume_ratio') - 1:+.2%}", f"{average('pressureless_share'):.2%}",
            f"{average('most_points_in_a_cell'):.0f}", f"{average('full_cell_ratio'):.3f}",
            f"{average('energy_residual'):.2%}", f"{average('sim_time'):.2f}", f"{average('steps'):.0f}",
            f"{average('newton_iterations'):.0f}", f"{average('failed_steps'):.0f}", ends,
        ]  # fmt: skip
        print("| " + " | ".join([*front, *cells]) + " |")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True)
    one = commands.add_parser("run")
    one.add_argument("--mode", default="explicit", choices=["explicit", "implicit"])
    one.add_argument("--lambda0", nargs="+", default=["0.5", "1"])
    one.add_argument("--damping", nargs="+", default=["0.05", "0.4"])
    one.add_argument("--cells", nargs="+", default=["8"], help="per r0")
    one.add_argument("--precision", nargs="+", default=["float64"])
    one.add_argument("--set", nargs="*", default=[], metavar="KEY=VALUE")
    one.add_argument("--reg", nargs="*", default=[], metavar="NAME=VALUE", help="of implicit.pseudo_time")
    one.add_argument("--turned", default="0", help="[degrees] about the axis")
    one.add_argument("--shifted", nargs=3, default=["0", "0", "0"], help="along x, y, z [cells]")
    one.add_argument("--symmetry", default="quarter")
    one.add_argument("--realisations", type=int, default=1)
    one.add_argument("--jobs", type=int, default=1)
    one.add_argument("--device", default="cpu")
    one.add_argument("--out", type=Path, required=True)
    one.set_defaults(act=run)
    for act in (means, limits):
        other = commands.add_parser(act.__name__)
        other.add_argument("tables", type=Path, nargs="+")
        other.set_defaults(act=act)
    options = parser.parse_args()
    options.act(options)


if __name__ == "__main__":
    main()
