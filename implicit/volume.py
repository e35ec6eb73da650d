"""The pressure law at the nodes, for one step: mean stress of the points, and how it couples their volume strains.

    d_p = ln det F,   d_i = sum N d_p/sum N,   theta_p = theta_p^n + sum N d_i,   theta_i = sum N theta_p/sum N,
    tau_i = the pressure law at theta_i,   tau_p = sum N tau_i

(ripples of d_i smoothed where K is many times G, see `mpm.stiffness.ripple_share`) over all nodes that points see,
held by walls or not (law in `mpm.drucker_prager`; all points have the same mass). tau is the mean Kirchhoff stress. A
node so couples points two cells apart or more, beyond the block rows that `System` assembles: what those lack is
applied as products with sparse matrices whose rows are points.
"""

import numpy as np
import warp as wp
from scipy.sparse import csr_matrix

from implicit._dolfinx import MPI
from implicit.kernels import basis, points
from implicit.kernels.layout import mat33, real, vec3
from implicit.kernels.nodes import apply_node_law, node_slopes
from implicit.points import Basis, Points
from mpm.domains import Halo
from mpm.stiffness import SMOOTHINGS, ripple_share

SMALLEST_STRETCH = 0.05  # det F of a point in one step, below which an increment is refused
# Share of K, or of what of it resists ripples, with which a point follows its own volume strain in the assembled rows,
# the preconditioner: a node averages away part of what varies within two cells. A fifth fewer sweeps than with all of
# it at nu = 0.3; a column of 2 kPa cohesion on 8 cells per r0 takes 881 in place of 1,219 at nu = 0.49, 1,698 in place
# of 4,331 at 0.499, than with half of K.
OWN_SHARE = 0.5


