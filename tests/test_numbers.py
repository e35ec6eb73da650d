"""The numbers of README.md and docs/ are those of the committed tables of benchmarks/results: tables as a whole, and
sentences whose numbers are worked out here anew."""

import json
import re
import runpy
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import curve_fit

from compare.ensembles import estimate, paired, relative, within
from compare.experiments import experiments, measured_runout
from mpm.theory import eq6, eq6_printed

ROOT = Path(__file__).parents[1]
TABLES = runpy.run_path(str(ROOT / "docs" / "make_tables.py"))
rows_of, plain = TABLES["rows_of"], TABLES["plain"]
EXPLICIT = TABLES["explicit_runs"]()  # (lambda0, D, cells per r0): R_995
IMPLICIT = {(float(row["lambda0"]), float(row["cells"])): row for row in TABLES["implicit_runs"]()}
TWENTY = {(float(row["lambda0"]), float(row["damping"])): row for row in TABLES["twenty"]()}
ENSEMBLES = TABLES["ensembles"]()  # (run, lambda0, precision): {cells per r0: rows}
ASPECTS = (0.5, 1.0, 2.0, 4.0)
SCATTERED = "grid.scatter=0.5"
CREEP = "creep after rest"  # the explicit solver's hard case


def r(row) -> float:
    return float(row["R_995"])


def text(page: str) -> str:
    """A page as one line."""
    return " ".join((ROOT / page).read_text(encoding="utf-8").split())


def numbers(page: str, sentence: str) -> list[str]:
    """The numbers of a page where `sentence` has #; the sentence must stand there once."""
    pattern = re.escape(sentence).replace(r"\#", r"([-+]?[\d.,]*\d)").replace(r"\ ", " ")
    found = re.findall(pattern, text(page))
    assert len(found) == 1, f"{page}: {sentence!r} stands there {len(found)} times"
    return [found[0]] if isinstance(found[0], str) else list(found[0])


def percent(*ratios: float) -> list[float]:
    return [100.0 * (ratio - 1.0) for ratio in ratios]


def stands(page: str, sentence: str, *values: float):
    """Each number of the sentence is one of `values`, in their order, rounded to as many digits as it has."""
    given = numbers(page, sentence)
    assert len(given) == len(values)
    for number, value in zip(given, values, strict=True):
        digits = len(number.partition(".")[2])
        assert float(number) == pytest.approx(value, abs=0.5001 * 10.0**-digits), sentence


@pytest.mark.parametrize("page", TABLES["PAGES"], ids=lambda page: page.name)
def test_tables_are_those_of_the_committed_results(page):
    """`python docs/make_tables.py` writes them anew."""
    written = page.read_text(encoding="utf-8")
    assert TABLES["updated"](written) == written


def test_every_table_has_its_place():
    names = [
        name for page in TABLES["PAGES"] for name in re.findall(r"<!-- table ([\w-]+): docs", page.read_text("utf-8"))
    ]
    assert sorted(names) == sorted(TABLES["TABLES"])


def test_another_number_in_a_table_is_found():
    page = (ROOT / "README.md").read_text(encoding="utf-8")
    run_out = f"{r(IMPLICIT[1.0, 20.0]):.3f} ("
    assert page.count(run_out) == 1
    assert TABLES["updated"](page.replace(run_out, "9.999 (")) == page
    sentence = "finds # of # within all their limits"
    found, all_of_them = map(float, numbers("docs/limits.md", sentence))
    stands("docs/limits.md", sentence, found, all_of_them)
    with pytest.raises(AssertionError, match=r"finds # of #[\s\S]*Expected"):
        stands("docs/limits.md", sentence, found + 1, all_of_them)


def test_what_the_readme_says_of_its_table():
    finest = {ratio: row for (ratio, _), row in IMPLICIT.items()}
    worst = max(abs(TABLES["over_eq4"](row)) for row in finest.values())
    stands("README.md", "**The implicit solver ends within # % of Eq. 4** on the grids of the table", 100 * worst)
    stands("docs/implicit.md", "Every run ends within # % of Eq. 4 on the finest grid of its aspect ratio", 100 * worst)
    falls = 100 - 100 * r(IMPLICIT[0.5, 20.0]) / r(IMPLICIT[0.5, 16.0])
    short = -100 * TABLES["over_eq4"](IMPLICIT[0.5, 20.0])
    said = "# % short of it on 20 cells per r0 (# % less than on 16)"
    stands("docs/limits.md", said, short, falls)
    above = [TABLES["over_eq4"](TWENTY[ratio, 0.4]) for ratio in ASPECTS]
    beside = [
        EXPLICIT[ratio, 0.4, cells] / r(row)
        for (ratio, cells), row in IMPLICIT.items()
        if (ratio, 0.4, cells) in EXPLICIT
    ]
    said = "it ends # to # % above Eq. 4 and # to # % above the implicit solver"
    for page in ("README.md", "docs/limits.md"):
        stands(page, said, 100 * min(above), 100 * max(above), *percent(min(beside), max(beside)))


