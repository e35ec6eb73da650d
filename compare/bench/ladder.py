"""`repose bench`: how fast a solver is over the size of a scene, what a step goes into, what it needs of memory."""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from compare.bench.worker import YARDSTICK_CELLS, column
from compare.launch import ONE_THREAD
from compare.plots.reports import draw_growth
from compare.report.page import refuse_another, write_table
from compare.report.sections import check, figure, verdict
from compare.solvers import runs_of
from mpm.devices import find_device
from mpm.errors import SceneError
from mpm.provenance import provenance
from mpm.walls import paper_grid

ASPECT = 0.5  # of the columns that are timed
CELLS = {"explicit": (10, 20, 32, 40), "explicit on a GPU": (20, 40, 80, 128), "implicit": (8, 10, 16)}  # per r0
ASPECTS = (0.5, 1.0, 2.0, 4.0, 8.0)  # of those whose stored nodes are counted, 20 cells per r0
# A step of split transfers moves this much of a point at least: position, velocity and stress in and out, twice over.
FLOOR_BYTES = {"float64": 336, "float32": 168}
LINEAR = 0.20  # by which the time of a point-step may differ between sizes, on a CPU


def bench(directory: Path, force, _monitor, command: str, mode: str, device: str, precision: str, cells) -> dict:
    """Measure one solver over `cells` (per r0; none: the usual sizes); the report (see `compare.report.page`).

    Raises SceneError for a size that does not fit the column, or what the solver cannot do.
    """
    if mode == "implicit" and (device, precision) != ("cpu", "float64"):
        raise SceneError(f"--device {device} --precision {precision}: the implicit solver runs on the CPU in float64")
    runs_of(mode)  # said now, and not by the process that measures
    place = find_device(device)
    sizes = sorted(cells) or CELLS["explicit on a GPU" if place.is_cuda and mode == "explicit" else mode]
    about_what = {"bench": mode, "device": device, "precision": precision, "cells": list(sizes)}
    for count in sizes:
        column(ASPECT, count, precision)
    refuse_another(directory, about_what, force)
    directory.mkdir(parents=True, exist_ok=True)
    job = {"mode": mode, "aspect": ASPECT, "precision": precision, "device": device, "phases": True}
    rows = []
    for count in sizes:
        rows.append({"mode": mode, "cells": count, "precision": precision} | _measured(job | {"cells": count}))
        print(_line(rows[-1]), flush=True)
    parts = _explicit_parts if mode == "explicit" else _implicit_parts
    checks, sections = parts(rows, job, directory)
    here = provenance(device, precision)
    made_by = {name: here[name] for name in ("device_name", "commit", "date")} | {"command": command}
    write_table([_flat(row) | made_by for row in rows], directory)
    return {
        "about": about_what,
        "title": f"Speed of the {mode} solver, {precision}, {here['device_name']}",
        "lead": "Each size runs in a process of its own, one core or one GPU, without output.",
        "verdict": verdict(checks),
        "checks": checks,
        "sections": sections,
        "provenance": here | {"report made by": command},
        "failed": [],
        "rows": rows,
    }


def _measured(job: dict, cold: bool = False) -> dict:
    """The figures of one measurement; `cold`: with an empty kernel cache. Raises RuntimeError where it dies."""
    with tempfile.TemporaryDirectory() as folder:
        answer, surroundings = Path(folder) / "answer.json", os.environ | ONE_THREAD
        if cold:
            surroundings["WARP_CACHE_PATH"] = folder
        asked = [sys.executable, "-P", "-m", "compare.bench.worker", json.dumps(job), str(answer)]
        said = subprocess.run(asked, env=surroundings, capture_output=True, text=True)
        if said.returncode:
            raise RuntimeError(f"{' '.join(asked)} ended with exit code {said.returncode}:\n{said.stderr[-2000:]}")
        return json.loads(answer.read_text(encoding="utf-8"))


def _flat(row: dict) -> dict:
    """A row of the table: the phases as columns."""
    phases = {f"{name} [s]": seconds for name, seconds in row["phases"].items()}
    return {name: value for name, value in row.items() if name != "phases"} | phases


def _line(row: dict) -> str:
    if row["mode"] == "explicit":
        return f"{row['points']:,} points: {row['point_steps_per_s'] / 1e6:.2f} million point-steps/s"
    return f"{row['points']:,} points: {row['seconds'] / row['newton_iterations']:.3f} s per Newton iteration"


