"""Principal axes by Jacobi rotations against LAPACK, with eigenvalues that meet, vanish or differ by many orders."""

import numpy as np
import pytest
import warp as wp

from implicit.kernels.eigen import eigen
from implicit.kernels.layout import mat33, vec3
from mpm.devices import KERNEL_OPTIONS, start_warp

start_warp()
MODULE = "repose_eigen"
wp.set_module_options(KERNEL_OPTIONS, module=wp.get_module(MODULE))


@wp.kernel(module=MODULE)
def call(a: wp.array(dtype=mat33), axes: wp.array(dtype=mat33), values: wp.array(dtype=vec3)):
    p = wp.tid()
    q, d = eigen(a[p])
    axes[p] = q
    values[p] = d


def matrices(spectrum, count=200):
    """Symmetric matrices (count, 3, 3) of these eigenvalues in turned axes."""
    turned = np.linalg.qr(np.random.default_rng(3).normal(size=(count, 3, 3)))[0]
    a = turned @ (np.asarray(spectrum, float)[:, None] * turned.transpose(0, 2, 1))
    return 0.5 * (a + a.transpose(0, 2, 1))


SPECTRA = [(3, 2, 1), (1, 1, 1), (2, 2, -1), (1, 1 + 1e-9, 1 - 1e-9), (1e-8, -2e-8, 3e-9), (1, 1e-9, -1e-12), (5, 0, 0)]


@pytest.mark.parametrize("spectrum", SPECTRA)
def test_axes_and_values(spectrum):
    a = matrices(spectrum)
    axes, values = (wp.zeros(len(a), dtype=dtype, device="cpu") for dtype in (mat33, vec3))
    wp.launch(call, len(a), inputs=[wp.array(a, dtype=mat33, device="cpu"), axes, values], device="cpu")
    q, d = axes.numpy(), values.numpy()
    size = np.abs(spectrum).max()
    np.testing.assert_allclose(np.sort(d, axis=1), np.linalg.eigvalsh(a), rtol=0, atol=4e-15 * size)
    np.testing.assert_allclose(q.transpose(0, 2, 1) @ q, np.broadcast_to(np.eye(3), a.shape), rtol=0, atol=4e-15)
    np.testing.assert_allclose(q * d[:, None, :] @ q.transpose(0, 2, 1), a, rtol=0, atol=6e-15 * size)


def test_what_is_diagonal_is_left_alone():
    a = np.array([np.diag([2.0, -1.0, 0.5]), np.zeros((3, 3))])
    axes, values = (wp.zeros(2, dtype=dtype, device="cpu") for dtype in (mat33, vec3))
    wp.launch(call, 2, inputs=[wp.array(a, dtype=mat33, device="cpu"), axes, values], device="cpu")
    assert np.array_equal(axes.numpy(), [np.eye(3)] * 2)
    assert np.array_equal(values.numpy(), [[2.0, -1.0, 0.5], [0.0, 0.0, 0.0]])
