"""The explicit solver on several MPI ranks: each steps the points of its own domain, nodes that two store are summed.

The first rank runs the program; the others serve it (`serve`): it tells them what to do with their domain, and all do
it together. Every rank takes the same steps: time step, faults and the distance travelled are agreed on. Points change
ranks where the stored nodes are found anew. What the first rank asks for is of the whole body, in the order of its
points, so that a run is judged, written and restarted as on one rank, and on any number of them.
"""

import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace

import numpy as np
import warp as wp
from mpi4py import MPI

from explicit.kernels import layout as K
from explicit.solver import POINT_ARRAYS, POINT_STATE, ExplicitSolver
from mpm.body import Body
from mpm.devices import find_device
from mpm.domains import UNEVEN, Halo, cut_plan, histogram, migrate, owner_of
from mpm.errors import NumericalError
from mpm.geostatic import initial_strain
from mpm.gimp import HALF_LENGTH_IN_CELLS
from mpm.watch import Look, look


class Domain(ExplicitSolver):
    """The part of a body that one rank steps; `ids` (n,) are its points' numbers in the whole body."""

    def __init__(self, body: Body, device, comm):
        self.comm, self.whole = comm, body
        self.halo: Halo | None = None  # until nodes are stored
        self.ids = self.cut_anew(body.x)
        self.theta_start_of_all = initial_strain(body).sum(axis=1)
        super().__init__(replace(body, x=body.x[self.ids]), device)

    def columns(self, x) -> np.ndarray:
        """The pencils (n, 2) at which the stencils of points `x` (n, 3) [m] start."""
        return np.floor(x[:, :2] / self.whole.scene.grid.cell - HALF_LENGTH_IN_CELLS).astype(int)

    def cut_anew(self, x) -> np.ndarray:
        """Cut the plan for points `x` (n, 3) [m] of the whole body; the numbers of those that are this rank's."""
        columns = self.columns(x)
        held, points = np.unique(columns, axis=0, return_counts=True)
        self.cut = cut_plan(held, points, self.comm.size)
        return np.flatnonzero(owner_of(columns, self.cut) == self.comm.rank)

    def _initial_strain(self, body) -> np.ndarray:
        return super()._initial_strain(self.whole)[self.ids]

    def fit_grid(self):
        """Hand points on to the ranks whose domains they are in, store the nodes needed, and find the shared ones."""
        if self.halo:
            self._migrate()
        super().fit_grid()
        self.halo = Halo(self.grid.pencils(), self.grid.capacity, self.comm)
        self.counted = wp.array(self.halo.counted, dtype=wp.int32, device=self.device)
        self._record_step()

    def _migrate(self):
        columns = self.columns(self.x.numpy())
        loads = np.array(self.comm.allgather(len(columns)))
        if loads.max() > UNEVEN * loads.mean():
            self.cut = cut_plan(*histogram(columns, self.comm), self.comm.size)
        owner = owner_of(columns, self.cut)
        if self.comm.allreduce(int((owner != self.comm.rank).sum())):
            self.take(migrate(self.rows(), owner, self.comm))

    def rows(self) -> dict[str, np.ndarray]:
        """A row a point of every array that the material has, and "id"."""
        arrays = {name: getattr(self, name) for name in POINT_ARRAYS}
        return {name: array.numpy() for name, array in arrays.items() if name in self.held} | {"id": self.ids}

    @property
    def held(self) -> list[str]:
        """Names of the arrays that the material has, whether there are points here or not."""
        constants = self.whole.constants
        spare = {"dilated": constants.plastic and constants.eta_bar > 0, "eps_p_eqv": constants.plastic}
        return [name for name in POINT_ARRAYS if spare.get(name, True)]

    def take(self, rows: dict[str, np.ndarray]):
        """Hold the points of `rows` (see `rows`) in place of those so far."""
        self.ids, self.points = rows["id"], len(rows["id"])
        self.theta_start = self.theta_start_of_all[self.ids]
        for name in self.held:
            setattr(self, name, wp.array(rows[name], dtype=getattr(self, name).dtype, device=self.device))
        self._pack_points()

    def _take(self, steps: int):
        """Steps one by one: ranks talk between the phases, and after each agree on speeds and on whether to go on."""
        for _ in range(steps):
            self.step()
            if self.clock.numpy()[K.DT] == 0.0:
                return
            agreed = np.append(self.speed.numpy(), self.fault.numpy().any()).astype(float)
            self.comm.Allreduce(MPI.IN_PLACE, agreed, MPI.MAX)
            self.speed.numpy()[:] = agreed[:-1]
            if agreed[-1]:
                return

    def step(self):
        """One step: the phases in order, and sums over shared nodes after each phase that adds to nodes."""
        summed = {
            "p2g": (self.node_momentum, self.node_force),
            "g2p2g": (self.node_mapped,),
            "strain_points": (self.node_dilation,),
        }
        begin, *phases = self._phases
        begin.launch()
        if self.clock.numpy()[K.DT] == 0.0:
            return
        # A rank without points has no such phase, and shares no nodes.
        for phase in phases:
            phase.launch()
            name = phase.kernel.key.rpartition("__")[2]
            if name in summed:
                self.halo.add(*(array.numpy() for array in summed[name]))

    def look(self) -> Look:
        """What a history row says of the whole body's shape and volume; no rank has all of its points."""
        return look(self.x.numpy(), self.volume_ratio, self.whole, self.ids, self.comm)

    def share(self) -> dict[str, int]:
        """What this rank has: points, nodes stored, those of them that others store too, ranks that do, and nodes whose
        sums it sends in an exchange."""
        peers = self.halo.peers
        counts = {"points": self.points, "nodes": self.grid.stored, "shared": len(self.halo.nodes)}
        return counts | {"peers": len(peers), "sent": sum(len(at) for _, at in peers)}

    def _check(self):
        """Raises on all ranks what the first that has a fault found."""
        for fault in self.comm.allgather(self._fault()):
            if fault:
                raise fault


