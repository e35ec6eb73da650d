"""The CUDA kernels compile for real GPU architectures, which Warp's NVRTC does on machines without a GPU too, into the
code they are meant to be: how many reductions, of which kind, and nothing in local memory."""

import functools
import runpy
from pathlib import Path
from types import SimpleNamespace

import pytest
import warp as wp

from explicit.kernels import step_kernels
from explicit.kernels.fused import fused_kernels
from explicit.kernels.order import order_kernels
from explicit.kernels.sparse_grid import sparse_grid_kernels
from mpm.devices import start_warp

start_warp()
COUNTS = SimpleNamespace(**runpy.run_path(Path(__file__).parents[2] / "benchmarks" / "gpu_counts.py"))
REALS = pytest.mark.parametrize("real", [wp.float32, wp.float64])
MOST_REGISTERS = 168  # three blocks of 128 threads to a multiprocessor


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    """`compiled(module, arch, ptx)`: where the module's code is; made once."""
    return functools.cache(lambda *code: COUNTS.compiled(*code[:2], tmp_path_factory.mktemp("cuda"), ptx=code[2]))


@REALS
def test_kernels_compile_for_cuda(real, compiled):
    for make, more in ((step_kernels, sparse_grid_kernels), (fused_kernels, None), (order_kernels, None)):
        kernels = vars(make(real)) | (vars(more(real)) if more else {})
        names = {name for name, kernel in kernels.items() if isinstance(kernel, wp.Kernel)}
        (module,) = {kernels[name].module for name in names}
        ptx = compiled(module, 80, True).read_text()
        for name in names:
            assert f"{name}_" in ptx, name
        assert ptx.count(".visible .entry") >= len(names) >= 3


# Of a thread. Sums over 27 nodes: of four numbers each (mass, momentum, force, m theta) twice where points are added to
# the nodes, of four in the second mapping (by three threads of four) and of one for the volume. Beside them the
# ledgers' rows, four greatest speeds and the faults. From sm_90 on four float32 take one reduction.
WATCHED = {"float32": {"atom.max.u32": 4, "atom.max.s32": 2}, "float64": {"atom.max.u64": 4, "atom.max.s32": 2}}
REDUCTIONS = {
    ("float32", 80): {
        "update_nodes": {"atom.f64": 2},
        "g2p2g": {"red.f32": 108, "atom.f64": 1} | WATCHED["float32"],
        "strain_to_nodes": {"red.f32": 27, "atom.max.s32": 1},
        "stress_to_nodes": {"red.f32": 216, "atom.f64": 1},
    },
    ("float32", 90): {
        "update_nodes": {"atom.f64": 2},
        "g2p2g": {"red.v4.f32": 27, "atom.f64": 1} | WATCHED["float32"],
        "strain_to_nodes": {"red.f32": 27, "atom.max.s32": 1},
        "stress_to_nodes": {"red.v4.f32": 54, "atom.f64": 1},
    },
    ("float64", 90): {
        "update_nodes": {"atom.f64": 2},
        "g2p2g": {"red.f64": 108, "atom.f64": 1} | WATCHED["float64"],
        "strain_to_nodes": {"red.f64": 27, "atom.max.s32": 1},
        "stress_to_nodes": {"red.f64": 216, "atom.f64": 1},
    },
}


@pytest.mark.parametrize(("name", "arch"), REDUCTIONS)
def test_a_step_s_reductions_are_those_designed(name, arch, compiled):
    kernels = COUNTS.step_of(getattr(wp, name))
    ptx = compiled(kernels[0].module, arch, True).read_text()
    counted = {COUNTS.name_of(kernel): COUNTS.reductions(COUNTS.ptx_of(kernel, ptx)) for kernel in kernels}
    assert counted == REDUCTIONS[name, arch]


@REALS
@pytest.mark.parametrize("arch", [80, 90, 120])
def test_a_step_s_machine_code_has_no_local_memory(real, arch, compiled):
    kernels = COUNTS.step_of(real)
    cubin = compiled(kernels[0].module, arch, False)
    if COUNTS.cuobjdump() is None:
        pytest.skip("compiled, but no cuobjdump to read it: pip install nvidia-cuda-cuobjdump")
    for kernel, (registers, local) in zip(kernels, COUNTS.resources(kernels, cubin), strict=True):
        assert local == 0, kernel.key
        assert 0 < registers <= MOST_REGISTERS, kernel.key
