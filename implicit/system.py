"""The nonlinear system of one step: residual and exact tangent of the nodes' displacement increment u.

    R(u) = f_int(u) - f_ext + drag M (u - momentum dt v)/dt^2 + ghost penalty on u

Internal forces and tangent come from `implicit.kernels`. Drag and ghost penalty vanish with u, so that what is at
rest is in static equilibrium.
"""

import math

import numpy as np
import warp as wp
from scipy.ndimage import binary_dilation

from implicit._dolfinx import MPI
from implicit.kernels import assembly, basis, ghost, points
from implicit.kernels.layout import NEIGHBOURS, OUTSIDE, SELF, STENCIL, mat33, real, vec3
from implicit.mesh import COUPLED, BackgroundMesh
from implicit.points import Basis, Points
from implicit.volume import Volume
from mpm.domains import Halo, Ownership, shared_nodes

REFUSED = 1e30  # [N] stands for the residual of such an increment: a line search shortens it
WEAK = 0.2  # share of a bulk node's mass below which the ghost penalty ties a node to those behind it
STRIDES = (25, 5, 1)  # of the three axes, among a node's 125 neighbours


class System:
    """Unknowns, sparsity, residual and tangent of one step, of the points and nodes of this rank.

    Nodes are solved for that some point sees and that no wall holds altogether: `total` on all ranks. `count` of them
    are kept here: first the `owned` ones, then, on several ranks, what is coupled to them or seen by points here. Where
    ranks keep a node, all hold the same of it: `place_in_lattice` (count, 3) from the window's corner, `dofs` (count,)
    its block in the dolfinx space, `held` (count, 3) bool the components that walls hold, `node_mass` (count,) [kg],
    `velocity` (count, 3) [m/s], `load` (count, 3) [N]. The matrix is kept in 3x3 blocks by compressed rows, those of
    the owned nodes: `indptr`, `indices` (numbers among the nodes of all ranks), and the values that `tangent` gives;
    `coupling` is the rest of the exact tangent.
    """

    def __init__(self, state: Points, weights: Basis, background: BackgroundMesh, material):
        self.state, self.weights, self.material, self.comm = state, weights, material, background.comm
        self._stencils = [weights.reach, weights.weight]
        self._number(background)
        by_cell = np.lexsort(weights.base.numpy().T[::-1]).astype(np.int32)
        self._order = wp.array(by_cell, dtype=wp.int32, device="cpu")
        self._gather()
        self._tie_weak_nodes()
        self._couple()
        self.force = self._zeros(self.count, vec3)
        self.flux = self._zeros(state.count, mat33)
        self.tangents = self._zeros((state.count, 9), mat33)
        self.u = self._zeros(self.count, vec3)
        self._deformed: tuple[np.ndarray, bool] | None = None
        seen = (self._seen, self._seen_halo, self.nodes)
        self.volume = Volume(state, weights, *seen, self._held, material)
        self.set_regularisation()

    @staticmethod
    def _zeros(shape, dtype):
        return wp.zeros(shape, dtype=dtype, device="cpu")

    @staticmethod
    def _launch(kernel, dim, *inputs):
        wp.launch(kernel, dim, inputs=list(inputs), device="cpu")

    def _number(self, background):
        """Number the nodes to solve for, in the order of the lattice, and look them up for each point."""
        window, dofs, owner = background.dof_of.shape, background.dof_of, background.owner
        self._corner = background.corner
        corner = wp.vec3i(*(int(c) for c in background.corner))
        touched = self._zeros(window, wp.int32)
        w = self.weights
        self._launch(basis.mark_active, self.state.count, w.base, w.reach, w.weight, corner, touched)
        seen = touched.numpy() > 0
        self._seen, self._seen_halo = self._look_up(self._numbered(seen), corner), self._halo(np.flatnonzero(seen))
        solved = seen.copy()
        self.comm.Allreduce(MPI.IN_PLACE, solved, MPI.LOR)
        solved &= ~background.fixed
        # Numbers among all ranks' nodes: rank by rank.
        flat = np.flatnonzero(solved)
        flat = flat[np.argsort(owner.ravel()[flat], kind="stable")]
        numbers = np.full(window, OUTSIDE, np.int32)
        numbers.ravel()[flat] = np.arange(len(flat))
        owned = solved & (owner == self.comm.rank)
        kept = seen & solved
        if self.comm.size > 1:
            kept |= binary_dilation(owned, np.ones((3, 3, 3), bool), iterations=COUPLED) & solved
        order = np.concatenate([np.flatnonzero(owned), np.flatnonzero(kept & ~owned)])
        self.total, self.count, self.owned = len(flat), len(order), int(owned.sum())
        self.halo, self._rank_of = self._halo(order), owner.ravel()[order]
        self._ownership = Ownership(
            [(rank, at[at < self.owned]) for rank, at in self.halo.peers],
            [(rank, at[self._rank_of[at] == rank]) for rank, at in self.halo.peers],
            self.comm,
        )
        self.dofs = dofs.ravel()[order]
        self.held = background.held[self.dofs]
        self.place_in_lattice = np.stack(np.unravel_index(order, window), axis=1)
        self._numbers = np.full(window, OUTSIDE, np.int32)
        self._numbers.ravel()[order] = np.arange(self.count)
        self._global_numbers = numbers
        self.nodes = self._look_up(self._numbers, corner)

    def _halo(self, nodes):
        """What this rank shares of `nodes`, by their places in the window."""
        return Halo(shared_nodes(nodes, self.comm), len(nodes), self.comm)

    @staticmethod
    def _numbered(marked):
        """Numbers of the marked nodes in the window, OUTSIDE elsewhere."""
        numbers = np.full(marked.shape, OUTSIDE, np.int32)
        numbers[marked] = np.arange(marked.sum())
        return numbers

    def _look_up(self, numbers, corner):
        """Numbers (points, 27) of the nodes of each point's stencil."""
        nodes = self._zeros((self.state.count, STENCIL), wp.int32)
        table = wp.array(numbers, dtype=wp.int32, device="cpu")
        self._launch(basis.look_up, self.state.count, self.weights.base, corner, table, nodes)
        return nodes

    def _gather(self):
        """Mass, velocity and external force of the nodes."""
        s = self.state
        mass, momentum, load = (
            self._zeros(self.count, real),
            self._zeros(self.count, vec3),
            self._zeros(self.count, vec3),
        )
        nodal = (mass, momentum, load)
        self._launch(assembly.p2g, s.count, self.nodes, *self._stencils, real(s.mass), s.v, s.load, *nodal)
        self.halo.add(*(array.numpy() for array in nodal))
        self.node_mass, self.load = mass.numpy(), load.numpy()
        self.velocity = momentum.numpy() / self.node_mass[:, None]
        self.velocity[self.held] = 0.0
        self.load[self.held] = 0.0

    def _tie_weak_nodes(self):
        """Triples of neighbours in a row, one of them weak, that the ghost penalty acts on."""
        weak = np.zeros(self._numbers.shape, bool)
        bulk = 8 * self.state.mass  # a bulk node has the mass of eight points
        weak[tuple(self.place_in_lattice.T)] = self.node_mass < WEAK * bulk
        triples, strides = [np.empty((0, 3), np.int32)], [np.empty(0, np.int32)]
        for axis, stride in enumerate(STRIDES):
            size = self._numbers.shape[axis]
            rows = [np.arange(size - 2) + shift for shift in range(3)]
            number = np.stack([np.take(self._numbers, row, axis) for row in rows], axis=-1)
            some_weak = np.any([np.take(weak, row, axis) for row in rows], axis=0)
            # Where two ranks own nodes of a triple both add its springs, each to its own nodes.
            mine = (number < self.owned).any(axis=-1)
            found = number[(number != OUTSIDE).all(axis=-1) & some_weak & mine]
            triples.append(found)
            strides.append(np.full(len(found), stride, np.int32))
        self.triples = wp.array(np.concatenate(triples), dtype=wp.vec3i, device="cpu")
        self.strides = wp.array(np.concatenate(strides), dtype=wp.int32, device="cpu")

    def _couple(self):
        """Block rows of the matrix: nodes that share a point or a triple."""
        marks = self._zeros((self.count, NEIGHBOURS), wp.int32)
        self._launch(basis.mark_neighbours, self.state.count, self.nodes, self.weights.reach, marks)
        coupled, triples, strides = marks.numpy(), self.triples.numpy(), self.strides.numpy()
        mine, theirs = self._exchange_marks(coupled)
        for a in range(3):
            for b in range(3):
                coupled[triples[:, a], SELF + (b - a) * strides] = 1
        rows, slots = np.nonzero(coupled)
        self.indptr = np.zeros(self.owned + 1, np.int32)
        np.cumsum(coupled[: self.owned].sum(axis=1), out=self.indptr[1:])
        blocks = self.indptr[-1]
        columns = tuple((self.place_in_lattice[rows[:blocks]] + self._offsets(slots[:blocks])).T)
        self.indices = self._global_numbers[columns]
        coupled[rows, slots] = np.arange(len(rows))
        self.place = marks
        self._block_ownership = Ownership(
            [(rank, coupled[at]) for rank, at in mine], [(rank, coupled[at]) for rank, at in theirs], self.comm
        )
        self._rows = wp.array(rows[:blocks].astype(np.int32), dtype=wp.int32, device="cpu")
        self._columns = wp.array(self._numbers[columns], dtype=wp.int32, device="cpu")
        self._held = wp.array(self.held.astype(float), dtype=vec3, device="cpu")
        self._values = self._zeros(len(rows), mat33)

    def _exchange_marks(self, coupled):
        """Mark in `coupled` what points of other ranks couple to rows owned here. For each other rank the marks (rows,
        slots) that it makes in rows of this one, and those that this one makes in its rows."""
        rows, slots = np.nonzero(coupled[self.owned :])
        rows += self.owned
        owner, others = self._rank_of[rows], [rank for rank in range(self.comm.size) if rank != self.comm.rank]
        theirs = {rank: (rows[owner == rank], slots[owner == rank]) for rank in others}
        place = self.place_in_lattice
        sent = [(place[theirs[rank][0]], theirs[rank][1]) if rank in theirs else None for rank in range(self.comm.size)]
        received = self.comm.alltoall(sent)
        mine = {rank: (self._numbers[tuple(received[rank][0].T)], received[rank][1]) for rank in others}
        for marked in mine.values():
            coupled[marked] = 1
        return mine.items(), theirs.items()

    @staticmethod
    def _offsets(slots):
        """Lattice offsets (n, 3) of `slots` (n,) among a node's 125 neighbours."""
        return np.stack(np.unravel_index(slots, (5, 5, 5)), axis=1) - COUPLED

    def set_regularisation(
        self,
        drag: float = 0.0,
        ghost: float = 0.0,
        viscous: float = 0.0,
        dt: float = float("inf"),
        momentum: float = 0.0,
    ):
        """Resist the increment: `drag` [-] times M u/dt^2, with the share `momentum` [-] of the velocity carried over;
        ghost springs of `ghost` [N/m]; `viscous` [-], the share of the trial deviator that outlives the return map.
        """
        self.dt, self.momentum, self.viscous = dt, momentum, real(viscous)
        self.inertia = drag * self.node_mass / dt**2
        self._inertia = wp.array(self.inertia, dtype=real, device="cpu")
        self.carried = momentum * dt * self.velocity if momentum else 0.0
        self.ghost_stiffness = real(ghost)
        self._last: tuple[np.ndarray, np.ndarray] | None = None

    def norm(self, field: np.ndarray) -> float:
        """Euclidean norm of a nodal field (count, 3), or (owned, 3), over the nodes of all ranks."""
        own = field[: self.owned].ravel()
        return math.sqrt(self.comm.allreduce(float(own.dot(own))))

    @property
    def places(self) -> np.ndarray:
        """Lattice indices (count, 3) int of the nodes, the same in every system."""
        return self.place_in_lattice + self._corner

    def field_of(self, places: np.ndarray, values: np.ndarray) -> np.ndarray:
        """The nodal field (count, 3) that has `values` (m, 3) at the nodes `places` (m, 3) of an earlier system, and
        nothing at others and where walls hold."""
        field, at = np.zeros((self.count, 3)), places - self._corner
        inside = ((at >= 0) & (at < self._numbers.shape)).all(axis=1)
        number = self._numbers[tuple(at[inside].T)]
        field[number[number != OUTSIDE]] = values[inside][number != OUTSIDE]
        field[self.held] = 0.0
        return field

    def kept(self, own: np.ndarray) -> np.ndarray:
        """The nodal field (count, 3) of which `own` (3 owned,) are the values of the nodes that this rank owns."""
        if self.count == self.owned:
            return own.reshape(-1, 3)
        field = np.empty((self.count, 3))
        field[: self.owned] = own.reshape(-1, 3)
        self._ownership.spread(field)
        return field

    def residual(self, u: np.ndarray) -> np.ndarray:
        """Out-of-balance force (owned, 3) [N] at the increment `u` (count, 3) [m]; REFUSED where a point collapses.

        Leaves its static part, without drag and ghost penalty, in `unbalanced`. Asked again for the `u` of the last
        call, as a step does at its start and its end, it gives the same array.
        """
        if self._last is None or not self._everywhere(np.array_equal(u, self._last[0])):
            self._last = u.copy(), self._residual(u)
        return self._last[1]

    def _everywhere(self, here: bool) -> bool:
        """Whether it is so on all ranks."""
        return self.comm.allreduce(here, MPI.LAND)

    def _residual(self, u):
        s, w = self.state, self.weights
        self.force.zero_()
        if not self._deform(u):
            return np.full((self.owned, 3), REFUSED)
        self._launch(points.stress_flux, s.count, *self._strained(), self.flux)
        flux = (self.flux, real(s.volume), self.force)
        self._launch(assembly.internal_force, s.count, self._order, self.nodes, *self._stencils, w.slope, *flux)
        self._ownership.collect(self.force.numpy())
        self.unbalanced = self.force.numpy() - self.load
        self.unbalanced[self.held] = 0.0
        self._launch(ghost.ghost_force, len(self.triples), self.triples, self.ghost_stiffness, self.u, self.force)
        residual = self.force.numpy() - self.load + self.inertia[:, None] * (u - self.carried)
        residual[self.held] = 0.0
        return residual[: self.owned]

    def _deform(self, u) -> bool:
        """Strain the points by `u`, unless they are strained by it already; False where one collapses."""
        if self._deformed is None or not self._everywhere(np.array_equal(u, self._deformed[0])):
            self.u.numpy()[:] = u
            self._deformed = u.copy(), self.volume.deform(self.u)
        return self._deformed[1]

    def _strained(self):
        """What kernels need for the stress of the points at the last increment."""
        v = self.volume
        return v.deformation, self.state.b_e, v.nodal, v.gap, self.state.law_state, self.material, self.viscous

    def coupling(self, v: np.ndarray) -> np.ndarray:
        """What the blocks of the last `tangent` lack of dR/du, times the flat `v` (3 owned,) [m]: force [N]."""
        force = self.volume.coupling(self.kept(v).ravel()).reshape(-1, 3)
        self._ownership.collect(force)
        return force[: self.owned].ravel()

    def tangent(self, u: np.ndarray, blend: float = 0.0) -> np.ndarray:
        """Blocks (blocks, 3, 3) [N/m] of dR/du at `u`; with `coupling` exact for `blend` = 0 (see `tangent_flux`)."""
        s, w, v = self.state, self.weights, self.volume
        self._values.zero_()
        self._deform(u)
        v.set_slopes(blend)
        moduli = (real(blend), v.closed, real(v.own_share), v.filled, self.tangents, v.volumetric)
        self._launch(points.tangent_flux, s.count, *self._strained(), *moduli)
        v.linearise()
        blocks = (self.tangents, real(s.volume), self.place, self._values)
        self._launch(assembly.stiffness, s.count, self._order, self.nodes, *self._stencils, w.slope, *blocks)
        self._block_ownership.collect(self._values.numpy())
        ties = (self.triples, self.ghost_stiffness, self.strides, self.place, self._values)
        self._launch(ghost.ghost_stiffness, len(self.triples), *ties)
        self._launch(assembly.add_diagonal, self.owned, self.place, self._inertia, self._values)
        values = self._values.numpy()[: len(self.indices)]
        diagonal = np.abs(values[self.place.numpy()[: self.owned, SELF], 0, 0])
        scale = real(self.comm.allreduce(float(diagonal.sum())) / self.total)
        self._launch(assembly.apply_dirichlet, len(values), self._held, self._rows, self._columns, scale, self._values)
        return values

    def points_at_the_worst_node(self) -> np.ndarray:
        """Points here that see the node, of those of all ranks, that is farthest from balance without an increment."""
        residual = np.linalg.norm(self.residual(np.zeros((self.count, 3))), axis=1)
        place = self.place_in_lattice[np.argmax(residual)] if self.owned else None
        _, place = max(self.comm.allgather((residual.max(initial=-1.0), place)), key=lambda found: found[0])
        node = self._numbers[tuple(place)]
        return np.flatnonzero((self.nodes.numpy() == node).any(axis=1) & (node != OUTSIDE))

    def commit(self, u: np.ndarray):
        """Accept the increment: points move and take their returned state; velocities follow FLIP."""
        s = self.state
        self._deform(u)
        self.volume.commit()
        changed = (s.x, s.mean, s.theta, s.moved)
        self._launch(points.commit, s.count, self.u, self.nodes, *self._stencils, *self._strained(), *changed)
        if not self.inertia.any():
            return
        gained = wp.array(u / self.dt - self.momentum * self.velocity, dtype=vec3, device="cpu")
        self._launch(assembly.g2p, s.count, self.nodes, *self._stencils, gained, real(self.momentum), s.v)
