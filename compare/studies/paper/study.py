"""`repose study paper`: the paper's runs as ensembles, and a page that holds its figures against what was found."""

from pathlib import Path

from compare.batch import Workers
from compare.ensembles import flat, run_ensembles
from compare.report.page import refuse_another, write_table
from compare.report.sections import (
    WHAT_MEASURES_MEAN,
    about,
    cost_table,
    eq6_section,
    failures,
    stability_table,
    verdict,
)
from compare.studies.paper import runs
from compare.studies.paper.figures import fig9, fig10, fig11, profiles
from compare.studies.paper.theory import fig7, fig8, table1
from mpm.errors import SceneError
from mpm.theory import tan_phi


def study_paper(
    directory: Path,
    force,
    monitor,
    command: str,
    lambda0,
    damping,
    realisations: int,
    quick: bool,
    device,
    workers: Workers,
) -> dict:
    """Run or reuse the paper's runs and draw the figures in `directory`; the report (see `compare.report.page`).

    `lambda0`: aspect ratios h0/r0 > 0 [-]; `damping`: D >= 0 and < 1 [-]; `quick`: on coarse grids.
    `force`, `monitor`, `command`, `workers` and what is raised: see `compare.studies`.
    """
    if min(lambda0) <= 0 or min(damping) < 0 or max(damping) >= 1:
        raise SceneError("--lambda0: must be > 0 [-]; --damping: must be >= 0 and < 1 [-]")
    about_what = {"study": "paper", "quick": quick, "device": device, "lambda0": lambda0, "damping": damping}
    about_what |= {"realisations": list(range(realisations))}
    refuse_another(directory, about_what, force)
    jobs = runs.plan(sorted(set(lambda0)), sorted(set(damping)), quick, device)
    ensembles = run_ensembles(jobs, realisations, directory / "runs", workers, force, monitor)
    tangent = tan_phi(jobs[0].scene)
    rows = [runs.row(one, tangent) for one in ensembles]
    write_table([flat(row, runs.MEASURES) for row in rows], directory)
    made = [
        fig7(tangent, directory),
        fig8(directory),
        fig9(rows, ensembles, directory),
        fig10(rows, tangent, directory),
        fig11(rows, tangent, directory),
        table1(),
    ]
    checks = [one for claims, _ in made for one in claims]
    everything = [one for outcomes in ensembles for one in outcomes]
    failed = failures(everything, [one.job.name for one in everything])
    first = [outcomes[0] for outcomes in ensembles]
    labels = [one.job.name for one in first]
    tables = [stability_table(first, labels), cost_table(first, labels)]
    explicit, implicit = (runs.QUICK_CELLS, runs.QUICK_IMPLICIT_CELLS) if quick else (runs.CELLS, runs.IMPLICIT_CELLS)
    return {
        "about": about_what,
        "title": "The paper remade" + (", quick" if quick else ""),
        "lead": "Wyser et al. (2023), figure by figure: what it claims, what was found, whether it holds. "
        f"tan(phi) = {tangent:.3f}. Explicit runs have {explicit} cells per r0 (the paper's 20), implicit ones, up to "
        f"lambda0 = {runs.IMPLICIT_LAMBDA0:g}, {implicit}; each was made {realisations} times from points that start "
        "at random within half of their spacing. A claim that runs decide holds where its whole 95 % interval does; "
        "where the interval reaches across a limit it is undecided."
        + (" So coarse a grid runs too far: for a look at the page, no judgement." if quick else ""),
        "verdict": verdict(checks),
        "checks": checks,
        "sections": [
            *(section for _, section in made),
            profiles(ensembles, directory),
            {"title": "Stability and cost", "text": ["Of the first realisation of each ensemble.", *failed]}
            | {"tables": tables, "figures": []},
            {"title": "What the measures mean", "text": WHAT_MEASURES_MEAN, "tables": [], "figures": []},
            eq6_section(),
        ],
        "provenance": about(everything, command),
        "failed": failed,
        "rows": [flat(row, runs.MEASURES) for row in rows],
    }
