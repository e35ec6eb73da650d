"""The explicit solver: state on the device, one step as its phases in order, batches of steps.

Cycle of Wyser et al. 2021/2023 (uGIMP, FLIP, double mapping, Drucker-Prager) without its reference code's
defects; see `explicit.kernels` for each phase.
"""

import math

import numpy as np
import warp as wp

from explicit.device_look import DeviceLook
from explicit.dials import Dials
from explicit.figures import Figures, energies_of
from explicit.fused import SORT_BYTES, STEPS_PER_GRAPH, FusedStep
from explicit.kernels import layout as K
from explicit.kernels import step_kernels
from explicit.kernels.layout import POINT_ARRAYS, POINT_STATE
from explicit.kernels.look import LOOK_SIZE
from explicit.kernels.sparse_grid import MARGIN
from explicit.phases import phases_of
from explicit.sparse_grid import SparseGrid
from mpm.body import Body
from mpm.errors import NumericalError, StepRefused
from mpm.geostatic import initial_strain
from mpm.law_state import by_name, by_point, first_law_state
from mpm.precheck import over_courant
from mpm.stiffness import SMOOTHINGS, limit_bulk, ripple_share
from mpm.watch import Look, look

# Velocity components below this share of sqrt(g h0) are not damped: at rest the sign of v is round-off.
# The reference code's 1e-3 m/s is this share of sqrt(g h0) for a column 1 m high.
STILL = 3e-4
UNSEEN = 4.0
MOST_STEPS = 200
LEDGER_COLUMNS_CUDA = 256  # a power of two: points find theirs with a mask


