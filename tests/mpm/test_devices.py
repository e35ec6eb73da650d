"""Devices by name: of one process, and of ranks that take a GPU each."""

import importlib.util
from types import SimpleNamespace

import pytest
import warp as wp
from threads_as_ranks import Ranks

from mpm.devices import device_of_rank, find_device, gpu_count
from mpm.errors import SceneError


def gpus(*uuids):
    return [SimpleNamespace(alias=f"cuda:{k}", uuid=uuid, is_cuda=True) for k, uuid in enumerate(uuids)]


@pytest.fixture
def machine(monkeypatch):
    """`machine(*uuids)`: give this machine such GPUs."""

    def make(*uuids):
        there = [SimpleNamespace(alias="cpu", is_cuda=False), *gpus(*uuids)]
        monkeypatch.setattr(wp, "get_devices", lambda: there)

    return make


def of_ranks(size, name):
    """Alias of the device that each of so many ranks gets, or what it raises."""

    def one(_part, comm):
        try:
            return device_of_rank(name, comm).alias
        except SceneError as error:
            return str(error)

    return Ranks(size).all(one, range(size))


def test_a_device_has_a_name(machine):
    machine("GPU-a", "GPU-b")
    assert [find_device(name).alias for name in ("cpu", "cuda:1", "cuda")] == ["cpu", "cuda:1", "cuda:0"]
    assert gpu_count() == 2
    with pytest.raises(SceneError, match="--device cuda:2: no such device; this machine has: cpu, cuda:0, cuda:1"):
        find_device("cuda:2")
    machine()
    with pytest.raises(SceneError, match="--device cuda: no such device; this machine has: cpu"):
        find_device("cuda")


needs_mpi = pytest.mark.skipif(
    importlib.util.find_spec("mpi4py") is None, reason="no mpi4py: it comes with dolfinx (see ./repose info)"
)


@needs_mpi
def test_ranks_of_a_host_take_a_gpu_each_in_their_order(machine):
    machine("GPU-a", "GPU-b", "GPU-c")
    assert of_ranks(3, "cuda") == ["cuda:0", "cuda:1", "cuda:2"]
    assert of_ranks(2, "cuda") == ["cuda:0", "cuda:1"]
    assert of_ranks(2, "cpu") == ["cpu", "cpu"]
    assert of_ranks(2, "cuda:1") == ["cuda:1", "cuda:1"]


@needs_mpi
def test_more_ranks_than_gpus_are_refused_on_all_ranks_with_their_number(machine):
    machine("GPU-a", "GPU-b")
    said = of_ranks(3, "cuda")
    assert len(set(said)) == 1
    assert said[0].startswith("--device cuda: each of 3 ranks takes a GPU of its own, and ")
    assert said[0].endswith(" has 2")
    machine()
    assert all(each.endswith(" has none") for each in of_ranks(2, "cuda"))
    assert set(of_ranks(2, "cuda:1")) == {"--device cuda:1: no such device; this machine has: cpu (rank 0)"}


@needs_mpi
def test_a_rank_that_is_shown_one_gpu_alone_takes_it(monkeypatch):
    """As a cluster's launcher does: each finds it under number 0. Threads look one after the other."""
    shown = iter(["GPU-a", "GPU-b"])
    monkeypatch.setattr(wp, "get_devices", lambda: gpus(next(shown)))
    assert of_ranks(2, "cuda") == ["cuda:0", "cuda:0"]
