"""The implicit solver: one step as its phases in order, load steps or steps of a collapse in pseudo-time."""

import numpy as np

from implicit._dolfinx import MPI
from implicit.kernels.layout import LAW
from implicit.mesh import BackgroundMesh
from implicit.newton import solve
from implicit.points import Basis, Points
from implicit.pseudo_time import Regularisation, StepLength
from implicit.system import REFUSED, System
from mpm.body import Body
from mpm.domains import Cut
from mpm.errors import NumericalError
from mpm.geostatic import geostatic_strain
from mpm.gimp import NODES_PER_AXIS
from mpm.reductions import quantile
from mpm.run import find_invalid
from mpm.watch import Look, look

MOVED_QUANTILE = 0.98  # of the points' displacement in a step: single grains in the air do not shorten it
# Residual over weight at which a step is solved: a hundredth of what it starts from, within these bounds. What is
# left is part of the next step's residual, so it does not add up.
LOOSEST, TIGHTEST, REDUCTION = 1e-3, 1e-5, 1e-2
# Of a linear solve, relative. With 2e-2 a collapse takes 7 % fewer Newton iterations and 40 % more sweeps.
LINEAR_TOLERANCE = 1e-1
# Share of the last step's increment, stretched to this one's length, from which Newton starts: what flows flows on.
# From u = 0 a collapse takes two to three times as many iterations (benchmarks/README.md).
GOES_ON = 0.7
STATIC_TOLERANCE = 1e-9  # likewise of a load step, where nothing corrects it afterwards
STATIC_LINEAR_TOLERANCE = 1e-6
STATIC_GHOST = 1e-4  # ghost springs of a load step, over G h
SMALLEST_LOAD_STEP = 1 / 64  # of the wanted one


