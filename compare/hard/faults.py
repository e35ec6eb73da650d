"""Hard cases of broken states: steps too long, points driven off every limit, numbers that are none.

A fault is stable (0, not 1) where the user reads what happened and goes on from the last good state.
"""

import os
import signal

import h5py
import numpy as np

from compare.hard.apart import (
    MODES,
    OWN,
    SCENE,
    SETTINGS,
    Striker,
    apart,
    finite,
    not_resumed,
    one_line,
    runs_of,
    scratch,
    start,
    undisturbed,
)
from compare.hard.case import Finding, hard_case
from mpm.errors import NumericalError, SceneError
from mpm.load import load_scene
from mpm.results import CHECKPOINT, Results

POINT = 7  # which is struck
STATE = {
    "explicit": ("x", "v", "tau", "theta", "eps_p_eqv"),
    "implicit": ("x", "v", "b_e", "mean", "theta", "jacobian", "eps_p_eqv"),
}
GOOD = (
    "said in a named error (exit code 3); the last good state is whole on disk, and resumed it ends as if undisturbed"
)


def struck(mode: str, what: str, act) -> Finding:
    """The finding of a run whose state `act(run)` spoils: whether it stops by name and can be gone on with."""
    undisturbed(mode)  # not in the forked process, which would compute it for itself
    with scratch() as folder:
        outcome = apart(lambda: start(mode, folder, act))
        if outcome.how == "returned":
            return Finding(what, mode, 1.0, 0.0, GOOD, "no error: the run goes on to its end")
        said = one_line(outcome.said, folder)
        if outcome.code != NumericalError.exit_code:
            return Finding(what, mode, 1.0, 0.0, GOOD, f"{outcome.how}: {said}")
        if "last good state: t = " not in outcome.said:
            return Finding(what, mode, 1.0, 0.0, GOOD, f"no last good state in: {said}")
        problem = not_resumed(mode, folder)
        return Finding(what, mode, float(bool(problem)), 0.0, GOOD, f"{problem}; it said: {said}" if problem else said)


def setting(name: str, value: float):
    """An `act` that sets array `name` of the solver's state to `value` at one point."""

    def act(run):
        array = getattr(run.solver if run.mode == "explicit" else run.solver.material_points, name)
        values = array.numpy().copy()
        values.reshape(len(values), -1)[POINT] = value
        array.assign(values)

    return act


@hard_case("too far")
def too_far():
    """A step that is too long, a point driven off every limit."""
    yield _fixed_step_too_long()
    for speed in (1e3, 1e30, 1e200):
        yield struck("explicit", f"a point thrown at {speed:.0e} m/s", setting("v", speed))
    for mode in MODES:
        yield struck(mode, "a point put 1e30 m away", setting("x", 1e30))
    yield _much_too_long_step()


def _fixed_step_too_long() -> Finding:
    """A fixed step just under h/c, too long as soon as points move: refused, and refused again, with the state before
    it on disk."""
    scene = load_scene(SCENE, list(SETTINGS))
    step = 0.9995 * scene.grid.cell / scene.material.constants().p_wave_speed
    reason = "refused by name before it is taken, resumed or not; the state stays"
    with scratch() as folder:
        first = apart(lambda: start("explicit", folder, more=[f"explicit.time_step={step}"]))
        saved = Results.open(folder).read_checkpoint()
        second = apart(lambda: runs_of("explicit").resume(folder))
        kept = Results.open(folder).read_checkpoint()
        holds = all(end.code == NumericalError.exit_code and "Courant limit" in end.said for end in (first, second))
        holds &= all(finite(value) for value in saved.values())
        holds &= all(np.array_equal(saved[name], kept[name]) for name in set(saved) - OWN)
        note = one_line(first.said, folder)
    return Finding("a fixed step that motion makes too long", "explicit", float(not holds), 0.0, reason, note)


def _much_too_long_step() -> Finding:
    """A step in pseudo-time a thousand times the longest: shortened until Newton solves it."""
    record = {}

    class Follower(Striker):
        def row(self, run, row):
            super().row(run, row)
            record.update(failed=run.solver.failed_steps, dt=row["dt"], moved=np.abs(run.x - run.body.x).max())

    def act(run):
        run.solver.length.dt *= 1e3

    runs, scene = runs_of("implicit"), load_scene(SCENE, list(SETTINGS))
    with scratch() as folder:
        try:
            runs.run(scene, folder, monitor=Follower(act))
            said = f"{record['failed']} tries failed; the points moved {record['moved']:.2f} m at most in the run"
            holds = record["moved"] < scene.geometry.radius
        except NumericalError as error:
            said, holds = one_line(str(error), folder), not not_resumed("implicit", folder)
    reason = "shortened until Newton solves it, points within r0 of where they were; or a named error"
    return Finding("a step of a thousand times its length", "implicit", float(not holds), 0.0, reason, said)


@hard_case("not a number")
def not_a_number():
    """NaN in one point's state, in mid-run or in the checkpoint that a run is resumed from."""
    for mode in MODES:
        for name in STATE[mode]:
            yield struck(mode, f"NaN in {name} of a point", setting(name, np.nan))
        yield _doctored(mode)


def _doctored(mode: str) -> Finding:
    """A run stopped half-way, NaN written into its checkpoint, resumed."""
    name = "v" if mode == "explicit" else "b_e"
    with scratch() as folder:
        apart(lambda: start(mode, folder, lambda _run: os.kill(os.getpid(), signal.SIGKILL)))
        with h5py.File(folder / CHECKPOINT, "r+") as file:
            values = file[name][()]
            values.reshape(len(values), -1)[POINT] = np.nan
            file[name][...] = values
        outcome = apart(lambda: runs_of(mode).resume(folder))
        said = one_line(outcome.said, folder) or outcome.how
    holds = outcome.code in (SceneError.exit_code, NumericalError.exit_code)
    what, reason = f"NaN in {name} in the checkpoint", "resume ends in a named error (exit code 2 or 3)"
    return Finding(what, mode, float(not holds), 0.0, reason, said)
