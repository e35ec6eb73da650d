"""Sums and maxima that threads share agree with NumPy's."""

import numpy as np
import pytest
import warp as wp

from explicit.kernels.reductions import reductions
from mpm.devices import KERNEL_OPTIONS, start_warp

start_warp()
NODES, THREADS = 40, 96


def kernels(real):
    module = f"repose_reductions_{real.__name__}"
    wp.set_module_options(KERNEL_OPTIONS, module=wp.get_module(module))
    vec4 = wp.types.vector(4, real)
    functions = reductions(real)
    raise_to, add_node, add_first = functions.raise_to, functions.add_node, functions.add_first

    @wp.kernel(module=module)
    def add(n: wp.array(dtype=int), values: wp.array(dtype=vec4), nodes: wp.array(dtype=vec4)):
        p = wp.tid()
        add_node(nodes, n[p], values[p])

    @wp.kernel(module=module)
    def others(
        n: wp.array(dtype=int),
        values: wp.array(dtype=real),
        nodes: wp.array(dtype=vec4),
        most: wp.array(dtype=real),
    ):
        p = wp.tid()
        add_first(nodes, n[p], values[p])
        raise_to(most, p % 3, values[p])

    return vec4, add, others


@pytest.mark.parametrize("real", [wp.float32, wp.float64])
def test_a_node_of_each_lane(monkeypatch, real):
    """The first 27 lanes of a warp add, to nodes of their own and to the same ones."""
    monkeypatch.setattr(wp.config, "enable_cpu_blocks", True)
    vec4, add, _others = kernels(real)
    dtype, rng = wp.dtype_to_numpy(real), np.random.default_rng(10)
    n, values = rng.integers(0, NODES, THREADS), rng.normal(size=(THREADS, 4)).astype(dtype)
    values[rng.uniform(size=values.shape) < 0.2] = 0.0
    before = rng.normal(size=(NODES, 4)).astype(dtype)
    nodes = wp.array(before, dtype=vec4, device="cpu")
    inputs = [wp.array(n, dtype=int, device="cpu"), wp.array(values, dtype=vec4, device="cpu"), nodes]
    wp.launch(add, THREADS, inputs=inputs, device="cpu", block_dim=32)
    expected, adds = before.astype(float), np.arange(THREADS) % 32 < 27
    np.add.at(expected, n[adds], values[adds])
    np.testing.assert_allclose(nodes.numpy(), expected, rtol=0, atol=50 * np.finfo(dtype).eps)


@pytest.mark.parametrize("real", [wp.float32, wp.float64])
def test_first_components_and_maxima(real):
    """A NaN is passed over, as are numbers below what is recorded."""
    vec4, _add, others = kernels(real)
    dtype, rng = wp.dtype_to_numpy(real), np.random.default_rng(2)
    n, values = rng.integers(0, NODES, THREADS), rng.uniform(0.0, 1.0, THREADS).astype(dtype)
    nodes, most = wp.zeros(NODES, dtype=vec4, device="cpu"), wp.array([0.0, 0.5, 2.0], dtype=real, device="cpu")
    for broken in (False, True):
        given = np.where(np.arange(THREADS) % 5 == 0, np.nan, values).astype(dtype) if broken else values
        inputs = [wp.array(n, dtype=int, device="cpu"), wp.array(given, dtype=real, device="cpu"), nodes, most]
        wp.launch(others, THREADS, inputs=inputs, device="cpu")
        if not broken:
            expected = np.zeros((NODES, 4))
            np.add.at(expected[:, 0], n, values)
            np.testing.assert_allclose(nodes.numpy(), expected, rtol=0, atol=50 * np.finfo(dtype).eps)
        np.testing.assert_array_equal(most.numpy(), [values[0::3].max(), max(values[1::3].max(), dtype(0.5)), 2.0])
