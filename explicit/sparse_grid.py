"""Sparse grid storage: only nodes near material exist, as pencils (runs of nodes along z).

A dense table over the plan window holds one integer per (i, j); everything else scales with the nodes that
the points reach. Three nodes of one pencil are neighbours in memory, and finding them costs one look-up.
"""

import numpy as np
import warp as wp

from explicit.kernels.sparse_grid import (
    FOUND_SIZE,
    I_MAX,
    I_MIN,
    J_MAX,
    J_MIN,
    LAST,
    MARGIN,
    MOST_NODES,
    NODES,
    NODES_SHORT,
    SHORT,
    WINDOW_SHORT,
    sparse_grid_kernels,
)

WINDOW_SLACK = 8  # cells by which the plan window grows beyond need, so that it seldom has to
CAPACITY_SLACK = 1.2  # likewise for the node arrays


class SparseGrid:
    """Which nodes are stored, and where.

    `base` (window_i, window_j) int32: node (i, j, k) is stored at base[i - i0, j - j0] + k.
    `pencil_of` (capacity,) int32: the pencil a stored node belongs to. `found` (FOUND_SIZE,) int32: what the last fit
    found (see `explicit.kernels.sparse_grid`).
    """

    def __init__(self, real, cell: float, device):
        self.real, self.inv_cell, self.device = real, 1.0 / cell, device
        self.kernels = sparse_grid_kernels(real)
        self.i0 = self.j0 = self.capacity = 0
        self.found = wp.zeros(FOUND_SIZE, dtype=wp.int32, device=device)
        self._allocate_window((1, 1))
        self._allocate_nodes()

    @property
    def stored(self) -> int:
        """Nodes in use."""
        return int(self.found.numpy()[NODES])

    @property
    def most_stored(self) -> int:
        """The most nodes that were in use at a time."""
        return int(self.found.numpy()[MOST_NODES])

    @property
    def bytes(self) -> int:
        """Memory of the tables [bytes]."""
        return 4 * (8 * self.shape[0] * self.shape[1] + self.shape[0] + self.capacity)

    def follow(self, x: wp.array) -> bool:
        """Store the nodes that points `x` (n,) vec3 [m] need. True when arrays were made anew.

        The host looks at the device once, and once more where the points have left the window."""
        if not x.shape[0]:
            return self._store_nothing()
        renewed, found = False, self._fit_and_look(x)
        if found[SHORT] == WINDOW_SHORT:
            self._renew_window(found[[I_MIN, J_MIN]] - MARGIN, found[[I_MAX, J_MAX]] + LAST + MARGIN)
            renewed, found = True, self._fit_and_look(x)
        if found[SHORT] == NODES_SHORT:
            self.capacity = int(CAPACITY_SLACK * found[NODES])
            self._allocate_nodes()
            self.fit(x)
            renewed = True
        return renewed

    def _fit_and_look(self, x) -> np.ndarray:
        self.fit(x)
        return self.found.numpy().copy()

    def fit(self, x: wp.array):
        """Store the nodes that points `x` need where the window and the node arrays have room for them, and leave all
        as it is where they have not. What came of it is in `found`; the host does not look."""
        k, window, spans, pencils = self.kernels, self.shape, (self.low, self.high), (self.new_first, self.new_count)
        corner, place = (self.i0, self.j0), (self.start, self.found)
        self._launch(k.clear_fit, window, *spans, self.found)
        self._launch(k.point_spans, x.shape[0], x, self.real(self.inv_cell), *corner, *spans, self.found)
        self._launch(k.widen_spans, window, *spans, *pencils)
        self._launch(k.sum_rows, window[0], self.new_count, self.row_nodes)
        self._launch(k.place_rows, window[0], self.new_count, self.row_nodes, *corner, self.capacity, *place)
        self._launch(k.adopt, window, *pencils, *place, self.first, self.count, self.base, self.pencil_of)

    def reset_travel(self, clock: wp.array):
        """Say in `clock` (see `explicit.kernels.layout`) that points travel from where `fit` found them."""
        self._launch(self.kernels.reset_travel, 1, self.found, clock)

    def find_strays(self, x: wp.array, slack: int, fault: wp.array):
        """Report in `fault` (see `explicit.kernels.layout`) a point of `x` that needs nodes which are not stored, or
        with `slack` [cells] one that is farther than that from the plan window."""
        where = (x, self.real(self.inv_cell), self.i0, self.j0, self.first, self.count, slack)
        self._launch(self.kernels.find_strays, x.shape[0], *where, fault)

    def pencils(self) -> np.ndarray:
        """The stored pencils (m, 5), by i, then j: i, j, first k, last k + 1 and the number of node `first k`."""
        first, count, base = (array.numpy() for array in (self.first, self.count, self.base))
        i, j = np.nonzero(count > 0)
        low = first[i, j]
        return np.stack([i + self.i0, j + self.j0, low, low + count[i, j], base[i, j] + low], axis=1).astype(int)

    def _store_nothing(self) -> bool:
        """Tables of one pencil without nodes, for a rank that has no points."""
        self.i0 = self.j0 = self.capacity = 0
        self.found.zero_()
        self._allocate_window((1, 1))
        self._allocate_nodes()
        return True

    def _renew_window(self, low, high):
        self.i0, self.j0 = (int(index) - WINDOW_SLACK for index in low)
        shape = high + 1 + WINDOW_SLACK - (self.i0, self.j0)
        self._allocate_window((int(shape[0]), int(shape[1])))

    def _allocate_window(self, shape: tuple[int, int]):
        self.shape = shape
        self.first, self.count, self.base = self._tables(3)
        # Of a fit under way: ranges of the points, the pencils that these need, and where their nodes start.
        self.low, self.high, self.new_first, self.new_count, self.start = self._tables(5)
        self.row_nodes = wp.zeros(shape[0], dtype=wp.int32, device=self.device)

    def _tables(self, number: int) -> list[wp.array]:
        return [wp.zeros(self.shape, dtype=wp.int32, device=self.device) for _ in range(number)]

    def _allocate_nodes(self):
        self.pencil_of = wp.zeros(self.capacity, dtype=wp.int32, device=self.device)

    def _launch(self, kernel, dim, *inputs):
        wp.launch(kernel, dim, inputs=inputs, device=self.device)
