"""The explicit solver on several MPI ranks: each steps the points of its own domain, nodes that two store are summed.

Every rank takes the same steps: time step, faults and the distance travelled are agreed on. Points change ranks where
the stored nodes are found anew. `mpm.parts` says how the first rank runs the program.
"""

from dataclasses import replace

import numpy as np
import warp as wp
from mpi4py import MPI

from explicit.dials import Seen
from explicit.kernels import layout as K
from explicit.kernels.layout import POINT_ARRAYS, POINT_STATE
from explicit.solver import ExplicitSolver
from explicit.staged import Buffers, StagedStep
from mpm.body import Body
from mpm.devices import device_of_rank
from mpm.domains import Halo, shared_pencils
from mpm.geostatic import initial_strain
from mpm.law_state import by_name, by_point
from mpm.parts import Gathered, Part, Whole
from mpm.stiffness import limit_bulk
from mpm.watch import Look, look


class Domain(Part, ExplicitSolver):
    """The part of a body that one rank steps."""

    def __init__(self, body: Body, device, comm):
        self.comm, self.whole = comm, (body := limit_bulk(body))
        self.halo: Halo | None = None  # until nodes are stored
        self.buffers: Buffers | None = None  # likewise
        self.ids = self.cut_anew(body.x)
        self.theta_start_of_all = initial_strain(body).sum(axis=1)
        super().__init__(replace(body, x=body.x[self.ids]), device, fused=False)

    def _initial_strain(self, body) -> np.ndarray:
        return super()._initial_strain(self.whole)[self.ids]

    def fit_grid(self):
        """Hand points on to the ranks whose domains they are in, store the nodes needed, and find the shared ones."""
        if self.halo:
            self.hand_on(self.x.numpy())
        super().fit_grid()
        self.halo = Halo(shared_pencils(self.grid.pencils(), self.comm), self.grid.capacity, self.comm)
        self.counted = wp.array(self.halo.counted, dtype=wp.int32, device=self.device)
        self._record_step()
        if self.staged:
            self.buffers = self.buffers or Buffers(self.real, self.device)
            self.staged_step = StagedStep(self, self.buffers)

    @property
    def staged(self) -> bool:
        """Whether sums over nodes are packed and added where the nodes are (`explicit.staged`), not by the host."""
        return self.device.is_cuda

    def field(self, name: str) -> np.ndarray:
        """One of the point arrays (n, ...)."""
        return getattr(self, name).numpy()

    @property
    def held(self) -> list[str]:
        """Names of the arrays that the material has, whether there are points here or not."""
        constants = self.whole.constants
        spare = {"dilated": constants.plastic and constants.eta_bar > 0, "law_state": constants.plastic}
        spare["lost"] = self.real == wp.float32
        return [name for name in POINT_ARRAYS if spare.get(name, True)]

    def take(self, rows: dict[str, np.ndarray]):
        """Hold the points of `rows` in place of those so far (see `Part.take`)."""
        self.ids, self.points = rows["id"], len(rows["id"])
        self.theta_start = self.theta_start_of_all[self.ids]
        for name in self.held:
            setattr(self, name, wp.array(rows[name], dtype=getattr(self, name).dtype, device=self.device))
        self._pack_points()

    def _take(self, steps: int):
        """Steps one by one: ranks talk between the phases, and after each agree on speeds and on whether to go on."""
        for _ in range(steps):
            seen = self.step()
            if seen.clock[K.DT] == 0.0:
                return
            agreed = np.append(seen.speed, seen.fault.any()).astype(float)
            self.comm.Allreduce(MPI.IN_PLACE, agreed, MPI.MAX)
            self.speed.assign(agreed[:-1])
            if agreed[-1]:
                return

    def step(self) -> Seen:
        """One step: the phases in order, and sums over shared nodes after each phase that adds to nodes. What the host
        sees of it."""
        if self.staged:
            return self.staged_step.take()
        begin, *phases = self.phases
        begin.launch()
        seen = self.dials.read()  # on the CPU that is what will be there
        if seen.clock[K.DT] == 0.0:
            return seen
        for phase in phases:
            phase.launch()
            if phase.summed:
                self.halo.add(*(array.numpy() for array in phase.summed))
        return seen

    def look(self) -> Look:
        """What a history row says of the whole body's shape and volume; no rank has all of its points."""
        return look(self.x.numpy(), self.volume_ratio, self.whole, self.ids, self.comm)

    def alias(self) -> str:
        """Warp's name of the device that this rank computes on."""
        return self.device.alias

    def share(self) -> dict[str, int]:
        """What this rank has: points, nodes stored, those of them that others store too, ranks that do, and nodes whose
        sums it sends in an exchange."""
        peers = self.halo.peers
        counts = {"points": self.points, "nodes": self.grid.stored, "shared": len(self.halo.nodes)}
        return counts | {"peers": len(peers), "sent": self.halo.sent}

    def check(self):
        """Raises on all ranks what the first that has a fault found."""
        for fault in self.comm.allgather(self._fault()):
            if fault:
                raise fault

    def restore(self, state: dict[str, np.ndarray]):
        """Take this rank's part of a state of the whole body."""
        mine, state = self.cut_anew(state["x"]), by_point(state)
        rows = {name: state[name][mine] for name in self.held if name != "carry"}
        self.take(rows | {"carry": np.zeros_like(rows["v"]), "id": mine})
        spare = {name: state[name][:0] for name in POINT_STATE}
        ledger = state["ledger"] if self.comm.rank == 0 else np.zeros_like(state["ledger"])
        super().restore(by_name(state | spare | rows | {"ledger": ledger}))

    def ledger_rows(self) -> np.ndarray:
        """Time integrals of power [J] of this rank's points and nodes."""
        return self.ledger.numpy()

    def nodes_stored(self) -> int:
        """Nodes that this rank stores."""
        return self.grid.stored


