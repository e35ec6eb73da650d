"""The background grid: a dolfinx hexahedral mesh around the material, its vector space and boundary conditions."""

import numpy as np
from scipy.ndimage import binary_dilation

from implicit._dolfinx import MPI, dolfinx, function_space, hexahedra
from mpm.gimp import NODES_PER_AXIS
from mpm.walls import FREE, NORMAL, TANGENTIAL, Walls

MARGIN = 2  # cells beyond the material that the mesh covers, so that it is not made anew each step


class BackgroundMesh:
    """First-order hexahedra on the lattice where material is or is about to be.

    `mesh`, `space` (dolfinx): the cells and the vector-valued Lagrange space of degree 1 on them.
    `corner` (3,): lattice index of the window's first node. `dof_of` (ni, nj, nk) int32: block of the space that
    sits on a node of the window, -1 where the mesh has none. `held` (dofs, 3) bool: components that walls hold.
    """

    def __init__(self, cell: float, walls: Walls, comm=MPI.COMM_WORLD):
        self.cell, self.walls, self.comm = cell, walls, comm
        self.dof_of = np.empty((0, 0, 0), np.int32)
        self.corner = np.zeros(3, int)

    def follow(self, base: np.ndarray) -> bool:
        """Cover the stencils that start at nodes `base` (n, 3); True where the mesh had to be made anew."""
        first = np.unique(base, axis=0)
        if self._covers(first):
            return False
        # A stencil of three nodes per axis spans two cells.
        low = first.min(axis=0) - MARGIN
        cells = np.zeros(first.max(axis=0) + NODES_PER_AXIS - 1 + MARGIN - low, bool)
        for offset in np.ndindex(2, 2, 2):
            cells[tuple((first - low + offset).T)] = True
        cells = binary_dilation(cells, np.ones((3, 3, 3), bool), iterations=MARGIN)
        self._make(cells, low)
        return True

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
        self.mesh = hexahedra(self.comm, connectivity, points)
        self.space = function_space(self.mesh, "Lagrange", 1, (3,))
        at = np.rint(self.space.tabulate_dof_coordinates() / self.cell).astype(int) - low
        self.dof_of = np.full(shape, -1, np.int32)
        self.dof_of[tuple(at.T)] = np.arange(len(at), dtype=np.int32)
        self.held = self._held()

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
