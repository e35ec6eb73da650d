"""What is asked of a quasistatic collapse by two solvers, with what was measured."""

from compare.batch import Outcome
from compare.report.sections import check
from implicit.pseudo_time import REST_UNBALANCED
from mpm.scene import Scene
from mpm.theory import theory

RUN_OUT_AGREES = 0.10  # relative difference in R_995
PROFILE_AGREES = 0.10  # volume between two profiles over the deposit's
VOLUME_KEPT = 0.01  # gain over the initial volume: psi = 0 asks for none
GRID_AGREES = 0.10  # relative change of R_995 from twice the cell size
FEW_FAILED = 0.05  # failed tries over steps of the implicit run
REST_KE = "1e-4, or 1e-6 of M g h0,"


def quasistatic_checks(
    outcomes: list[Outcome], deposits: list[dict | None], distances: dict[str, float], collapsed: bool
) -> list[dict]:
    """Checks of an implicit and an explicit run and, after them, the same on a coarser grid.

    `deposits`: what `compare.metrics.deposit` says of each, None where it failed; `distances`: between the first two
    profiles. A body that has not `collapsed` has no run-out to compare. A check that needs a failed run has no value.
    """
    fine, coarse = list(zip(outcomes[:2], deposits[:2], strict=True)), deposits[2:]
    scene = outcomes[0].job.scene
    found = _run_outs(deposits, scene) if collapsed else []
    apart = distances.get("implicit from explicit")
    said = "a run failed" if apart is None else f"{apart:.1%} of the deposit's volume lies between them"
    found.append(check("profiles agree", apart, PROFILE_AGREES, f"{said}; {PROFILE_AGREES:.0%} is allowed."))
    found += [_rest(one) for one, _ in fine]
    found.append(_steps(outcomes[0].summary))
    if scene.material.model == "drucker_prager" and scene.material.dilatancy_angle == 0:
        for one, measured in fine:
            gain = measured["volume_error"] if measured else None
            said = "the run failed" if gain is None else f"the deposit gained {gain:+.1%}"
            sentence = f"{said}; {VOLUME_KEPT:.0%} is allowed."
            found.append(check(f"{one.job.mode} keeps its volume", gain, VOLUME_KEPT, sentence))
    for (one, measured), coarser in zip(fine, coarse, strict=False) if collapsed else ():
        off = coarser["R_995"] / measured["R_995"] - 1.0 if coarser and measured else None
        said = "a run failed" if off is None else f"with twice the cell R_995 is {coarser['R_995']:.3f}, {off:+.1%}"
        name = f"{one.job.mode} run-out hardly depends on the grid"
        found.append(check(name, off, GRID_AGREES, f"{said}; {GRID_AGREES:.0%} is allowed."))
    return found


def _run_outs(deposits, scene: Scene) -> list[dict]:
    """R_995 of each solver against the other's and Eq. 4's."""
    implicit, explicit = (one and one["R_995"] for one in deposits[:2])
    pairs = [("implicit run-out agrees with explicit", implicit, explicit, "the explicit run-out")]
    if known := theory(scene)["eq4"]:
        pairs += [("implicit run-out agrees with Eq. 4", implicit, known, "Eq. 4")]
        pairs += [("explicit run-out agrees with Eq. 4", explicit, known, "Eq. 4")]
    found = []
    for name, value, reference, of in pairs:
        off = value / reference - 1.0 if value and reference else None
        said = "a run failed" if off is None else f"R_995 {value:.3f} against {reference:.3f}, {off:+.1%}"
        found.append(check(name, off, RUN_OUT_AGREES, f"{said}; {RUN_OUT_AGREES:.0%} of {of} is allowed."))
    return found


def _rest(outcome: Outcome) -> dict:
    """Whether the run ended at rest."""
    name = f"{outcome.job.mode} run came to rest"
    if not outcome.done:
        return check(name, None, 0.0, "the run failed.")
    summary = outcome.summary
    measure, key, limit = {
        "implicit": ("out-of-balance force over external", "unbalanced_ratio", f"{REST_UNBALANCED:g}"),
        "explicit": ("grid kinetic energy over its peak", "grid_ke_ratio", REST_KE),
    }[outcome.job.mode]
    said = f"{measure} {summary[key]:.1e}; rest asks for {limit} and a front that stands still over 2 sqrt(h0/g)."
    return check(name, float(summary["stop_reason"] != "rest"), 0.0, said)


def _steps(summary: dict | None) -> dict:
    """How often Newton had to try again, over the steps of the implicit run."""
    if not summary:
        return check("implicit steps succeed", None, FEW_FAILED, "the run failed.")
    share = summary["failed_steps"] / summary["steps"]
    said = f"{summary['failed_steps']} tries failed in {summary['steps']} steps; {FEW_FAILED:.0%} is allowed."
    return check("implicit steps succeed", share, FEW_FAILED, said)
