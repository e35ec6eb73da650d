"""A history row's look at the points on the device they are on: what the host reads does not grow with them."""

import numpy as np
import warp as wp

from explicit.kernels.layout import VOLUME
from explicit.kernels.look import DISTANCES, SIDES, look_kernels
from mpm.reductions import between, place_of
from mpm.runout import QUANTILE, front_of
from mpm.watch import Look, beyond_walls, farthest_of


class DeviceLook:
    """What `mpm.watch.look` finds of a solver's points, written to `looked` (LOOK_SIZE,) and to `solver.energy`.

    It keeps room for a sort of the points by their distance: twice a key and a number each.
    """

    def __init__(self, solver, looked: wp.array):
        self.solver, self.looked, self.k = solver, looked, look_kernels(solver.real)
        self.place, (below, above) = place_of(QUANTILE, solver.points)
        self.places = wp.vec3i(below, above, solver.points - 1)
        measure = solver.body.measure
        self.axis, self.plane = wp.vec2d(*measure.axis), int(len(measure.axes) == 1)
        start = solver.theta_start if solver.theta_start.any() else []
        self.theta_start = wp.array(start, dtype=solver.real, device=solver.device)
        self.keys = solver._zeros(2 * solver.points, solver.real)
        self.order = solver._zeros(2 * solver.points, wp.int32)
        self.extreme, self.first = solver._zeros(SIDES, solver.real), solver._zeros(SIDES, wp.int32)

    @property
    def arrays(self) -> list[wp.array]:
        """Arrays that grow with the points."""
        return [self.theta_start, self.keys, self.order]

    def launch(self):
        """Look; the row VOLUME of `solver.energy` must be clean."""
        s, k, x, n = self.solver, self.k, self.solver.x, self.solver.points
        seen_from, reach = (self.axis, self.plane), (self.extreme, self.first)
        self._launch(k.start_look, SIDES, x, *reach)
        self._launch(
            k.look_at_points, n, *seen_from, s.arrays, self.theta_start, self.keys, self.order, self.extreme, s.energy
        )
        self._launch(k.find_first, n, x, *reach)
        wp.utils.radix_sort_pairs(self.keys, self.order, n)
        self._launch(k.write_look, 1, *seen_from, self.places, x, self.order, self.first, self.looked)

    def _launch(self, kernel, dim, *inputs):
        wp.launch(kernel, dim, inputs=inputs, device=self.solver.device)

    def of(self, energy: np.ndarray, looked: np.ndarray) -> Look:
        """The look that the device wrote to `energy` (ENERGY_ROWS,), its columns added up, and `looked`."""
        solver, body = self.solver, self.solver.body
        below, above, farthest = looked[:DISTANCES]
        extreme, x = looked[DISTANCES : DISTANCES + SIDES].astype(int), looked[DISTANCES + SIDES :].reshape(SIDES, 3)
        x = x.astype(wp.dtype_to_numpy(solver.real))
        front = front_of(farthest, between(below, above, self.place), float(x[-1, 2]), body.measure)
        beyond = farthest_of(beyond_walls(extreme, x, body))
        return Look(front, float(energy[VOLUME] / solver.points), beyond)
