"""State variables of the law: both solvers hand them on, whatever they are; files have them by name."""

import shutil
import subprocess
from pathlib import Path

import h5py
import numpy as np
import pytest
from installed import needs_implicit, needs_ranks

from compare import launch
from mpm.law_state import by_name, by_point, first_law_state, variables
from mpm.results import CHECKPOINT, RESULTS
from mpm.scene import Material

SAND = {"young": 1e7, "poisson": 0.3, "density": 2000.0, "friction_angle": 30.0}
LAW = Path(__file__).with_name("law_of_two.py")
LONGEST = 600  # seconds: nothing hangs
MODES = [
    "explicit",
    pytest.param(
        "implicit",
        marks=needs_implicit,
    ),
]
RANKS = [
    1,
    pytest.param(2, marks=needs_ranks),
]


def test_an_elastic_material_remembers_nothing():
    assert first_law_state(Material(**SAND, model="elastic").constants(), 5).shape == (0, 1)
    np.testing.assert_array_equal(first_law_state(Material(**SAND).constants(), 5), np.zeros((5, 1)))


def test_a_restart_state_has_variables_by_name():
    class Array:
        def numpy(self):
            return np.array([[1.0], [2.0]], np.float32)

    state = {"x": np.zeros((2, 3)), "law_state": Array().numpy()}
    named = by_name(state)
    assert set(named) == {"x", "eps_p_eqv"} and named["eps_p_eqv"].dtype == np.float32
    np.testing.assert_array_equal(named["eps_p_eqv"], [1.0, 2.0])
    np.testing.assert_array_equal(by_point(named)["law_state"], state["law_state"])
    np.testing.assert_array_equal(variables(Array())["eps_p_eqv"](), [1.0, 2.0])


def run_apart(ranks, *words):
    """Run the law of two variables on so many ranks; exit code and what it says."""
    process = launch.start(ranks, [str(LAW), *map(str, words)], stderr=subprocess.PIPE, text=True)
    try:
        said = process.communicate(timeout=LONGEST)[1]
    finally:
        process.kill()
    return process.returncode, said


@pytest.fixture(scope="module", params=MODES)
def stopped(request, tmp_path_factory):
    """A run that was stopped when its points were marked: its solver, and its folder."""
    folder = tmp_path_factory.mktemp(request.param) / "run"
    code, said = run_apart(1, request.param, "start", folder)
    assert "Interrupted" in said, (code, said)
    return request.param, folder


@pytest.mark.parametrize("ranks", RANKS)
def test_a_second_variable_reaches_restarts_ranks_and_snapshots(stopped, tmp_path, ranks):
    """It starts from the law's value, and each point keeps its own through steps, a restart and other ranks."""
    mode, folder = stopped
    shutil.copytree(folder, tmp_path / "run")
    code, said = run_apart(ranks, mode, "resume", tmp_path / "run")
    assert code == 0, said
    with h5py.File(tmp_path / "run" / RESULTS) as results, h5py.File(tmp_path / "run" / CHECKPOINT) as checkpoint:
        first, *_, last = results["snapshots"].values()
        marks = 0.25 + np.arange(len(results["static"]["x0"]))
        assert set(first["mark"][()]) == {0.25}
        np.testing.assert_array_equal(last["mark"], marks)
        np.testing.assert_array_equal(checkpoint["mark"], marks)
        assert last["eps_p_eqv"][()].max() > 1e-3