class ImplicitSolver:
    """Points and background grid of one body.

    `material_points`: the points (`implicit.points.Points`). `background`: mesh and space in dolfinx. `system`: that of
    the last step. `time` [s]: pseudo-time; `steps`, `failed_steps`, `newton_iterations`, `linear_iterations` so far;
    `unbalanced_ratio`: norm of the out-of-balance over that of the external nodal forces. `node_place` (m, 3) int,
    `node_velocity` (m, 3) [m/s]: lattice indices of the nodes of the last step, and how fast each moved in it.
    """

    ids: np.ndarray | None = None  # numbers of the points in the whole body, where these are a part of it
    cut: Cut | int = 0  # of the plan
    NODAL = ("node_place", "node_velocity")
    COUNTERS = ("time", "steps", "failed_steps", "newton_iterations", "linear_iterations", "load_share")

    def __init__(self, body: Body, regularisation: Regularisation = Regularisation(), comm=MPI.COMM_SELF):
        """`body`: one that `mpm.precheck.refuse` lets pass."""
        scene = body.scene
        self.body = body = regularisation.limit_stiffness(body)
        self.regularisation = regularisation
        self.cell, self.gravity = scene.grid.cell, scene.loads.gravity
        self.points = len(body.x)
        self.material_points = Points(body)
        self.material = LAW.pack(body.constants)
        self.weights = Basis(self.points)
        self.background = BackgroundMesh(self.cell, body.walls, comm)
        self.length = StepLength(regularisation, self.cell, self.gravity)
        self.time, self.steps, self.failed_steps = 0.0, 0, 0
        self.newton_iterations = self.linear_iterations = 0
        self.unbalanced_ratio = float("inf")
        self.residuals: list[float] = []
        self.nodes_solved_max = 0
        self.node_place, self.node_velocity = np.zeros((0, 3), int), np.zeros((0, 3))
        self.load_share = 0.0
        if scene.loads.initial_stress != "none":
            self.material_points.strain(self._geostatic_strain(), body.constants.bulk)
            self.load_share = 1.0
        self._pull()
        self.system = self._new_system()
        self.nodes_solved_start = self.system.total

    @property
    def time_step(self) -> float:
        """Length [s] of the next step in pseudo-time."""
        return self.length.dt

    @property
    def x(self) -> np.ndarray:
        """Positions (n, 3) [m] of the points."""
        return self.material_points.x.numpy()

    def _geostatic_strain(self) -> np.ndarray:
        return geostatic_strain(self.body)

    def _pull(self):
        """External force of the points at the present share of gravity."""
        self.material_points.load.numpy()[:] = [0.0, 0.0, -self.load_share * self.gravity * self.material_points.mass]

    def _new_system(self) -> System:
        """Where the points are now: basis, mesh, unknowns, sparsity."""
        self.weights.evaluate(self.material_points.x, self.cell)
        self.background.follow(self.weights.base.numpy(), self.cut)
        system = System(self.material_points, self.weights, self.background, self.material)
        self.nodes_solved_max = max(self.nodes_solved_max, system.total)
        return system

    def advance_to(self, time: float):
        """Step until `time` [s] of pseudo-time is reached or, by less than a step, passed. Raises as `advance`."""
        while self.time < time:
            self.advance()

    def advance(self):
        """One step: of gravity, while it is not whole, then of the collapse. Its Newton may need several tries.

        Raises NumericalError when Newton fails at the smallest step; the state is then that of the last step.
        """
        if self.load_share < 1.0:
            self._load_step(1.0 / self.body.scene.implicit.load_steps)
            self.time += self.body.time_scale / self.body.scene.implicit.load_steps
        else:
            self._collapse_step()
        self.steps += 1

    def _collapse_step(self):
        """Balance gravity, internal forces and drag over `time_step`."""
        self.system = system = self._new_system()
        weight = system.norm(system.load)
        wanted, going = self.length.dt, system.field_of(self.node_place, GOES_ON * self.node_velocity)
        while True:
            system.set_regularisation(**self.regularisation.of_step(self.body, self.length.dt))
            start = system.norm(system.residual(np.zeros((system.count, 3))))
            tolerance = max(TIGHTEST * weight, min(REDUCTION * start, LOOSEST * weight))
            outcome = self._solve(tolerance, LINEAR_TOLERANCE, self._first_guess(going))
            if outcome.converged:
                break
            self.failed_steps += 1
            going[:] = 0.0
            if not self.length.failed():
                tried, self.length.dt = self.length.dt, wanted
                raise NumericalError(self._stuck(f"at the smallest step, {tried:.3g} s", weight))
        self.time += self.length.dt
        self._accept(outcome.u)
        self.node_place, self.node_velocity = system.places, outcome.u / self.length.dt
        moved, comm = np.linalg.norm(self.material_points.moved.numpy(), axis=1), self.background.comm
        most = quantile(moved, MOVED_QUANTILE, comm if comm.size > 1 else None)
        self.length.accepted(most, outcome.iterations)

    def _first_guess(self, going):
        """The increment (count, 3) [m] from which Newton starts: nodes go on at `going` (count, 3) [m/s], unless a
        point would collapse."""
        u = self.length.dt * going
        return u if self.system.norm(self.system.residual(u)) < REFUSED else np.zeros_like(u)

    def _load_step(self, wanted: float):
        """Add the share `wanted` of gravity in static equilibrium, in smaller parts where Newton needs them."""
        part, end = wanted, min(self.load_share + wanted, 1.0)
        if end > 1.0 - 1e-9:
            end = 1.0
        while self.load_share < end:
            before = self.load_share
            self.load_share = min(before + part, end)
            self._pull()
            self.system = self._new_system()
            weight = self.system.norm(self.system.load)
            self.system.set_regularisation(ghost=STATIC_GHOST * self.body.constants.shear * self.cell)
            outcome = self._solve(STATIC_TOLERANCE * weight, STATIC_LINEAR_TOLERANCE)
            if outcome.converged:
                self._accept(outcome.u)
                continue
            self.failed_steps += 1
            self.load_share, part = before, 0.5 * part
            self._pull()
            if part < SMALLEST_LOAD_STEP * wanted:
                raise NumericalError(self._stuck(f"at the smallest load step, {part:.3g} of gravity", weight))

    def _solve(self, tolerance, linear_tolerance, start=None):
        outcome = solve(self.system, tolerance, linear_tolerance, start)
        self.newton_iterations += outcome.iterations
        self.linear_iterations += outcome.linear_iterations
        self.residuals = outcome.residuals
        return outcome

    def _accept(self, u):
        system = self.system
        system.residual(u)
        self.unbalanced_ratio = system.norm(system.unbalanced) / system.norm(system.load)
        system.commit(u)

    def write_grid(self, path):
        """The background mesh and the last step's displacement increment [m] as XDMF, for ParaView."""
        self.background.write(path, self.system.dofs, self.system.u.numpy())

    def _stuck(self, where: str, weight: float) -> str:
        """Newton's failure in words: how far it came, and the point whose node is farthest from balance."""
        reached = min(self.residuals) / weight if self.residuals else float("nan")
        point, x = self._farthest_from_balance()
        at = np.array2string(x, precision=4)
        return (
            f"Newton failed {where}, pseudo-time {self.time:.6g} s, step {self.steps + 1}: residual {reached:.2g} of "
            f"the weight after {len(self.residuals) - 1} iterations, largest near point {point}, x = {at} m; "
            + (
                "loads.initial_stress = 'geostatic' follows a body that gravity makes collapse"
                if self.load_share < 1.0
                else "a smaller grid.cell may follow it"
            )
        )

    def _farthest_from_balance(self) -> tuple[int, np.ndarray]:
        """Number and position of the first point, of those on all ranks, that sees the node farthest from balance."""
        found = self.system.points_at_the_worst_node()[:1]
        numbers = found if self.ids is None else self.ids[found]
        there = self.background.comm.allgather((numbers.tolist(), self.x[found]))
        return min((number[0], x[0]) for number, x in there if number)

    def look(self) -> Look:
        """What a history row says of the body's shape and volume."""
        return look(self.x, self.material_points.jacobian.numpy(), self.body)

    def grid_mass(self) -> float:
        """Mass [kg] that the points have put on the grid in the last step, by their weights."""
        seen = np.arange(NODES_PER_AXIS) < self.weights.reach.numpy()[:, :, None]
        shares = np.prod((self.weights.weight.numpy() * seen).sum(axis=2), axis=1)
        return float(self.material_points.mass * shares.sum())

    def find_invalid(self, farthest: float) -> str:
        """What of the state is invalid (see `mpm.run.find_invalid`); "" where all is well."""
        return find_invalid(self.state(), farthest, self.ids)

    def state(self) -> dict:
        """Everything a restart needs; `restore` takes it back to the bit."""
        counters = {name: getattr(self, name) for name in self.COUNTERS}
        return {
            **self.material_points.state(),
            **counters,
            **{name: getattr(self, name) for name in self.NODAL},
            "dt": self.length.dt,
            "unbalanced_ratio": self.unbalanced_ratio,
            "nodes_solved_start": self.nodes_solved_start,
            "nodes_solved_max": self.nodes_solved_max,
        }

    def restore(self, state: dict):
        """Take over what `state` gave."""
        self.material_points.restore(state)
        for name in (*self.COUNTERS, "unbalanced_ratio", "nodes_solved_start", "nodes_solved_max", *self.NODAL):
            setattr(self, name, state[name])
        self.length.dt = state["dt"]
        self._pull()
