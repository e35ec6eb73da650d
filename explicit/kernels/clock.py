"""The time step on the device: its length, the target time, and what stops a batch early."""

import functools
from types import SimpleNamespace

import warp as wp

from explicit.kernels.layout import (
    CARRIED,
    DT,
    GRAVITY,
    INVERTED,
    NOT_FINITE,
    OFF_GRID,
    OVER_LIMIT,
    STEPS,
    TARGET,
    TIME,
    TOO_FAST,
    TRAVEL,
    layout,
)


@functools.cache
def clock_kernels(real):
    """Return the kernels for `real` (wp.float32 or wp.float64)."""
    types = layout(real)
    name = types.name
    Setup = types.Setup
    float64 = wp.float64
    zero = wp.constant(real(0.0))

    @wp.kernel(module=name)
    def set_target(clock: wp.array(dtype=float64), target: float64):
        """Aim at time `target` [s]: the step that would pass it is shortened to meet it."""
        clock[TARGET] = target

    @wp.kernel(module=name)
    def reset_travel(clock: wp.array(dtype=float64)):
        """The stored nodes fit the points as they are now."""
        clock[TRAVEL] = float64(0.0)
        clock[DT] = float64(0.0)

    @wp.kernel(module=name)
    def begin_step(
        setup: Setup,
        clock: wp.array(dtype=float64),
        speed: wp.array(dtype=real),
        fault: wp.array(dtype=wp.int32),
    ):
        clock[TRAVEL] = clock[TRAVEL] + float64(speed[CARRIED]) * clock[DT]
        cell = float64(setup.cell)
        limit = cell / (setup.wave + float64(wp.max(wp.max(speed[0], speed[1]), speed[2])))
        dt = setup.fixed_dt
        if dt == float64(0.0):
            dt = setup.cfl * limit
        if dt > limit:
            fault[OVER_LIMIT] = 1
        time = clock[TIME]
        left = wp.max(clock[TARGET] - time, float64(0.0))
        finished = time + dt * float64(1.0 + 1.0e-6) >= clock[TARGET]
        if finished:
            dt = left
        faults = fault[NOT_FINITE] + fault[TOO_FAST] + fault[INVERTED] + fault[OFF_GRID] + fault[OVER_LIMIT]
        if clock[TRAVEL] > setup.margin or faults > 0:
            dt = float64(0.0)
        if dt > float64(0.0):
            g = setup.gravity
            if time < setup.ramp:
                g = g * time / setup.ramp
            clock[GRAVITY] = g
            clock[TIME] = time + dt
            if finished:
                clock[TIME] = clock[TARGET]
            clock[STEPS] = clock[STEPS] + float64(1.0)
            for axis in range(4):
                speed[axis] = zero
        clock[DT] = dt

    return SimpleNamespace(
        set_target=set_target,
        reset_travel=reset_travel,
        begin_step=begin_step,
    )