class ExplicitSolver:
    """Points and grid of one body on one device.

    Point arrays, all (n,) in the body's order, also in `arrays` as kernels take them: `x`, `v`, `carry` vec3 [m, m/s],
    `tau` vec6 [Pa] Kirchhoff stress in order xx, yy, zz, yz, xz, xy, `theta` [-] volume strain that bears pressure,
    `dilated` [-] plastic volume strain, `law_state` (n, variables) what the law remembers. The last two are empty
    where the material has no use for them. `lost` vec3 [m]: what float32 has left out of `x`, empty in float64.

    `fused`: take steps in four launches (`explicit.fused`) in place of nine phases, and look at the points on the
    device (`explicit.device_look`); so on a GPU, unless told otherwise or where ripples of the volume strain are
    smoothed (`ripple_share` < 1), which takes phases of its own.
    """

    ids: np.ndarray | None = None  # numbers of the points in the whole body, where these are a part of it

    def __init__(self, body: Body, device="cpu", fused: bool | None = None):
        settings = body.scene.explicit
        self.body = body = limit_bulk(body)
        self.device = wp.get_device(device)
        self.ripple_share = ripple_share(body.constants)
        self.fused = self.ripple_share == 1.0 and (self.device.is_cuda if fused is None else fused)
        self.real = getattr(wp, settings.precision)
        self.k = step_kernels(self.real)
        self.points = len(body.x)
        self._target = 0.0
        self._pack(body)
        self.grid = SparseGrid(self.real, body.scene.grid.cell, self.device)
        self._allocate_points(body)
        self.dials = Dials(self.real, self.device)
        self.clock, self.speed, self.fault = self.dials.clock, self.dials.speed, self.dials.fault
        self.plan = self._zeros(K.CLOCK_SIZE, wp.float64)  # what the clock will be in the next step
        # One column on the CPU: its sum does not depend on how nodes are numbered, so restarts are exact.
        columns = LEDGER_COLUMNS_CUDA if self.device.is_cuda else 1
        self.figures = Figures(columns, LOOK_SIZE if self.fused else 0, self.device)
        self.energy, self.ledger = self.figures.energy, self.figures.ledger
        self.device_look = DeviceLook(self, self.figures.more) if self.fused else None
        self._stored_before = 0
        self.fit_grid()
        self.nodes_stored_start = self.grid.stored

    def _pack(self, body):
        """Constants of the scene as kernel structs."""
        scene, settings, k = body.scene, body.scene.explicit, self.k
        setup = k.Setup()
        setup.cell, setup.inv_cell = scene.grid.cell, 1.0 / scene.grid.cell
        setup.mass, setup.volume = body.point_mass, body.point_volume
        setup.damping = settings.damping
        setup.decay = self._decay_rate(body)
        setup.still = STILL * math.sqrt(scene.loads.gravity * body.height)
        setup.cfl, setup.fixed_dt = settings.cfl, settings.time_step or 0.0
        setup.wave, setup.gravity = body.constants.p_wave_speed, scene.loads.gravity
        setup.ramp, setup.margin = scene.loads.ramp, MARGIN * scene.grid.cell
        walls = k.Walls()
        for name in ("low", "high", "low_kind", "high_kind"):
            setattr(walls, name, wp.vec3i(*getattr(body.walls, name)))
        self.setup, self.walls, self.material = setup, walls, k.pack_material(body.constants)

    @staticmethod
    def _decay_rate(body) -> float:
        """Rate [1/s] at which the part of a point's velocity that the grid does not see decays.

        Local damping takes the share D of what the grid sees; by default the rest decays in UNSEEN sqrt(h0/g)/D. At
        D = 0.4 that ends the creep of a coarse heap, at D = 0.05 it moves R_995 by 1 % at most (benchmarks/README.md).
        """
        settings = body.scene.explicit
        if settings.unseen_decay:
            return 1.0 / settings.unseen_decay
        return settings.damping / (UNSEEN * body.time_scale)

    def _allocate_points(self, body):
        n, k = self.points, self.k
        self.x = wp.array(body.x, dtype=k.vec3, device=self.device)
        self.lost = self._zeros(n if self.real == wp.float32 else 0, k.vec3)
        self.v = self._zeros(n, k.vec3)
        self.carry = self._zeros(n, k.vec3)
        strain = self._initial_strain(body)
        self.theta_start = strain.sum(axis=1)
        stress = np.zeros((n, 6))
        constants = body.constants
        lame = constants.bulk - 2.0 / 3.0 * constants.shear
        stress[:, :3] = 2.0 * constants.shear * strain + lame * self.theta_start[:, None]
        self.tau = wp.array(stress, dtype=k.vec6, device=self.device)
        self.theta = wp.array(self.theta_start, dtype=self.real, device=self.device)
        self.dilated = self._zeros(n if constants.plastic and constants.eta_bar > 0 else 0, self.real)
        self.law_state = wp.array(first_law_state(constants, n), dtype=k.LawState, device=self.device)
        self._pack_points()

    def _initial_strain(self, body) -> np.ndarray:
        return initial_strain(body)

    def _pack_points(self):
        self.arrays = self.k.Points()
        for name in POINT_ARRAYS:
            setattr(self.arrays, name, getattr(self, name))

    def _allocate_nodes(self):
        """Node arrays, reused within a step: `node_momentum` holds (m, m v), from the grid update on (m, v_new);
        `node_force` force and m theta, then the velocity increment dt a and m theta, then what the pressure law gives;
        `node_mapped` the second mapping's m v, then v; `node_dilation` the sum of m ln det F, `node_smoothed`
        its averages (`explicit.kernels.ripples`). `explicit.kernels.fused` says what they hold in a fused step."""
        nodes, k = self.grid.capacity, self.k
        self.node_momentum = self._zeros(nodes, k.vec4)
        self.node_force = self._zeros(nodes, k.vec4)
        self.node_mapped = self._zeros(nodes, k.vec4)
        self.node_dilation = self._zeros(0 if self.fused else nodes, self.real)
        self.node_smoothed = [self._zeros(nodes, self.real) for _ in range(SMOOTHINGS if self.ripple_share < 1 else 0)]
        self.counted = self._zeros(0, wp.int32)  # empty: sums over nodes count all of them (see `explicit.ranks`)

    def _zeros(self, shape, dtype):
        return wp.zeros(shape, dtype=dtype, device=self.device)

    @property
    def devices(self) -> str:
        """Warp's alias of the device, or of all of them where the body is spread over ranks."""
        return self.device.alias

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return float(self.dials.seen.clock[K.TIME])

    @property
    def steps(self) -> int:
        """Steps taken."""
        return int(self.dials.seen.clock[K.STEPS])

    @property
    def time_step(self) -> float:
        """Length [s] of the next step: the fixed one, or CFL with the points' present speed."""
        return self.setup.fixed_dt or self.setup.cfl * self.courant_limit

    @property
    def courant_limit(self) -> float:
        """h/(c + |v|) [s] with the points' present speed along the fastest axis."""
        fastest = float(np.max(self.dials.seen.speed[: K.CARRIED]))
        return self.body.scene.grid.cell / (self.setup.wave + fastest)

    @property
    def nodes_stored_max(self) -> int:
        """Most nodes that were stored at a time, also before a restart that set it."""
        return max(self._stored_before, self.grid.most_stored)

    @nodes_stored_max.setter
    def nodes_stored_max(self, nodes: int):
        self._stored_before = nodes

    @property
    def volume_ratio(self) -> np.ndarray:
        """Volume of each point over its initial one (n,) [-]."""
        strain = self.theta.numpy().astype(float) - self.theta_start
        return np.exp(strain + (self.dilated.numpy() if self.dilated.size else 0.0))

    @property
    def sigma(self) -> np.ndarray:
        """Cauchy stress (n, 6) [Pa]: xx, yy, zz, yz, xz, xy."""
        return self.tau.numpy() / self.volume_ratio[:, None]

    @property
    def bytes_per_point(self) -> int:
        """Memory of one point's state [bytes]."""
        arrays = (getattr(self, name) for name in POINT_ARRAYS)
        state = sum(wp.types.type_size_in_bytes(array.dtype) for array in arrays if array.size)
        return 2 * state + SORT_BYTES if self.fused else state  # a fused step has sorted copies

    @property
    def bytes_per_node(self) -> int:
        """Memory of one stored node [bytes], without the tables that say where it is."""
        return sum(wp.types.type_size_in_bytes(array.dtype) for array in self._node_arrays())

    @property
    def bytes(self) -> int:
        """Memory of points and grid on the device [bytes]."""
        arrays = self._node_arrays() + (self.device_look.arrays if self.fused else [])
        return self.points * self.bytes_per_point + sum(array.capacity for array in arrays) + self.grid.bytes

    def _node_arrays(self):
        shared = [self.node_momentum, self.node_force, self.node_mapped]
        own = self.fused_step.node_arrays if self.fused else [self.node_dilation, *self.node_smoothed]
        return [*shared, *own]

    def fit_grid(self):
        """Store the nodes that the points need now."""
        if self.grid.follow(self.x):
            self._allocate_nodes()
            self._record_step()
        if self.fused:
            self.fused_step.sort()
        self.grid.reset_travel(self.clock)
        self.dials.forget()

    def _record_step(self):
        """The step as launches in order, ready to be repeated."""
        self.pencils = pencils = self.k.Pencils()
        pencils.base, pencils.i0, pencils.j0 = self.grid.base, self.grid.i0, self.grid.j0
        if self.fused:
            self.fused_step = FusedStep(self)
            return
        self.phases = phases_of(self)
        self._graph = None

    def step(self):
        """One step: the phases in order. Does nothing once the target time is reached."""
        self.dials.forget()
        if self.fused:
            return self.fused_step.take(1)
        for phase in self.phases:
            phase.launch()

    def advance_to(self, time: float):
        """Step to exactly `time` [s]. Raises as `advance`."""
        self.set_target(time)
        while self.time < time:
            self.advance(time)

    def set_target(self, target: float):
        """Set the time [s] that `advance` must not pass; the last step is shortened to meet it."""
        self._target = target
        wp.launch(self.k.set_target, 1, inputs=[self.clock, wp.float64(target)], device=self.device)

    def advance(self, until: float) -> float:
        """Take a batch of steps towards time `until` [s]: it may end a step past it, or well before, where the
        stored nodes must follow the points. The target of `set_target` is met exactly. Returns the time reached.

        Raises NumericalError when a point's state is not finite, it crosses half a cell in one step, leaves the grid
        or its volume turns negative, and StepRefused when a fixed time step passes the Courant limit.
        """
        clock, fastest, dt = self.dials.seen.clock, float(np.max(self.dials.seen.speed)), self.time_step
        margin, travelled = self.setup.margin, clock[K.TRAVEL] + fastest * clock[K.DT]
        outgrown = travelled > 0.5 * margin
        # The last step of a batch may have carried points beyond the margin, by less than a cell.
        self.grid.find_strays(self.x, int(outgrown), self.fault)
        self.dials.forget()
        by_itself = self.fused and self.fused_step.branches and travelled < K.OUT_OF_NODES
        if outgrown and not by_itself:
            self.check()
            self.fit_grid()
            travelled = 0.0
        steps = math.ceil((min(until, self._target) - clock[K.TIME]) / dt - 1e-9)
        if self.fused:
            # Some more, in case they get shorter: the device stops by itself.
            stride = STEPS_PER_GRAPH if STEPS_PER_GRAPH * fastest * dt < 0.5 * margin else 1
            self.fused_step.take(min(max(steps + steps // 16 + 1, 1), MOST_STEPS), until, stride)
        else:
            if fastest > 0:
                steps = min(steps, int(0.8 * (margin - travelled) / (fastest * dt)))
            self._take(min(max(steps, 1), MOST_STEPS))
        self.dials.forget()
        self.check()
        return self.time

    def _take(self, steps: int):
        """Most steps as replays of a recorded batch, the rest one by one."""
        if self.fused:
            return self.fused_step.take(steps)
        if steps >= STEPS_PER_GRAPH and self._graph is None:
            with wp.ScopedCapture(device=self.device) as capture:
                for _ in range(STEPS_PER_GRAPH):
                    self.step()
            self._graph = capture.graph
        batches, rest = divmod(steps, STEPS_PER_GRAPH)
        for _ in range(batches):
            wp.capture_launch(self._graph)
        for _ in range(rest):
            self.step()

    def check(self):
        if fault := self._fault():
            raise fault

    def _fault(self) -> NumericalError | None:
        """What the kernels reported, in words."""
        fault = self.dials.seen.fault
        if not fault.any():
            return None
        where = f"at t = {self.time:.6g} s, step {self.steps}"
        troubles = {
            K.NOT_FINITE: "its velocity is not finite",
            K.TOO_FAST: "it crossed more than half a cell in one step",
            K.INVERTED: "its volume turned negative",
            K.OFF_GRID: "it has left the stored grid",
        }
        for kind, what in troubles.items():
            if fault[kind]:
                point = int(fault[kind]) - 1
                number = point if self.ids is None else int(self.ids[point])
                x, v = (np.array2string(a.numpy()[point], precision=4) for a in (self.x, self.v))
                return NumericalError(
                    f"diverged {where}, point {number}: {what} (x = {x} m, v = {v} m/s, dt = {self.time_step:.3g} s)"
                )
        return StepRefused(f"time step refused {where}: {over_courant(self.setup.fixed_dt, self.courant_limit)}")

    def energies(self) -> dict[str, float]:
        """Energies and time integrals of power [J], with the grid as the last step left it.

        W_ext: work of gravity; W_damping: dissipated by local damping; W_plastic: by yielding; W_decay: by the decay of
        velocities that the grid does not see.
        """
        if self.fused:
            return self.observe()[0]
        self.energy.zero_()
        self.add_point_energy()
        nodes = [self.node_momentum, self.node_mapped, self.counted, self.energy]
        wp.launch(self.k.grid_energy, self.grid.capacity, inputs=nodes, device=self.device)
        return energies_of(self.figures.read()[0])

    def add_point_energy(self):
        """Add the energies of the points to `energy`."""
        inputs = [self.setup, self.material, self.arrays, self.energy]
        wp.launch(self.k.point_energy, self.points, inputs=inputs, device=self.device)

    def look(self) -> Look:
        """What a history row says of the body's shape and volume."""
        if self.fused:
            return self.observe()[1]
        return look(self.x.numpy(), self.volume_ratio, self.body)

    def observe(self) -> tuple[dict[str, float], Look]:
        """What a history row says: `energies` and `look`, which the device finds by itself in a fused run."""
        if not self.fused:
            return self.energies(), self.look()
        self.fused_step.observe()
        rows, looked = self.figures.read()
        return energies_of(rows), self.device_look.of(rows, looked)

    def grid_mass(self) -> float:
        """Mass [kg] that the last step put on the grid."""
        mass = self.node_momentum.numpy()[:, 0].astype(np.float64)
        return float((mass * self.counted.numpy() if self.counted.size else mass).sum())

    def state(self) -> dict[str, np.ndarray]:
        """Everything a restart needs, as host arrays; `restore` takes it back to the bit."""
        names = (*POINT_STATE, "clock", "speed", "ledger")
        return by_name({name: getattr(self, name).numpy().copy() for name in names})

    def restore(self, state: dict[str, np.ndarray]):
        """Take over a state made by `state`, on this or another kind of device, and store the nodes it needs."""
        state = by_point(state)
        for name in (*POINT_STATE, "speed"):
            if getattr(self, name).size:
                getattr(self, name).assign(state[name])
        ledger = state["ledger"]
        if ledger.shape != self.ledger.shape:
            ledger = np.zeros(self.ledger.shape)
            ledger[:, 0] = state["ledger"].sum(axis=1)
        self.ledger.assign(ledger)
        self.fit_grid()
        # After the fit, which resets the distance travelled: the length of batches depends on it, and history
        # rows are written between batches.
        self.clock.assign(state["clock"])
        self.dials.forget()
