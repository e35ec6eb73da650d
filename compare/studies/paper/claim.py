"""A claim of the paper beside what was found: a check of the report, and the first sentence of its figure."""

from compare.ensembles import Part, joined

FOUND = {True: "It holds.", False: "It does not hold.", None: "The runs do not decide."}


def of_runs(name: str, paper: str, parts: list[Part]) -> dict:
    """A claim that holds where each part does, and does not where one does not."""
    holds, cases = joined(parts)
    return _claim(name, paper, cases, holds)


def of_theory(name: str, paper: str, found: str, holds: bool) -> dict:
    """A claim on closed forms and counts, of which no run decides."""
    return _claim(name, paper, found, holds)


def sentences(claims: list[dict]) -> list[str]:
    """A paragraph a claim, for the section of its figure."""
    return [f"{one['sentence']} {FOUND[one['holds']]}" for one in claims]


def _claim(name, paper, found, holds) -> dict:
    """The check of a report (see `compare.report.sections.check`); `value`: 0 where it holds, 1 where it does not."""
    sentence = f"The paper: {paper}. Found: {found}."
    value = None if holds is None else float(not holds)
    return {"name": name, "holds": holds, "value": value, "limit": 0.0, "sentence": sentence}
