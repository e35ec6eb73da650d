"""uGIMP weights against the piecewise definition, and the sums they must keep anywhere in the grid."""

import numpy as np
import pytest
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st

from mpm.devices import start_warp
from mpm.gimp import gimp

start_warp()
CELL = 0.05
BASIS = gimp(wp.float64)


@wp.kernel(module="repose_float64")
def evaluate(
    x: wp.array(dtype=wp.float64),
    inv_cell: wp.float64,
    base: wp.array(dtype=wp.int32),
    s: wp.array(dtype=wp.vec3d),
    ds: wp.array(dtype=wp.vec3d),
):
    p = wp.tid()
    first = BASIS.base(x[p], inv_cell)
    value, slope = BASIS.weights(x[p], inv_cell, first)
    base[p] = first
    s[p] = value
    ds[p] = slope


def weights(x):
    x = np.atleast_1d(np.asarray(x, float))
    base = wp.zeros(len(x), dtype=wp.int32, device="cpu")
    s, ds = (wp.zeros(len(x), dtype=wp.vec3d, device="cpu") for _ in range(2))
    inputs = [wp.array(x, dtype=wp.float64, device="cpu"), wp.float64(1.0 / CELL), base, s, ds]
    wp.launch(evaluate, len(x), inputs=inputs, device="cpu")
    return base.numpy(), s.numpy(), ds.numpy()


def piecewise(xi, h=CELL, half=CELL / 4):
    """The uGIMP weight and slope at distance xi = x_p - x_n (Bardenhagen and Kober 2004)."""
    a = abs(xi)
    if a < half:
        return 1 - (a**2 + half**2) / (2 * h * half), -xi / (h * half)
    if a < h - half:
        return 1 - a / h, -np.sign(xi) / h
    if a < h + half:
        return (h + half - a) ** 2 / (4 * h * half), -np.sign(xi) * (h + half - a) / (2 * h * half)
    return 0.0, 0.0


def test_weights_are_the_piecewise_ugimp_functions():
    x = np.random.default_rng(1).uniform(-1.0, 1.0, 2000)
    base, s, ds = weights(x)
    for p in range(len(x)):
        for a in range(3):
            value, slope = piecewise(x[p] - (base[p] + a) * CELL)
            assert s[p, a] == pytest.approx(value, abs=1e-12)
            assert ds[p, a] == pytest.approx(slope, abs=1e-9)
        # no node outside the stencil sees the point
        assert piecewise(x[p] - (base[p] - 1) * CELL)[0] < 1e-14
        assert piecewise(x[p] - (base[p] + 3) * CELL)[0] < 1e-14


def assert_sums(x):
    base, s, ds = weights(x)
    nodes = (base[:, None] + np.arange(3)) * CELL
    scale = 1.0 + np.abs(np.atleast_1d(x)) / CELL  # round-off of a position counted in cells
    assert np.all(np.abs(s.sum(axis=1) - 1) < 4e-16 * 4)
    assert np.all(np.abs(ds.sum(axis=1)) * CELL < 4e-15)
    assert np.all(s > -1e-15 * scale[:, None])
    # linear fields: the weighted mean of node positions is the point, the weighted slope is one
    assert np.all(np.abs((s * nodes).sum(axis=1) - x) < 1e-14 * scale)
    assert np.all(np.abs((ds * nodes).sum(axis=1) - 1) < 1e-13 * scale)


@settings(max_examples=200, deadline=None)
@given(st.floats(-1e3, 1e3))
def test_partition_of_unity_and_linear_completeness_anywhere(x):
    assert_sums(np.array([x]))


def test_partition_of_unity_on_faces_and_domain_edges():
    """On nodes, cell faces and where the domain's edge meets a face, and one ulp to either side of each."""
    marks = np.arange(-40, 41) * (CELL / 4)
    x = np.concatenate([marks, np.nextafter(marks, np.inf), np.nextafter(marks, -np.inf)])
    assert_sums(x)