def domain(body: Body, device: str, comm) -> Domain:
    """This rank's domain, on the device that it has by that name. Raises as `mpm.devices.device_of_rank`."""
    place = device_of_rank(device, comm)
    wp.set_device(place)  # what has no device of its own, pinned memory, is no load on the first GPU then
    return Domain(body, place, comm)


class RankedSolver(Whole):
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

    def __init__(self, body: Body, device: str, comm):
        """`device`: "cpu", "cuda", a GPU for each rank of a host, or "cuda:0", one for all. Raises SceneError where
        there are none, or too few."""
        super().__init__(domain, body := limit_bulk(body), device, comm)
        self.devices = ", ".join(dict.fromkeys(self.ask("each", "alias")))
        self.theta_start = initial_strain(body).sum(axis=1)
        for name in POINT_STATE:
            setattr(self, name, Gathered(self, name))
        self.nodes_stored_start = self.nodes_stored_max = sum(self.ask("each", "nodes_stored"))

    volume_ratio, sigma, advance_to = ExplicitSolver.volume_ratio, ExplicitSolver.sigma, ExplicitSolver.advance_to

    @property
    def bytes(self) -> int:
        """Memory of points and grid of this rank [bytes]."""
        return self.part.bytes

    def set_target(self, target: float):
        """Set the time [s] that `advance` must not pass."""
        self.ask("set_target", target)

    def advance(self, until: float) -> float:
        """A batch of steps (see `ExplicitSolver.advance`)."""
        now = self.ask("advance", until)
        self.nodes_stored_max = max(self.nodes_stored_max, sum(self.ask("each", "nodes_stored")))
        return now

    def look(self) -> Look:
        """What a history row says of the body's shape and volume."""
        return self.ask("look")

    def observe(self) -> tuple[dict[str, float], Look]:
        """What a history row says: `energies` and `look`."""
        return self.energies(), self.look()

    def shares(self) -> list[dict[str, int]]:
        """What each rank has (see `Domain.share`)."""
        return self.ask("each", "share")

    def energies(self) -> dict[str, float]:
        """Energies of the whole body (see `ExplicitSolver.energies`), summed in the order of ranks."""
        parts = self.ask("each", "energies")
        return {name: sum(part[name] for part in parts) for name in parts[0]}

    def grid_mass(self) -> float:
        """Mass [kg] that the last step put on the grid."""
        return sum(self.ask("each", "grid_mass"))

    def state(self) -> dict[str, np.ndarray]:
        """Everything a restart needs, of the whole body; `restore` takes it back on any number of ranks."""
        state = {name: getattr(self, name).numpy() for name in POINT_STATE}
        state |= {name: getattr(self.part, name).numpy().copy() for name in ("clock", "speed")}
        return by_name(state) | {"ledger": sum(self.ask("each", "ledger_rows"))}

    def restore(self, state: dict[str, np.ndarray]):
        """Take over a state made by `state`, on this or another number of ranks."""
        self.ask("restore", state)
