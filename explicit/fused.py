"""The explicit step in four launches, for a GPU (see `explicit.kernels.fused`)."""

import warp as wp

from explicit.kernels.fused import BLOCK, GO_ON, MAY_FIT, STOP, fused_kernels
from explicit.kernels.layout import POINT_ARRAYS
from explicit.kernels.order import order_kernels
from explicit.kernels.warps import WARP

STEPS_PER_GRAPH = 10
SORT_BYTES = 16  # of a point: the cell it is sorted by and its number, both with as much room to sort them
FOR_EVER = 2.0**100  # [s]


class FusedStep:
    """What `ExplicitSolver` hands its steps over to on a GPU, for as long as its node arrays are the same ones.

    `phases`: the launches of a step, in order; `grid_energy`: the one that adds the kinetic energy of the nodes to the
    solver's `energy`. Sums that points add to are clean before a batch of steps; after it the node arrays are of its
    last step, and the tables of the stored nodes those that it was taken with.

    The stored nodes follow the points within a batch, by a branch of its graph; the host is asked only where there is
    no room for them (OUT_OF_NODES). Without `branches` (CUDA drivers before 12.4) a batch ends where they must.

    The solver's point arrays are in the body's order. A batch of steps works on copies, `points`, in the order of cells
    that `sort` found last; `order` (n,) has their numbers in the body. Points may leave their cells meanwhile, which
    costs time, not correctness.
    """

    def __init__(self, solver):
        self.solver, self.device = solver, solver.device
        self.k, self.sort_kernels = fused_kernels(solver.real), order_kernels(solver.real)
        n = solver.points
        self.points = solver.k.Points()
        for name in POINT_ARRAYS:
            setattr(self.points, name, wp.empty_like(getattr(solver, name)))
        # The first half of each counts, the sort needs the other.
        self.cell_of, self._order = (wp.zeros(2 * n, dtype=wp.int32, device=self.device) for _ in range(2))
        self.order = self._order[:n]
        nodes, k = solver.grid.capacity, solver.k
        self.sum_momentum = wp.zeros(nodes, dtype=k.vec4, device=self.device)
        self.sum_force = wp.zeros(nodes, dtype=k.vec4, device=self.device)
        self.node_volume = wp.zeros(nodes, dtype=k.vec4, device=self.device)
        self.until, self.due = solver._zeros(1, wp.float64), solver._zeros(1, wp.int32)
        self.branches = self.device.is_cpu or wp.is_conditional_graph_supported()
        self._graphs = {}
        self._record()

    @property
    def node_arrays(self) -> list[wp.array]:
        """Node arrays beside the solver's own."""
        return [self.sum_momentum, self.sum_force, self.node_volume]

    def _command(self, kernel, dim, *inputs):
        block = BLOCK if self.device.is_cuda else WARP  # the latter: Warp's block runtime on a CPU, in tests
        return wp.launch(kernel, dim, inputs=inputs, device=self.device, block_dim=block, record_cmd=True)

    def _record(self):
        """The launches, ready to be repeated."""
        s, k, pencils = self.solver, self.k, self.solver.pencils
        n, nodes = s.points, s.grid.capacity
        whole = -(-n // WARP) * WARP  # threads where those of a warp work together
        setup, clock, plan, ledger, watched = s.setup, s.clock, s.plan, s.ledger, (s.speed, s.fault)
        points, order = self.points, self.order
        sums, ready = (self.sum_momentum, self.sum_force), (s.node_momentum, s.node_force, s.node_mapped)
        self._take_points = self._command(self.sort_kernels.take_points, n, order, s.arrays, points)
        self._put_back = self._command(self.sort_kernels.put_back, n, order, points, s.arrays)
        start = (setup, pencils, clock, self.until, plan, points, n)
        self._start = self._command(k.start_steps, whole, *start, *watched, *sums)
        self._mark_due = self._command(k.mark_due, 1, setup, clock, self.until, *watched, self.due)
        at_nodes = (s.walls, pencils, s.grid.pencil_of, s.node_momentum, s.node_mapped, s.energy)
        self.grid_energy = self._command(k.grid_energy, nodes, *at_nodes)
        nodes_and_back = [
            self._command(k.update_nodes, nodes, setup, s.walls, pencils, plan, clock, s.speed, s.grid.pencil_of, *sums,
                          *ready, self.node_volume, ledger),
            self._command(k.g2p2g, whole, setup, pencils, clock, points, order, n, *ready, ledger, *watched),
            self._command(k.strain_to_nodes, whole, setup, s.material, s.walls, pencils, clock, points, order, n,
                          s.node_mapped, self.node_volume, s.fault),
        ]  # fmt: skip
        law = (setup, s.material, pencils, clock, self.until, plan, points, n, self.node_volume, ledger, *watched)
        self.phases, self._may_fit, self._last = (
            [*nodes_and_back, self._command(k.stress_to_nodes, whole, *law, then, self.due, *sums)]
            for then in (GO_ON, MAY_FIT, STOP)
        )

    def take(self, steps: int, until: float = FOR_EVER, stride: int = STEPS_PER_GRAPH):
        """A batch of at most so many steps, as replays of recorded ones (CUDA graphs on a GPU), none from time `until`
        [s] on; the stored nodes may follow the points every `stride` steps, 1 or STEPS_PER_GRAPH."""
        self.start(until)
        tens, ones = divmod(steps - 1, STEPS_PER_GRAPH) if stride == STEPS_PER_GRAPH else (0, steps - 1)
        for _ in range(tens):
            self._replay("ten", lambda: self._steps(STEPS_PER_GRAPH))
        for _ in range(ones):
            self._replay("one", lambda: self._steps(1))
        self._replay("last", lambda: _launch(self._last))
        self.finish()

    def start(self, until: float = FOR_EVER):
        """What comes before the first step of a batch."""
        self.until.fill_(until)
        self._replay("start", self._fit_clear_and_start)

    def finish(self):
        """What comes after the last step of a batch: the solver's arrays are up to date."""
        self._put_back.launch()

    def sort(self):
        """Order the points by the nodes that their stencils start at, those of one cell as in the body."""
        s, n = self.solver, self.solver.points
        inputs = [s.x, s.setup.inv_cell, s.pencils, self.cell_of, self._order]
        wp.launch(self.sort_kernels.number_cells, n, inputs=inputs, device=self.device)
        wp.utils.radix_sort_pairs(self.cell_of, self._order, n, end_bit=s.grid.capacity.bit_length())

    def observe(self):
        """Energies of the points and the nodes, and a look at the points: into the solver's `figures`."""
        self._replay("row", self._observe)

    def _steps(self, steps: int):
        """Steps within a batch, after which the stored nodes follow the points where they must."""
        if not self.branches:
            _launch(steps * self.phases)
            return
        _launch((steps - 1) * self.phases + self._may_fit)
        wp.capture_if(self.due, self._fit_and_start)

    def _fit_and_start(self):
        """The sums are clean: the step before has added nothing to them."""
        self._put_back.launch()
        self._fit()
        self._take_points.launch()
        self._start.launch()

    def _fit(self):
        self.solver.grid.fit(self.solver.x)
        self.solver.grid.reset_travel(self.solver.clock)
        self.sort()

    def _fit_clear_and_start(self):
        if self.branches:
            self._mark_due.launch()
            wp.capture_if(self.due, self._fit)
        self._take_points.launch()
        self.sum_momentum.zero_()
        self.sum_force.zero_()
        self._start.launch()

    def _observe(self):
        self.solver.energy.zero_()
        self.solver.add_point_energy()
        self.grid_energy.launch()
        self.solver.device_look.launch()

    def _replay(self, name: str, record):
        """What `record()` launches, recorded once."""
        if name not in self._graphs:
            with wp.ScopedCapture(device=self.device) as capture:
                record()
            self._graphs[name] = capture.graph
        wp.capture_launch(self._graphs[name])


def _launch(commands):
    for command in commands:
        command.launch()