def test_what_is_said_of_creep():
    of: dict[tuple[str, str], dict[float, float]] = {}
    for row in rows_of("implicit_creep_cpu.csv"):
        of.setdefault((row["lambda0"], row["cells"]), {})[float(row["unbalanced"])] = r(row)
    grows = percent(*(of[at][1e-3] / of[at][5e-3] for at in (("0.5", "8"), ("1", "8"), ("0.5", "16"))))
    stands("README.md", "where rest is declared moves R_995 by # to # %", min(grows), max(grows))
    stands("docs/implicit.md", "where rest is declared moves R_995 by # to # %", min(grows), max(grows))
    stands("docs/limits.md", "R_995 grows by #, # and # % more while what is out of balance falls", *grows)
    after = {row["what"]: 100 * float(row["value"]) for row in rows_of("stability_cpu.csv") if row["case"] == CREEP}
    said = "Explicit, D = 0.4: by # and # % in another 4 sqrt(h0/g) after rest"
    stands("docs/limits.md", said, *(after[f"lambda0 = {ratio}: R in another 4 sqrt(h0/g)"] for ratio in ("0.5", "1")))


def test_the_experiments_lie_between_the_measures_of_light_damping():
    assert "they lie between R_995 and R_max, or within 2 % of R_max" in text("docs/paper.md")
    for ratio in ASPECTS:
        row, known = TWENTY[ratio, 0.05], measured_runout(ratio)
        assert r(row) < known < 1.02 * float(row["R_max"])


def test_what_the_page_on_the_paper_says():
    page = "docs/paper.md"
    above = [100 * TABLES["over_eq4"](TWENTY[ratio, 0.4]) for ratio in ASPECTS]
    stands(page, "**D = 0.4 ends above Eq. 4**: by #, #, # and # %", *above)
    known = experiments()
    printed, exchanged = (
        float(np.sqrt(np.mean((form(known[:, 0]) - known[:, 1]) ** 2))) for form in (eq6_printed, eq6)
    )
    stands(page, "misses the digitised experiments by an RMSE of #; with", printed)
    stands(page, "1.30 lambda0^0.63, by the # that the paper states", exchanged)
    for measure in ("R_995", "R_max"):
        for ratio in ASPECTS:
            run_outs = [float(TWENTY[ratio, damping][measure]) for damping in (0, 0.05, 0.1, 0.2, 0.4)]
            assert run_outs == sorted(run_outs, reverse=True)


def test_pairs_of_runs_end_as_near_as_the_page_on_the_paper_says():
    pairs = {}
    for row in plain(rows_of("explicit_ladder_h200.csv")):
        pairs.setdefault((row["lambda0"], row["damping"], row["cells"]), []).append(r(row))
    apart = [100 * (max(two) / min(two) - 1) for two in pairs.values() if len(two) == 2]
    stands("docs/paper.md", "they end within # % of each other", max(apart))


