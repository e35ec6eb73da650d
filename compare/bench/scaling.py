"""`repose bench explicit --ranks 1 2`: speed over MPI ranks, measured here, and a model's word on other machines."""

import json
import math
import subprocess
import tempfile
from pathlib import Path

from compare.bench.ladder import ASPECT
from compare.bench.model import EXCHANGES, Link, Machine, Prediction, predict
from compare.bench.worker import column, on_ranks
from compare.launch import call, count_of, refuse_nested, start
from compare.plots.reports import draw_scaling
from compare.report.page import refuse_another, write_table
from compare.report.sections import check, figure, verdict
from mpm.errors import SceneError
from mpm.provenance import provenance

COLUMNS = ((0.5, 20), (1.0, 20), (2.0, 20))  # aspect ratio and cells per r0 of the paper's columns
ROUNDS = 3  # in which every size is measured on every number of ranks in turn; the best counts
AGREES = 0.2  # by which the model may be off what is measured here
PREDICTED = "predicted.csv"
POINTS = (10**6, 10**8, 10**9)  # of the predictions
# Assumed, as there is none of these here: what makers and others state of them, rounded.
CORES, HOSTS, GPUS = 16, 64, 4
INFINIBAND = Link(2e-6, 25e9)  # one NDR200 port a host
# PCIe 5 of 16 lanes; of an exchange two copies, a wait and the launches, half of it Python's calls of them.
STAGING = Link(50e-6, 50e9)
GPU_PACKING = 1e12  # a quarter of the card's bandwidth
# Measured on an H200 in float32 (benchmarks/results/bench_explicit_h200.csv): a straight line through its step times.
GPU_RATE, GPU_START = 1.2e9, 95e-6


def bench_ranks(
    directory: Path, force, _monitor, command: str, mode: str, device: str, precision: str, cells, ranks
) -> dict:
    """Measure the step on one rank and on each number of `ranks`: of the paper's columns, or of the lowest over `cells`
    (per r0); the report (see `compare.report.page`).

    Raises SceneError for a size that does not fit the column, and where there are no ranks.
    """
    if mode != "explicit":
        raise SceneError("bench --ranks measures the explicit solver; benchmarks/implicit_ranks.py the implicit one")
    if device != "cpu":
        raise SceneError(f"--device {device}: bench --ranks measures ranks on CPU cores")
    refuse_nested("bench --ranks")
    counts = sorted({1, *map(count_of, ranks)})
    bodies = [(ASPECT, size) for size in sorted(cells)] or list(COLUMNS)
    about_what = {"bench": f"{mode} on ranks", "precision": precision, "ranks": counts}
    about_what |= {"columns": [f"lambda0 = {aspect:g}, {size:g} cells" for aspect, size in bodies]}
    for body in bodies:
        column(*body, precision)
    weak = [wider(bodies[0][1], count) for count in counts[1:]]
    for body in weak:
        column(*body, precision)
    jobs = [("strong", *body, count) for body in bodies for count in counts]
    jobs += [("weak", *body, count) for body, count in zip(weak, counts[1:], strict=True)]
    refuse_another(directory, about_what, force)
    directory.mkdir(parents=True, exist_ok=True)
    best, link = _measured(jobs, precision)
    rows = _rows(best, link)
    here = provenance(device, precision)
    made_by = {name: here[name] for name in ("device_name", "cores", "commit", "date")} | {"command": command}
    write_table([row | link | made_by for row in rows], directory)
    predicted = predictions(rows, link)
    write_table([row | made_by for row in predicted], directory, PREDICTED)
    checks = _checks(rows)
    return {
        "about": about_what,
        "title": f"Speed of the {mode} solver on MPI ranks, {precision}, {here['device_name']}",
        "lead": "Each measurement runs in processes of its own, without output; every size on every number of ranks in "
        f"turn, {ROUNDS} times, and of each the fastest batch of steps counts.",
        "verdict": verdict(checks),
        "checks": checks,
        "sections": [_measured_section(rows, here, directory), _model_section(link, predicted)],
        "provenance": here | {"report made by": command},
        "failed": [],
        "rows": rows,
        "link": link,
        "predicted": predicted,
    }


def wider(cells: float, times: int) -> tuple[float, int]:
    """Aspect ratio and cells per r0 of a column as high as that of `cells`, with so many times its base."""
    count = round(cells * math.sqrt(times))
    return ASPECT * cells / count, count