def _gathered(domain: Domain, name: str) -> np.ndarray | None:
    """An array of all points in the order of the body, on the first rank; empty where the material has none."""
    if name not in domain.held:
        return getattr(domain, name).numpy()
    parts = domain.comm.gather((domain.ids, getattr(domain, name).numpy()))
    if parts is None:
        return None
    whole = np.empty((len(domain.whole.x), *parts[0][1].shape[1:]), parts[0][1].dtype)
    for ids, part in parts:
        whole[ids] = part
    return whole


def _restored(domain: Domain, state: dict[str, np.ndarray]):
    """Take this rank's part of a state of the whole body."""
    mine = domain.cut_anew(state["x"])
    rows = {name: state[name][mine] for name in domain.held if name != "carry"}
    domain.take(rows | {"carry": np.zeros_like(rows["v"]), "id": mine})
    spare = {name: state[name][:0] for name in POINT_STATE}
    ledger = state["ledger"] if domain.comm.rank == 0 else np.zeros_like(state["ledger"])
    domain.restore(state | spare | rows | {"ledger": ledger})


# What the first rank can ask of all: each is called with the rank's domain and the arguments that it sends.
ORDERS: dict[str, Callable] = {
    "advance": lambda domain, until: domain.advance(until),
    "set_target": lambda domain, target: domain.set_target(target),
    "gathered": _gathered,
    "restore": _restored,
    "look": lambda domain: domain.look(),
    "energies": lambda domain: domain.comm.gather(domain.energies()),
    "grid_mass": lambda domain: domain.comm.gather(domain.grid_mass()),
    "ledger": lambda domain: domain.comm.gather(domain.ledger.numpy()),
    "stored": lambda domain: domain.comm.gather(domain.grid.stored),
    "shares": lambda domain: domain.comm.gather(domain.share()),
}
BUILD, DISMISS = "build", "dismiss"


def serve(comm):
    """Do what the first rank asks, until it dismisses this one. Raises what is no fault of the run's."""
    domain = None
    while True:
        order, arguments = comm.bcast(None)
        if order == DISMISS:
            return
        if order == BUILD:
            body, device = arguments
            domain = Domain(body, find_device(device), comm)
            continue
        with suppress(NumericalError):  # all ranks raise it, the first one tells it
            ORDERS[order](domain, *arguments)


