"""Ensembles: one scene from several random starts, what a measure is then known to, and when a claim holds.

A collapse is chaotic in its details, so that one run is one throw. A realisation moves each point at random within half
of its spacing (`grid.scatter`). Intervals are those of Student's t at 95 %.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.stats import t as student

from compare.batch import Job, Outcome, Workers, run_all
from mpm.errors import SceneError

SCATTER = 0.5  # share of their spacing within which points start at random places
CONFIDENCE = 0.95
# Five realisations tell a mean to 1.2 standard deviations, three to 2.5, two to 9. That of R_995 is 0.2 to 3.5 % of
# R_995 at 8 cells per r0 (benchmarks/results/scatter_cpu.csv).
REALISATIONS, QUICK_REALISATIONS = 5, 3
MOST_NAMED = 4  # cases of a claim that are all named
SETS = ("grid.scatter", "grid.realisation")  # scene keys that make a realisation


@dataclass(frozen=True)
class Estimate:
    """`mean` of a measure, its `standard_error` (same unit), the `freedom` of its t, and `n`, the runs behind it.

    One run has no standard error: it is NaN, and the interval is without ends.
    """

    mean: float
    standard_error: float
    freedom: float
    n: int

    @property
    def half(self) -> float:
        """Half of the interval's width, in the measure's unit."""
        if self.freedom < 1:
            return math.inf
        return float(student.ppf(0.5 + CONFIDENCE / 2, self.freedom) * self.standard_error)

    @property
    def low(self) -> float:
        """Lower end of the interval."""
        return self.mean - self.half

    @property
    def high(self) -> float:
        """Upper end of the interval."""
        return self.mean + self.half

    def over(self, reference: float) -> "Estimate":
        """The measure over `reference` - 1, where the reference has no error of its own."""
        error = self.standard_error / abs(reference)
        return replace(self, mean=self.mean / reference - 1.0, standard_error=error)

    def said(self, form: str = ".3f") -> str:
        """Mean and half of the interval in words, `form` as in format()."""
        half = "" if self.n < 2 else f" ± {self.half:{form.replace('+', '')}}"
        return f"{self.mean:{form}}{half}"


def estimate(values: Iterable[float | None]) -> Estimate | None:
    """What the `values` of the realisations say of their mean; those of failed runs are None and left out.

    None where no run gave a value.
    """
    known = np.array([value for value in values if value is not None and np.isfinite(value)], float)
    if len(known) == 0:
        return None
    error = float(known.std(ddof=1) / math.sqrt(len(known))) if len(known) > 1 else math.nan
    return Estimate(float(known.mean()), error, len(known) - 1.0, len(known))


def difference(a: Estimate, b: Estimate) -> Estimate:
    """a - b of two ensembles, in their unit (Welch: their variances may differ)."""
    return _combined(a.mean - b.mean, a, a.standard_error, b, b.standard_error)


def relative(a: Estimate, b: Estimate) -> Estimate:
    """a/b - 1 of two ensembles; standard errors to first order."""
    ratio = a.mean / b.mean
    return _combined(ratio - 1.0, a, abs(a.standard_error / b.mean), b, abs(ratio * b.standard_error / b.mean))


def paired(values: Iterable[float | None], others: Iterable[float | None]) -> Estimate | None:
    """values/others - 1 of runs from the same starts, in the same order; pairs of which one failed (None) are left out.

    A change that hardly matters leaves a collapse from one start where it was, so that pairs tell it much more closely
    than the means of both ensembles do.
    """
    pairs = zip(values, others, strict=True)
    return estimate(one / other - 1.0 for one, other in pairs if one is not None and other is not None)


def _combined(mean: float, a: Estimate, error_a: float, b: Estimate, error_b: float) -> Estimate:
    variance = error_a**2 + error_b**2
    parts = [(error_a**2, a.freedom), (error_b**2, b.freedom)]
    if min(a.freedom, b.freedom) < 1:
        freedom = 0.0
    elif variance == 0:
        freedom = a.freedom + b.freedom
    else:  # Welch and Satterthwaite
        freedom = variance**2 / sum(part**2 / free for part, free in parts)
    return Estimate(mean, math.sqrt(variance), freedom, a.n + b.n)


def within(value: Estimate | None, low: float, high: float) -> bool | None:
    """Whether a claim that the measure lies between `low` and `high` holds.

    True where the whole interval does, False where none of it does, None where the runs do not decide or failed.
    """
    if value is None or not math.isfinite(value.half):
        return None
    if low <= value.low and value.high <= high:
        return True
    return False if value.high < low or value.low > high else None


class Part(NamedTuple):
    """One case of a claim: `where` ("lambda0 = 1"), the value, between what it must lie, what is `said` of it."""

    where: str
    value: Estimate | None
    low: float
    high: float
    said: str

    @property
    def holds(self) -> bool | None:
        """Whether the interval lies between the limits (see `within`)."""
        return within(self.value, self.low, self.high)


def joined(parts: list[Part]) -> tuple[bool | None, str]:
    """Whether a claim holds in every case, and the cases in words: of more than four only those that do not hold.

    False where it does not hold in one, None where one is undecided or there is none.
    """
    judged = [part.holds for part in parts]
    holds = None if not parts else False if False in judged else None if None in judged else True
    words = {True: "holds", False: "does not hold", None: "undecided"}
    named = [part for part in parts if len(parts) <= MOST_NAMED or not part.holds]
    cases = [f"{part.where}: {part.said} ({words[part.holds]})" for part in named]
    if others := len(parts) - len(named):
        cases.append(f"it holds in {'the other' if named else 'all'} {others} cases")
    return holds, "; ".join(cases) or "no such run was asked for"


def flat(row: dict, measures: tuple[str, ...]) -> dict:
    """A row for a table, of which `measures` are an `Estimate` or None: KEY its mean, KEY_half half of the interval,
    KEY_n the number of runs."""
    cells = {}
    for key, value in row.items():
        if key in measures:
            known = (value.mean, value.half, value.n) if value else (None, None, 0)
            cells |= zip((key, f"{key}_half", f"{key}_n"), known, strict=True)
        else:
            cells[key] = value
    return cells


def ensemble(job: Job, realisations: int) -> list[Job]:
    """The realisations of one job, NAME-r0, NAME-r1 and so on."""
    return [
        replace(
            job,
            name=f"{job.name}-r{number}",
            settings=(*job.settings, f"grid.scatter={SCATTER}", f"grid.realisation={number}"),
        )
        for number in range(realisations)
    ]


def run_ensembles(
    jobs: list[Job], realisations: int, directory: Path, workers: Workers, force: bool, monitor
) -> list[list[Outcome]]:
    """Run or reuse so many realisations of each job (see `compare.batch.run_all`); the outcomes of each.

    Raises SceneError for fewer than two realisations: they have no interval.
    """
    if realisations < 2:
        raise SceneError(f"--realisations {realisations}: must be >= 2 [-]; one run has no interval")
    whole = [one for job in jobs for one in ensemble(job, realisations)]
    outcomes = run_all(whole, directory, workers, force, monitor)
    return [outcomes[first : first + realisations] for first in range(0, len(whole), realisations)]
