"""A claim of the paper beside what was found: a check of the report, and the first sentence of its figure."""

from typing import NamedTuple

from compare.ensembles import Estimate, within

FOUND = {True: "It holds.", False: "It does not hold.", None: "The runs do not decide."}
SHORT = {True: "holds", False: "does not hold", None: "undecided"}


class Part(NamedTuple):
    """One case of a claim: `where` ("lambda0 = 1"), the value, between what it must lie, what is `said`."""

    where: str
    value: Estimate | None
    low: float
    high: float
    said: str

    @property
    def holds(self) -> bool | None:
        """Whether the interval lies between the limits (see `compare.ensembles.within`)."""
        return within(self.value, self.low, self.high)


def of_runs(name: str, paper: str, parts: list[Part]) -> dict:
    """A claim that holds where each part does, and does not where one does not."""
    judged = [part.holds for part in parts]
    holds = None if not parts else False if False in judged else None if None in judged else True
    cases = [f"{part.where}: {part.said} ({SHORT[part.holds]})" for part in parts]
    return _claim(name, paper, "; ".join(cases) or "no such run was asked for", holds, judged.count(False))


def of_theory(name: str, paper: str, found: str, holds: bool) -> dict:
    """A claim on closed forms and counts, of which no run decides."""
    return _claim(name, paper, found, holds, int(not holds))


def sentences(claims: list[dict]) -> list[str]:
    """A paragraph a claim, for the section of its figure."""
    return [f"{one['sentence']} {FOUND[one['holds']]}" for one in claims]


def _claim(name, paper, found, holds, missed) -> dict:
    """`value`: in how many cases it does not hold, of which none is allowed."""
    value = None if holds is None else float(missed)
    return {"name": name, "holds": holds, "value": value, "limit": 0.0} | {
        "sentence": f"The paper: {paper}. Found: {found}."
    }