def test_why_damping_is_not_quasistatic():
    page = "docs/paper.md"
    ladder = {
        (row["lambda0"], row["damping"], row["cells"], row["settings"]): r(row)
        for row in rows_of("explicit_ladder_h200.csv")
    }
    stiff = {
        row["lambda0"]: r(row)
        for row in rows_of("explicit_stiff_cpu.csv")
        if row["settings"] == "material.young=5.84e7"
    }
    creep = {
        (row["lambda0"], row["cells"], float(row["unbalanced"])): r(row) for row in rows_of("implicit_creep_cpu.csv")
    }
    material = {row["settings"]: r(row) for row in rows_of("implicit_material_cpu.csv")}
    explicit, implicit = EXPLICIT[1.0, 0.4, 8.0], r(IMPLICIT[1.0, 8.0])
    stands(page, "the explicit run ends at #, the implicit one at #.", explicit, implicit)
    started = ladder["1", "0.4", "16", "loads.initial_stress=geostatic"]
    stands(page, "16 cells: # against #)", started, EXPLICIT[1.0, 0.4, 16.0])
    rested = creep["1", "8", 1e-3]
    stands(page, "0.1 % is out of balance, the implicit one ends at #", rested)
    tenfold = ladder["1", "0.4", "8", "material.young=5.84e7"]
    moved = material["material.young=5.84e7"] / implicit
    said = (
        "ten times stiffer it ends at #, # % shorter, where the implicit one moves by # %. Then the two are # % apart"
    )
    stands(page, said, tenfold, -percent(tenfold / explicit)[0], *percent(moved, tenfold / rested))
    low = stiff["0.5"], creep["0.5", "8", 1e-3]
    stands(page, "at lambda0 = 0.5 likewise, # and #, # %", *low, *percent(low[0] / low[1]))


def test_what_the_page_on_the_implicit_solver_says_of_the_grid():
    page = "docs/implicit.md"
    at = {ratio: {cells: r(IMPLICIT[ratio, cells]) for cells in (8.0, 10.0, 16.0, 20.0)} for ratio in (0.5, 1.0)}
    low, high = at[0.5], at[1.0]
    said = "at lambda0 = 0.5 by # % from 10 to 16 cells and # % from 16 to 20, at lambda0 = 1 by # % from 8 to 10, "
    said += "# % from 10 to 16 and # % from 16 to 20"
    changes = percent(
        low[16] / low[10], low[20] / low[16], high[10] / high[8], high[16] / high[10], high[20] / high[16]
    )
    stands(page, said, *changes)
    of = {cells: TABLES["run_out"](rows) for cells, rows in ENSEMBLES["implicit", 0.5, "float64"].items()}
    steps = [relative(of[fine], of[coarse]) for coarse, fine in ((16.0, 20.0), (20.0, 32.0))]
    said = "by # ± # % from 16 to 20 cells and # ± # % from 20 to 32."
    stands(page, said, *(100 * x for step in steps for x in (step.mean, step.half)))
    fitted = []
    for coarsest in (8.0, 10.0):
        fine = [cells for cells in of if cells >= coarsest]
        size, means = 10.0 / np.array(fine), [of[cells].mean for cells in fine]
        errors = [of[cells].standard_error for cells in fine]
        limit, _, order = curve_fit(lambda h, a, c, p: a + c * h**p, size, means, (0.3, 0.05, 1.5), errors)[0]
        fitted += [order, limit, *percent(limit / float(IMPLICIT[0.5, 20.0]["eq4"]))]
    said = "R + C h^p through those of 8 cells and more gives p = # and R = # (#% of Eq. 4), "
    stands(page, said + "of 10 and more p = # and R = # (#%)", *fitted)
    less = -np.mean([fitted[2], fitted[5]])
    stands(page, "So it tends to some # % less than Eq. 4", less)
    stands("README.md", "At lambda0 = 0.5 it tends to some # % less as cells shrink", less)
    stands("docs/limits.md", "some # % in the limit", less)


def test_what_the_page_on_the_implicit_solver_says_of_iterations():
    page = "docs/implicit.md"
    before = {(float(row["lambda0"]), float(row["cells"])): row for row in plain(rows_of(TABLES["FROM_NONE"]))}
    times = {
        at: int(before[at]["newton_iterations"]) / int(row["newton_iterations"])
        for at, row in IMPLICIT.items()
        if at[0] <= 1.0
    }
    said = "From u = 0 a collapse of lambda0 = 0.5 or 1 takes # to # times as many iterations"
    stands(page, said, min(times.values()), max(times.values()))
    (own,), usual = rows_of("implicit_own_modulus_cpu.csv"), IMPLICIT[0.5, 8.0]
    said = "E x 10 takes # steps and # Newton iterations where the default takes # and # (8 cells per r0"
    stands(page, said, *(int(row[key]) for row in (own, usual) for key in ("steps", "newton_iterations")))
    said = "A Newton iteration takes # ms at 1,624 points and # ms at 12,912"
    each = [IMPLICIT[0.5, cells] for cells in (8.0, 16.0)]
    assert [row["points"] for row in each] == ["1624", "12912"]
    for given, row in zip(numbers(page, said), each, strict=True):  # two digits
        assert float(given) == float(f"{1000 * float(row['cpu_s']) / int(row['newton_iterations']):.2g}")