def _explicit_parts(rows, job, directory):
    """Checks and sections of the explicit solver."""
    cold = _measured(job | {"cells": 10, "phases": False}, cold=True)
    ratios = [row["over_yardstick"] for row in rows]
    checks = []
    if all(ratios):
        uneven = max(ratios) / min(ratios) - 1.0
        told = f"Beside one small column, the dearest point-step costs {uneven:.0%} more than the cheapest."
        checks = [check("Time grows with points", uneven, LINEAR, told)]
    floor = FLOOR_BYTES[job["precision"]]
    table = [
        [row["points"], row["nodes"], row["point_steps_per_s"] / 1e6, row["slowest"] / 1e6, row["fastest"] / 1e6,
         row["over_yardstick"], 1e3 * row["points"] / row["point_steps_per_s"],
         f"{row['point_steps_per_s'] * floor / row['bandwidth']:.1%}", row["bytes_per_point"],
         row["bytes_per_node"], row["state_mb"], row["memory_mb"]]
        for row in rows
    ]  # fmt: skip
    columns = ["points", "nodes stored", "million point-steps/s (median)", "slowest batch", "fastest batch",
               f"over {YARDSTICK_CELLS} cells per r0 beside it", "ms a step", "of the bandwidth's",
               "bytes a point", "bytes a node", "state [MB]", "process memory [MB]"]  # fmt: skip
    draw_growth([(row["points"], row["points"] / row["point_steps_per_s"]) for row in rows], "s a step",
                directory / "speed.png")  # fmt: skip
    speed = {
        "title": "Throughput",
        "text": [
            f"Quarter columns of lambda0 = {ASPECT:g}, in motion at t = sqrt(h0/g). The bandwidth's: of the "
            f"throughput at which {floor} bytes a point and step, which split transfers move at least, would fill the "
            f"{max(row['bandwidth'] for row in rows) / 1e9:.1f} GB/s that a copy reaches in the same process.",
            f"With an empty kernel cache {cold['import_s']:.1f} s of import and {cold['first_step_s']:.1f} s to the "
            f"first step; with a filled one {rows[0]['import_s']:.1f} and {rows[0]['first_step_s']:.1f} s.",
        ],
        "tables": [{"caption": "Throughput and memory", "columns": columns, "rows": table}],
        "figures": [figure("speed.png", "Time of a step over points, and the line of equal cost per point.")],
    }
    return checks, [speed, _phases(rows, lambda row: 1e9 / row["points"], "ns a point"), _nodes(job)]


def _implicit_parts(rows, _job, directory):
    """Checks and sections of the implicit solver."""
    table = [
        [row["points"], row["unknowns"], row["newton_iterations"], row["seconds"] / row["newton_iterations"],
         1e6 * row["seconds"] / row["newton_iterations"] / row["points"],
         row["linear_iterations"] / row["newton_iterations"], row["bytes_per_point"], row["memory_mb"]]
        for row in rows
    ]  # fmt: skip
    columns = ["points", "unknowns", "Newton iterations", "s a Newton iteration", "µs a Newton iteration and point",
               "GMRES iterations a solve", "bytes a point", "process memory [MB]"]  # fmt: skip
    draw_growth([(row["points"], row["seconds"] / row["newton_iterations"]) for row in rows],
                "s a Newton iteration", directory / "speed.png")  # fmt: skip
    speed = {
        "title": "Newton iterations",
        "text": [f"The first steps of the collapse of quarter columns, lambda0 = {ASPECT:g}."],
        "tables": [{"caption": "Time and memory", "columns": columns, "rows": table}],
        "figures": [figure("speed.png", "Time of a Newton iteration over points, and the line of equal cost.")],
    }
    scaled = _phases(
        rows, lambda row: 1e6 / row["newton_iterations"] / row["points"], "µs a Newton iteration and point"
    )
    return [], [speed, scaled]


def _phases(rows, scale, unit: str) -> dict:
    """Where the time goes: each phase times `scale(row)`."""
    names = list(rows[0]["phases"])
    table = [[name, *(row["phases"][name] * scale(row) for row in rows)] for name in names]
    table.append(["sum", *(sum(line[1 + number] for line in table) for number in range(len(rows)))])
    columns = ["phase", *(f"{row['points']:,} points" for row in rows)]
    caption = f"Phases of a step, {unit}"
    return {
        "title": "Phases",
        "text": [],
        "tables": [{"caption": caption, "columns": columns, "rows": table}],
        "figures": [],
    }


def _nodes(job) -> dict:
    """Nodes stored at the start beside those of the paper's grid, which encloses the deposit."""
    from explicit.solver import ExplicitSolver

    rows = []
    for aspect in ASPECTS:
        solver = ExplicitSolver(column(aspect, 20, job["precision"]), job["device"])
        box = paper_grid(20, aspect)[1]
        rows.append([aspect, solver.points, box, solver.grid.stored, f"{solver.grid.stored / box:.1%}"])
    columns = ["lambda0", "points", "nodes of the paper's grid", "nodes stored", "share"]
    table = {"caption": "Nodes at the start, 20 cells per r0", "columns": columns, "rows": rows}
    return {"title": "Only what holds material", "text": [], "tables": [table], "figures": []}
