"""Domains of a run on several ranks: which rank computes where, and sums over the nodes that ranks share.

The plan is cut by recursive bisection along x and y (Berger and Bokhari 1987) into rectangles of pencils, runs of nodes
along z, that hold about as many points each. A rank stores the nodes that its own points reach; where two ranks store a
node, both add up what both have of it, in the order of ranks, and so hold the same number to the last bit.
"""

import sys
import time
from typing import NamedTuple

import numpy as np

PATIENCE = 30.0  # seconds that a rank waits for others before it says so
UNEVEN = 1.05  # points of the heaviest rank over the mean, beyond which the plan is cut anew


class Cut(NamedTuple):
    """Pencils with index below `at` along `axis` (0: x, 1: y) go to `low`, the others to `high`: a cut, or a rank."""

    axis: int
    at: int
    low: "Cut | int"
    high: "Cut | int"


def cut_plan(columns, weights, ranks: int, first: int = 0) -> Cut | int:
    """Cut the plan for `ranks` ranks, the first of them numbered `first`.

    `columns` (m, 2) int: index along x and y of pencils at which stencils start; `weights` (m,): points there. A rank
    can end up without any where there are fewer columns than ranks.
    """
    if ranks == 1:
        return first
    left = ranks // 2
    axis = int(np.argmax(np.ptp(columns, axis=0))) if len(columns) else 0
    index, where = np.unique(columns[:, axis], return_inverse=True)
    below = np.cumsum(np.bincount(where.ravel(), weights, minlength=len(index)))
    wanted = below[-1] * left / ranks if len(below) else 0.0
    # The cut after the index that leaves the share of `left` ranks below it, as nearly as whole pencils allow.
    at = int(index[np.argmin(np.abs(below - wanted))]) + 1 if len(index) else 0
    lower = columns[:, axis] < at
    return Cut(
        axis,
        at,
        cut_plan(columns[lower], weights[lower], left, first),
        cut_plan(columns[~lower], weights[~lower], ranks - left, first + left),
    )


def owner_of(columns, cut: Cut | int) -> np.ndarray:
    """The rank (m,) of each of the `columns` (m, 2); every column, stored or not, has one."""
    owner = np.empty(len(columns), dtype=int)
    if isinstance(cut, int):
        owner[:] = cut
        return owner
    lower = columns[:, cut.axis] < cut.at
    owner[lower] = owner_of(columns[lower], cut.low)
    owner[~lower] = owner_of(columns[~lower], cut.high)
    return owner


def histogram(columns, comm) -> tuple[np.ndarray, np.ndarray]:
    """Columns that hold points on any rank (m, 2), and how many points (m,); the same on all ranks."""
    mine = np.unique(columns, axis=0, return_counts=True) if len(columns) else (np.zeros((0, 2), int), np.zeros(0, int))
    parts = comm.allgather(mine)
    together, which = np.unique(np.concatenate([part[0] for part in parts]), axis=0, return_inverse=True)
    return together, np.bincount(which.ravel(), np.concatenate([part[1] for part in parts]), len(together))


class Halo:
    """The nodes that this rank shares with others.

    `counted` (nodes,) int32: 1 for the nodes that this rank answers for, those that no lower rank stores: sums over all
    nodes of all ranks count each once.
    """

    def __init__(self, peers: list[tuple[int, np.ndarray]], nodes: int, comm):
        """`peers`: the other ranks that share nodes with this one, in order, and the numbers of these nodes here, in an
        order that both have (see `shared_pencils`, `shared_nodes`); `nodes`: length of node arrays."""
        self.comm, self.peers = comm, peers
        self.nodes = np.unique(np.concatenate([at for _, at in self.peers])) if self.peers else np.zeros(0, int)
        self.counted = np.ones(nodes, np.int32)
        for rank, at in self.peers:
            if rank < comm.rank:
                self.counted[at] = 0
        # Ranks in order, this one among them, with the places of their nodes in `nodes`; None: all of them.
        places = [
            (rank, None if np.array_equal(at, self.nodes) else np.searchsorted(self.nodes, at))
            for rank, at in self.peers
        ]
        self._order = sorted([*places, (comm.rank, None)], key=lambda item: item[0])
        self._buffers: dict[tuple, tuple] = {}

    @property
    def sent(self) -> int:
        """Nodes whose numbers go out in an exchange; one goes to each rank that stores it."""
        return sum(len(at) for _, at in self.peers)

    def add(self, *arrays):
        """Replace what `arrays`, each (nodes, w) or (nodes,), hold of the shared nodes by the sums over all ranks."""
        if not self.peers:
            return
        own, sent, received, inbox = self._room(arrays)

        def packed():
            for rank, at in self.peers:
                for array, part in zip(arrays, sent[rank][1], strict=True):
                    np.take(array, at, axis=0, out=part, mode="clip")  # "raise" would copy
                yield rank, sent[rank][0]

        for array, mine in zip(arrays, own[1], strict=True):
            np.take(array, self.nodes, axis=0, out=mine, mode="clip")
        exchange(packed(), inbox, self.comm)
        for k, array in enumerate(arrays):
            parts = {self.comm.rank: own[1][k]} | {rank: received[rank][1][k] for rank, _ in self.peers}
            array[self.nodes] = self._sum(parts)

    def _sum(self, parts):
        """Sum of what each rank has of the shared nodes, in the order of ranks."""
        (first, places), *others = self._order
        if places is None:
            total = parts[first]
        else:
            total = np.zeros_like(parts[self.comm.rank])
            total[places] = parts[first]
        for rank, places in others:
            if places is None:
                total = total + parts[rank]
            else:
                total[places] += parts[rank]
        return total

    def _room(self, arrays):
        """Buffers of the size of what `arrays` have of the shared nodes, kept from step to step: for this rank, to send
        and to receive, each a flat one and the parts of it for each array; ranks with the flat ones they fill."""
        key = tuple((array.shape[1:], array.dtype) for array in arrays)
        if key not in self._buffers:

            def room(count):
                widths = [int(np.prod(array.shape[1:], dtype=int)) for array in arrays]
                flat = np.empty(count * sum(widths), arrays[0].dtype)
                ends = np.cumsum([count * width for width in widths])
                parts = np.split(flat, ends[:-1])
                return flat, [part.reshape(count, *array.shape[1:]) for part, array in zip(parts, arrays, strict=True)]

            sent, received = ({rank: room(len(at)) for rank, at in self.peers} for _ in range(2))
            inbox = [(rank, flat) for rank, (flat, _) in received.items()]
            self._buffers[key] = room(len(self.nodes)), sent, received, inbox
        return self._buffers[key]


