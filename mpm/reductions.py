"""Figures of values that are spread over MPI ranks, without gathering them: the same on all ranks, and as of one array.

`comm` is the ranks' communicator, or None where `values` are all there are.
"""

import numpy as np

DIGIT = 8  # bits of a float64 that are found in a round


def largest(values: np.ndarray, comm=None) -> float:
    """The largest of `values` (n,); -inf where there are none."""
    mine = float(np.max(values, initial=-np.inf))
    return mine if comm is None else max(comm.allgather(mine))


def mean(values: np.ndarray, comm=None) -> float:
    """The mean of `values` (n,), summed rank by rank in their order."""
    if comm is None:
        return float(np.mean(values))
    parts = comm.allgather((float(np.sum(values)), len(values)))
    return sum(part for part, _ in parts) / sum(count for _, count in parts)


def quantile(values: np.ndarray, share: float, comm=None) -> float:
    """The quantile of `values` (n,) >= 0 below which a `share` of them lies, as numpy.quantile has it."""
    if comm is None:
        return float(np.quantile(values, share))
    place, neighbours = place_of(share, sum(comm.allgather(len(values))))
    below, above = _in_order(np.sort(values), neighbours, comm)
    return between(below, above, place)


def place_of(share: float, count: int) -> tuple[float, tuple[int, int]]:
    """Where the quantile of `share` stands among `count` values in ascending order, from 0, and the two places that it
    is between."""
    place = share * (count - 1)
    return place, (int(np.floor(place)), int(np.ceil(place)))


def between(below: float, above: float, place: float) -> float:
    """The quantile that stands at `place`, between its two neighbours in ascending order."""
    return float(np.quantile([below, above], place - np.floor(place)))


def _in_order(ascending, places: tuple[int, ...], comm) -> np.ndarray:
    """The values that stand at `places`, from 0, among those of all ranks in ascending order.

    Read as integers, the bits of numbers >= 0 ascend as these do: they are found digit by digit, the leading one first,
    by counting on all ranks what lies at or below the last number with that digit.
    """
    bits, wanted = np.zeros(len(places), np.int64), np.array(places)[:, None]
    for shift in range(64 - DIGIT, -1, -DIGIT):
        digits = np.arange(1 << DIGIT if shift < 64 - DIGIT else 1 << (DIGIT - 1))  # the first bit is the sign
        last = bits[:, None] + (digits << shift) + ((1 << shift) - 1)
        counts = np.searchsorted(ascending, last.view(np.float64), side="right")
        together = np.sum(comm.allgather(counts), axis=0)
        bits += np.argmax(together > wanted, axis=1) << shift
    return bits.view(np.float64)