def _measured(jobs, precision) -> tuple[list[dict], dict[str, float]]:
    """The best of each job over the rounds, and what ranks need to tell each other something, likewise."""
    best, links = [{"fastest": 0.0} for _ in jobs], []
    for _ in range(ROUNDS):
        links.append(_exchange())
        for number, (kind, aspect, size, count) in enumerate(jobs):
            found = call(count, on_ranks, aspect, size, precision)
            if found["fastest"] > best[number]["fastest"]:
                best[number] = found | {"kind": kind, "aspect": aspect, "cells": size, "ranks": count}
            print(f"{found['points']:,} points, {count} ranks: {found['fastest'] / 1e6:.2f} million point-steps/s")
    best_of = {"latency": min, "handling": min, "bandwidth": max, "packing": max}
    return best, {name: choose(each[name] for each in links) for name, choose in best_of.items()}


def _exchange() -> dict[str, float]:
    """What a pair of ranks needs (see `compare.bench.exchange`). Raises RuntimeError where it dies."""
    with tempfile.TemporaryDirectory() as folder:
        answer = Path(folder) / "answer.json"
        process = start(2, ["-P", "-m", "compare.bench.exchange", str(answer)], stderr=subprocess.PIPE, text=True)
        said = process.communicate()[1]
        if process.returncode:
            raise RuntimeError(f"compare.bench.exchange ended with exit code {process.returncode}:\n{said[-2000:]}")
        return json.loads(answer.read_text(encoding="utf-8"))


def _rows(best: list[dict], link) -> list[dict]:
    """A row a job: what was measured, over one rank, and what the model says."""
    alone = {(one["aspect"], one["cells"]): one for one in best if one["ranks"] == 1}
    first = next(iter(alone.values()))
    rows = []
    for one in best:
        base = alone[one["aspect"], one["cells"]] if one["kind"] == "strong" else first
        loads = [part["points"] for part in one["parts"]]
        over = one["fastest"] / base["fastest"]
        said = predict(one["points"], one["aspect"], this_machine(one["ranks"], base["fastest"], link))
        row = {key: one[key] for key in ("kind", "aspect", "cells", "points", "ranks")}
        row |= {"point_steps_per_s": one["fastest"], "over_one_rank": over, "efficiency": over / one["ranks"]}
        row |= {"heaviest_over_mean": max(loads) * len(loads) / sum(loads)}
        row |= {name: max(part[name] for part in one["parts"]) for name in ("nodes", "shared", "sent", "peers")}
        row |= {"predicted_over_one_rank": said.rate / base["fastest"]}
        rows.append(row)
    return rows


def this_machine(ranks: int, rate: float, link: dict[str, float]) -> Machine:
    """So many ranks of this machine, each of which alone takes `rate` point-steps/s."""
    within = Link(link["latency"], link["bandwidth"])
    return Machine(1, ranks, rate, 0.0, within, INFINIBAND, link["handling"], link["packing"])


def predictions(rows: list[dict], link: dict[str, float]) -> list[dict]:
    """A row a machine and number of points: what a step of a quarter column takes there."""
    rate = max(row["point_steps_per_s"] for row in rows if row["ranks"] == 1)
    gpus = this_machine(GPUS, GPU_RATE, link)  # which send from the host's memory, as its cores do
    gpus = gpus._replace(start=GPU_START, packing=GPU_PACKING, real=4, staging=STAGING)
    machines = {
        f"{CORES} cores": this_machine(CORES, rate, link),
        f"{GPUS} GPUs": gpus,
        f"{HOSTS} hosts of {CORES} cores": this_machine(CORES, rate, link)._replace(hosts=HOSTS),
    }
    return [
        {"machine": name, "points": points, "ranks": machine.all_ranks} | _flat(predict(points, ASPECT, machine))
        for name, machine in machines.items()
        for points in POINTS
    ]


def _flat(said: Prediction) -> dict:
    return {
        "ms_per_step": 1e3 * said.seconds,
        "million_point_steps_per_s": said.rate / 1e6,
        "efficiency": said.efficiency,
        "exchange_share": said.exchange / said.seconds,
        "agreement_share": said.agreement / said.seconds,
        "sent_mb": said.sent_bytes / 1e6,
        "messages": said.messages,
    }


