"""The local damping D that meets a run-out: bisection over ensembles of runs, and the interval of D."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

from compare.ensembles import Estimate

LOWEST, HIGHEST = 0.0, 0.9  # of D; more holds a column up for ever
FINEST = 0.005  # width of a bracket of D that is not halved any more


@dataclass(frozen=True)
class Calibration:
    """D that meets a target and its interval `low` to `high` [-]; all None where no D does. `said`: how it came out.

    `tried`: what each D gave, in the order in which they were tried.
    """

    damping: float | None
    low: float | None
    high: float | None
    said: str
    tried: dict[float, Estimate]


def bisect(run_outs: Callable[[float], Estimate | None], target: float) -> Calibration:
    """D in [0, 0.9] at which the interval of the run-out covers `target` [-]; run-outs fall with D.

    `run_outs`(D): what an ensemble with that D gives, None where its runs failed. D = 0 is tried first. A damping at
    which fewer than two runs end with a result holds the column up (its energy ledger does not close): less is tried.
    Where the intervals are so narrow that none covers the target, the bracket is halved until it is 0.005 wide.
    """
    tried: dict[float, Estimate] = {}
    low, high, damping = LOWEST, HIGHEST, LOWEST
    while high - low > FINEST:
        found = run_outs(damping)
        if found is not None and found.n > 1:
            tried[damping] = found
        elif damping == LOWEST:
            return _none(tried, "without damping fewer than two runs came to a result")
        if damping not in tried:
            high = damping
        elif found.low <= target <= found.high:
            if damping == LOWEST:  # where does the interval end?
                other = run_outs(0.5 * HIGHEST)
                if other is None or other.n < 2:
                    high = 0.5 * HIGHEST
                else:
                    tried[0.5 * HIGHEST] = other
            return _found(tried, damping, target, high)
        elif found.mean > target:
            low = damping
        elif damping == LOWEST:
            return _none(tried, f"without damping the run-out is {found.said()}, short of {target:g}")
        else:
            high = damping
        damping = 0.5 * (low + high)
    if high not in tried:
        why = "and runs with more come to no result" if high < HIGHEST else "the most that was tried"
        return _none(tried, f"at D = {low:.3g} the run-out is still {tried[low].said()}, beyond {target:g}, {why}")
    return Calibration(damping, low, high, f"run-outs on either side of {target:g} are that near", tried)


def _none(tried, said) -> Calibration:
    return Calibration(None, None, None, f"no D in [{LOWEST:g}, {HIGHEST:g}] was found: {said}", tried)


def _found(tried, damping, target, beyond) -> Calibration:
    """The interval: all D around `damping` whose intervals of the run-out, on straight lines between those that were
    tried, cover the target; up to `beyond` at the most, where none was."""
    known = sorted(tried)
    at = known.index(damping)
    # Towards less damping the lower end rises beyond the target, towards more the upper end falls short of it.
    least = _passed(known[at::-1], [tried[one].low - target for one in known[at::-1]], LOWEST)
    most = _passed(known[at:], [target - tried[one].high for one in known[at:]], beyond)
    return Calibration(damping, least, most, f"the run-out there is {tried[damping].said()}", tried)


def _passed(dampings: list[float], off: list[float], limit: float) -> float:
    """D at which `off`, at most 0 at the first of `dampings`, becomes positive on straight lines; else `limit`."""
    for (one, before), (other, after) in pairwise(zip(dampings, off, strict=True)):
        if after > 0:
            return one - before / (after - before) * (other - one)
    return limit
