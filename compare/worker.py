"""One run of a study in a process of its own: `python -m compare.worker FOLDER`, which holds job.json.

A run that was cut off goes on from its checkpoint. How it ended is left in outcome.json; a process that dies leaves
none.
"""

import json
import sys
from pathlib import Path

from compare.terminal import Monitor
from mpm.config import parse_scene
from mpm.errors import NumericalError, SceneError
from mpm.results import CHECKPOINT, SUMMARY

JOB, OUTCOME = "job.json", "outcome.json"
INTERRUPTED = 130


def work(folder: Path) -> int:
    """Start or go on with the run that FOLDER/job.json asks for; the exit code, as that of `repose run`."""
    job = json.loads((folder / JOB).read_text(encoding="utf-8"))
    more = {}
    if job["mode"] == "implicit":
        import implicit.run as runs
        from implicit.relaxation import Regularisation

        more = {"regularisation": Regularisation(**job["regularisation"])}
    else:
        import explicit.run as runs
    status, reason, code = "done", None, 0
    try:
        if (folder / CHECKPOINT).is_file() and not (folder / SUMMARY).is_file():
            runs.resume(folder, job["device"], Monitor())
        else:
            runs.run(parse_scene(job["scene"]), folder, job["device"], force=True, monitor=Monitor(), **more)
    except KeyboardInterrupt:
        return INTERRUPTED
    except (SceneError, NumericalError) as error:
        status, reason, code = "failed", str(error), error.exit_code
    (folder / OUTCOME).write_text(json.dumps({"status": status, "reason": reason}), encoding="utf-8")
    return code


if __name__ == "__main__":
    sys.exit(work(Path(sys.argv[1])))
