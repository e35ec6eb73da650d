"""Arithmetic on a node's four components agrees with NumPy's, in both precisions within one process."""

import numpy as np
import pytest
import warp as wp

from explicit.kernels.simd import simd
from mpm.devices import KERNEL_OPTIONS, start_warp

start_warp()


@pytest.mark.parametrize("real", [wp.float32, wp.float64])
def test_four_components_at_once(real):
    module = f"repose_lanes_{real.__name__}"
    wp.set_module_options(KERNEL_OPTIONS, module=wp.get_module(module))
    vec3, vec4 = wp.types.vector(3, real), wp.types.vector(4, real)
    scaled, add_scaled, gather, add = (getattr(simd(real), name) for name in ("scaled", "add_scaled", "gather", "add"))

    @wp.kernel(module=module)
    def call(nodes: wp.array(dtype=vec4), weights: wp.array(dtype=vec3), out: wp.array(dtype=vec4, ndim=2)):
        p = wp.tid()
        w = weights[p]
        out[0, p] = scaled(w[0], nodes[p])
        out[1, p] = add_scaled(w[0], nodes[p], nodes[p + 1])
        out[2, p] = gather(nodes, p, w)

    @wp.kernel(module=module)
    def add_all(nodes: wp.array(dtype=vec4), sums: wp.array(dtype=vec4)):
        p = wp.tid()
        add(sums, p // 2, nodes[p])

    dtype, rng = wp.dtype_to_numpy(real), np.random.default_rng(5)
    nodes, weights = rng.normal(size=(12, 4)).astype(dtype), rng.normal(size=(10, 3)).astype(dtype)
    out = wp.zeros((3, 10), dtype=vec4, device="cpu")
    arrays = [wp.array(nodes, dtype=vec4, device="cpu"), wp.array(weights, dtype=vec3, device="cpu"), out]
    wp.launch(call, 10, inputs=arrays, device="cpu")

    first = weights[:, :1]
    tails = np.stack([nodes[p : p + 3] for p in range(10)])
    expected = [first * nodes[:10], first * nodes[:10] + nodes[1:11], np.einsum("pc,pci->pi", weights, tails)]
    np.testing.assert_allclose(out.numpy(), expected, rtol=0, atol=10 * np.finfo(dtype).eps)

    sums = wp.zeros(6, dtype=vec4, device="cpu")
    wp.launch(add_all, 12, inputs=[arrays[0], sums], device="cpu")
    np.testing.assert_allclose(sums.numpy(), nodes[0::2] + nodes[1::2], rtol=0, atol=10 * np.finfo(dtype).eps)