class Ownership:
    """Exchange between ranks that own entries of an array (nodes, blocks of a matrix) and those that have parts or
    copies of them."""

    def __init__(self, mine, theirs, comm):
        """`mine`: other ranks, in order, and the numbers here of what this one owns and they have too; `theirs`: ranks
        and the numbers here of what they own. Both ranks of a pair have these in the same order."""
        self.comm = comm
        self.mine, self.theirs = ([(rank, at) for rank, at in side if len(at)] for side in (mine, theirs))

    def collect(self, array):
        """Add to what this rank owns of `array` (n, ...) what others have of it, in the order of ranks."""
        for at, part in self._exchanged(array, self.theirs, self.mine):
            array[at] += part

    def spread(self, array):
        """Give others what this rank owns of `array` (n, ...), and take what they own."""
        for at, part in self._exchanged(array, self.mine, self.theirs):
            array[at] = part

    def _exchanged(self, array, sent, received):
        parts = [(at, np.empty((len(at), *array.shape[1:]), array.dtype)) for _, at in received]
        leaving = ((rank, np.take(array, at, axis=0)) for rank, at in sent)
        exchange(leaving, [(rank, part) for (rank, _), (_, part) in zip(received, parts, strict=True)], self.comm)
        return parts


def exchange(sent, received, comm):
    """Send each of `sent`, pairs of rank and array, which may be made as it goes; fill each of `received`, likewise.
    Back when all is done."""
    ranks, waiting = [rank for rank, _ in received], [comm.Irecv(array, rank) for rank, array in received]
    for rank, array in sent:
        ranks.append(rank)
        waiting.append(comm.Isend(array, rank))
    if waiting:
        _wait(waiting, ranks, comm)


def _wait(requests, ranks, comm):
    """Wait for messages from or to `ranks`, one a request; say for which ranks where it takes long: one that was
    stopped or has lost its host is found by what the others wait for."""
    since, told, all_done = time.monotonic(), False, type(requests[0]).Testall
    while not all_done(requests):
        if not told and time.monotonic() - since > PATIENCE:
            late = sorted({rank for rank, request in zip(ranks, requests, strict=True) if not request.Test()})
            if late:  # none: the last message has just arrived
                told = True
                whom = " and ".join(f"rank {rank}" for rank in late)
                said = f"rank {comm.rank} waits for {whom}, for {PATIENCE:.0f} s now\n"
                print(said, end="", file=sys.stderr, flush=True)  # in one write: ranks would write into lines of others


def shared_pencils(pencils, comm) -> list[tuple[int, np.ndarray]]:
    """Ranks that store nodes that this one stores too, and their numbers here, pencil by pencil.

    `pencils` (m, 5) int, by i, then j: i, j, first k, last k + 1 and number of node `first k` of each pencil here.
    """
    mine = {(i, j): (low, high, start) for i, j, low, high, start in pencils.tolist()}

    def in_common(theirs):
        shared = [np.zeros(0, int)]
        for i, j, low, high, _ in theirs.tolist():
            if (i, j) in mine:
                first, last, start = mine[i, j]
                low, high = max(low, first), min(high, last)
                shared.append(np.arange(low, max(low, high)) - first + start)
        return np.concatenate(shared)

    return _peers(pencils, in_common, comm)


def shared_nodes(keys, comm) -> list[tuple[int, np.ndarray]]:
    """Ranks that store nodes that this one stores too, and their numbers here, by key.

    `keys` (nodes,) int, each once: what a node is called on every rank.
    """
    return _peers(keys, lambda theirs: np.intersect1d(keys, theirs, assume_unique=True, return_indices=True)[1], comm)


def _peers(stored, in_common, comm):
    """The other ranks, and what `in_common` finds in what they have `stored`, where that is anything."""
    found = ((rank, in_common(theirs)) for rank, theirs in enumerate(comm.allgather(stored)) if rank != comm.rank)
    return [(rank, nodes) for rank, nodes in found if len(nodes)]


def migrate(rows: dict[str, np.ndarray], owner, comm) -> dict[str, np.ndarray]:
    """Send each point's row of every array in `rows` to its `owner` (n,); the rows that are this rank's now.

    Points come in the order of "id", one of the rows, so that the order does not tell where they came from.
    """
    sent = [{name: array[owner == rank] for name, array in rows.items()} for rank in range(comm.size)]
    parts = comm.alltoall(sent)
    joined = {name: np.concatenate([part[name] for part in parts]) for name in rows}
    order = np.argsort(joined["id"], kind="stable")
    return {name: array[order] for name, array in joined.items()}
