"""The step of one of several ranks on a GPU: CUDA graphs between exchanges, whose sums travel by way of the host.

What a rank has of the nodes that it shares a kernel packs into one buffer. That is copied to pinned memory of the host,
from where MPI takes it; what other ranks have comes back likewise, and a kernel adds it up in the order of ranks. An
MPI that reads a GPU's memory itself would save the copies, but mpi4py has no sure way to ask for that.
"""

import numpy as np
import warp as wp

from explicit.dials import Seen
from explicit.kernels.halo import halo_kernels
from mpm.domains import Halo, exchange

SLACK = 1.2  # by which buffers are larger than needed, so that they are seldom made anew


class Buffers:
    """Room for what is sent and received: numbers on `device`, and as many in memory of the host, pinned for a GPU.

    One exchange at a time uses it: its copies to the host have ended before MPI reads and writes there.
    """

    def __init__(self, real, device):
        self.real, self.device = real, device
        self.size = 0

    def hold(self, size: int):
        """Make room for `size` numbers each way, where there is less; sums that were made before lose theirs."""
        if size <= self.size:
            return
        self.size = int(SLACK * size)
        self.sent, self.received = (wp.empty(self.size, dtype=self.real, device=self.device) for _ in range(2))
        self.sent_here, self.received_here = (
            wp.empty(self.size, dtype=self.real, device="cpu", pinned=self.device.is_cuda) for _ in range(2)
        )


class StagedSum:
    """Replaces what node arrays hold of the shared nodes by the sums over all ranks, as `mpm.domains.Halo.add` does.

    `pack`, `add`: the launches before `fetch` and after `carry`; none where no nodes are shared. Between `fetch` and
    `carry` the device is waited for.
    """

    def __init__(self, halo: Halo, arrays, clock: wp.array, buffers: Buffers):
        """`arrays`: one or two of (nodes,) numbers or vectors of `buffers.real`."""
        self.comm, self.buffers, real, device = halo.comm, buffers, buffers.real, buffers.device
        self.pack, self.add, self.peers = [], [], []
        if not halo.peers:
            return
        nothing = wp.empty((0, 0), dtype=real, device=device)
        first, second = [*(array.view(real).reshape((len(array), -1)) for array in arrays), nothing][:2]
        count, width = halo.sent, first.shape[1] + second.shape[1]
        self.size = count * width
        ends = width * np.cumsum([0, *(len(at) for _, at in halo.peers)])
        self.peers = [(rank, slice(*ends[k : k + 2])) for k, (rank, _) in enumerate(halo.peers)]
        sent, received = (flat[: self.size].reshape((count, width)) for flat in (buffers.sent, buffers.received))
        k = halo_kernels(real)

        def command(kernel, dim, *inputs):
            return wp.launch(kernel, dim, inputs=inputs, device=device, record_cmd=True)

        listed = (np.concatenate([at for _, at in halo.peers]), halo.nodes, *contributions(halo))
        self._listed = at, nodes, starts, rows = [wp.array(each, dtype=wp.int32, device=device) for each in listed]
        self.pack = [command(k.pack, (count, width), first, second, at, sent)]
        summed = (clock, first, second, nodes, starts, rows, received)
        self.add = [command(k.add_up, (len(halo.nodes), width), *summed)]

    def fetch(self):
        """Start the copy of what was packed to the host."""
        if self.peers:
            wp.copy(self.buffers.sent_here, self.buffers.sent, count=self.size)

    def carry(self):
        """Exchange it with the other ranks, and start the copy of what came to the device."""
        if not self.peers:
            return
        sent, received = (here.numpy() for here in (self.buffers.sent_here, self.buffers.received_here))
        exchange(*([(rank, flat[part]) for rank, part in self.peers] for flat in (sent, received)), self.comm)
        wp.copy(self.buffers.received, self.buffers.received_here, count=self.size)


def contributions(halo: Halo) -> tuple[np.ndarray, np.ndarray]:
    """For each of the shared nodes, `halo.nodes`, the rows of what has come that are of it, in the order of ranks, and
    among them -1 for this rank: where a node's begin, with the end of all, and the rows themselves."""
    own = len(halo.nodes)
    places = np.concatenate([np.arange(own), *(np.searchsorted(halo.nodes, at) for _, at in halo.peers)])
    ranks = np.repeat([halo.comm.rank, *(rank for rank, _ in halo.peers)], [own, *(len(at) for _, at in halo.peers)])
    rows = np.concatenate([np.full(own, -1), np.arange(len(places) - own)])
    order = np.lexsort((ranks, places))
    return np.searchsorted(places[order], np.arange(own + 1)), rows[order]


class StagedStep:
    """The step of a domain (`explicit.ranks.Domain`), for as long as its nodes and those that it shares are the same.

    It waits for the device at each exchange. With the last of them the host sees clock, speeds and faults.
    """

    def __init__(self, domain, buffers: Buffers):
        self.domain, self.device = domain, domain.device
        summed = [phase.summed for phase in domain.phases if phase.summed]
        width = max(sum(wp.types.type_size(each.dtype) for each in arrays) for arrays in summed)
        buffers.hold(domain.halo.sent * width)
        self.sums = [StagedSum(domain.halo, arrays, domain.clock, buffers) for arrays in summed]
        launches: list[list[wp.Launch]] = [[]]  # between exchanges
        for phase in domain.phases:
            launches[-1] += [phase.command] if phase.command else []
            if phase.summed:
                launches.append([])
        for before, total, after in zip(launches, self.sums, launches[1:], strict=False):
            before += total.pack
            after[:0] = total.add
        self._launches, self._graphs = launches, {}
        self._dials_here = wp.empty(len(domain.dials.bytes), dtype=wp.uint8, device="cpu", pinned=self.device.is_cuda)

    def take(self) -> Seen:
        """One step of a length that may be zero; what the host sees of it."""
        dials = self.domain.dials
        for number, total in enumerate(self.sums):
            self._run(number)
            total.fetch()
            if total is self.sums[-1]:
                wp.copy(self._dials_here, dials.bytes)
            wp.synchronize_device(self.device)
            total.carry()
        self._run(len(self.sums))
        return dials.named(self._dials_here.numpy())

    def _run(self, number: int):
        """What lies between two exchanges, as replays of what was recorded (CUDA graphs on a GPU)."""
        if not self._launches[number]:
            return
        if number not in self._graphs:
            with wp.ScopedCapture(device=self.device) as capture:
                for launch in self._launches[number]:
                    launch.launch()
            self._graphs[number] = capture.graph
        wp.capture_launch(self._graphs[number])
