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
from explicit.kernels.halo import halo_kernels
from explicit.kernels.look import look_kernels
from explicit.kernels.order import order_kernels
from explicit.kernels.ripples import ripple_kernels
from explicit.kernels.sparse_grid import sparse_grid_kernels
from mpm.devices import start_warp

start_warp()
COUNTS = SimpleNamespace(**runpy.run_path(Path(__file__).parents[2] / "benchmarks" / "gpu_counts.py"))
REALS = pytest.mark.parametrize("real", [wp.float32, wp.float64])
MOST_REGISTERS = 168  # three blocks of 128 threads to a multiprocessor
# Bytes a block: of the 100 KB that a multiprocessor of sm_120 has (sm_80: 164, sm_90: 228), six blocks' and two.
MOST_SHARED = {wp.float32: 17408, wp.float64: 34816}


@pytest.fixture(autouse=True)
def blocks(monkeypatch):
    """A step is put together on a CPU, whose kernels are built for blocks of 32 fibers."""
    monkeypatch.setattr(wp.config, "enable_cpu_blocks", True)


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    """`compiled(module, arch, ptx)`: where the module's code is; made once."""
    return functools.cache(lambda *code: COUNTS.compiled(*code[:2], tmp_path_factory.mktemp("cuda"), ptx=code[2]))


@REALS
def test_kernels_compile_for_cuda(real, compiled):
    alone = ((make, None) for make in (fused_kernels, halo_kernels, look_kernels, order_kernels, ripple_kernels))
    for make, more in ((step_kernels, sparse_grid_kernels), *alone):
        kernels = vars(make(real)) | (vars(more(real)) if more else {})
        names = {name for name, kernel in kernels.items() if isinstance(kernel, wp.Kernel)}
        (module,) = {kernels[name].module for name in names}
        ptx = compiled(module, 80, True).read_text()
        for name in names:
            assert f"{name}_" in ptx, name
        assert ptx.count(".visible .entry") >= len(names) >= 2


# Of a lane, which adds to one node for a group of points: four numbers (mass and momentum; force and m theta; momentum
# of the second mapping), one after the other but for float32 from sm_90 on, or one number, the volume. Beside them the
# ledgers' rows, four greatest speeds and the faults.
WATCHED = {"float32": {"atom.max.u32": 4, "atom.max.s32": 2}, "float64": {"atom.max.u64": 4, "atom.max.s32": 2}}
REDUCTIONS = {
    ("float32", 80): {
        "update_nodes": {"atom.f64": 2},
        "g2p2g": {"red.f32": 4, "atom.f64": 1} | WATCHED["float32"],
        "strain_to_nodes": {"red.f32": 1, "atom.max.s32": 1},
        "stress_to_nodes": {"red.f32": 8, "atom.f64": 1},
    },
    ("float32", 90): {
        "update_nodes": {"atom.f64": 2},
        "g2p2g": {"red.v4.f32": 1, "atom.f64": 1} | WATCHED["float32"],
        "strain_to_nodes": {"red.f32": 1, "atom.max.s32": 1},
        "stress_to_nodes": {"red.v4.f32": 2, "atom.f64": 1},
    },
    ("float64", 90): {
        "update_nodes": {"atom.f64": 2},
        "g2p2g": {"red.f64": 4, "atom.f64": 1} | WATCHED["float64"],
        "strain_to_nodes": {"red.f64": 1, "atom.max.s32": 1},
        "stress_to_nodes": {"red.f64": 8, "atom.f64": 1},
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
    for kernel, (registers, local, shared) in zip(kernels, COUNTS.resources(kernels, cubin), strict=True):
        assert local == 0, kernel.key
        assert 0 < registers <= MOST_REGISTERS, kernel.key
        assert shared <= MOST_SHARED[real], kernel.key