class Volume:
    """Deformation, volume strain and mean stress of the points at an increment, and their derivatives.

    `deformation` (points,) mat33 F; `nodal` (points,) mean stress tau_p [Pa]; `gap` (points,) volume strain by which
    the nodes are open beyond the apex [-], where psi > 0; `dilated` (points,) sum N d_i [-]; `slope` (seen,) share of K
    that nodes have in the tangent [-]; `own_share` of K with which a point follows its own volume strain in the
    assembled rows [-].
    """

    def __init__(self, state: Points, weights: Basis, seen: wp.array, halo: Halo, nodes: wp.array, held, material):
        """`seen`, `nodes` (points, 27): numbers of all nodes of the stencils, which `halo` shares with other ranks, and
        of those solved for; `held` (solved,) vec3: 1 for components that walls hold."""
        self.state, self.weights, self.material, self._nodes, self._held = state, weights, material, nodes, held
        self._ripple_share = ripple_share(material)
        self.own_share = OWN_SHARE * self._ripple_share
        self._halo, seen_count = halo, len(halo.counted)
        self._start = np.zeros(state.count + 1, np.int32)  # of a point's entries in the sparse matrices
        np.cumsum(weights.reach.numpy().prod(axis=1), out=self._start[1:])
        self._rows = wp.array(self._start[:-1], dtype=wp.int32, device="cpu")
        self._average = self._by_rows(seen, seen_count)
        self._gather = self._average.T
        self._weight_sum = self._sums(np.ones(state.count))
        self.deformation, self.volumetric = (self._zeros(state.count, mat33) for _ in range(2))
        self._det, self.nodal, self.gap, self.closed, self.filled = (self._zeros(state.count, real) for _ in range(5))
        self._theta, self._stress, self._opened, self.slope = (self._zeros(seen_count, real) for _ in range(4))
        self._strain_slopes = None

    @staticmethod
    def _zeros(shape, dtype):
        return wp.zeros(shape, dtype=dtype, device="cpu")

    def _by_rows(self, nodes, count):
        """Weights N as a sparse matrix (points, count)."""
        w, size = self.weights, int(self._start[-1])
        column, value = self._zeros(size, wp.int32), self._zeros(size, real)
        outputs = [self._rows, column, value]
        wp.launch(basis.weights_by_rows, self.state.count, inputs=[nodes, w.reach, w.weight, *outputs], device="cpu")
        return csr_matrix((value.numpy(), column.numpy(), self._start), shape=(self.state.count, count))

    def _sums(self, field):
        """sum N field of the nodes, over the points of all ranks."""
        sums = self._gather @ field
        self._halo.add(sums)
        return sums

    def _at_nodes(self, field):
        """sum N field/sum N of the nodes."""
        return self._sums(field) / self._weight_sum

    def _increments(self, field):
        """Volume strain increments of the nodes from those of the points, or of what changes them."""
        of_nodes = self._at_nodes(field)
        if self._ripple_share == 1.0:
            return of_nodes
        smooth = of_nodes
        for _ in range(SMOOTHINGS):
            smooth = self._at_nodes(self._average @ smooth)
        return smooth + self._ripple_share * (of_nodes - smooth)

    def deform(self, u: wp.array) -> bool:
        """Take the increment `u`; False where a point collapses."""
        w = self.weights
        seen = [u, self._nodes, w.reach, w.weight, w.slope, self.deformation, self._det]
        wp.launch(points.deform, self.state.count, inputs=seen, device="cpu")
        det = self._det.numpy()
        if not self._halo.comm.allreduce(det.min(initial=np.inf) > SMALLEST_STRETCH, MPI.LAND):
            return False
        self.dilated = self._average @ self._increments(np.log(det))
        self._theta.numpy()[:] = self._at_nodes(self.state.theta.numpy() + self.dilated)
        law = [self._theta, self.material, self._stress, self._opened]
        wp.launch(apply_node_law, self._theta.size, inputs=law, device="cpu")
        self.nodal.numpy()[:] = self._average @ self._stress.numpy()
        if self.material.eta_bar > 0.0:
            self.gap.numpy()[:] = self._average @ self._opened.numpy()
        return True

    def set_slopes(self, blend: float):
        """Share of K that nodes have in the tangent (`slope`), and points from theirs (`closed`).

        1 where a node is closed, `blend` where it is open.
        """
        law = [self._theta, self.material, real(blend), self.slope]
        wp.launch(node_slopes, self._theta.size, inputs=law, device="cpu")
        self.closed.numpy()[:] = self._average @ self.slope.numpy()

    def linearise(self):
        """Rows of the points for `coupling`, from `volumetric` as `tangent_flux` leaves it."""
        if self._strain_slopes is None:
            column = self._by_rows(self._nodes, len(self._held)).indices
            indices = (3 * column[:, None] + np.arange(3, dtype=np.int32)).ravel()
            shape = (self.state.count, 3 * len(self._held))
            self._slopes = [self._zeros(len(column), vec3) for _ in range(2)]
            self._strain_slopes, force_slopes = (
                csr_matrix((slopes.numpy().reshape(-1), indices, 3 * self._start), shape=shape)
                for slopes in self._slopes
            )
            self._push = force_slopes.T
        w = self.weights
        fields = [self._rows, self._held, self.deformation, self.volumetric, *self._slopes]
        seen = [self._nodes, w.reach, w.weight, w.slope]
        wp.launch(points.volume_slopes, self.state.count, inputs=[*seen, *fields], device="cpu")
        fill = self.filled.numpy()
        self._fill = fill if fill.any() else None
        closed = self.closed.numpy()
        self._own = self.own_share * (closed if self._fill is None else closed + fill * (1.0 - closed))

    def coupling(self, v: np.ndarray) -> np.ndarray:
        """What the tangent of the block rows lacks, times the flat `v` (3 nodes,) [m]: force (3 nodes,) [N]."""
        own = self._strain_slopes @ v
        theta = self._at_nodes(self._average @ self._increments(own))
        slope = self.slope.numpy()
        change = self._average @ (slope * theta)
        if self._fill is not None:
            change += self._fill * (self._average @ ((1.0 - slope) * theta))
        change -= self._own * own
        return self._push @ ((self.state.volume * self.material.bulk) * change)

    def commit(self):
        """Add the increment's volume strain to the points' state."""
        self.state.theta.numpy()[:] += self.dilated
        self.state.jacobian.numpy()[:] *= np.exp(self.dilated)
