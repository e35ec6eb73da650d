"""Energies of points and grid at one instant."""

import functools
from types import SimpleNamespace

import warp as wp

from explicit.kernels.layout import E_ELASTIC, KE_GRID, KE_POINTS, layout
from mpm.drucker_prager import drucker_prager


@functools.cache
def energy_kernels(real):
    """Return the kernels for `real` (wp.float32 or wp.float64)."""
    types = layout(real)
    name = types.name
    vec4 = types.vec4
    vec6 = types.vec6
    Setup = types.Setup
    Points = types.Points
    float64 = wp.float64
    law = drucker_prager(real)
    Material, second_invariant = law.Material, law.second_invariant
    zero, one, half, three = (wp.constant(real(value)) for value in (0.0, 1.0, 0.5, 3.0))

    @wp.kernel(module=name)
    def point_energy(
        setup: Setup,
        material: Material,
        points: Points,
        energy: wp.array2d(dtype=float64),
    ):
        """Kinetic energy of the points and elastic energy tau_m^2/(2K) + J2/(2G) per initial volume."""
        p = wp.tid()
        s = points.tau[p]
        mean = (s[0] + s[1] + s[2]) / three
        j2 = second_invariant(s - mean * vec6(one, one, one, zero, zero, zero))
        v = points.v[p]
        elastic = half * (mean * mean / material.bulk + j2 / material.shear) * setup.volume
        wp.atomic_add(energy, KE_POINTS, p % energy.shape[1], float64(half * setup.mass * wp.dot(v, v)))
        wp.atomic_add(energy, E_ELASTIC, p % energy.shape[1], float64(elastic))

    @wp.kernel(module=name)
    def grid_energy(
        node_velocity: wp.array(dtype=vec4),
        node_mapped: wp.array(dtype=vec4),
        counted: wp.array(dtype=wp.int32),
        energy: wp.array2d(dtype=float64),
    ):
        """Kinetic energy of the grid with the velocities of the second mapping."""
        n = wp.tid()
        if counted.shape[0] > 0:  # noqa: SIM102 (Warp would read counted[n] all the same)
            if counted[n] == 0:
                return
        v = node_mapped[n]
        wp.atomic_add(energy, KE_GRID, n % energy.shape[1], float64(half * node_velocity[n][0] * wp.dot(v, v)))

    return SimpleNamespace(
        point_energy=point_energy,
        grid_energy=grid_energy,
    )
