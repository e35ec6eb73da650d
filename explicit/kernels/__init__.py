"""Warp kernels of the explicit step, one file per idea; `step_kernels(real)` gathers them for a solver."""

import functools

from explicit.kernels.clock import clock_kernels
from explicit.kernels.energy import energy_kernels
from explicit.kernels.grid import grid_kernels
from explicit.kernels.layout import layout as shared_layout  # not to hide the module of that name
from explicit.kernels.stress import stress_kernels
from explicit.kernels.transfer import transfer_kernels
from mpm.drucker_prager import drucker_prager


class StepKernels:
    """Kernels, types and structs of the step for `real` (wp.float32 or wp.float64)."""

    def __init__(self, real):
        types = shared_layout(real)
        self.vec3, self.vec4, self.vec6 = types.vec3, types.vec4, types.vec6
        self.Points, self.Pencils, self.LawState = types.Points, types.Pencils, types.LawState
        self.Walls, self.Setup = types.Walls, types.Setup
        self.pack_material = drucker_prager(real).pack
        clock = clock_kernels(real)
        self.set_target = clock.set_target
        self.begin_step = clock.begin_step
        grid = grid_kernels(real)
        self.clear_grid = grid.clear_grid
        self.update_grid = grid.update_grid
        self.hold_walls = grid.hold_walls
        transfer = transfer_kernels(real)
        self.p2g = transfer.p2g
        self.g2p2g = transfer.g2p2g
        stress = stress_kernels(real)
        self.strain_points = stress.strain_points
        self.apply_node_law = stress.apply_node_law
        self.update_stress = stress.update_stress
        energy = energy_kernels(real)
        self.point_energy = energy.point_energy
        self.grid_energy = energy.grid_energy


step_kernels = functools.cache(StepKernels)  # a solver's kernels are compiled once for each `real`
