"""Cuts of the plan into domains. What ranks exchange is tested where they run: tests/explicit/test_ranks.py."""

import numpy as np
import pytest

from mpm import domains
from mpm.domains import cut_plan, owner_of


def disc(radius):
    """Pencils under a quarter disc, and how many points each has: fewer at the rim."""
    i, j = np.nonzero(np.add.outer(np.arange(radius) ** 2, np.arange(radius) ** 2) < radius**2)
    return np.stack([i, j], axis=1), np.where(i**2 + j**2 < (radius - 1) ** 2, 40, 10)


@pytest.mark.parametrize("ranks", [1, 2, 3, 4, 7])
def test_domains_hold_equal_shares_as_nearly_as_whole_pencils_allow(ranks):
    columns, weights = disc(40)
    owner = owner_of(columns, cut_plan(columns, weights, ranks))
    loads = np.bincount(owner, weights, minlength=ranks)
    assert loads.sum() == weights.sum()
    assert loads.max() < 1.06 * loads.mean()


def test_every_pencil_has_an_owner_also_where_no_point_was():
    columns, weights = disc(10)
    cut = cut_plan(columns, weights, 3)
    far = np.array([[-500, 0], [500, 500], [0, -500], [3, 400]])
    assert set(owner_of(far, cut)) <= {0, 1, 2}
    # a domain is a rectangle: what lies beyond the body belongs to the domain it adjoins
    assert owner_of(np.array([[9, 0]]), cut) == owner_of(np.array([[900, 0]]), cut)


def test_more_ranks_than_pencils_leave_some_without_points():
    columns, weights = np.array([[0, 0], [0, 1]]), np.array([8, 8])
    owner = owner_of(columns, cut_plan(columns, weights, 4))
    assert len(set(owner)) == 2


def test_a_cut_runs_across_the_longer_side():
    columns = np.array([[i, j] for i in range(20) for j in range(4)])
    cut = cut_plan(columns, np.ones(len(columns)), 2)
    assert (cut.axis, cut.at, cut.low, cut.high) == (0, 10, 0, 1)


class Message:
    """A request that has arrived when it is looked at for the `arrives`th time."""

    def __init__(self, arrives):
        self.looks_left = arrives

    def Test(self):
        self.looks_left -= 1
        return self.looks_left <= 0

    @classmethod
    def Testall(cls, requests):
        return all([request.Test() for request in requests])


class Comm:
    rank = 0


@pytest.mark.parametrize(
    ("arrives", "told"),
    [
        ((1, 1), ""),
        ((1, 4), "rank 0 waits for rank 2, for 0 s now\n"),
        ((4, 4), "rank 0 waits for rank 1 and rank 2, for 0 s now\n"),
        ((2, 2), ""),  # late, but there when it is asked which are missing
    ],
)
def test_who_is_waited_for_is_said_once_and_nobody_where_all_have_come(capsys, monkeypatch, arrives, told):
    monkeypatch.setattr(domains, "PATIENCE", 0.0)
    domains._wait([Message(count) for count in arrives], [1, 2], Comm)
    assert capsys.readouterr().err == told
