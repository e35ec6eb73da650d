"""What the law of the material remembers of a point: one vector in the solvers, variables with names in files.

Which variables these are, and how they start, `mpm.drucker_prager` says; the solvers only hand them on.
"""

from collections.abc import Callable

import numpy as np

from mpm.drucker_prager import LAW_STATE, Constants


def first_law_state(constants: Constants, points: int) -> np.ndarray:
    """State of the law (points, variables) at the start; empty, (0, variables), where the material is elastic."""
    return np.tile(np.array(constants.law_state_start, float), points).reshape(-1, len(LAW_STATE))


def variables(law_state) -> dict[str, Callable[[], np.ndarray]]:
    """For each variable, a function that gives it (n,); `law_state.numpy()` gives all of them (n, variables)."""

    def maker(at):
        return lambda: law_state.numpy()[:, at].copy()

    return {name: maker(at) for at, name in enumerate(LAW_STATE)}


def by_name(state: dict) -> dict:
    """A restart state as files have it: with each variable (n,) in place of "law_state" (n, variables)."""
    rest = {name: value for name, value in state.items() if name != "law_state"}
    return rest | {name: state["law_state"][:, at].copy() for at, name in enumerate(LAW_STATE)}


def by_point(state: dict) -> dict:
    """A restart state as solvers have it: what `by_name` started from."""
    rest = {name: value for name, value in state.items() if name not in LAW_STATE}
    return rest | {"law_state": np.stack([state[name] for name in LAW_STATE], axis=1)}
