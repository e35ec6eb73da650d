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
    OUT_OF_NODES,
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

    @wp.func(module=name)
    def goes_on(
        setup: Setup,
        clock: wp.array(dtype=float64),
        speed: wp.array(dtype=real),
        fault: wp.array(dtype=wp.int32),
    ):
        """1 where the stored nodes still serve the points after the step that `clock` is at, and none is at fault."""
        travel = clock[TRAVEL] + float64(speed[CARRIED]) * clock[DT]
        if travel > setup.margin or fault[NOT_FINITE] + fault[TOO_FAST] + fault[INVERTED] + fault[OFF_GRID] > 0:
            return 0
        return 1

    @wp.func(module=name)
    def fit_due(
        setup: Setup,
        clock: wp.array(dtype=float64),
        until: float64,
        speed: wp.array(dtype=real),
        fault: wp.array(dtype=wp.int32),
    ):
        """1 where the stored nodes must follow the points, which have used up half of their margin, before more steps
        are taken; not where none will be, nor where the host must make room first."""
        travel = clock[TRAVEL] + float64(speed[CARRIED]) * clock[DT]
        if travel <= float64(0.5) * setup.margin or travel >= float64(OUT_OF_NODES):
            return 0
        at_fault = fault[NOT_FINITE] + fault[TOO_FAST] + fault[INVERTED] + fault[OFF_GRID] + fault[OVER_LIMIT] > 0
        if at_fault or clock[TIME] >= wp.min(until, clock[TARGET]):
            return 0
        return 1

    @wp.func(module=name)
    def plan_step(
        setup: Setup,
        clock: wp.array(dtype=float64),
        until: float64,
        speed: wp.array(dtype=real),
        fault: wp.array(dtype=wp.int32),
        plan: wp.array(dtype=float64),
    ):
        """Work out what `clock` will be in the next step, under its names, in `plan`; there is none from the time
        `until` [s] on."""
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
        if time >= until or goes_on(setup, clock, speed, fault) == 0 or fault[OVER_LIMIT] > 0:
            dt = float64(0.0)
        plan[TRAVEL] = clock[TRAVEL] + float64(speed[CARRIED]) * clock[DT]
        plan[TIME] = time
        plan[STEPS] = clock[STEPS]
        plan[GRAVITY] = clock[GRAVITY]
        plan[DT] = dt
        if dt > float64(0.0):
            g = setup.gravity
            if time < setup.ramp:
                g = g * time / setup.ramp
            plan[GRAVITY] = g
            plan[TIME] = time + dt
            if finished:
                plan[TIME] = clock[TARGET]
            plan[STEPS] = clock[STEPS] + float64(1.0)

    @wp.func(module=name)
    def follow_plan(plan: wp.array(dtype=float64), clock: wp.array(dtype=float64), speed: wp.array(dtype=real)):
        """Start the step that was planned, if it has a length; what was planned once may be followed twice."""
        clock[TRAVEL] = plan[TRAVEL]
        clock[TIME] = plan[TIME]
        clock[STEPS] = plan[STEPS]
        clock[GRAVITY] = plan[GRAVITY]
        clock[DT] = plan[DT]
        if plan[DT] > float64(0.0):
            for axis in range(4):
                speed[axis] = zero

    @wp.kernel(module=name)
    def begin_step(
        setup: Setup,
        clock: wp.array(dtype=float64),
        speed: wp.array(dtype=real),
        fault: wp.array(dtype=wp.int32),
        plan: wp.array(dtype=float64),
    ):
        plan_step(setup, clock, clock[TARGET], speed, fault, plan)
        follow_plan(plan, clock, speed)

    return SimpleNamespace(
        set_target=set_target,
        begin_step=begin_step,
        goes_on=goes_on,
        fit_due=fit_due,
        plan_step=plan_step,
        follow_plan=follow_plan,
    )
