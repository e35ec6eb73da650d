"""Warp started quietly, once, how its kernels are compiled, and devices found by name."""

import os
from contextlib import contextmanager

import warp as wp

from mpm.caches import prepare_caches
from mpm.errors import SceneError

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
    """The Warp device called `name` ("cpu", "cuda:0"). Raises SceneError that lists the devices there are."""
    start_warp()
    known = [device.alias for device in wp.get_devices()]
    if name not in known:
        raise SceneError(f"--device {name}: no such device; this machine has: {', '.join(known)}")
    return wp.get_device(name)
