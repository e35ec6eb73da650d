"""What is looked at for a history row: of one body, and of the same one spread over ranks."""

import numpy as np
import pytest
from threads_as_ranks import Ranks

from mpm.body import build
from mpm.load import load_scene
from mpm.runout import front
from mpm.watch import farthest_beyond, look


@pytest.fixture
def body():
    return build(load_scene("column_small", sections={"grid": {"cell": 0.25}}))


def test_a_point_is_as_far_beyond_a_wall_as_it_was_put(body):
    """The base, z = 0, is a wall: below it a point is beyond, and the lowest of all others is a quarter cell above."""
    assert farthest_beyond(body.x, body).cells == pytest.approx(-0.25)
    x = body.x.copy()
    x[17, 2] = -0.1
    found = farthest_beyond(x, body)
    assert (found.cells, found.point) == (pytest.approx(0.4), 17)
    np.testing.assert_array_equal(found.x, x[17])


def test_a_body_over_ranks_looks_as_it_does_whole(body):
    """Three ranks, one of which has no points; the point that is farthest beyond a wall is the last one's."""
    x, volume = body.x.copy(), np.linspace(0.9, 1.2, len(body.x))
    x[17, 2] = -0.1
    ids = [np.flatnonzero(np.arange(len(x)) % 3 != 2), np.zeros(0, int), np.arange(2, len(x), 3)]
    assert 17 in ids[2]
    for seen in Ranks(3).all(lambda mine, comm: look(x[mine], volume[mine], body, mine, comm), ids):
        assert seen.front == front(x, body.measure)
        assert seen.volume_ratio == pytest.approx(volume.mean(), rel=1e-14)
        assert (seen.beyond.point, seen.beyond.cells) == (17, pytest.approx(0.4))
        np.testing.assert_array_equal(seen.beyond.x, x[17])
