"""Broken states: steps too long, points driven off every limit, numbers that are none.

The user reads what happened, and goes on from the last good state.
"""

import os
import signal

import h5py
import numpy as np
import pytest
from apart import (
    IMPLICIT,
    OWN,
    SCENE,
    SETTINGS,
    Striker,
    apart,
    assert_resumes_as_undisturbed,
    each_mode,
    finite,
    runs_of,
    start,
    undisturbed,
)

from mpm.errors import NumericalError, SceneError
from mpm.load import load_scene
from mpm.results import CHECKPOINT, Results

POINT = 7  # which is struck
STATE = {
    "explicit": ("x", "v", "tau", "theta", "law_state"),
    "implicit": ("x", "v", "b_e", "mean", "theta", "jacobian", "law_state"),
}


def each_array():
    """Parametrises a test over `mode` and `name` of every array of a solver's state."""
    return pytest.mark.parametrize(
        ("mode", "name"),
        [
            pytest.param(mode, name, marks=IMPLICIT.marks if mode == "implicit" else ())
            for mode, names in STATE.items()
            for name in names
        ],
    )


def setting(name: str, value: float):
    """An act that sets array `name` of the solver's state to `value` at one point."""

    def act(run):
        array = getattr(run.solver if run.mode == "explicit" else run.solver.material_points, name)
        values = array.numpy().copy()
        values.reshape(len(values), -1)[POINT] = value
        array.assign(values)

    return act


def assert_named_and_resumed(mode: str, folder, act):
    """A run whose state `act(run)` spoils stops with a named error, and goes on from the last good state."""
    undisturbed(mode)
    ending = apart(lambda: start(mode, folder, act))
    assert ending.code == NumericalError.exit_code, ending
    assert "last good state: t = " in ending.said
    assert_resumes_as_undisturbed(mode, folder)


@pytest.mark.parametrize("speed", [1e3, 1e30, 1e200])
def test_a_point_thrown(tmp_path, speed):
    """At `speed` [m/s]."""
    assert_named_and_resumed("explicit", tmp_path / "run", setting("v", speed))


@each_mode
def test_a_point_put_far_away(tmp_path, mode):
    """At 1e30 m."""
    assert_named_and_resumed(mode, tmp_path / "run", setting("x", 1e30))


@each_array()
def test_nan_in_the_state_of_a_point(tmp_path, mode, name):
    assert_named_and_resumed(mode, tmp_path / "run", setting(name, np.nan))


@each_mode
def test_nan_in_the_checkpoint(tmp_path, mode):
    """A run is killed half-way, NaN written into its checkpoint: to resume it ends in a named error."""
    name, folder = "v" if mode == "explicit" else "b_e", tmp_path / "run"
    undisturbed(mode)
    apart(lambda: start(mode, folder, lambda _run: os.kill(os.getpid(), signal.SIGKILL)))
    with h5py.File(folder / CHECKPOINT, "r+") as file:
        values = file[name][()]
        values.reshape(len(values), -1)[POINT] = np.nan
        file[name][...] = values
    ending = apart(lambda: runs_of(mode).resume(folder))
    assert ending.code in (SceneError.exit_code, NumericalError.exit_code), ending


def test_a_fixed_step_that_motion_makes_too_long(tmp_path):
    """A fixed step just under h/c, too long as soon as points move: refused by name before it is taken, and refused
    again when it is resumed; the state stays."""
    scene, folder = load_scene(SCENE, list(SETTINGS)), tmp_path / "run"
    step = 0.9995 * scene.grid.cell / scene.material.constants().p_wave_speed
    endings, states = [], []
    for go in (
        lambda: start("explicit", folder, more=[f"explicit.time_step={step}"]),
        lambda: runs_of("explicit").resume(folder),
    ):
        endings.append(apart(go))
        states.append(Results.open(folder).read_checkpoint())
    for ending in endings:
        assert ending.code == NumericalError.exit_code, ending
        assert "Courant limit" in ending.said
    saved, kept = states
    assert all(finite(value) for value in saved.values())
    for name in saved.keys() - OWN:
        np.testing.assert_array_equal(kept[name], saved[name], err_msg=name)


@pytest.mark.parametrize("mode", [IMPLICIT])
def test_a_step_of_a_thousand_times_its_length(tmp_path, mode):
    """It is shortened until Newton solves it, and no point goes farther than r0; or it ends in a named error, and the
    run goes on from the last good state."""
    moved = [np.inf]

    class Follower(Striker):
        def row(self, run, row):
            super().row(run, row)
            moved.append(np.abs(run.x - run.body.x).max())

    def act(run):
        run.solver.length.dt *= 1e3

    scene = load_scene(SCENE, list(SETTINGS))
    try:
        runs_of(mode).run(scene, tmp_path / "run", monitor=Follower(act))
    except NumericalError:
        assert_resumes_as_undisturbed(mode, tmp_path / "run")
    else:
        assert moved[-1] < scene.geometry.radius
