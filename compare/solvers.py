"""Where a solver is found by its name; nothing of it is imported before it is asked for."""

import importlib


def runs_of(mode: str):
    """The module with `run` and `resume` of the solver `mode`, "explicit" or "implicit".

    Raises SceneError where what it needs is not installed.
    """
    return importlib.import_module(f"{mode}.run")
