"""One run of a study in a process of its own: `python -m compare.worker FOLDER`, which holds job.json.

A run that was cut off goes on from its checkpoint. How it ended is left in outcome.json; a process that dies leaves
none.
"""

import json
import sys
from pathlib import Path

from compare.cli.ranks import take_part
from compare.cli.terminal import Monitor
from compare.solvers import runs_of
from mpm.caches import announce_compilation
from mpm.errors import INTERRUPTED, NumericalError, SceneError
from mpm.load import parse_scene
from mpm.provenance import code_version
from mpm.results import CHECKPOINT, SUMMARY

JOB, OUTCOME = "job.json", "outcome.json"


def work(folder: Path) -> int:
    """Start or go on with the run that FOLDER/job.json asks for; the exit code, as that of `repose run`."""
    job = json.loads((folder / JOB).read_text(encoding="utf-8"))
    more = {}
    runs = runs_of(job["mode"])
    if job["mode"] == "implicit":
        from implicit.pseudo_time import Regularisation

        more = {"regularisation": Regularisation(**job["regularisation"])}
    if code_version(job["mode"]) != job["code"]:
        print("the solver's code was changed while the study ran")
        return SceneError.exit_code
    status, reason, code = "done", None, 0
    try:
        if not _resumed(runs, folder, job["device"]):
            runs.run(parse_scene(job["scene"]), folder, job["device"], force=True, monitor=Monitor(), **more)
    except KeyboardInterrupt:
        return INTERRUPTED
    except SceneError as error:  # of the machine perhaps, a full disk: not kept, so that the next call tries again
        print(error)
        return error.exit_code
    except NumericalError as error:
        status, reason, code = "failed", str(error), error.exit_code
    (folder / OUTCOME).write_text(json.dumps({"status": status, "reason": reason}), encoding="utf-8")
    return code


def _resumed(runs, folder: Path, device: str) -> bool:
    """Go on from the checkpoint of a run that was cut off; False where there is none that can be read."""
    if not (folder / CHECKPOINT).is_file() or (folder / SUMMARY).is_file():
        return False
    try:
        runs.resume(folder, device, Monitor())
    except SceneError as error:
        print(f"starting anew: {error}")
        return False
    return True


if __name__ == "__main__":
    announce_compilation()
    take_part(lambda: sys.exit(work(Path(sys.argv[1]))))
