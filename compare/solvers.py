"""Where a solver is found by its name; nothing of it is imported before it is asked for."""

import importlib

from mpm.errors import SceneError

MODES = ("explicit", "implicit")


def refuse_mode(mode: str):
    """Raises SceneError where there is no solver of that name."""
    if mode not in MODES:
        raise SceneError(f"mode = {mode!r}: must be {' or '.join(map(repr, MODES))}")


def runs_of(mode: str):
    """The module with `run` and `resume` of the solver `mode`, "explicit" or "implicit".

    Raises SceneError where there is no such solver, and where what it needs is not installed.
    """
    refuse_mode(mode)
    return importlib.import_module(f"{mode}.run")
