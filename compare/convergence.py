"""What a measure tends to as the cell shrinks: Richardson extrapolation from three grids, or from ensembles on them."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.optimize import brentq

from compare.ensembles import CONFIDENCE, Estimate, difference

ORDERS = (0.4, 6.0)  # outside them a fitted order says that the grids are too coarse, not how the error falls
FARTHEST = 0.2  # of the finest value: a limit farther off is a guess
DRAWS = 1000  # of the ensembles' means, for the interval of their limit


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

    `order` of the error; NaN where no change with the grid shows (`said` tells) or where there is no limit: then
    `value`, `low` and `high` are NaN too.
    """

    value: float
    low: float
    high: float
    order: float
    said: str

    @property
    def known(self) -> bool:
        """Whether there is a limit."""
        return bool(np.isfinite(self.value))


def ensemble_limit(h, ensembles: list[Estimate]) -> EnsembleLimit:
    """Limit of `ensembles` (n,) on grids of size `h` (n,) from the finest three, by Richardson's extrapolation.

    Its interval comes from 1,000 draws of the three means, each from its own t distribution: it is given where at least
    95 % of the draws have a limit (see `richardson`). Where neither refinement changes the mean beyond its interval
    there is no error of the grid to extrapolate: the limit is then the finest ensemble. Otherwise it is not converged.
    Raises ValueError as `richardson` does.
    """
    found = richardson(h, [one.mean for one in ensembles])  # also checks h
    h = np.asarray(h, float)
    finest = np.argsort(h)[:3]
    three = [ensembles[index] for index in finest]
    if any(one.n < 2 for one in three):
        return _no_ensemble_limit("not converged: an ensemble of the three finest grids has fewer than two runs")
    changes = [difference(fine, coarse) for fine, coarse in pairwise(three)]
    if all(one.low <= 0.0 <= one.high for one in changes):
        known = three[0]
        said = f"no change with the grid beyond the intervals of the three finest; the finest: {known.said('.4f')}"
        return EnsembleLimit(known.mean, known.low, known.high, float("nan"), said)
    if not found.converged:
        return _no_ensemble_limit(f"not converged: {found.reason}")
    draw = np.random.default_rng(0)
    means = np.transpose([one.mean + one.standard_error * draw.standard_t(one.freedom, DRAWS) for one in three])
    limits = [one.value for one in (richardson(h[finest], row) for row in means) if one.converged]
    if len(limits) < CONFIDENCE * DRAWS:
        share = len(limits) / DRAWS
        said = (
            f"not converged: within the intervals of the three finest grids only {share:.0%} of the draws have a limit"
        )
        return _no_ensemble_limit(said)
    low, high = np.quantile(limits, [(1.0 - CONFIDENCE) / 2, (1.0 + CONFIDENCE) / 2])
    said = f"tends to {found.value:.4f} ({low:.4f} to {high:.4f}) with order {found.order:.2f}"
    return EnsembleLimit(found.value, float(low), float(high), found.order, said)


def _no_ensemble_limit(said):
    return EnsembleLimit(*[float("nan")] * 4, said)


def _no_limit(reason):
    return Limit(float("nan"), float("nan"), False, reason)