def test_what_the_page_on_the_implicit_solver_says_does_not_matter():
    page = "docs/implicit.md"
    usual = {ratio: r(IMPLICIT[ratio, 8.0]) for ratio in (0.5, 1.0)}
    material = {
        row["settings"].removeprefix("material."): r(row) / usual[1.0] for row in rows_of("implicit_material_cpu.csv")
    }
    farther = percent(material["poisson=0.49"], material["poisson=0.499"])
    stands(page, "nu = 0.49 and 0.499 end # and # % farther than nu = 0.3", *farther)
    young = percent(*(material[f"young=5.84e{power}"] for power in (5, 7, 8)))
    stands(page, "E = 0.58, 58 and 584 MPa at #, # and # %", *young)
    placed = {}
    for row in rows_of("implicit_lattice_cpu.csv"):
        change = percent(r(row) / usual[float(row["lambda0"])])[0]
        placed[row["turned"], row["shifted"], row["lambda0"]] = change
    turned = [placed["45", "0 0 0", ratio] for ratio in ("0.5", "1")]
    stands(page, "turned by 45 degrees to the grid ends # (lambda0 = 0.5) and # % off", *turned)
    shifted = [placed["0", "0.142857 0.142857 0", ratio] for ratio in ("0.5", "1")]
    stands(page, "a seventh of a cell along x and y ends # and # % off", *shifted)
    lifted = [placed["0", "0 0 0.142857", ratio] for ratio in ("0.5", "1")]
    stands(page, "ends # and # % farther", *lifted)


def test_what_is_said_of_ensembles():
    known = {at: {cells: TABLES["run_out"](rows).mean for cells, rows in of.items()} for at, of in ENSEMBLES.items()}
    seconds = {
        (*at, cells): float(np.mean([float(row["cpu_s"]) for row in rows]))
        for at, of in ENSEMBLES.items()
        for cells, rows in of.items()
    }

    def off(solver, ratio, cells):
        of = known[solver, ratio, "float64"]
        return percent(of[cells] / of[max(of)])[0]

    def cost(solver, ratio, cells):
        return seconds[solver, ratio, "float64", cells]

    page = "docs/speed.md"
    said = (
        "to come within # % of its own run at 16 cells, at lambda0 = 1, it needs 8 cells and # s, the implicit one 10 "
    )
    within, *rest = (float(number) for number in numbers(page, said + "cells and # s"))
    values = [cost("D = 0.4", 1.0, 8.0), cost("implicit", 1.0, 10.0)]
    assert rest == pytest.approx(values, abs=0.051)
    assert max(max(known[solver, 1.0, "float64"]) for solver in ("D = 0.4", "implicit")) == 16.0
    solvers, low = ("D = 0.4", "implicit"), {}
    for cells in (10.0, 16.0, 20.0):
        low[cells] = [each for solver in solvers for each in (off(solver, 0.5, cells), cost(solver, 0.5, cells))]
    said = "with 10 cells the explicit run is # % off its own at 32 after # s, the implicit one # % after # s; "
    said += "with 16 # % after # s and # % after # s; with 20 # % after # s and # % after # s."
    stands(page, said, *low[10.0], *low[16.0], *low[20.0])
    equal = low[16.0][0], low[16.0][1], low[20.0][2], low[20.0][3]
    said = "# % off, the explicit run is there after # s, the implicit one, at # %, after # s: # times as long"
    stands(page, said, *equal, equal[3] / equal[1])
    nearest = off("D = 0.4", 1.0, 8.0), off("implicit", 1.0, 10.0)
    assert max(nearest) < within + 0.05
    said = "at lambda0 = 1 it is # % from its own run at 16 cells after # s of one core, the implicit one # % after # s"
    given = [float(number) for number in numbers("README.md", said)]
    assert given == pytest.approx([nearest[0], values[0], nearest[1], values[1]], abs=0.051)
    said = "at 0.5 it is # % from its run at 32 cells after # s, the implicit one # % after # s"
    stands("README.md", said, *equal)
    assert max(known["D = 0.4", 0.5, "float64"]) == max(known["implicit", 0.5, "float64"]) == 32.0
    powers = [
        np.log(cost(solver, ratio, last) / cost(solver, ratio, 10.0)) / np.log(last / 10.0)
        for solver in ("implicit", "D = 0.4")
        for ratio, last in ((0.5, 32.0), (1.0, 16.0))
    ]
    stands(page, "cost grows with a power of # to # of the resolution", min(powers[:2]), max(powers[:2]))
    assert 3 < min(powers[2:]) < max(powers[2:]) < 4
    apart = [known["D = 0.4", ratio, "float64"][16.0] / known["implicit", ratio, "float64"][16.0] for ratio in (0.5, 1)]
    far = known["D = 0.4", 0.5, "float64"][32.0] / known["implicit", 0.5, "float64"][32.0]
    stands(page, "at 16 cells they are # and # % apart, at 32 (lambda0 = 0.5) # %", *percent(*apart, far))
    stands("README.md", "on 16 cells they are # and # % apart", *percent(*apart))
    page = "docs/paper.md"
    moved = []
    for (solver, ratio, precision), of in ENSEMBLES.items():
        for cells, rows in of.items() if precision == "float32" else ():
            other = {row["realisation"]: r(row) for row in ENSEMBLES[solver, ratio, "float64"][cells]}
            moved.append(estimate(100 * (r(row) / other[row["realisation"]] - 1) for row in rows))
    worst = max(moved, key=lambda one: abs(one.mean) + one.half)
    stands(page, "it moves R_995 by at most # ± # %", abs(worst.mean), worst.half)
    everything = rows_of("ensembles_cpu.csv")
    gain = max(abs(float(row["volume_ratio"]) - 1) for row in everything)
    stands(page, "lose or gain at most # % of their volume", 100 * gain)
    stands(page, "no cell holds more than # points", max(float(row["most_points_in_a_cell"]) for row in everything))


