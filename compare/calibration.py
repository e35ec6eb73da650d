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

    `run_outs`(D): what an ensemble with that D gives, None where its runs failed. D = 0 is tried first, 0.9 where 0.45
    still runs too far: heavy damping holds a column up, and such runs are long. Where the intervals are so narrow that
    none covers the target, the bracket is halved until it is 0.005 wide.
    """
    tried: dict[float, Estimate] = {}
    low, high, damping = LOWEST, HIGHEST, LOWEST
    while high - low > FINEST:
        found = run_outs(damping)
        if found is None or found.n < 2:
            return _none(tried, f"fewer than two runs at D = {damping:g} came to an end")
        tried[damping] = found
        if found.low <= target <= found.high:
            beyond = 0.5 * (LOWEST + HIGHEST)
            if damping == LOWEST and (other := run_outs(beyond)):  # where the interval ends
                tried[beyond] = other
            return _found(tried, damping, target)
        if found.mean < target and damping == LOWEST:
            return _none(tried, f"without damping the run-out is {found.said()}, short of {target:g}")
        if found.mean > target and damping == HIGHEST:
            return _none(tried, f"at D = {HIGHEST:g} the run-out is still {found.said()}, beyond {target:g}")
        if found.mean > target:
            low = damping
        else:
            high = damping
        first_beyond = low > LOWEST and high == HIGHEST and HIGHEST not in tried
        damping = HIGHEST if first_beyond else 0.5 * (low + high)
    return Calibration(0.5 * (low + high), low, high, f"run-outs on either side of {target:g} are that near", tried)


def _none(tried, said) -> Calibration:
    return Calibration(None, None, None, f"no D in [{LOWEST:g}, {HIGHEST:g}] was found: {said}", tried)


def _found(tried, damping, target) -> Calibration:
    """The interval: all D around `damping` whose intervals of the run-out, on straight lines between those that were
    tried, cover the target."""
    known = sorted(tried)
    at = known.index(damping)
    # Towards less damping the lower end rises beyond the target, towards more the upper end falls short of it.
    least = _passed(known[at::-1], [tried[one].low - target for one in known[at::-1]], LOWEST)
    most = _passed(known[at:], [target - tried[one].high for one in known[at:]], HIGHEST)
    return Calibration(damping, least, most, f"the run-out there is {tried[damping].said()}", tried)


def _passed(dampings: list[float], off: list[float], limit: float) -> float:
    """D at which `off`, at most 0 at the first of `dampings`, becomes positive on straight lines; else `limit`."""
    for (one, before), (other, after) in pairwise(zip(dampings, off, strict=True)):
        if after > 0:
            return one - before / (after - before) * (other - one)
    return limit
