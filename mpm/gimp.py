"""uGIMP basis (undeformed generalised interpolation), the one place it is written.

A point carries a fixed half-length l = h/4 (two points per cell and axis). Its weight at a node is the
mean of the linear hat over [x - l, x + l], and the weight's gradient the mean of the hat's slope. The
domain is shorter than a cell, so at most three nodes per axis see it: base, base + 1 and base + 2 with
base = floor((x - l) / h).

Written per axis from the lengths a0, a1 of the domain that lie in cells base and base + 1, the sums are
exact by construction (weights to one, slopes to zero), on faces too, and no branch is taken. The values
are those of the usual piecewise form (Wyser et al. 2023, uGIMP; Bardenhagen and Kober 2004).
"""

import functools
from types import SimpleNamespace

import warp as wp

NODES_PER_AXIS = 3
HALF_LENGTH_IN_CELLS = 0.25


@functools.cache
def gimp(real):
    """Return the basis as Warp functions for `real` (wp.float32 or wp.float64).

    Members: `base(x, inv_h)` -> int, first node of the stencil on one axis;
    `weights(x, inv_h, base)` -> (S, dS): vec3 of weights [-] and vec3 of slopes [1/m] of nodes base..base+2;
    `stencil(x, inv_h)` -> (i, j, k, Sx, Sy, Sz, dSx, dSy, dSz): both for a point, axis by axis;
    `reached(S)` -> int: how many of an axis' three nodes have a weight, 2 where the domain ends before the third.
    `x` is a coordinate or position [m] measured from the lattice's origin, `inv_h` = 1/h [1/m].
    """
    vec3 = wp.types.vector(3, real)
    half_length = wp.constant(real(HALF_LENGTH_IN_CELLS))
    length = wp.constant(real(2.0 * HALF_LENGTH_IN_CELLS))
    inv_length = wp.constant(real(0.5 / HALF_LENGTH_IN_CELLS))
    half = wp.constant(real(0.5))
    one = wp.constant(real(1.0))
    zero = wp.constant(real(0.0))
    name = f"repose_{real.__name__}"

    @wp.func(module=name)
    def base(x: real, inv_h: real):
        return int(wp.floor(x * inv_h - half_length))

    @wp.func(module=name)
    def weights(x: real, inv_h: real, first: int):
        start = x * inv_h - half_length - real(first)  # domain start in cells after node `first`, in [0, 1)
        a0 = wp.min(one - start, length)
        a1 = length - a0
        mid0 = start + half * a0
        mid1 = half * a1
        f0 = a0 * inv_length
        f1 = a1 * inv_length
        s = vec3(f0 * (one - mid0), f0 * mid0 + f1 * (one - mid1), f1 * mid1)
        ds = vec3(-f0 * inv_h, (f0 - f1) * inv_h, f1 * inv_h)
        return s, ds

    @wp.func(module=name)
    def stencil(x: vec3, inv_h: real):
        i = base(x[0], inv_h)
        j = base(x[1], inv_h)
        k = base(x[2], inv_h)
        sx, dx = weights(x[0], inv_h, i)
        sy, dy = weights(x[1], inv_h, j)
        sz, dz = weights(x[2], inv_h, k)
        return i, j, k, sx, sy, sz, dx, dy, dz

    @wp.func(module=name)
    def reached(s: vec3):
        if s[2] > zero:
            return 3
        return 2

    return SimpleNamespace(base=base, weights=weights, stencil=stencil, reached=reached)