def test_what_is_said_of_the_cost_of_stiffness():
    page, seconds = "docs/speed.md", {}
    for row in rows_of("study_error_cpu.csv"):
        if row["cells"] == "8.0" and row["precision"] == "float64":
            seconds[row["solver"], row["changed"]] = float(row["seconds"])
    said = "the explicit run takes # and # times as long for 10 and 100 times as much, the implicit one # and # times"
    more = [seconds[solver, e] / seconds[solver, ""] for solver in ("explicit", "implicit") for e in ("E10", "E100")]
    stands(page, said, *more)
    (soft,) = (row for row in rows_of("study_error_cpu.csv") if row["changed"] == "soft")
    alike = seconds["explicit", "soft"] / seconds["implicit", "E10"]
    said = "both with E = # MPa, the explicit run takes # times as long as the implicit one with 8 cells per r0"
    stands(page, said, float(soft["young"]) / 1e6, alike)


def test_what_is_said_of_material_in_the_explicit_solver():
    of = {}
    for row in rows_of("explicit_material_ensembles_cpu.csv"):
        of.setdefault((row["damping"], row["settings"].removeprefix("grid.scatter=0.5").strip()), []).append(r(row))
    known = {at: estimate(values) for at, values in of.items()}

    def changes(setting, *dampings):
        found = [relative(known[damping, setting], known[damping, ""]) for damping in dampings]
        return [number for change in found for number in (100 * change.mean, 100 * change.half)]

    page = "docs/limits.md"
    said = "it ends # ± # % from nu = 0.3 at D = 0.05 and # ± # % at D = 0.4"
    stands(page, said, *changes("material.poisson=0.499", "0.05", "0.4"))
    said = "E x 10 by # ± # % (D = 0.05: # ± # %; likewise)"
    stands(page, said, *changes("material.young=5.84e7", "0.4", "0.05"))
    stands(page, "E x 100 by # ± # % (three", *changes("material.young=5.84e8", "0.4"))
    lattice = {(row["lambda0"], row["damping"], row["settings"]): r(row) for row in rows_of("explicit_stiff_cpu.csv")}
    hundred = lattice["1", "0.05", "material.young=5.84e8"] / EXPLICIT[1.0, 0.05, 8.0]
    stands(page, "D = 0.05: # %, one run", *percent(hundred))
    undamped = [*changes("material.young=5.84e7", "0"), *changes("material.young=5.84e8", "0")]
    stands(page, "E x 10 ends # ± # % and E x 100 # ± # % off at D = 0", *undamped)


