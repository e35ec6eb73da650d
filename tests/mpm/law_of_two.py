"""A run of a law that has a second state variable, which neither solver names; where its points are marked by number.

python tests/mpm/law_of_two.py explicit|implicit start|resume FOLDER, for `resume` also under mpiexec
"""

import os
import signal
import sys

import numpy as np

from mpm import drucker_prager

# Before anything else sees the law.
drucker_prager.LAW_STATE["mark"] = "-"
drucker_prager.Constants.law_state_start = property(lambda constants: (0.0, 0.25) if constants.plastic else ())

from compare.cli.ranks import take_part  # noqa: E402
from compare.solvers import runs_of  # noqa: E402
from mpm.load import load_scene  # noqa: E402

SETTINGS = ("grid.cell=0.25", "explicit.until=0.3", "implicit.max_steps=4", "output.every=0.1", "output.vtk=false")
FIELDS = "output.fields=['eps_p_eqv', 'mark']"


class Marker:
    """A monitor that adds to each point's mark its number, after the first row, and stops the run as Ctrl-C does."""

    def start(self, _run):
        pass

    stop = start

    def row(self, run, _row):
        points = run.solver if run.mode == "explicit" else run.solver.material_points
        state = points.law_state.numpy().copy()
        state[:, 1] += np.arange(len(state))
        points.law_state.assign(state)
        os.kill(os.getpid(), signal.SIGINT)


def main(mode: str, what: str, folder: str):
    runs = runs_of(mode)
    if what == "resume":
        runs.resume(folder)
    else:
        runs.run(load_scene("column_small", [*SETTINGS, FIELDS]), folder, monitor=Marker())


if __name__ == "__main__":
    take_part(lambda: main(*sys.argv[1:]))
