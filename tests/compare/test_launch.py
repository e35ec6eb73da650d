"""Programs on several MPI ranks: how many, by what launcher, what they give back and how they end."""

import os
import signal
import threading

import pytest
from installed import needs_ranks

from compare import launch
from compare.launch import call, cores, count_of, refuse_nested, refuse_ranks, sorted_lines
from mpm.errors import NumericalError, SceneError


# What ranks are asked to do here; `compare.launch` finds them by name.
def ranks_and_sum(*numbers):
    from mpm.ranks import count

    print("so many numbers:", len(numbers))
    return count(), sum(numbers)


def refuse():
    raise SceneError(["one problem", "another"])


def diverge():
    raise NumericalError("diverged at t = 1 s")


def die():
    os.kill(os.getpid(), signal.SIGKILL)


def wait():
    print("waiting", flush=True)
    signal.pause()


def test_a_core_is_counted_once_whatever_threads_it_has(monkeypatch, tmp_path):
    """Two cores with two threads each, of which this process may use three threads; then none that tells its core."""
    block = "processor\t: {}\nphysical id\t: 0\ncore id\t\t: {}\n"
    file = tmp_path / "cpuinfo"
    file.write_text("\n".join(block.format(number, number % 2) for number in range(4)))
    monkeypatch.setattr(launch, "Path", lambda _: file)
    monkeypatch.setattr(launch.os, "sched_getaffinity", lambda _: {0, 1, 2})
    assert cores() == 2
    monkeypatch.setattr(launch.os, "sched_getaffinity", lambda _: {0, 2})
    assert cores() == 1
    file.write_text("processor\t: 0\nprocessor\t: 1\n")
    assert cores() == 2
    file.unlink()
    assert cores() == 2


def test_numbers_of_ranks():
    assert (count_of("3"), count_of(3), count_of("all")) == (3, 3, cores())
    for wrong in ("0", 0, -1, "two", "1.5", ""):
        with pytest.raises(SceneError, match="must be a number of MPI ranks"):
            count_of(wrong)


@pytest.mark.parametrize(("gpus", "there"), [(0, "none"), (2, "2")])
def test_ranks_take_cores_or_a_gpu_each(monkeypatch, gpus, there):
    monkeypatch.setattr("mpm.devices.gpu_count", lambda: gpus)
    refuse_ranks("cpu", 3)
    with pytest.raises(SceneError, match=f"each of 3 ranks takes a GPU of its own, and this machine has {there}"):
        refuse_ranks("cuda", 3)
    if gpus:
        refuse_ranks("cuda", gpus)
    with pytest.raises(SceneError, match="--device cuda:0: that is one device, for one rank; --device cuda gives"):
        refuse_ranks("cuda:0")
    assert count_of("all", "cuda") == max(gpus, 1)
    assert count_of("all", "cuda:0") == cores()


def test_what_starts_ranks_itself_is_refused_on_ranks(monkeypatch):
    refuse_nested("a study")
    monkeypatch.setenv("OMPI_COMM_WORLD_SIZE", "2")
    with pytest.raises(SceneError, match="without mpirun"):
        refuse_nested("a study")


def test_what_mpi_left_behind_does_not_reach_the_ranks():
    left = {"OMPI_COMM_WORLD_RANK": "0", "OMPI_COMM_WORLD_SIZE": "1", "PMIX_RANK": "0", "HOME": "/home/me"}
    env = launch._environment(left)
    assert not {"OMPI_COMM_WORLD_RANK", "OMPI_COMM_WORLD_SIZE", "PMIX_RANK"} & env.keys()
    assert (env["HOME"], env["OMP_NUM_THREADS"]) == ("/home/me", "1")
    # where nothing ran, what a user tells Open MPI is left as it is
    assert launch._environment({"OMPI_MCA_btl": "tcp,self"})["OMPI_MCA_btl"] == "tcp,self"


def test_lines_of_the_launcher_are_told_from_those_of_ranks():
    rule = 74 * "-" + "\n"
    said = ["a\n", rule, "mpiexec noticed\n", rule, "\0b\n", "c" + rule, "mpiexec noticed\n", rule]
    told = [("a\n", False), ("mpiexec noticed\n", True), ("b\n", False), ("c\n", False), ("mpiexec noticed\n", True)]
    assert list(sorted_lines(said)) == told


@needs_ranks
def test_a_call_gives_what_the_first_rank_returns_and_shows_what_it_prints(found_by_processes, capfd):
    assert call(2, ranks_and_sum, 1, 2, 3.5) == (2, 6.5)
    assert "so many numbers: 3" in capfd.readouterr().out


@needs_ranks
def test_a_call_raises_what_the_first_rank_raises(found_by_processes):
    with pytest.raises(SceneError) as refused:
        call(2, refuse)
    assert refused.value.problems == ["one problem", "another"]
    with pytest.raises(NumericalError, match="diverged at t = 1 s"):
        call(2, diverge)


@needs_ranks
def test_a_call_whose_rank_is_killed_says_so(found_by_processes):
    with pytest.raises(ChildProcessError, match=r"exit code 137: .*signal 9"):
        call(2, die)


@needs_ranks
def test_ctrl_c_reaches_the_ranks(found_by_processes):
    before = signal.getsignal(signal.SIGINT)
    threading.Timer(5.0, lambda: os.kill(os.getpid(), signal.SIGINT)).start()
    with pytest.raises(KeyboardInterrupt):
        call(2, wait)
    assert signal.getsignal(signal.SIGINT) is before  # given back


def test_without_mpi_ranks_are_refused(monkeypatch):
    monkeypatch.setattr(launch.shutil, "which", lambda name: None)
    monkeypatch.setattr(launch.Path, "is_file", lambda path: False)
    with pytest.raises(SceneError, match=r"mpiexec|mpi4py"):
        call(2, refuse)