def test_what_is_said_of_the_papers_claims():
    page = "docs/paper.md"
    report = json.loads((ROOT / "docs" / "study_paper" / "report.json").read_text(encoding="utf-8"))
    three = json.loads((ROOT / "docs" / "study_paper" / "three.json").read_text(encoding="utf-8"))["checks"]
    said = "`study_paper_three_cpu.csv`) # of the # hold, # do not, and # is open"
    tally = [sum(one["holds"] is verdict for one in three) for verdict in (True, False, None)]
    stands(page, said, tally[0], len(three), *tally[1:])
    (undecided,) = (one["name"] for one in three if one["holds"] is None)
    assert undecided == "The implicit solver ends near Eq. 4"
    holds = [one["holds"] for one in report["checks"]]
    said = "So # of # claims hold, # do not, and two realisations leave # open"
    stands(page, said, holds.count(True), len(holds), holds.count(False), holds.count(None))
    rows = [row for row in rows_of("study_paper_cpu.csv") if row["label"] == "D = 0.05"]
    farthest, front = (
        percent(*(float(row[measure]) / float(row["experiments"]) for row in rows)) for measure in ("R_max", "R_995")
    )
    assert len(rows) == 4
    known = min(farthest), max(farthest), -max(front), -min(front)
    stands(page, "it ends # to # % beyond the experiments in the mean, where R_995 ends # to # % short of them", *known)
    (runs,) = {int(row[f"{measure}_n"]) for row in rows for measure in ("R_max", "R_995")}
    said = "in the mean of # realisations R_max ends # to # % beyond them, R_995 # to # % short"
    for bullets in (page, "README.md"):
        stands(bullets, said, runs, *known)
    said = "Of the paper's # claims # hold, # do not, and # are left open"
    stands("README.md", said, len(holds), *(holds.count(each) for each in (True, False, None)))


def test_what_is_said_of_hard_cases():
    page, cases = "docs/limits.md", {}
    for row in rows_of("stability_cpu.csv"):
        cases.setdefault(row["case"], {})[row["what"]] = row
    stable = [all(row["outcome"] == "stable" for row in found.values()) for found in cases.values()]
    stands(page, "finds # of # within all their limits", sum(stable), len(stable))

    def of(case, what):
        (row,) = [row for name, row in cases[case].items() if what in name]
        return float(row["value"])

    both = ("near-incompressible", "near-incompressible, implicit")
    said = "scatter # (explicit) and # times as much at nu = 0.499 as at 0.3"
    stands(page, said, *(of(case, "nu = 0.499: pressure scatter in a cell of a standing") for case in both))
    stands(page, "turned by 45 degrees (# %, 2 % allowed)", 100 * of("symmetry", "turned by 45 degrees"))
    stands(page, "settlement scatters by # %", 100 * of("small cut, implicit", "settlement of the top"))
    stands(page, "at nu = 0.499 as at 0.3 (# % apart explicit;", 100 * of("clay", "tall block, nu = 0.499: R"))


def test_what_is_said_of_the_grids_directions():
    page, ends = "docs/limits.md", {}
    for table in ("explicit_lattice_ensembles_cpu.csv", "ensembles_cpu.csv"):
        for row in rows_of(table):
            if row["mode"] == "explicit" and row["precision"] == "float64" and row["settings"] == SCATTERED:
                place = row["shifted"], row["turned"], row["symmetry"]
                ends.setdefault((row["lambda0"], row["damping"], row["cells"], *place), []).append(r(row))

    def turned(ratio, damping, cells, symmetry):
        both = (ends[ratio, damping, cells, "0 0 0", *turn] for turn in (("45", "full"), ("0", symmetry)))
        change = relative(*map(estimate, both))
        return 100 * change.mean, 100 * change.half

    said = "end # ± # (D = 0.05) and # ± # % (D = 0.4) farther when turned by 45 degrees at lambda0 = 0.5, "
    said += "# ± # and # ± # % at 1"
    stands(page, said, *(x for ratio in ("0.5", "1") for d in ("0.05", "0.4") for x in turned(ratio, d, "8", "full")))
    said = "On 16 cells, against the quarter column, it is # ± # and # ± # % at 1"
    stands(page, said, *(x for d in ("0.05", "0.4") for x in turned("1", d, "16", "quarter")))


