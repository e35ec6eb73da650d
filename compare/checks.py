"""What is asked of a quasistatic collapse by two solvers, with what was measured."""

from compare.batch import Outcome
from compare.report.sections import HOW_ENDED, check
from explicit.run import REST_KE, REST_KE_OF_FALL
from implicit.pseudo_time import REST_UNBALANCED
from mpm.runout import REST_WINDOW
from mpm.scene import Scene
from mpm.theory import theory

RUN_OUT_AGREES = 0.10  # relative difference in R_995
PROFILE_AGREES = 0.10  # volume between two profiles over the deposit's
VOLUME_KEPT = 0.01  # gain over the initial volume: psi = 0 asks for none
GRID_AGREES = 0.10  # relative change of R_995 from twice the cell size
FEW_FAILED = 0.05  # failed tries over steps of the implicit run
FAILED = "not known: a run failed"


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
    said = FAILED
    if apart is not None:
        said = f"{apart:.1%} of the deposit's volume lies between them{_allowed(PROFILE_AGREES)}"
    found.append(check("profile, implicit against explicit", apart, PROFILE_AGREES, said))
    found += [_rest(one) for one, _ in fine]
    found.append(_steps(outcomes[0].summary))
    if scene.material.model == "drucker_prager" and scene.material.dilatancy_angle == 0:
        for one, measured in fine:
            gain = measured["volume_error"] if measured else None
            found.append(_relative(f"volume kept, {one.job.mode}", gain, VOLUME_KEPT))
    for (one, measured), coarser in zip(fine, coarse, strict=False) if collapsed else ():
        off, said = coarser["R_995"] / measured["R_995"] - 1.0 if coarser and measured else None, ""
        if off is not None:
            said = f": R_995 is {coarser['R_995']:.3f} on it, {measured['R_995']:.3f} on the scene's own grid"
        found.append(_relative(f"run-out on twice the cell, {one.job.mode}", off, GRID_AGREES, said))
    return found


def _allowed(limit: float) -> str:
    """The limit of a share, as a sentence adds it."""
    return f" ({limit:.0%} allowed)"


def _relative(name: str, off: float | None, limit: float, said: str = "") -> dict:
    """A check of the relative difference `off`, None where a run failed; `said`: of what numbers."""
    return check(name, off, limit, FAILED if off is None else f"{off:+.1%}{_allowed(limit)}{said}")


def _run_outs(deposits, scene: Scene) -> list[dict]:
    """R_995 of each solver against the other's and Eq. 4's."""
    implicit, explicit = (one and one["R_995"] for one in deposits[:2])
    pairs = [("implicit against explicit", implicit, "the explicit run", explicit)]
    if known := theory(scene)["eq4"]:
        pairs += [("implicit against Eq. 4", implicit, "Eq. 4", known)]
        pairs += [("explicit against Eq. 4", explicit, "Eq. 4", known)]
    found = []
    for what, value, whose, reference in pairs:
        off, said = value / reference - 1.0 if value and reference else None, ""
        if off is not None:
            said = f": R_995 is {value:.3f}, that of {whose} {reference:.3f}"
        found.append(_relative(f"run-out, {what}", off, RUN_OUT_AGREES, said))
    return found


def _rest(outcome: Outcome) -> dict:
    """Whether the run ended at rest."""
    name = f"came to rest, {outcome.job.mode}"
    if not outcome.done:
        return check(name, None, 0.0, FAILED)
    summary = outcome.summary
    if outcome.job.mode == "implicit":
        state = f"the out-of-balance force is {summary['unbalanced_ratio']:.2g} of the external one"
        limit = f"{REST_UNBALANCED:g}"
    else:
        state = f"the grid's kinetic energy is {summary['grid_ke_ratio']:.2g} of its peak"
        limit = f"{REST_KE:g}, or {REST_KE_OF_FALL:g} of M g h0,"
    at_rest = summary["stop_reason"] == "rest"
    answer = "yes" if at_rest else f"no ({HOW_ENDED[summary['stop_reason']]})"
    asked = f"rest asks for {limit} and a front that stands still over {REST_WINDOW:g} sqrt(h0/g)"
    return check(name, float(not at_rest), 0.0, f"{answer}: {state}; {asked}")


def _steps(summary: dict | None) -> dict:
    """How often Newton had to try again, over the steps of the implicit run."""
    name = "tries that failed, implicit"
    if not summary:
        return check(name, None, FEW_FAILED, FAILED)
    share = summary["failed_steps"] / summary["steps"]
    said = f"{summary['failed_steps']} in {summary['steps']} steps, {share:.1%}{_allowed(FEW_FAILED)}"
    return check(name, share, FEW_FAILED, said)
