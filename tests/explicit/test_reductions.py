"""Sums and maxima that threads share agree with NumPy's, thread by thread and in blocks that work together."""

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
    raise_to, add_pencil, add_first = functions.raise_to, functions.add_pencil, functions.add_first

    @wp.kernel(module=module)
    def add(
        n: wp.array(dtype=int),
        reached: wp.array(dtype=int),
        parts: int,
        values: wp.array2d(dtype=vec4),
        nodes: wp.array(dtype=vec4),
    ):
        p = wp.tid()
        add_pencil(nodes, n[p], values[p, 0], values[p, 1], values[p, 2], reached[p], parts)

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
@pytest.mark.parametrize("block", [1, 32])
@pytest.mark.parametrize("parts", [3, 4])
def test_three_nodes_of_a_pencil(monkeypatch, real, block, parts):
    """Neighbours add to the same nodes and to others, to three, two or none of a pencil."""
    monkeypatch.setattr(wp.config, "enable_cpu_blocks", block > 1)
    vec4, add, _others = kernels(real)
    dtype, rng = wp.dtype_to_numpy(real), np.random.default_rng(10 * block + parts)
    n, reached = rng.integers(0, NODES - 2, THREADS), rng.choice([0, 2, 3], THREADS)
    values = rng.normal(size=(THREADS, 3, 4)).astype(dtype)
    values[..., parts:] = 0.0
    before = rng.normal(size=(NODES, 4)).astype(dtype)
    nodes = wp.array(before, dtype=vec4, device="cpu")
    arrays = [wp.array(each, dtype=int, device="cpu") for each in (n, reached)]
    wp.launch(add, THREADS, inputs=[*arrays, parts, wp.array(values, dtype=vec4, device="cpu"), nodes], device="cpu",
              block_dim=block)  # fmt: skip
    expected = before.astype(float)
    for k in range(3):
        np.add.at(expected, (n + k)[reached > k], values[reached > k, k])
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