def test_what_is_said_of_the_energy_that_is_lost():
    lost = {}
    for row in plain(rows_of("explicit_ladder_h200.csv")):
        if (row["lambda0"], row["damping"], row["realisation"]) == ("1", "0.05", "0"):
            lost[row["cells"]] = 100 * float(row["energy_residual"])
    said = "it is #, #, # and # % of the work of gravity at 8, 10, 16 and 20 cells per r0"
    stands("docs/limits.md", said, *(lost[cells] for cells in ("8", "10", "16", "20")))


def test_what_is_said_of_clumps():
    page, runs = "docs/limits.md", {}
    for row in rows_of("scatter_cpu.csv"):
        runs.setdefault((row["lambda0"], row["damping"], row["settings"]), []).append(row)
    of = [runs["4", "0.05", settings] for settings in ("", SCATTERED, "grid.scatter=1.0")]
    tall = [[IMPLICIT[8.0, 6.0]], runs["8", "", SCATTERED]]

    def rows(what, ensembles, last):
        def means(key):
            return [float(np.mean([float(row[key]) for row in its])) for its in ensembles]

        places = " | ".join("#" for _ in ensembles) + last
        changes = " | ".join("# %" for _ in ensembles[1:]) + last
        most = [max(float(row["most_points_in_a_cell"]) for row in its) for its in ensembles]
        said = f"| {what}: most points in a cell | {places} | | points in a full cell, over 8 | {places} | "
        said += f"| R_995 over the lattice's | | {changes} |"
        lattice, *others = means("R_995")
        stands(page, said, *most, *means("full_cell_ratio"), *percent(*(other / lattice for other in others)))

    rows("lambda0 = 4, explicit, D = 0.05, 8 cells", of, "")
    rows("lambda0 = 8, implicit, 6 cells", tall, " |")
    most = [max(float(TWENTY[ratio, d]["most_points_in_a_cell"]) for d in (0, 0.05, 0.1, 0.2, 0.4)) for ratio in (2, 4)]
    stands(page, "At 20 cells per r0 up to # points are in a cell at lambda0 = 2 and up to # at 4", *most)
    most, full = [], []
    for scatter in (SCATTERED, "grid.scatter=1.0"):
        flat = [row for (ratio, _, setting), its in runs.items() for row in its if (ratio, setting) == ("2", scatter)]
        assert {row["mode"] for row in flat} == {"explicit", "implicit"} and {row["cells"] for row in flat} == {"8"}
        most.append(max(float(row["most_points_in_a_cell"]) for row in flat))
        ratios = [float(row["full_cell_ratio"]) for row in flat]
        full += [min(ratios), max(ratios)]
    said = "at most # points are in a cell with scatter 0.5 and # with 1, and full ones hold # to # and # to # times 8"
    stands(page, said, *most, *full)


def test_what_is_said_of_the_cost_of_a_point_step():
    rows = [row for row in rows_of("bench_explicit_cpu.csv") if row["precision"] == "float64"]
    costs = [float(row["over_yardstick"]) for row in rows]
    points = sorted(int(row["points"]) for row in rows)
    said = f"From {points[0]:,} to {points[-1]:,} points the dearest point-step costs # % more than the cheapest"
    stands("docs/speed.md", said, *percent(max(costs) / min(costs)))


def test_what_two_ranks_of_the_implicit_solver_gain():
    of = {n: [row for row in rows_of("implicit_ranks_cpu.csv") if row["ranks"] == n] for n in ("1", "2")}
    gains = [float(a["wall_s"]) / float(b["wall_s"]) for a, b in zip(of["1"], of["2"], strict=True)]
    said = "Two ranks are # times as fast as one (median of the three pairs; # to #)"
    stands("docs/speed.md", said, float(np.median(gains)), min(gains), max(gains))
    heavier = 100 * (float(of["2"][0]["most_points_over_mean"]) - 1)
    stands("docs/speed.md", "and # % more points on one of the ranks", heavier)


