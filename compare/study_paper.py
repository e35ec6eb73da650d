"""The paper's runs: aspect ratio and damping, beside the implicit solver, theory and experiments."""

from compare.batch import Job

LAMBDA0 = (0.5, 1.0, 2.0, 4.0)
DAMPING = (0.0, 0.05, 0.1, 0.2, 0.4)
CELLS, QUICK_CELLS = 20, 8  # per r0, of the explicit runs; the paper's resolution is 20
# Of the implicit runs. An implicit run's cost grows with the fifth power of the resolution: half the paper's.
IMPLICIT_CELLS, QUICK_IMPLICIT_CELLS = 10, 5
IMPLICIT_LAMBDA0 = 2.0  # the highest column that the implicit solver is run for


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
    return jobs + [job("implicit", ratio, "implicit", implicit) for ratio in lambda0 if ratio <= IMPLICIT_LAMBDA0]
