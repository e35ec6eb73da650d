"""What a hard case is, and how one that was run is judged."""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from mpm.errors import NumericalError, SceneError
from mpm.run import Run

CASES: list["Case"] = []  # in the order in which their modules register them


@dataclass(frozen=True)
class Finding:
    """One figure of a case: `value` measured by `solver` ("explicit", "implicit", "both" or "law") for `what`.

    It is stable where `value` is at most `limit`; `reason` says where the limit comes from. `note`: what else a reader
    should know of the figure. `run`: one whose end the picture of the case shows.
    """

    what: str
    solver: str
    value: float
    limit: float
    reason: str
    note: str = ""
    run: Run | None = None

    @property
    def stable(self) -> bool:
        """Whether the figure keeps its limit; NaN does not."""
        return bool(self.value <= self.limit)


@dataclass(frozen=True)
class Case:
    """A hard case: `run()` computes it and yields its findings. `slow`: `--quick` leaves it out. `on_ranks`: runs of
    a solver are all that it takes (`compare.hard.collapse.finish`), so that several MPI ranks can compute it."""

    name: str
    run: Callable[[], Iterator[Finding]]
    slow: bool
    on_ranks: bool = False


def hard_case(name: str, slow: bool = False, on_ranks: bool = False):
    """Register the decorated generator of findings as the case `name` (see `Case`)."""

    def register(run):
        CASES.append(Case(name, run, slow, on_ranks))
        return run

    return register


def judge(case: Case) -> tuple[list[dict], dict[str, Run]]:
    """Run a case: a row a finding (case, what, solver, outcome, value, limit, reason, note, seconds), and the runs that
    a picture shows, by what was found of them.

    Outcome: "stable" within its limit, "degraded" beyond it, "refused" where the solver stopped with a named error,
    whose text is then the note.
    """
    rows: list[dict[str, Any]] = []
    runs: dict[str, Run] = {}
    started = time.perf_counter()
    try:
        for one in case.run():
            outcome = "stable" if one.stable else "degraded"
            rows.append({"case": case.name, "what": one.what, "solver": one.solver, "outcome": outcome})
            rows[-1] |= {"value": one.value, "limit": one.limit, "reason": one.reason, "note": one.note}
            if one.run:
                runs[one.what] = one.run
    except (NumericalError, SceneError) as error:
        rows.append({"case": case.name, "what": "the rest of the case", "solver": "", "outcome": "refused"})
        rows[-1] |= {"value": None, "limit": None, "reason": "a named error ended it", "note": str(error)}
    for row in rows:
        row["seconds"] = time.perf_counter() - started
    return rows, runs
