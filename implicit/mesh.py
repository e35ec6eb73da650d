"""The background grid: a dolfinx hexahedral mesh around the material, its vector space and boundary conditions.

On several ranks the mesh is distributed by the cuts of the plan (`mpm.domains`): a rank owns the cells of its pencils,
and has as ghosts those from which its nodes can be coupled. dolfinx then says who owns which node.
"""

import numpy as np
from scipy.ndimage import binary_dilation

from implicit._dolfinx import MPI, dolfinx, function_space, hexahedra
from mpm.domains import Cut, owner_of
from mpm.gimp import NODES_PER_AXIS
from mpm.walls import FREE, NORMAL, TANGENTIAL, Walls

MARGIN = 2  # cells beyond the material that the mesh covers, so that it is not made anew each step
COUPLED = 2  # nodes or cells along each axis within which a node is coupled to others


class BackgroundMesh:
    """First-order hexahedra on the lattice where material is or is about to be.

    `mesh`, `space` (dolfinx): the cells and the vector-valued Lagrange space of degree 1 on them, on all ranks of
    `comm`. The window is the same on all ranks: `corner` (3,) lattice index of its first node, `owner` (ni, nj, nk) the
    rank that owns a node, -1 where the mesh has none, `fixed` (ni, nj, nk) bool the nodes that walls hold altogether.
    `dof_of` (ni, nj, nk) int32: block of the space that sits on a node of the window, -1 where this rank has none;
    `held` (dofs, 3) bool: components that walls hold.
    """

    def __init__(self, cell: float, walls: Walls, comm=MPI.COMM_SELF):
        self.cell, self.walls, self.comm = cell, walls, comm
        self.cut: Cut | int = 0
        self.dof_of = np.empty((0, 0, 0), np.int32)
        self.corner = np.zeros(3, int)

    def follow(self, base: np.ndarray, cut: Cut | int = 0):
        """Cover the stencils that start at nodes `base` (n, 3) of any rank, the plan being cut by `cut`, by a new mesh
        where this one does not."""
        first = np.unique(base, axis=0)
        if self.comm.allreduce(self.cut == cut and self._covers(first), MPI.LAND):
            return
        self.cut, first = cut, np.unique(np.concatenate(self.comm.allgather(first)), axis=0)
        # A stencil of three nodes per axis spans two cells.
        low = first.min(axis=0) - MARGIN
        cells = np.zeros(first.max(axis=0) + NODES_PER_AXIS - 1 + MARGIN - low, bool)
        for offset in np.ndindex(2, 2, 2):
            cells[tuple((first - low + offset).T)] = True
        cells = binary_dilation(cells, np.ones((3, 3, 3), bool), iterations=MARGIN)
        self._make(cells, low)

    def write(self, path, dofs: np.ndarray, increment: np.ndarray):
        """Mesh and displacement increment (count, 3) [m] of the blocks `dofs` (count,) as XDMF, for ParaView."""
        function = dolfinx.fem.Function(self.space)
        function.name = "increment"
        function.x.array.reshape(-1, 3)[dofs] = increment
        with dolfinx.io.XDMFFile(self.comm, str(path), "w") as file:
            file.write_mesh(self.mesh)
            file.write_function(function)

    def _covers(self, first) -> bool:
        at = first - self.corner
        if np.any(at < 0) or np.any(at + NODES_PER_AXIS > self.dof_of.shape):
            return False
        return all(np.all(self.dof_of[tuple((at + offset).T)] >= 0) for offset in np.ndindex(3, 3, 3))

    def _make(self, cells, low):
        """Mesh of the marked cells, the first of which starts at node `low`."""
        self.corner, shape = low, np.array(cells.shape) + 1
        nodes = np.zeros(shape, bool)
        where = np.argwhere(cells)
        corners = [where + offset[::-1] for offset in np.ndindex(2, 2, 2)]  # x fastest, as dolfinx orders them
        for corner in corners:
            nodes[tuple(corner.T)] = True
        number = np.cumsum(nodes.ravel()).reshape(shape) - 1
        connectivity = np.stack([number[tuple(corner.T)] for corner in corners], axis=1).astype(np.int64)
        points = (np.argwhere(nodes) + low) * self.cell
        owner = self._owner_of_cells(where + low)
        mine = owner == self.comm.rank
        share = np.array_split(points, self.comm.size)[self.comm.rank]
        ghosts = self._ghosts(cells, owner)[mine] if self.comm.size > 1 else None
        self.mesh = hexahedra(self.comm, connectivity[mine], share, ghosts)
        self.space = function_space(self.mesh, "Lagrange", 1, (3,))
        at = np.rint(self.space.tabulate_dof_coordinates() / self.cell).astype(int) - low
        self.dof_of = np.full(shape, -1, np.int32)
        self.dof_of[tuple(at.T)] = np.arange(len(at), dtype=np.int32)
        self.held = self._held()
        self.owner, self.fixed = np.full(shape, -1), np.zeros(shape, bool)
        own = slice(self.space.dofmap.index_map.size_local)
        for rank, (nodes_of, held) in enumerate(self.comm.allgather((at[own], self.held[own].all(axis=1)))):
            self.owner[tuple(nodes_of.T)], self.fixed[tuple(nodes_of.T)] = rank, held

    def _owner_of_cells(self, cells):
        """The rank (m,) that owns each of the `cells` (m, 3): that of its pencil, and at least one for every rank."""
        owner = owner_of(cells[:, :2], self.cut)
        for rank in range(self.comm.size):
            held = np.bincount(owner, minlength=self.comm.size)
            if held[rank] == 0:
                owner[np.flatnonzero(owner == held.argmax())[-1]] = rank
        return owner

    def _ghosts(self, cells, owner):
        """Which ranks (m, ranks) are to have each of the marked cells as a ghost, of which `owner` (m,) is the rank."""
        near = []
        for rank in range(self.comm.size):
            marked = np.zeros(cells.shape, bool)
            marked[cells] = owner == rank
            near.append(binary_dilation(marked, np.ones((3, 3, 3), bool), iterations=COUPLED)[cells] & (owner != rank))
        return np.stack(near, axis=1)

    def _held(self) -> np.ndarray:
        """Components held by the walls: a condition holds on its wall's nodes and on every node beyond."""
        index_map = self.space.dofmap.index_map
        held = np.zeros((index_map.size_local + index_map.num_ghosts, 3), bool)
        slack = 0.01 * self.cell
        for axis in range(3):
            sides = (
                (self.walls.low[axis], self.walls.low_kind[axis], -1.0),
                (self.walls.high[axis], self.walls.high_kind[axis], 1.0),
            )
            for node, kind, sign in sides:
                if kind == FREE:
                    continue
                plane = node * self.cell
                blocks = dolfinx.fem.locate_dofs_geometrical(
                    self.space,
                    lambda x, axis=axis, plane=plane, sign=sign: sign * (x[axis] - plane) > -slack,
                )
                across = np.arange(3) == axis
                held[blocks] |= np.where(across, kind & NORMAL, kind & TANGENTIAL) > 0
        return held
