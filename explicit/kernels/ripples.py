"""Smoothing of the nodes' volume strain increments, where K is many times G (`mpm.stiffness.ripple_share`)."""

import functools
from types import SimpleNamespace

import warp as wp

from explicit.kernels.layout import DT, layout
from mpm.devices import KERNEL_OPTIONS
from mpm.gimp import gimp


@functools.cache
def ripple_kernels(real):
    """Return the kernels for `real` (wp.float32 or wp.float64).

    They are in a Warp module of their own, which other scenes do not compile.
    """
    types = layout(real)
    name = f"repose_ripples_{real.__name__}"
    wp.set_module_options(KERNEL_OPTIONS, module=wp.get_module(name))
    vec4, Points, Pencils, Setup = types.vec4, types.Points, types.Pencils, types.Setup
    node_of, stencil = types.node_of, gimp(real).stencil
    float64 = wp.float64
    zero, one = wp.constant(real(0.0)), wp.constant(real(1.0))

    @wp.kernel(module=name)
    def average_dilation(
        setup: Setup,
        pencils: Pencils,
        clock: wp.array(dtype=float64),
        points: Points,
        node_velocity: wp.array(dtype=vec4),
        node_dilation: wp.array(dtype=real),
        node_average: wp.array(dtype=real),
    ):
        """What points read of the nodes' averages, back to the nodes: both arrays are sums of mass times volume strain,
        `node_velocity` holds (m, v)."""
        if clock[DT] == float64(0.0):
            return
        p = wp.tid()
        i, j, k, sx, sy, sz, _dx, _dy, _dz = stencil(points.x[p], setup.inv_cell)
        read = zero
        for a in range(3):
            for b in range(3):
                n = node_of(pencils, i + a, j + b, k)
                for c in range(3):
                    m = node_velocity[n + c][0]
                    if m > zero:
                        read += sx[a] * sy[b] * sz[c] * node_dilation[n + c] / m
        # As in `strain_points`: one function for both made that 1.45 times as slow (25,120 points, float64, AMD EPYC).
        for a in range(3):
            for b in range(3):
                wxy = sx[a] * sy[b]
                if wxy > zero:
                    n = node_of(pencils, i + a, j + b, k)
                    for c in range(3):
                        wp.atomic_add(node_average, n + c, setup.mass * read * wxy * sz[c])

    @wp.kernel(module=name)
    def blend_dilation(
        clock: wp.array(dtype=float64),
        share: real,
        node_dilation: wp.array(dtype=real),
        node_once: wp.array(dtype=real),
        node_twice: wp.array(dtype=real),
    ):
        """Take the `share` [-] of a node's own volume strain and the rest of what was averaged twice; clear both."""
        if clock[DT] == float64(0.0):
            return
        n = wp.tid()
        node_dilation[n] = share * node_dilation[n] + (one - share) * node_twice[n]
        node_once[n] = zero
        node_twice[n] = zero

    return SimpleNamespace(average_dilation=average_dilation, blend_dilation=blend_dilation)
