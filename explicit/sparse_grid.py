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
        self._allocate_window((1, 1))
        self.stored = self.capacity = 0
        self.pencil_of: wp.array | None = None
        # Of the points: smallest i and j, largest i and j; of the nodes: how many.
        self._nothing_found = wp.array([EMPTY, EMPTY, -EMPTY, -EMPTY, 0], dtype=wp.int32, device=device)
        self._found = wp.empty_like(self._nothing_found)

    @property
    def bytes(self) -> int:
        """Memory of the tables [bytes]."""
        return 4 * (5 * self.shape[0] * self.shape[1] + self.capacity)

    def follow(self, x: wp.array) -> bool:
        """Store the nodes that points `x` (n,) vec3 [m] need. True when arrays were made anew."""
        if not x.shape[0]:
            return self._store_nothing()
        renewed = False
        low, high, stored = self._find_nodes(x)
        if not self._holds(low, high):
            self._renew_window(low, high)
            renewed = True
            _low, _high, stored = self._find_nodes(x)
        self.stored = stored
        if self.stored > self.capacity:
            self.capacity = int(CAPACITY_SLACK * self.stored)
            self.pencil_of = wp.zeros(self.capacity, dtype=wp.int32, device=self.device)
            renewed = True
        self._launch(self.kernels.label_nodes, self.shape, [self.first, self.count, self.base, self.pencil_of])
        return renewed

    def _find_nodes(self, x) -> tuple[np.ndarray, np.ndarray, int]:
        """Fill the tables of the window for points `x`: its first and last pencil that these need, (i, j) each, and
        how many nodes those of them have that lie in the window. The host looks at the device once."""
        k, spans, real_inv_cell = self.kernels, [self.low, self.high], self.real(self.inv_cell)
        wp.copy(self._found, self._nothing_found)
        self._launch(k.plan_bounds, x.shape[0], [x, real_inv_cell, self._found])
        self._launch(k.clear_spans, self.shape, spans)
        self._launch(k.point_spans, x.shape[0], [x, real_inv_cell, self.i0, self.j0, *spans])
        self._launch(k.widen_spans, self.shape, [*spans, self.first, self.count])
        wp.utils.array_scan(self.count.flatten(), self.base.flatten(), inclusive=False)
        self._launch(k.shift_base, self.shape, [self.first, self.count, self.base, self._found])
        found = self._found.numpy().copy()
        return found[:2] - MARGIN, found[2:4] + LAST + MARGIN, int(found[4])

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

    def _holds(self, low, high) -> bool:
        start = np.array([self.i0, self.j0])
        return bool(np.all(low >= start) and np.all(high < start + self.shape))

    def _renew_window(self, low, high):
        self.i0, self.j0 = (int(index) - WINDOW_SLACK for index in low)
        shape = high + 1 + WINDOW_SLACK - (self.i0, self.j0)
        self._allocate_window((int(shape[0]), int(shape[1])))

    def _allocate_window(self, shape: tuple[int, int]):
        self.shape = shape
        self.low, self.high, self.first, self.count, self.base = (
            wp.zeros(shape, dtype=wp.int32, device=self.device) for _ in range(5)
        )

    def _launch(self, kernel, dim, inputs):
        wp.launch(kernel, dim, inputs=inputs, device=self.device)
