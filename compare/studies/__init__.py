"""Studies: many runs and a report of them.

A study is a function of a `directory` and what to study. It runs or reuses the runs in `directory`/runs, draws its
figures in `directory` and returns its report (see `compare.report.page`). Common to all of them:

`force` [bool]: run everything again, and replace a report about something else. `monitor`: is told how the runs go on,
by `start(jobs)`, `look(job, log)`, `ended(outcome)` and `stop()` (see `compare.batch.run_all`). `command`: the command
line that makes the report, which it names. `workers`: runs at a time, and MPI ranks of each.

Raises SceneError for bad input, with every problem of a scene, for a solver or device that is not there, and for a
`directory` that holds another report or that another call is at work in. Raises KeyboardInterrupt once every run in
progress has saved its state: the same call, without `force`, goes on from there. Runs that fail raise nothing: the
report lists them.
"""

from mpm.errors import SceneError


def refuse_settings(settings: list[str], decided: tuple[str, ...], why: str = "the study sets it itself"):
    """Raise SceneError for each of the `settings` (KEY=VALUE) of a key that is `decided`, with the reason `why`."""
    if taken := [item for item in settings if item.partition("=")[0].strip() in decided]:
        raise SceneError([f"--set {item}: {why}" for item in taken])
