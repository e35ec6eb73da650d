"""Threads that stand for MPI ranks, in one process."""

import threading


class Ranks:
    """Threads as the ranks of a communicator that can gather what each has."""

    def __init__(self, size):
        self.size, self.barrier, self.parts = size, threading.Barrier(size, timeout=60), [None] * size

    def all(self, call, parts):
        """What `call(part, comm)` gives on each rank."""
        given = [None] * self.size

        def work(rank):
            given[rank] = call(parts[rank], Rank(self, rank))

        threads = [threading.Thread(target=work, args=(rank,)) for rank in range(self.size)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        return given


class Rank:
    def __init__(self, ranks, rank):
        self.ranks, self.rank, self.size = ranks, rank, ranks.size

    def Split_type(self, _kind):
        """The ranks of this one's host: all."""
        return self

    def Free(self):
        """A communicator of threads holds nothing."""

    def allgather(self, part):
        self.ranks.parts[self.rank] = part
        self.ranks.barrier.wait()
        parts = list(self.ranks.parts)
        self.ranks.barrier.wait()
        return parts