def _checks(rows: list[dict]) -> list[dict]:
    off = [row["predicted_over_one_rank"] / row["over_one_rank"] for row in rows if row["ranks"] > 1]
    if not off:
        return []
    worst = max(off, key=lambda ratio: abs(math.log(ratio)))
    told = f"The model is off what was measured by {worst - 1.0:+.0%} at most."
    return [check("Model against measurement", worst - 1.0, AGREES, told)]


def _measured_section(rows, here, directory) -> dict:
    """Speed over ranks."""
    table = [
        [row["kind"], f"{row['aspect']:.3g}", row["points"], row["ranks"], row["point_steps_per_s"] / 1e6,
         row["over_one_rank"], f"{row['efficiency']:.0%}", row["predicted_over_one_rank"], row["heaviest_over_mean"],
         row["nodes"], row["shared"], len(EXCHANGES) * row["peers"], 8e-3 * sum(EXCHANGES) * row["sent"]]
        for row in rows
    ]  # fmt: skip
    columns = ["scaling", "lambda0", "points", "ranks", "million point-steps/s", "over one rank", "efficiency",
               "over one rank, by the model", "heaviest rank's points over the mean", "nodes stored by a rank",
               "of these shared", "messages a step", "kB a step"]  # fmt: skip
    curves = {}
    for row in rows:
        name = f"{row['points']:,} points" if row["kind"] == "strong" else "as many points a rank"
        start = [] if row["kind"] == "strong" else [(1, 1.0, 1.0)]
        curves.setdefault(name, start).append((row["ranks"], row["over_one_rank"], row["predicted_over_one_rank"]))
    draw_scaling(curves, directory / "scaling.png")
    return {
        "title": "Measured",
        "text": [
            f"Quarter columns in motion, at t = sqrt(h0/g), on {here['cores']} cores. Strong: one column on more "
            "ranks. Weak: as high as the first column, with a base that grows with the ranks. Of nodes, messages and "
            "what they carry the rank with most."
        ],
        "tables": [{"caption": "Speed over ranks", "columns": columns, "rows": table}],
        "figures": [figure("scaling.png", "Speed over ranks, over that of one rank.")],
    }


def _model_section(link, predicted) -> dict:
    """What the model takes, and what it says of other machines."""
    table = [
        [row["machine"], row["points"], row["ranks"], row["ms_per_step"], row["million_point_steps_per_s"],
         f"{row['efficiency']:.0%}", f"{row['exchange_share']:.0%}", f"{row['agreement_share']:.0%}", row["sent_mb"],
         row["messages"]]
        for row in predicted
    ]  # fmt: skip
    columns = ["machine", "points", "ranks", "ms a step", "million point-steps/s", "efficiency", "exchange",
               "agreement", "MB a rank sends", "messages"]  # fmt: skip
    return {
        "title": "By the model",
        "text": [
            "The plan is cut into equal rectangles; adjoining ones share four planes of nodes, whose sums travel three "
            "times a step; once a step all ranks agree on speeds and faults; the rank with most points is waited for. "
            f"Measured here between two ranks: {1e6 * link['latency']:.1f} µs and "
            f"{link['bandwidth'] / 1e9:.1f} GB/s of a message, {1e6 * link['handling']:.0f} µs to handle it, "
            f"{link['packing'] / 1e9:.1f} GB/s to gather and add what it carries.",
            f"Assumed: {CORES} cores each as fast as one alone; {1e6 * INFINIBAND.latency:.0f} µs and "
            f"{INFINIBAND.bandwidth / 1e9:.0f} GB/s of InfiniBand, which a host's ranks share; GPUs like an H200 in "
            f"float32, {GPU_RATE / 1e9:.1f} billion point-steps/s and {1e6 * GPU_START:.0f} µs a step, "
            f"{1e6 * STAGING.latency:.0f} µs of an exchange and {STAGING.bandwidth / 1e9:.0f} GB/s each way to the "
            "host's memory, from where messages go as measured. The solver has never run on several GPUs. Snapshots "
            "and checkpoints, which the first rank gathers, and points that change ranks are not counted.",
        ],
        "tables": [{"caption": "A step of a quarter column", "columns": columns, "rows": table}],
        "figures": [],
    }
