"""On how many MPI ranks the program was started; MPI itself is loaded only where there are several."""

import os

GPUS = "cuda"  # the name of a device that stands for a GPU for each rank
SIZES = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE")  # in which Open MPI and MPICH tell a process how many ranks there are


def count() -> int:
    """How many ranks the program was started on."""
    return max(int(os.environ.get(name, "1")) for name in SIZES)


def started() -> bool:
    """Whether this process is one of several ranks."""
    return count() > 1


def too_few_gpus(ranks: int, there: int, host: str = "this machine") -> str:
    """In words, that `host` has not a GPU for each of its `ranks`."""
    return f"--device {GPUS}: each of {ranks} ranks takes a GPU of its own, and {host} has {there or 'none'}"


def world():
    """The communicator of all ranks where the program was started on several; else None."""
    if not started():
        return None
    from mpi4py import MPI

    return MPI.COMM_WORLD
