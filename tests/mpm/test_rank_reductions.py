"""Figures over ranks: threads that stand for ranks, against NumPy on all values at once."""

import numpy as np
import pytest
from threads_as_ranks import Ranks

from mpm.reductions import largest, mean, quantile
from mpm.runout import Measure, front

VALUES = {
    "spread over decades": np.exp(np.random.default_rng(1).normal(0, 20, 1001)),
    "ties": np.repeat([0.0, 0.125, 3.0, 3.0, 7.5], 200),
    "all the same": np.full(10, 1.5),
    "with the smallest there is": np.array([0.0, 5e-324, 1e-310, 2.0, np.finfo(float).max]),
    "one": np.array([0.3]),
}


@pytest.mark.parametrize("values", VALUES.values(), ids=VALUES)
@pytest.mark.parametrize("share", [0.0, 0.5, 0.98, 0.995, 1.0])
def test_quantiles_over_ranks_are_those_of_all_values_to_the_last_bit(values, share):
    """Shared out unevenly, one rank with nothing."""
    parts = [values[::3], np.zeros(0), np.delete(values, np.arange(0, len(values), 3))]
    wanted = np.quantile(values, share)
    assert Ranks(3).all(lambda part, comm: quantile(part, share, comm), parts) == [wanted] * 3
    assert quantile(values, share) == wanted


def test_largest_and_mean_over_ranks():
    values = np.random.default_rng(2).normal(size=100)
    parts = [values[:40], values[40:], np.zeros(0)]
    assert Ranks(3).all(largest, parts) == [values.max()] * 3
    np.testing.assert_allclose(Ranks(3).all(mean, parts), values.mean(), rtol=1e-14)
    assert (largest(values), mean(values)) == (values.max(), values.mean())


def test_a_front_over_ranks_is_that_of_the_whole_body():
    x = np.random.default_rng(3).uniform(0, 2, (500, 3))
    measure = Measure(axes=(0, 1), reference=1.0, half_length=0.025, cell=0.1, axis=(0.1, 0.2))
    parts = [x[:100], x[100:]]
    for found in Ranks(2).all(lambda part, comm: front(part, measure, comm), parts):
        assert found == front(x, measure)