def dismiss(comm):
    """Let the other ranks go."""
    comm.bcast((DISMISS, ()))


class Gathered:
    """One array of all points, as `numpy` of a Warp array gives it."""

    def __init__(self, solver: "RankedSolver", name: str):
        self.solver, self.name = solver, name

    @property
    def size(self) -> int:
        """Points that have it; 0 where the material has no use for it."""
        return self.solver.points if self.name in self.solver.domain.held else 0

    def numpy(self) -> np.ndarray:
        """The array (n, ...), a copy."""
        return self.solver.ask("gathered", self.name)


class RankedSolver:
    """The interface of `ExplicitSolver` for a body that is spread over the ranks of `comm`, on its first rank.

    Arrays, energies and counts are of the whole body.
    """

    # Of the first rank's domain, the same on all.
    SAME = (
        "device",
        "setup",
        "grid",
        "time",
        "steps",
        "time_step",
        "courant_limit",
        "bytes_per_point",
        "bytes_per_node",
    )

    def __init__(self, body: Body, device, comm):
        self.body, self.comm, self.points = body, comm, len(body.x)
        comm.bcast((BUILD, (body, device.alias)))
        self.domain = Domain(body, device, comm)
        self.theta_start = initial_strain(body).sum(axis=1)
        for name in POINT_STATE:
            setattr(self, name, Gathered(self, name))
        self.nodes_stored_start = self.nodes_stored_max = sum(self.ask("stored"))

    def ask(self, order: str, *arguments):
        """Let all ranks follow an order; what it gives here. Raises NumericalError where it does so on any rank."""
        self.comm.bcast((order, arguments))
        try:
            return ORDERS[order](self.domain, *arguments)
        except NumericalError:
            raise
        except BaseException as error:  # the others wait in the middle of the order, for ever
            print(f"error: rank 0: {str(error) or type(error).__name__}", file=sys.stderr, flush=True)
            self.comm.Abort(1)

    def __getattr__(self, name):
        if name in self.SAME:
            return getattr(self.domain, name)
        raise AttributeError(name)

    volume_ratio, sigma, advance_to = ExplicitSolver.volume_ratio, ExplicitSolver.sigma, ExplicitSolver.advance_to

    @property
    def bytes(self) -> int:
        """Memory of points and grid of this rank [bytes]."""
        return self.domain.bytes

    def set_target(self, target: float):
        """Set the time [s] that `advance` must not pass."""
        self.ask("set_target", target)

    def advance(self, until: float) -> float:
        """A batch of steps (see `ExplicitSolver.advance`)."""
        now = self.ask("advance", until)
        self.nodes_stored_max = max(self.nodes_stored_max, sum(self.ask("stored")))
        return now

    def look(self) -> Look:
        """What a history row says of the body's shape and volume."""
        return self.ask("look")

    def shares(self) -> list[dict[str, int]]:
        """What each rank has (see `Domain.share`)."""
        return self.ask("shares")

    def energies(self) -> dict[str, float]:
        """Energies of the whole body (see `ExplicitSolver.energies`), summed in the order of ranks."""
        parts = self.ask("energies")
        return {name: sum(part[name] for part in parts) for name in parts[0]}

    def grid_mass(self) -> float:
        """Mass [kg] that the last step put on the grid."""
        return sum(self.ask("grid_mass"))

    def state(self) -> dict[str, np.ndarray]:
        """Everything a restart needs, of the whole body; `restore` takes it back on any number of ranks."""
        state = {name: getattr(self, name).numpy() for name in POINT_STATE}
        state |= {name: getattr(self.domain, name).numpy().copy() for name in ("clock", "speed")}
        return state | {"ledger": sum(self.ask("ledger"))}

    def restore(self, state: dict[str, np.ndarray]):
        """Take over a state made by `state`, on this or another number of ranks."""
        self.ask("restore", state)
