"""Pseudo-time of a quasistatic collapse: what resists the increment, how long the next step is, when it is over.

A cohesionless column with a free face is in no equilibrium, so the collapse is followed. Each step finds the
increment u at which gravity, internal forces and a drag M u/dt^2 balance: u falls freely over dt where nothing
holds it. No momentum is carried over, so nothing overshoots. Two more terms make Newton's problem well posed: springs
between nodes that hardly any material touches and those behind them (ghost penalty), and a little viscous
overstress. All three act on the increment and vanish with it.
"""

import math
from dataclasses import dataclass

from mpm.body import Body
from mpm.runout import REST_WINDOW
from mpm.stiffness import STIFFEST, limit_both

GHOST_FADES = 0.5  # step in sqrt(cell/g) beyond which the ghost penalty falls: what it holds must come down in the end
# Out-of-balance over external force, below which the body may be at rest. A heap creeps on below it, ever more slowly,
# as it does in the explicit solver: at 8 cells per r0, lambda0 = 0.5, R_995 = 0.313, 0.325, 0.346, 0.350 at 1e-2, 5e-3,
# 2e-3, 1e-3 (benchmarks/results/implicit_creep_cpu.csv). At 5e-3 it moves by less than 0.5 % in 4 sqrt(h0/g).
REST_UNBALANCED = 5e-3
REST_DRIFT = 1.5e-3  # advance of R_995 over REST_WINDOW of pseudo-time, over R_995 or LEAST_RUNOUT, likewise
LEAST_RUNOUT = 0.1  # for what hardly runs out
REST_STEPS = 3  # steps over which that advance is taken at least: steps may be longer than the window
FIRST = 0.3  # first step, in sqrt(cell/g)
SHORTEST = 1e-4  # step over its cap, below which a run that still fails is given up


@dataclass(frozen=True)
class Regularisation:
    """What makes the collapse computable; benchmarks/results/implicit_regularisation_cpu.csv says what it does to R.

    `drag` [-]: on M u/dt^2. `momentum` [-]: share of the velocity carried from step to step; 0 quasistatic, 1 full
    inertia. `ghost` [-]: face ghost penalty over rho g h0, in steps up to sqrt(cell/g)/2; in longer ones it falls as
    1/dt. `viscosity` [-]: overstress per plastic shear strain of a step, over rho g h0. `reach` [-]: distance in
    cells that all but 2 % of the points may go in a step. `cap` [-]: longest step, in sqrt(cell/g). `iterations` [-]:
    of Newton in a step; after fewer the next step is longer, after more it is shorter. `stiffest` [-]: Young's modulus
    over rho g h0 up to which a cohesionless material keeps its own moduli (see `mpm.stiffness`).
    """

    drag: float = 1.0
    momentum: float = 0.0
    ghost: float = 0.4
    viscosity: float = 0.1
    reach: float = 0.3
    cap: float = 12.0
    iterations: float = 6.0
    stiffest: float = STIFFEST

    def of_step(self, body: Body, dt: float) -> dict[str, float]:
        """Arguments of `System.set_regularisation` for a step of `dt` [s]."""
        cell, gravity = body.scene.grid.cell, body.scene.loads.gravity
        fading = min(1.0, GHOST_FADES * math.sqrt(cell / gravity) / dt)
        return {
            "drag": self.drag,
            # gamma h/3 times the square of the jump, integrated over the faces around a node, h^2 in all
            "ghost": self.ghost * fading * body.overburden * cell / 3.0,
            "viscous": self.viscosity * body.overburden / body.constants.shear,
            "dt": dt,
            "momentum": self.momentum,
        }

    def limit_stiffness(self, body: Body) -> Body:
        """The body as its collapse is followed (see `mpm.stiffness`); in load steps it keeps its moduli."""
        return limit_both(body, self.stiffest) if body.scene.loads.initial_stress != "none" else body


class StepLength:
    """Length `dt` [s] of the next step, steered by how far points moved and what Newton needed."""

    def __init__(self, regularisation: Regularisation, cell: float, gravity: float):
        self.longest = regularisation.cap * math.sqrt(cell / gravity)
        self.reach = regularisation.reach * cell
        self.wanted_iterations = regularisation.iterations
        self.dt = min(FIRST * math.sqrt(cell / gravity), self.longest)

    def accepted(self, moved: float, iterations: int):
        """A step succeeded in which points moved `moved` [m] (a high quantile)."""
        growth = min(max(math.sqrt(self.wanted_iterations / max(iterations, 1)), 0.7), 1.5)
        wanted = self.reach / moved if moved > 0 else growth
        self.dt = min(self.dt * min(max(wanted, 0.5), growth), self.longest)

    def failed(self) -> bool:
        """Halve a step that Newton could not solve; False where it is the shortest already."""
        self.dt *= 0.5
        return self.dt > SHORTEST * self.longest


class Rest:
    """Judges rest from the (time, R_995) of the steps so far."""

    def __init__(self, time_scale: float):
        """`time_scale` [s]: sqrt(h0/g)."""
        self.window = REST_WINDOW * time_scale
        self.recent: list[tuple[float, float]] = []

    def __call__(self, time: float, runout: float, unbalanced: float) -> bool:
        """Whether the body rests at `time` [s]: forces balance, and the front (R_995 = `runout`) has stopped."""
        self.recent.append((time, runout))
        while len(self.recent) > REST_STEPS + 1 and self.recent[1][0] <= time - self.window:
            self.recent.pop(0)
        since, earlier = self.recent[0]
        if len(self.recent) <= REST_STEPS or time - since < self.window or unbalanced > REST_UNBALANCED:
            return False
        return abs(runout - earlier) / (time - since) * self.window < REST_DRIFT * max(runout, LEAST_RUNOUT)
