"""What goes wrong on one of several ranks ends all of them, with one message and the last checkpoint whole."""

import os
import re
import signal
import subprocess
import time

import numpy as np
import pytest
from installed import HAS_RANKS, NO_RANKS

from compare import launch
from mpm.errors import INTERRUPTED
from mpm.results import Results

if not HAS_RANKS:
    pytest.skip(NO_RANKS, allow_module_level=True)

LONGEST = 120  # seconds: nothing hangs
AFTER = 30  # steps that are well before what goes wrong
# A program whose ranks call `fault(domain)` before a step of their domain, once AFTER steps are done.
PROGRAM = """
import os
from explicit.ranks import Domain

FAULT

step = Domain.step
def faulty(domain):
    if domain.steps >= AFTER:
        fault(domain)
    return step(domain)
Domain.step = faulty

from compare.cli.main import main
main()
"""


def started(folder, fault):
    """The process of a run on three ranks with a fault."""
    code = PROGRAM.replace("FAULT", fault).replace("AFTER", str(AFTER))
    settings = [
        word for key in ("explicit.until=0.5", "output.every=0.01", "output.vtk=false") for word in ("--set", key)
    ]
    words = ["-c", code, "run", "column_small", *settings, "--out", str(folder)]
    return launch.start(3, words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)


def run(folder, fault):
    """Exit code of a run with a fault, and what was said on standard error."""
    return ended(started(folder, fault))


def ended(process):
    """Exit code of a process, and what its ranks said on standard error."""
    try:
        said = process.communicate(timeout=LONGEST)[1]
    finally:
        process.kill()
    lines = launch.sorted_lines(said.splitlines())
    return process.returncode, [line for line, is_launchers in lines if not is_launchers]


def reached(folder) -> float:
    """Time [s] of the checkpoint, which is whole."""
    state = Results.open(folder).read_checkpoint()
    assert np.isfinite(state["x"]).all() and len(state["x"]) == len(Results.open(folder).read_static("x0"))
    return float(state["clock"][0])


@pytest.mark.parametrize("rank", [0, 2])
def test_a_velocity_that_is_not_a_number_is_told_once_with_its_points_number_in_the_body(tmp_path, rank):
    """Point 7 of a rank's; its neighbours' velocities are none either by the time that anyone looks."""
    fault = f"""
def fault(domain):
    if domain.comm.rank == {rank} and domain.steps == AFTER:
        print("spoilt:", domain.ids[7], domain.ids.min(), flush=True, file=__import__("sys").stderr)
        domain.v.numpy()[7] = float("nan")
"""
    code, said = run(tmp_path / "run", fault)
    assert code == 3, said
    failures = [line for line in said if "numerical failure" in line]
    assert len(failures) == 1 and "is not finite" in failures[0]
    point = int(re.search(r"point (\d+):", failures[0])[1])
    (spoilt,) = [list(map(int, line.split()[1:])) for line in said if line.startswith("spoilt:")]
    x0 = Results.open(tmp_path / "run").read_static("x0")
    near = 4 * 0.125  # cells that two steps reach at the most
    assert np.abs(x0[point] - x0[spoilt[0]]).max() < near
    assert 0.0 < reached(tmp_path / "run") < 0.05


@pytest.mark.parametrize("rank", [0, 2])
def test_an_exception_on_any_rank_ends_all_and_is_told_once(tmp_path, rank):
    fault = f"""
def fault(domain):
    if domain.comm.rank == {rank}:
        raise OSError("the disk of a rank is gone")
"""
    code, said = run(tmp_path / "run", fault)
    assert code != 0
    assert [line for line in said if "the disk" in line] == [f"error: rank {rank}: the disk of a rank is gone"]
    assert not any("Traceback" in line for line in said)
    assert 0.0 < reached(tmp_path / "run") < 0.05


def test_memory_that_runs_out_on_a_rank_has_a_name(tmp_path):
    fault = """
def fault(domain):
    if domain.comm.rank == 1:
        raise MemoryError
"""
    code, said = run(tmp_path / "run", fault)
    assert code != 0
    assert "error: rank 1: MemoryError" in said


def test_ctrl_c_before_the_ranks_are_set_up_ends_all_as_ctrl_c_does(tmp_path):
    """The launcher hands it on as SIGUSR1, here while the first rank cuts the plan."""
    code = """
import signal
from explicit.ranks import Domain

cut_anew = Domain.cut_anew
def interrupted(domain, x):
    if domain.comm.rank == 0:
        signal.raise_signal(signal.SIGUSR1)
    return cut_anew(domain, x)
Domain.cut_anew = interrupted

from compare.cli.main import main
main()
"""
    process = launch.start(
        3,
        ["-c", code, "run", "column_small", "--out", str(tmp_path / "run")],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    code, said = ended(process)
    assert (code, said.count("interrupted")) == (INTERRUPTED, 1)
    assert not any(line.startswith("error") for line in said)
    assert not (tmp_path / "run").exists()


def test_a_rank_that_exits_ends_all(tmp_path):
    """As a library does that gives up."""
    fault = """
def fault(domain):
    if domain.comm.rank == 1:
        os._exit(1)
"""
    started = time.monotonic()
    code, _ = run(tmp_path / "run", fault)
    assert code != 0
    assert time.monotonic() - started < LONGEST
    assert 0.0 < reached(tmp_path / "run") < 0.05


def test_ranks_that_wait_say_for_whom_and_go_on_when_it_does(tmp_path):
    """The middle one of three ranks is stopped, as by a debugger, until both others have waited a second."""
    fault = """
import signal, mpm.domains
mpm.domains.PATIENCE = 1.0

def fault(domain):
    if domain.comm.rank == 1 and domain.steps == AFTER:
        print("stopped:", os.getpid(), flush=True, file=__import__("sys").stderr)
        os.kill(os.getpid(), signal.SIGSTOP)
"""
    process = started(tmp_path / "run", fault)
    told, stopped = [], None
    try:
        for line in process.stderr:
            if line.startswith("stopped:"):
                stopped = int(line.split()[1])
            if "waits for" in line:
                told.append(line.strip())
                os.kill(stopped, signal.SIGCONT)
        code = process.wait(timeout=LONGEST)
    finally:
        process.kill()
    assert code == 0
    assert told and set(told) <= {f"rank {rank} waits for rank 1, for 1 s now" for rank in (0, 2)}
