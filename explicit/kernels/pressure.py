"""Optional cell averaging of pressure: each point takes its cell's volume-weighted mean stress."""

import functools
from types import SimpleNamespace

import warp as wp

from explicit.kernels.layout import DT, layout


@functools.cache
def pressure_kernels(real):
    """Return the kernels for `real` (wp.float32 or wp.float64)."""
    types = layout(real)
    name = types.name
    vec2 = types.vec2
    vec3 = types.vec3
    vec6 = types.vec6
    Pencils = types.Pencils
    Setup = types.Setup
    float64 = wp.float64
    zero, three = wp.constant(real(0.0)), wp.constant(real(3.0))

    @wp.kernel(module=name)
    def clear_cells(clock: wp.array(dtype=float64), cell_mean: wp.array(dtype=vec2)):
        if clock[DT] == float64(0.0):
            return
        cell_mean[wp.tid()] = vec2(zero, zero)

    @wp.func(module=name)
    def cell_index(setup: Setup, pencils: Pencils, x: vec3):
        """Stored index of the lowest node of the cell that holds `x`."""
        i = int(wp.floor(x[0] * setup.inv_cell))
        j = int(wp.floor(x[1] * setup.inv_cell))
        return pencils.base[i - pencils.i0, j - pencils.j0] + int(wp.floor(x[2] * setup.inv_cell))

    @wp.func(module=name)
    def is_open(opening: wp.array(dtype=real), p: int):
        """Open points bear no pressure: lent some, they would close without moving."""
        if opening.shape[0] == 0:
            return False
        return opening[p] > zero

    @wp.kernel(module=name)
    def gather_cell_pressure(
        setup: Setup,
        pencils: Pencils,
        clock: wp.array(dtype=float64),
        x: wp.array(dtype=vec3),
        sigma: wp.array(dtype=vec6),
        volume: wp.array(dtype=real),
        opening: wp.array(dtype=real),
        cell_mean: wp.array(dtype=vec2),
    ):
        """Volume and volume-weighted mean stress of each cell (indexed by its lowest node)."""
        if clock[DT] == float64(0.0):
            return
        p = wp.tid()
        if is_open(opening, p):
            return
        n = cell_index(setup, pencils, x[p])
        s = sigma[p]
        vol = volume[p]
        wp.atomic_add(cell_mean, n, vec2(vol, vol * (s[0] + s[1] + s[2]) / three))

    @wp.kernel(module=name)
    def spread_cell_pressure(
        setup: Setup,
        pencils: Pencils,
        clock: wp.array(dtype=float64),
        x: wp.array(dtype=vec3),
        sigma: wp.array(dtype=vec6),
        opening: wp.array(dtype=real),
        cell_mean: wp.array(dtype=vec2),
    ):
        """Each point takes its cell's mean stress; the deviator stays its own."""
        if clock[DT] == float64(0.0):
            return
        p = wp.tid()
        if is_open(opening, p):
            return
        n = cell_index(setup, pencils, x[p])
        s = sigma[p]
        shift = cell_mean[n][1] / cell_mean[n][0] - (s[0] + s[1] + s[2]) / three
        sigma[p] = vec6(s[0] + shift, s[1] + shift, s[2] + shift, s[3], s[4], s[5])

    return SimpleNamespace(
        clear_cells=clear_cells,
        gather_cell_pressure=gather_cell_pressure,
        spread_cell_pressure=spread_cell_pressure,
    )
