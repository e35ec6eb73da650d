"""What a measure tends to as the cell shrinks: Richardson extrapolation from three grids, or from ensembles on them."""

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.optimize import brentq

from compare.ensembles import CONFIDENCE, Estimate, difference, within

ORDERS = (0.4, 6.0)  # outside them a fitted order says that the grids are too coarse, not how the error falls
FARTHEST = 0.2  # of the finest value: a limit farther off is a guess
DRAWS = 1000  # of the ensembles' means, for the interval of their limit
OUTSIDE = round((1.0 - CONFIDENCE) / 2 * DRAWS)  # draws that lie outside of it on either side
SAME = 0.03  # of the finest mean: ensembles of grids that change by less agree, as runs with other steps do


@dataclass(frozen=True)
class Limit:
    """Limit `value` (unit of the measure) for a vanishing cell and `order` p [-] of the error C h^p.

    Both are NaN where not `converged`; then `reason` says why, else it is empty.
    """

    value: float
    order: float
    converged: bool
    reason: str


def richardson(h, f) -> Limit:
    """Limit of values `f` (n,) found with grid sizes `h` (n,), from the finest three, in any order and ratio.

    f = value + C h^p through three points h1 > h2 > h3: (f1 - f2)/(f2 - f3) = (h1^p - h2^p)/(h2^p - h3^p), which
    rises with p and so has one root p at most, sought in [0.4, 6]. Raises ValueError for fewer than three, for
    sizes that are equal or not positive, and for as many sizes as values not given.
    """
    h, f = np.asarray(h, float), np.asarray(f, float)
    if h.shape != f.shape or h.ndim != 1 or len(h) < 3:
        raise ValueError("an extrapolation needs at least three grid sizes, and one value for each")
    if len(np.unique(h)) < len(h) or not np.all(h > 0):
        raise ValueError(f"grid sizes must be positive and all different: {h.tolist()}")
    finest = np.argsort(h)[:3]
    (h3, h2, h1), (f3, f2, f1) = h[finest], f[finest]
    coarse, fine = f1 - f2, f2 - f3  # the change from coarse to middle, and from middle to finest

    def ratio(p):
        return (h1**p - h2**p) / (h2**p - h3**p)

    if not np.isfinite([f1, f2, f3]).all():
        return _no_limit("one of the three finest grids gives no value")
    if coarse == 0 and fine == 0:
        return _no_limit("the three finest grids give the same value, so there is no change to extrapolate")
    if coarse * fine < 0:
        return _no_limit(
            "the value goes up with one refinement and down with the other: it oscillates, and shows no trend"
        )
    if abs(coarse) < ratio(ORDERS[0]) * abs(fine):
        return _no_limit("the value changes too much with the last refinement: it is not settling on a limit yet")
    if abs(coarse) > ratio(ORDERS[1]) * abs(fine):
        return _no_limit(
            "the value hardly changes with the last refinement after a large change before: "
            "the coarsest of the three grids is too coarse to extrapolate from"
        )
    order = brentq(lambda p: ratio(p) * abs(fine) - abs(coarse), *ORDERS)
    value = f3 - fine * h3**order / (h2**order - h3**order)
    if abs(value - f3) > FARTHEST * abs(f3):
        return _no_limit(f"the limit that the trend points to is more than {FARTHEST:.0%} from the finest grid's value")
    return Limit(float(value), float(order), True, "")


@dataclass(frozen=True)
class EnsembleLimit:
    """Limit `value` of ensembles for a vanishing cell, its interval `low` to `high` (unit of the measure), and why.

    `order` of the error. It is NaN where the three finest grids agree within 3 %: the interval is then that of the
    finest ensemble and holds no error of the grid (`said` tells). Where there is no limit all numbers are NaN;
    `undecided` where that is because the ensembles are too small to tell whether the grid matters.
    """

    value: float
    low: float
    high: float
    order: float
    said: str
    undecided: bool = False

    @property
    def known(self) -> bool:
        """Whether there is a limit."""
        return bool(np.isfinite(self.value))


def ensemble_limit(h, ensembles: list[Estimate]) -> EnsembleLimit:
    """Limit of `ensembles` (n,) on grids of size `h` (n,) from the finest three, by Richardson's extrapolation.

    Its interval comes from 1,000 draws of the three means, each from its own t distribution: 95 % of them lie within. A
    draw without a limit (see `richardson`) may lie anywhere and counts as beyond either end, so that there is an
    interval where at most 2.5 % are such. Where that gives no limit, but all changes between the three, coarsest to
    finest too, lie within 3 % with their whole intervals, the finest ensemble stands for it. Otherwise it is not
    converged, or undecided where no change shows. Raises ValueError as `richardson` does.
    """
    found = richardson(h, [one.mean for one in ensembles])  # also checks h
    h = np.asarray(h, float)
    finest = np.argsort(h)[:3]
    three = [ensembles[index] for index in finest]
    if any(one.n < 2 for one in three):
        return _no_ensemble_limit("not converged: an ensemble of the three finest grids has fewer than two runs")
    changes = [difference(fine, coarse) for fine, coarse in combinations(three, 2)]
    changed = any(not one.low <= 0.0 <= one.high for one in changes)
    if changed:
        limit = _extrapolated(found, h[finest], three)
        if limit.known:
            return limit
    known = three[0]
    allowed = SAME * abs(known.mean)
    if all(within(one, -allowed, allowed) for one in changes):
        said = (
            f"changes by less than {SAME:.0%} over the three finest grids; the finest: {known.said('.4f')}, "
            "without the error of its grid"
        )
        return EnsembleLimit(known.mean, known.low, known.high, float("nan"), said)
    if changed:
        return limit
    most = max(max(abs(one.low), abs(one.high)) for one in changes)
    said = f"undecided: no change with the grid shows, but the intervals of the three finest allow one of {most:.4f}"
    return _no_ensemble_limit(f"{said}, more than {SAME:.0%} of the finest", undecided=True)


def _extrapolated(found: Limit, h, three: list[Estimate]) -> EnsembleLimit:
    """Limit of the ensembles `three` on grids `h` (3,), whose means have the limit `found`."""
    if not found.converged:
        return _no_ensemble_limit(f"not converged: {found.reason}")
    draw = np.random.default_rng(0)
    means = np.transpose([one.mean + one.standard_error * draw.standard_t(one.freedom, DRAWS) for one in three])
    limits = sorted(one.value for one in (richardson(h, row) for row in means) if one.converged)
    outside = OUTSIDE - (DRAWS - len(limits))  # of those with a limit, on either side
    if outside < 0:
        share = len(limits) / DRAWS
        return _no_ensemble_limit(
            f"not converged: within the intervals of the three finest grids only {share:.1%} of the draws have a limit"
        )
    low, high = limits[outside], limits[-1 - outside]
    said = f"tends to {found.value:.4f} ({low:.4f} to {high:.4f}) with order {found.order:.2f}"
    return EnsembleLimit(found.value, low, high, found.order, said)


def _no_ensemble_limit(said, undecided=False):
    nothing = float("nan")
    return EnsembleLimit(nothing, nothing, nothing, nothing, said, undecided)


def _no_limit(reason):
    return Limit(float("nan"), float("nan"), False, reason)
