"""`repose study stability`: every hard case in a process of its own, and a table of what held and what did not.

Cases that only take runs of a solver are computed on several MPI ranks where these are asked for.
"""

import hashlib
import json
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from itertools import repeat
from pathlib import Path

from compare.batch import Workers, killed_as_by_ctrl_c
from compare.cli.ranks import take_part
from compare.hard import clay, collapse, law, rest, transfer
from compare.hard.case import CASES, Case, judge
from compare.launch import sorted_lines, start, stop
from compare.plots.hard import draw_case
from compare.report.page import refuse_another, write_table
from compare.report.sections import check, figure, verdict
from mpm.provenance import code_version, provenance

MODULES = (transfer, law, rest, collapse, clay)  # importing them registers their cases
COLUMNS = ("case", "what", "solver", "outcome", "value", "limit", "reason", "note", "seconds")
LONGEST = 3600.0  # [s] of one case, after which it counts as hung


def study_stability(directory: Path, force, _monitor, command: str, quick: bool, workers: Workers) -> dict:
    """Run the hard cases, the long ones too unless `quick`; the report (see `compare.report.page`).

    A case's rows are kept in `directory`/cases and used again as long as the code stays the same. Each case is said
    when it is done; nothing is told to the monitor. `force`, `command`, `workers` and what is raised: see
    `compare.studies`; but a case that was interrupted starts anew.
    """
    about_what = {"study": "stability", "quick": quick}
    refuse_another(directory, about_what, force)
    folder = directory / "cases"
    folder.mkdir(parents=True, exist_ok=True)
    version = _version()
    cases = [case for case in CASES if not (quick and case.slow)]
    ranks = [workers.ranks if case.on_ranks else 1 for case in cases]
    answers = [_answer(case, folder, version, count) for case, count in zip(cases, ranks, strict=True)]
    running: set[subprocess.Popen] = set()
    with killed_as_by_ctrl_c(), ThreadPoolExecutor(workers.runs) as pool:
        try:
            found = list(pool.map(_rows, cases, answers, ranks, repeat(force), repeat(running)))
        except KeyboardInterrupt:
            for process in running.copy():
                stop(process)
            raise
    rows = [row for rows in found for row in rows]
    here = provenance("cpu", "float64")
    made_by = {name: here[name] for name in ("cpu", "commit")}
    write_table([{name: row[name] for name in COLUMNS} | made_by for row in rows], directory)
    checks = [_check(case.name, rows) for case, rows in zip(cases, found, strict=True)]
    table = {
        "caption": "Stable: within the limit. Degraded: beyond it. Refused: ended by a named error. Died: no answer.",
        "columns": ["case", "what", "solver", "outcome", "figure", "limit", "why this limit", "remark", "s"],
        "rows": [[row[name] if row[name] != "" else None for name in COLUMNS] for row in rows],
    }
    del here["precision"], here["device"], here["device_name"]
    return {
        "about": about_what,
        "title": "Numerical stability on hard cases" + (", quick" if quick else ""),
        "lead": "What breaks, where, and how it is noticed. A figure is the measure that its row names; it must not "
        "pass its limit, which is physical or has the reason given."
        + (f" Cases that only take runs of a solver: on {workers.ranks} MPI ranks." if workers.ranks > 1 else ""),
        "verdict": verdict(checks),
        "checks": checks,
        "sections": [
            _pictures(cases, answers, directory),
            {"title": "All figures", "text": [], "tables": [table], "figures": []},
        ],
        "provenance": here | {"code": version, "report made by": command},
        "failed": [f"{row['case']}: {row['note']}" for row in rows if row["outcome"] == "died"],
        "rows": rows,
    }


def _rows(case: Case, path: Path, ranks: int, force: bool, running: set[subprocess.Popen]) -> list[dict]:
    """The rows of one case: those kept at `path`, or those of a process that runs it now and is one of `running`."""
    if force:
        path.unlink(missing_ok=True)
    started = time.perf_counter()
    if not (path.is_file() and path.with_suffix(".png").is_file()):
        nowhere, pipe = subprocess.DEVNULL, subprocess.PIPE
        words = ["-P", "-m", "compare.studies.stability", case.name, str(path)]
        process = start(ranks, words, stdin=nowhere, stdout=nowhere, stderr=pipe, text=True)
        running.add(process)
        try:
            lines = sorted_lines(process.communicate(timeout=LONGEST)[1].strip().splitlines())
            said = [line for line, is_launchers in lines if not is_launchers]
            how = f"exit code {process.returncode}: {(said or ['without a word'])[-1]}"
        except subprocess.TimeoutExpired:
            process.terminate()  # a launcher ends its ranks then
            process.communicate()
            how = f"no answer after {LONGEST:g} s"
        running.discard(process)
    if path.is_file():
        rows = json.loads(path.read_text(encoding="utf-8"))
    else:
        rows = [dict.fromkeys(COLUMNS, "") | {"case": case.name, "what": "its process died", "outcome": "died"}]
        rows[0] |= {"note": how, "seconds": time.perf_counter() - started}
    stable = sum(row["outcome"] == "stable" for row in rows)
    print(f"{case.name}: {stable} of {len(rows)} stable, {rows[-1]['seconds']:.1f} s", flush=True)
    return rows


def _answer(case: Case, folder: Path, version: str, ranks: int) -> Path:
    """Where the rows of a case on so many ranks are kept; its picture lies beside, as PNG."""
    several = f"-{ranks}-ranks" if ranks > 1 else ""
    return folder / f"{case.name.replace(' ', '-')}-{version}{several}.json"


def _pictures(cases: list[Case], answers: list[Path], directory: Path) -> dict:
    """The picture of each case, beside its answer; a process that died left none."""
    figures = []
    for case, answer in zip(cases, answers, strict=True):
        picture = answer.with_suffix(".png")
        if picture.is_file():
            meant = " ".join((case.run.__doc__ or "").split())
            figures.append(figure(str(picture.relative_to(directory)), f"{case.name}: {meant}"))
    text = "Bars: figures over their limits. Below: where the runs ended, cut through the axis; colour: displacement."
    return {"title": "Each case as a picture", "text": [text], "tables": [], "figures": figures}


def _check(name: str, rows: list[dict]) -> dict:
    missed = [row for row in rows if row["outcome"] != "stable"]
    died = any(row["outcome"] == "died" for row in rows)
    said = "; ".join(
        f"{row['what']} ({row['solver']}): {row['value']:.3g} over the limit {row['limit']:.3g}"
        if row["outcome"] == "degraded"
        else f"{row['what']}: {row['outcome']}, {row['note']}"
        for row in missed
    )
    sentence = f"{len(rows) - len(missed)} of {len(rows)} figures within their limits" + (f"; {said}." if said else ".")
    return check(name, None if died else float(len(missed)), 0.0, sentence)


def _version() -> str:
    """Digest of both solvers' code and of the cases."""
    digest = hashlib.sha256((code_version("explicit") + code_version("implicit")).encode())
    for path in sorted((Path(__file__).parents[1] / "hard").glob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


def _work(name: str, answer: Path):
    """Run a case, and leave its rows and its picture at `answer`."""
    found, shown = judge(next(case for case in CASES if case.name == name))
    answer.write_text(json.dumps(found), encoding="utf-8")
    draw_case(found, shown, answer.with_suffix(".png"))


if __name__ == "__main__":
    take_part(lambda: _work(sys.argv[1], Path(sys.argv[2])))
