"""What tests share: a solver built from a scene with overrides, and run to a time; the ranks that were started."""

import os
import sys

import pytest

from explicit.solver import ExplicitSolver
from mpm.body import build
from mpm.devices import start_warp
from mpm.load import load_scene


@pytest.fixture
def solver_of():
    """`solver_of(scene, *overrides, device="cpu")` -> ExplicitSolver; `scene` is a file or a preset's name."""

    def make(scene, *overrides, device="cpu"):
        start_warp()
        return ExplicitSolver(build(load_scene(scene, list(overrides))), device)

    return make


@pytest.fixture
def run_to():
    """`run_to(solver, time, every)`: steps to exactly `time` [s]; yields after each batch of about `every` [s]."""

    def march(solver, time, every=None):
        solver.set_target(time)
        while solver.time < time:
            solver.advance(solver.time + (every or time))
            yield solver.time

    return march


@pytest.fixture
def found_by_processes(monkeypatch):
    """Programs that the test starts find the modules of tests, as this process does.

    The checkout comes first: tests/mpm and its like would else be found as packages of these names.
    """
    here = os.path.dirname(__file__)
    folders = [os.path.dirname(here), *(folder for folder in sys.path if folder.startswith(here))]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([*folders, os.environ.get("PYTHONPATH", "")]))


@pytest.fixture
def ranks_below():
    """`ranks_below(pid)`: process numbers of the ranks whose launcher is a child of the process `pid`."""

    def find(pid: int) -> list[int]:
        below = {}
        for path in os.listdir("/proc"):
            if path.isdecimal():
                try:
                    with open(f"/proc/{path}/stat") as file:
                        below.setdefault(int(file.read().rpartition(")")[2].split()[1]), []).append(int(path))
                except OSError:
                    continue
        return sorted(rank for launcher in below.get(pid, []) for rank in below.get(launcher, []))

    return find
