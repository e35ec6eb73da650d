"""Sparse grid storage: only nodes near material exist, as pencils (runs of nodes along z).

A dense table over the plan window holds one integer per (i, j); everything else scales with the nodes that
the points reach. Three nodes of one pencil are neighbours in memory, and finding them costs one look-up.
"""

import numpy as np
import warp as wp

from explicit.kernels.sparse_grid import EMPTY, LAST, MARGIN, sparse_grid_kernels

WINDOW_SLACK = 8  # cells by which the plan window grows beyond need, so that it seldom has to
CAPACITY_SLACK = 1.2  # likewise for the node arrays


class SparseGrid:
    """Which nodes are stored, and where.

    `base` (window_i, window_j) int32: node (i, j, k) is stored at base[i - i0, j - j0] + k.
    `pencil_of` (capacity,) int32: the pencil a stored node belongs to. `stored`: nodes in use.
    """

    def __init__(self, real, cell: float, device):
        self.real, self.inv_cell, self.device = real, 1.0 / cell, device
        self.kernels = sparse_grid_kernels(real)
        self.i0 = self.j0 = 0
        self.shape = (0, 0)
        self.stored = self.capacity = 0
        self.pencil_of: wp.array | None = None

    @property
    def bytes(self) -> int:
        """Memory of the tables [bytes]."""
        return 4 * (5 * self.shape[0] * self.shape[1] + self.capacity)

    def follow(self, x: wp.array) -> bool:
        """Store the nodes that points `x` (n,) vec3 [m] need. True when arrays were made anew."""
        if not x.shape[0]:
            return self._store_nothing()
        renewed = self._fit_window(x)
        k, spans = self.kernels, [self.low, self.high]
        self._launch(k.clear_spans, self.shape, spans)
        self._launch(k.point_spans, x.shape[0], [x, self.real(self.inv_cell), self.i0, self.j0, *spans])
        self._launch(k.widen_spans, self.shape, [*spans, self.first, self.count])
        wp.utils.array_scan(self.count.flatten(), self.base.flatten(), inclusive=False)
        last = [self.base.flatten()[-1:].numpy()[0], self.count.flatten()[-1:].numpy()[0]]
        self.stored = int(sum(last))
        self._launch(k.shift_base, self.shape, [self.first, self.base])
        if self.stored > self.capacity:
            self.capacity = int(CAPACITY_SLACK * self.stored)
            self.pencil_of = wp.zeros(self.capacity, dtype=wp.int32, device=self.device)
            renewed = True
        self._launch(k.label_nodes, self.shape, [self.first, self.count, self.base, self.pencil_of])
        return renewed

    def find_strays(self, x: wp.array, slack: int, fault: wp.array):
        """Report in `fault` (see `explicit.kernels.layout`) a point of `x` that needs nodes which are not stored, or
        with `slack` [cells] one that is farther than that from the plan window."""
        where = [x, self.real(self.inv_cell), self.i0, self.j0, self.first, self.count, slack]
        self._launch(self.kernels.find_strays, x.shape[0], [*where, fault])

    def pencils(self) -> np.ndarray:
        """The stored pencils (m, 5), by i, then j: i, j, first k, last k + 1 and the number of node `first k`."""
        first, count, base = (array.numpy() for array in (self.first, self.count, self.base))
        i, j = np.nonzero(count > 0)
        low = first[i, j]
        return np.stack([i + self.i0, j + self.j0, low, low + count[i, j], base[i, j] + low], axis=1).astype(int)

    def _store_nothing(self) -> bool:
        """Tables of one pencil without nodes, for a rank that has no points."""
        self.i0 = self.j0 = self.stored = self.capacity = 0
        self._allocate_window((1, 1))
        self.pencil_of = wp.zeros(0, dtype=wp.int32, device=self.device)
        return True

    def _fit_window(self, x) -> bool:
        start = np.array([EMPTY, EMPTY, -EMPTY, -EMPTY], dtype=np.int32)
        bounds = wp.array(start, dtype=wp.int32, device=self.device)
        self._launch(self.kernels.plan_bounds, x.shape[0], [x, self.real(self.inv_cell), bounds])
        i_min, j_min, i_max, j_max = (int(value) for value in bounds.numpy())
        low_i, low_j = i_min - MARGIN, j_min - MARGIN
        high_i, high_j = i_max + LAST + MARGIN, j_max + LAST + MARGIN
        inside = low_i >= self.i0 and low_j >= self.j0
        if inside and high_i < self.i0 + self.shape[0] and high_j < self.j0 + self.shape[1]:
            return False
        self.i0, self.j0 = low_i - WINDOW_SLACK, low_j - WINDOW_SLACK
        self._allocate_window((high_i - self.i0 + 1 + WINDOW_SLACK, high_j - self.j0 + 1 + WINDOW_SLACK))
        return True

    def _allocate_window(self, shape: tuple[int, int]):
        self.shape = shape
        self.low, self.high, self.first, self.count, self.base = (
            wp.zeros(shape, dtype=wp.int32, device=self.device) for _ in range(5)
        )

    def _launch(self, kernel, dim, inputs):
        wp.launch(kernel, dim, inputs=inputs, device=self.device)
