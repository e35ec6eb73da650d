"""Warp started quietly, once, how its kernels are compiled, and devices found by name."""

import os
import platform
from contextlib import contextmanager

import warp as wp

from mpm.caches import prepare_caches
from mpm.errors import SceneError
from mpm.ranks import GPUS, too_few_gpus

# Of every module of kernels. Warp's default CPU flags cap SLP vectorisation, which costs the explicit step a fifth of
# its throughput. Products and sums are fused: 4 to 8 % more (benchmarks/README.md).
KERNEL_OPTIONS = {"enable_backward": False, "cpu_compiler_flags": "-march=native -ffp-contract=fast"}
# Warp lets an index count from the end and looks at each for that; of one so masked the compiler sees that it does not.
NOT_NEGATIVE = wp.constant(2**31 - 1)


@contextmanager
def _stderr_hidden():
    """Send file descriptor 2 nowhere: Warp's native code writes a warning there when no CUDA driver is found."""
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def start_warp():
    """Initialise Warp, and return it, without its banner, compile messages or the remark that there is no GPU."""
    prepare_caches()
    wp.config.log_level = wp.LOG_ERROR
    with _stderr_hidden():
        wp.init()
    return wp


def find_device(name: str):
    """The Warp device called `name`: "cpu", "cuda:0", or "cuda", the first GPU.

    Raises SceneError that lists the devices there are.
    """
    start_warp()
    known = {device.alias: device for device in wp.get_devices()}
    if name == GPUS:
        name = next(iter(_gpus()), name)
    if name not in known:
        raise SceneError(f"--device {name}: no such device; this machine has: {', '.join(known)}")
    return known[name]


def device_of_rank(name: str, comm):
    """The Warp device that this one of the ranks of `comm`, which all call, has by the `name`: as `find_device`, but of
    "cuda" each rank of a host has a GPU of its own.

    Raises SceneError on all ranks where one has no such device or must share its GPU.
    """
    from mpi4py import MPI  # which only runs on several ranks load

    start_warp()
    device, problem = None, ""
    if name == GPUS:
        here = comm.Split_type(MPI.COMM_TYPE_SHARED)
        found = list(_gpus().values())
        device = found[here.rank % len(found)] if found else None
        # By their own names, as a launcher may have shown each rank but one GPU, whose number is 0 everywhere.
        taken = set(here.allgather(device.uuid if device else None)) - {None}
        if len(taken) < here.size:
            problem = too_few_gpus(here.size, len(taken), platform.node())
        here.Free()
    else:
        try:
            device = find_device(name)
        except SceneError as error:
            problem = f"{error} (rank {comm.rank})"
    for each in comm.allgather(problem):
        if each:
            raise SceneError(each)
    return device


def gpu_count() -> int:
    """How many GPUs this machine has for the explicit solver."""
    start_warp()
    return len(_gpus())


def _gpus() -> dict:
    """The GPUs, by Warp's alias."""
    return {device.alias: device for device in wp.get_devices() if device.is_cuda}
