"""Warp kernels of the explicit step, one file per idea; `step_kernels(real)` gathers them for a solver."""

import functools
from types import SimpleNamespace

from explicit.kernels.clock import clock_kernels
from explicit.kernels.energy import energy_kernels
from explicit.kernels.grid import grid_kernels
from explicit.kernels.layout import layout as shared_layout
from explicit.kernels.stress import stress_kernels
from explicit.kernels.transfer import transfer_kernels
from mpm.drucker_prager import drucker_prager


@functools.cache
def step_kernels(real):
    """Kernels, types and structs of the step for `real` (wp.float32 or wp.float64), in one namespace."""
    factories = (clock_kernels, transfer_kernels, grid_kernels, stress_kernels, energy_kernels)
    parts = [vars(factory(real)) for factory in factories]
    merged = {key: value for part in parts for key, value in part.items()}
    return SimpleNamespace(**vars(shared_layout(real)), **merged, pack_material=drucker_prager(real).pack)