def test_newton_takes_as_many_iterations_on_ranks_within_five_percent():
    """Both ends of each interval; thirty starts each."""
    of = {}
    for row in rows_of("implicit_starts_cpu.csv"):
        of.setdefault((row["petsc"], row["ranks"]), []).append(row)
    assert {ranks for petsc, ranks in of if petsc == "3.18.5"} == {"1", "2", "3", "4"}
    more, sweeps = [], []
    for (petsc, ranks), rows in of.items():
        alone = of[petsc, "1"]
        over = paired(*([float(row["newton"]) for row in some] for some in (rows, alone)))
        assert within(over, -0.05, 0.05) and over.n == 30
        each = [sum(float(r["linear"]) for r in some) / sum(float(r["newton"]) for r in some) for some in (rows, alone)]
        if ranks != "1":
            more.append(100 * over.mean)
            sweeps.append(100 * (each[0] / each[1] - 1))
    said = "So two to four ranks take # to # % more iterations, of # to # % more sweeps each"
    stands("docs/speed.md", said, min(more), max(more), min(sweeps), max(sweeps))


def test_what_is_said_of_whole_collapses():
    for cells in (8.0, 10.0):
        row = IMPLICIT[0.5, cells]
        runs = [row for row in rows_of("implicit_rest_cpu.csv") if row["set"] == f"grid.cell={1 / cells:g}"]
        before, now = ([one for one in runs if one["commit"].startswith("307c5ad") == early] for early in (True, False))
        assert len(before) == len(now) == 3 and f"{r(now[0]):.3f}" == f"{r(row):.3f}"
        seconds = [float(np.median([float(one["wall_s"]) for one in some])) for some in (before, now)]
        of_both = [
            each for key in (r, lambda one: int(one["newton_iterations"])) for each in (key(before[0]), key(now[0]))
        ]
        said = f"| implicit | {cells:g} | # -> # | rest -> rest | # -> # | # -> # | # |"
        stands("benchmarks/README.md", said, *of_both, *seconds, seconds[1] / seconds[0])
        present = r(now[0]), int(now[0]["newton_iterations"]), seconds[1]
        stands("docs/speed.md", f"| implicit | {cells:g} | # | # | # |", *present)
        _, run_out = numbers("benchmarks/README.md", f"| explicit, D = 0.4 | {cells:g} | # -> # |")
        stands("docs/speed.md", f"| explicit, D = 0.4 | {cells:g} | # | |", float(run_out))
        assert run_out == f"{EXPLICIT[0.5, 0.4, cells]:.3f}"


def test_what_the_page_on_the_paper_says_of_damping():
    page, everything = "docs/paper.md", rows_of("damping_cpu.csv")
    of_target = [row for row in everything if row["target"] == "1.119"]
    farthest = sorted((float(row["R_max"]), float(row["damping"])) for row in of_target if row["damping"])
    met = np.interp(1.119, *zip(*farthest, strict=True))
    stands(page, "the experiments would ask for about D = #:", met)
    of_eq4 = {row["run"]: row for row in everything if row["target"] != "1.119"}
    tried = [f"D = {damping}" for damping in ("0.45", "0.5625", "0.5906", "0.6188")]
    said = "# at D = 0.45, # at 0.5625, but # at 0.5906 and # at 0.6188"
    stands(page, said, *(r(of_eq4[run]) for run in tried))
    assert of_eq4["D = 0.675"]["R_995_n"] == "0"
    few, five = of_eq4["implicit"], TABLES["run_out"](ENSEMBLES["implicit", 1.0, "float64"][8.0])
    assert int(few["R_995_n"]) == 3 and five.n == 5
    said = "which has no D, ends at # ± # from these three starts, and at # ± # from five"
    stands(page, said, r(few), float(few["R_995_half"]), five.mean, five.half)
    for rows, runs in ((of_target, "5"), (of_eq4.values(), "3")):
        assert {row["R_995_n"] for row in rows} - {"0"} == {runs}


def test_what_the_page_on_the_explicit_solver_says_of_decay():
    page, without = "docs/explicit.md", {}
    for row in [*rows_of("explicit_decay_cpu.csv"), *rows_of("explicit_ladder_h200.csv")]:
        if row["settings"] == "explicit.unseen_decay=1e9":
            without[float(row["lambda0"]), float(row["damping"]), float(row["cells"])] = r(row)
    said = "ends at # in place of # on 8 cells, at # in place of # on 16; at D = 0.05 it moves R_995 by # % at most"
    pairs = [(without[0.5, 0.4, cells], EXPLICIT[0.5, 0.4, cells]) for cells in (8.0, 16.0)]
    moved = [abs(percent(value / EXPLICIT[at])[0]) for at, value in without.items() if at[1] == 0.05]
    stands(page, said, *(number for pair in pairs for number in pair), max(moved))
