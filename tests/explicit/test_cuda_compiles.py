"""The CUDA kernels compile for real GPU architectures, which Warp's NVRTC does on machines without a GPU too."""

import pytest
import warp as wp

from explicit.kernels import step_kernels
from explicit.kernels.sparse_grid import sparse_grid_kernels
from mpm.devices import start_warp

start_warp()


@pytest.mark.parametrize("real", [wp.float32, wp.float64])
def test_kernels_compile_for_cuda(real, tmp_path):
    kernels = {**vars(step_kernels(real)), **vars(sparse_grid_kernels(real))}
    names = [name for name, kernel in kernels.items() if isinstance(kernel, wp.Kernel)]
    assert {"p2g", "g2p2g", "update_stress", "begin_step", "widen_spans"} <= set(names)
    # PTX, not machine code, so that the names of the entry points can be read.
    module = wp.get_module(f"repose_{real.__name__}")
    wp.compile_aot_module(module, arch=80, module_dir=tmp_path, use_ptx=True)
    (ptx,) = tmp_path.glob("*.ptx")
    text = ptx.read_text()
    for name in names:
        assert f"{name}_" in text, name
    assert text.count(".visible .entry") >= len(names)


@pytest.mark.parametrize(
    ("real", "sums", "each"), [(wp.float32, "red.global.add.v4.f32", 1), (wp.float64, "red.global.add.f64", 4)]
)
def test_sums_into_nodes_are_single_reductions(real, sums, each, tmp_path):
    """On sm_90 four float32 reach a node in one reduction. p2g's loops over pencils stay loops, with three nodes of two
    arrays in each of three cases; g2p2g's are written out, 27 nodes.
    """
    step_kernels(real)
    module = wp.get_module(f"repose_{real.__name__}")
    wp.compile_aot_module(module, arch=90, module_dir=tmp_path, use_ptx=True)
    (ptx,) = tmp_path.glob("*.ptx")
    kernels = ptx.read_text().split(".entry ")[1:]
    counts = {}
    for name in ("p2g", "g2p2g"):
        (text,) = [kernel for kernel in kernels if f"__{name}_" in kernel.partition("(")[0]]
        counts[name] = text.count(sums)
    assert counts == {"p2g": 18 * each, "g2p2g": 27 * each}
