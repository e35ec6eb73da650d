"""The paper's runs as ensembles: what is run, and what each ensemble says."""

import numpy as np

from compare.batch import Job, Outcome
from compare.ensembles import estimate
from compare.experiments import measured_runout
from compare.metrics import axis_of, deposit
from compare.report.sections import made_by
from mpm.results import Results
from mpm.runout import connected
from mpm.theory import eq4, eq6, eq45

CELLS, QUICK_CELLS = 20, 5  # per r0, of the explicit runs; the paper's resolution is 20
# Of the implicit runs. An implicit run's cost grows with the fifth power of the resolution: half the paper's.
IMPLICIT_CELLS, QUICK_IMPLICIT_CELLS = 10, 5
IMPLICIT_LAMBDA0 = 2.0  # the highest column that the implicit solver is run for
IMPLICIT = "implicit"
MEASURES = ("R_995", "R_max", "R_connected", "h_inf", "slope", "volume_error", "detached", "upper_strain")


def plan(lambda0: list[float], damping: list[float], quick: bool, device: str) -> list[Job]:
    """One explicit job of each damping and aspect ratio, and an implicit one of each aspect ratio up to 2."""
    common = ("output.vtk=false", "output.every=2.0", "output.fields=['displacement', 'eps_p_eqv', 'volume']")
    explicit, implicit = (QUICK_CELLS, QUICK_IMPLICIT_CELLS) if quick else (CELLS, IMPLICIT_CELLS)

    def job(name, ratio, mode, count, *more):
        column = (f"name=column_{ratio:g}", f"geometry.aspect_ratio={ratio!r}", f"grid.cell={1.0 / count!r}")
        sized = (*common, *column, "explicit.until=rest", *more)
        return Job(f"{name}-{ratio:g}", "column_1", sized, mode, device if mode == "explicit" else "cpu")

    jobs = [
        job(f"D{value:g}", ratio, "explicit", explicit, f"explicit.damping={value!r}")
        for ratio in lambda0
        for value in damping
    ]
    return jobs + [job(IMPLICIT, ratio, "implicit", implicit) for ratio in lambda0 if ratio <= IMPLICIT_LAMBDA0]


def label(job: Job) -> str:
    """What a figure calls the runs of a job."""
    return IMPLICIT if job.mode == "implicit" else f"D = {job.scene.explicit.damping:g}"


def row(outcomes: list[Outcome], tangent: float) -> dict:
    """One ensemble beside theory with tan(phi) = `tangent` and experiment: an `Estimate` of each of MEASURES, or None.

    `slope`: tan of the flank angle; `detached` and `upper_strain` as in `morphology`.
    """
    job = outcomes[0].job
    ratio = job.scene.geometry.aspect_ratio
    found = [_measured(one) for one in outcomes]
    known = measured_runout(ratio)
    explicit = job.mode == "explicit"
    return {
        "lambda0": ratio,
        "label": label(job),
        "damping": job.scene.explicit.damping if explicit else None,
        "cells": round(1.0 / job.scene.grid.cell, 6),
        **{name: estimate(one.get(name) for one in found) for name in MEASURES},
        "eq4": float(eq4(ratio, tangent)),
        "eq45": float(eq45(ratio, tangent)),
        "eq6": float(eq6(ratio)),
        "experiments": None if np.isnan(known) else known,
        "at_rest": sum((one.summary or {}).get("stop_reason") == "rest" for one in outcomes),
        "wall_s": sum(one.summary["wall_s"] for one in outcomes if one.done),
        "failed": sum(not one.done for one in outcomes),
    } | made_by(outcomes[0])


def morphology(results: Results) -> dict[str, float]:
    """Of the last snapshot: `detached`, the share of the points [-] not joined to the axis, and `upper_strain`, the
    share of all plastic strain [-] that lies in the upper half of the local thickness."""
    last, scene = results.snapshot(-1), results.scene
    x, cell = last["x"].astype(float), scene.grid.cell
    square = np.unique(np.floor(x[:, :2] / cell).astype(int), axis=0, return_inverse=True)[1].ravel()
    z = x[:, 2] + scene.grid.half_length
    top = np.zeros(square.max() + 1)
    np.maximum.at(top, square, z)
    strain = last["eps_p_eqv"].astype(float)
    return {
        "detached": float(1.0 - connected(x, cell, axis_of(results)).mean()),
        "upper_strain": float(strain[z > 0.5 * top[square]].sum() / strain.sum()),
    }


def _measured(outcome: Outcome) -> dict:
    if not outcome.done:
        return {}
    found = deposit(outcome.results)
    return found | {"slope": float(np.tan(np.radians(found["flank_angle"])))} | morphology(outcome.results)
