"""What ranks on this machine need to tell each other something: `python -m compare.bench.exchange ANSWER` on two ranks.

ANSWER: the file that the figures are written to, as JSON: see `measure`.
"""

import json
import sys
import time
from pathlib import Path

import numpy as np

SMALL, LARGE = 8, 1 << 18  # bytes of a message that shows the latency, and of one like a halo's
REPEATS = 300
HEIGHT = 16  # nodes of a pencil that two ranks share here
FEW, MANY = 1, 256  # such pencils


def measure(comm) -> dict[str, float]:
    """Figures of a pair of ranks, the best of many times each.

    latency [s] and bandwidth [bytes/s] of a message, each way; handling [s]: what adding up the nodes of one pencil
    takes beyond its message; packing [bytes/s]: at which those of many are gathered, and added again.
    """
    latency = ping_pong(comm, SMALL)
    bandwidth = LARGE / (ping_pong(comm, LARGE) - latency)
    handling = halo_sum(comm, FEW) - latency
    size = MANY * HEIGHT * 8 * 8
    packing = 2.0 * size / (halo_sum(comm, MANY) - latency - handling - size / bandwidth)
    return {"latency": latency, "bandwidth": bandwidth, "handling": handling, "packing": packing}


def ping_pong(comm, size: int) -> float:
    """Seconds that a message of `size` bytes takes from one rank to the other."""
    message, other = np.zeros(size, np.uint8), 1 - comm.rank
    best = float("inf")
    for _ in range(REPEATS):
        comm.Barrier()
        start = time.perf_counter()
        if comm.rank == 0:
            comm.Send(message, other)
            comm.Recv(message, other)
        else:
            comm.Recv(message, other)
            comm.Send(message, other)
        best = min(best, time.perf_counter() - start)
    return 0.5 * best


def halo_sum(comm, pencils: int) -> float:
    """Seconds in which two arrays of four float64 a node are added up over both ranks, which share so many pencils."""
    from mpm.domains import Halo, shared_pencils

    number = np.arange(pencils)
    zero = np.zeros(pencils, int)
    stored = np.stack([number, zero, zero, zero + HEIGHT, number * HEIGHT], axis=1)
    halo = Halo(shared_pencils(stored, comm), pencils * HEIGHT, comm)
    arrays = [np.zeros((pencils * HEIGHT, 4)) for _ in range(2)]
    best = float("inf")
    for _ in range(REPEATS):
        comm.Barrier()
        start = time.perf_counter()
        halo.add(*arrays)
        best = min(best, time.perf_counter() - start)
    return best


if __name__ == "__main__":
    from mpi4py import MPI

    figures = measure(MPI.COMM_WORLD)
    if MPI.COMM_WORLD.rank == 0:
        Path(sys.argv[1]).write_text(json.dumps(figures), encoding="utf-8")
