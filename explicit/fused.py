"""The explicit step in four launches, for a GPU (see `explicit.kernels.fused`)."""

import warp as wp

from explicit.kernels.fused import BLOCK, fused_kernels
from explicit.kernels.layout import POINT_ARRAYS
from explicit.kernels.order import order_kernels
from explicit.kernels.warps import WARP

STEPS_PER_GRAPH = 10
SORT_BYTES = 16  # of a point: the cell it is sorted by and its number, both with as much room to sort them


class FusedStep:
    """What `ExplicitSolver` hands its steps over to on a GPU, for as long as its node arrays are the same ones.

    `phases`: the launches of a step, in order; `grid_energy`: the one that adds the kinetic energy of the nodes to the
    solver's `energy`. Sums that points add to are clean before a batch of steps; after it the node arrays are of its
    last step.

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
        self._start = self._command(k.start_steps, whole, setup, pencils, clock, plan, points, n, *watched, *sums)
        at_nodes = (s.walls, pencils, s.grid.pencil_of, s.node_momentum, s.node_mapped, s.energy)
        self.grid_energy = self._command(k.grid_energy, nodes, *at_nodes)
        nodes_and_back = [
            self._command(k.update_nodes, nodes, setup, s.walls, pencils, plan, clock, s.speed, s.grid.pencil_of, *sums,
                          *ready, self.node_volume, ledger),
            self._command(k.g2p2g, whole, setup, pencils, clock, points, order, n, *ready, ledger, *watched),
            self._command(k.strain_to_nodes, whole, setup, s.material, s.walls, pencils, clock, points, order, n,
                          s.node_mapped, self.node_volume, s.fault),
        ]  # fmt: skip
        law = (setup, s.material, pencils, clock, plan, points, n, self.node_volume, ledger, *watched)
        go_on, end = (self._command(k.stress_to_nodes, whole, *law, last, *sums) for last in (0, 1))
        self.phases, self._last = [*nodes_and_back, go_on], [*nodes_and_back, end]

    def take(self, steps: int):
        """A batch of steps, as replays of recorded ones (CUDA graphs on a GPU)."""
        self.start()
        tens, ones = divmod(steps - 1, STEPS_PER_GRAPH)
        for _ in range(tens):
            wp.capture_launch(self._graph("ten", STEPS_PER_GRAPH * self.phases))
        for _ in range(ones):
            wp.capture_launch(self._graph("one", self.phases))
        wp.capture_launch(self._graph("last", self._last))
        self.finish()

    def observe(self):
        """Energies of the points and the nodes, and a look at the points: into the solver's `energy` and `looked`."""
        if "row" not in self._graphs:
            with wp.ScopedCapture(device=self.device) as capture:
                self.solver.energy.zero_()
                self.solver.add_point_energy()
                self.grid_energy.launch()
                self.solver.device_look.launch()
            self._graphs["row"] = capture.graph
        wp.capture_launch(self._graphs["row"])

    def start(self):
        """What comes before the first step of a batch."""
        self._take_points.launch()
        self.sum_momentum.zero_()
        self.sum_force.zero_()
        self._start.launch()

    def finish(self):
        """What comes after the last step of a batch: the solver's arrays are up to date."""
        self._put_back.launch()

    def sort(self):
        """Order the points by the nodes that their stencils start at, those of one cell as in the body."""
        s, n = self.solver, self.solver.points
        inputs = [s.x, s.setup.inv_cell, s.pencils, self.cell_of, self._order]
        wp.launch(self.sort_kernels.number_cells, n, inputs=inputs, device=self.device)
        wp.utils.radix_sort_pairs(self.cell_of, self._order, n, end_bit=s.grid.capacity.bit_length())

    def _graph(self, name: str, phases: list):
        if name not in self._graphs:
            with wp.ScopedCapture(device=self.device) as capture:
                for phase in phases:
                    phase.launch()
            self._graphs[name] = capture.graph
        return self._graphs[name]
