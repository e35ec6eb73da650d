"""What a measure tends to as the cell shrinks: Richardson extrapolation from three grids."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

ORDERS = (0.4, 6.0)  # outside them a fitted order says that the grids are too coarse, not how the error falls
FARTHEST = 0.2  # of the finest value: a limit farther off is a guess


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


def _no_limit(reason):
    return Limit(float("nan"), float("nan"), False, reason)
