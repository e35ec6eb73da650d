"""The laboratory collapses of the paper's Fig. 7a: normalised run-out of silicon carbide columns."""

from importlib import resources

import numpy as np


def experiments() -> np.ndarray:
    """(n, 2) array of (lambda0, R = (r_inf - r0)/r0) [-], in order of lambda0, as digitised by a third party."""
    with (resources.files("compare") / "experiments.csv").open(encoding="utf-8") as file:
        lines = [line for line in file if line[0].isdigit()]
    return np.loadtxt(lines, delimiter=",")


def measured_runout(lambda0: float) -> float:
    """Run-out [-] between the two neighbouring experiments, by straight line. NaN outside the measured range."""
    known, runout = experiments().T
    return float(np.interp(lambda0, known, runout, left=np.nan, right=np.nan))
