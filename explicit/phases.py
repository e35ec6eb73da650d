"""The explicit step as its phases in order: what a CPU, a rank or a run that smooths the volume strain launches."""

import itertools
import time
from collections import defaultdict
from typing import NamedTuple

import numpy as np
import warp as wp

from explicit.kernels.ripples import ripple_kernels


class Phase(NamedTuple):
    """A launch of the step, none where nothing takes part; `summed`: the node arrays that points add to in it."""

    command: wp.Launch | None
    summed: tuple[wp.array, ...]

    def launch(self):
        if self.command:
            self.command.launch()


def phases_of(solver) -> list[Phase]:
    """The phases of `solver` (an `ExplicitSolver`), ready to be repeated for as long as its arrays are the same."""
    s, k, n, nodes = solver, solver.k, solver.points, solver.grid.capacity
    setup, walls, material, clock, pencil_of = s.setup, s.walls, s.material, s.clock, s.grid.pencil_of
    momentum, force, mapped, dilation = s.node_momentum, s.node_force, s.node_mapped, s.node_dilation
    ledger, speed, fault = s.ledger, s.speed, s.fault
    where, law = (setup, s.pencils, clock, s.arrays), (setup, material, s.pencils, clock, s.arrays)
    at_nodes = (walls, s.pencils, clock, pencil_of, momentum)

    def phase(kernel, dim, inputs, *summed):
        command = wp.launch(kernel, dim, inputs=list(inputs), device=s.device, record_cmd=True) if dim > 0 else None
        return Phase(command, summed)

    smoothing = []
    if s.ripple_share < 1.0:
        ripples, sums = ripple_kernels(s.real), [dilation, *s.node_smoothed]
        smoothing = [
            phase(ripples.average_dilation, n, (*where, momentum, before, after), after)
            for before, after in itertools.pairwise(sums)
        ]
        smoothing.append(phase(ripples.blend_dilation, nodes, (clock, s.real(s.ripple_share), *sums)))
    return [
        phase(k.begin_step, 1, (setup, clock, speed, fault, s.plan)),
        phase(k.clear_grid, nodes, (clock, momentum, force, mapped, dilation)),
        phase(k.p2g, n, (*where, momentum, force), momentum, force),
        phase(k.update_grid, nodes, (setup, *at_nodes, force, s.counted, ledger)),
        phase(k.g2p2g, n, (*where, momentum, force, mapped, ledger, speed, fault), mapped),
        phase(k.hold_walls, nodes, (*at_nodes, mapped)),
        phase(k.strain_points, n, (*law, mapped, dilation, fault), dilation),
        *smoothing,
        phase(k.apply_node_law, nodes, (material, clock, momentum, dilation, force)),
        phase(k.update_stress, n, (*law, force, ledger)),
    ]


def time_phases(solver, steps: int) -> dict[str, float]:
    """Take `steps` steps phase by phase: median seconds of each phase."""
    seconds = defaultdict(list)
    for _ in range(steps):
        solver.fit_grid()
        if solver.fused:
            solver.fused_step.start()
        for number, command in enumerate(_commands(solver)):
            wp.synchronize_device(solver.device)
            start = time.perf_counter()
            command.launch()
            wp.synchronize_device(solver.device)
            seconds[number].append(time.perf_counter() - start)
        if solver.fused:
            solver.fused_step.finish()
        solver.dials.forget()
    solver.check()
    medians: dict[str, float] = defaultdict(float)
    for number, command in enumerate(_commands(solver)):
        medians[command.kernel.key.rpartition("__")[2]] += float(np.median(seconds[number]))
    return dict(medians)


def _commands(solver) -> list[wp.Launch]:
    return solver.fused_step.phases if solver.fused else [phase.command for phase in solver.phases if phase.command]
