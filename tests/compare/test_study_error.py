"""`repose study error`: limits, errors and times by hand, and the whole study on tiny runs."""

import json
import math

import numpy as np
import pytest
from installed import needs_implicit
from test_comparison import repose, rows_of

from compare.ensembles import Estimate
from compare.studies.error import _checks, _errors, _limit, ladder
from compare.studies.stiffness import crossover, like_with_like, softened_settings, stiffness_check
from mpm.errors import SceneError
from mpm.load import load_scene


def rows(family, values, error=1e-4, **more):
    solver = family.partition(",")[0]
    plain = {"solver": solver, "family": family, "changed": "", "young": 1e6, "precision": "float64"} | more
    return [
        plain | {"cells": cells, "R_995": value and Estimate(value, error, 4.0, 5), "each": each(value, error)}
        for cells, value in zip((5, 10, 20), values, strict=True)
    ]


def each(value, error):
    """Five runs around a value; of another error in another order."""
    off = [-1.0, 0.5, 0.0, -0.5, 1.0] if error < 1e-3 else [1.0, 0.0, -1.0, 0.5, -0.5]
    return [value and value + error * one for one in off]


RISING, FALLING = [0.3 + 0.2 / n for n in (5, 10, 20)], [0.4 - 0.1 / n for n in (5, 10, 20)]


def test_limits_and_errors_of_first_order_by_hand():
    """Explicit 0.3 + 0.2 h, implicit 0.4 - 0.1 h: at 10 cells 0.32 and 0.39."""
    plain = rows("explicit", RISING) + rows("implicit", FALLING)
    limits = {solver: _limit([row for row in plain if row["solver"] == solver]) for solver in ("explicit", "implicit")}
    assert limits["explicit"].value == pytest.approx(0.3) and limits["explicit"].order == pytest.approx(1.0)
    assert limits["explicit"].low < 0.3 < limits["explicit"].high
    explicit, implicit = (_errors(plain[at], limits, plain) for at in (1, 4))
    assert (explicit["error"], explicit["error_other"]) == (pytest.approx(0.02 / 0.3), pytest.approx(1 - 0.32 / 0.4))
    assert (implicit["error"], implicit["error_other"]) == (pytest.approx(0.01 / 0.4), pytest.approx(0.39 / 0.3 - 1))
    assert explicit["error_half"] == pytest.approx(2.776e-4 / 0.32, rel=1e-3)


def test_without_a_limit_there_is_no_error_and_the_other_solver_s_finest_grid_counts():
    plain = rows("explicit", RISING) + rows("implicit", [0.30, 0.40, 0.35])
    limits = {solver: _limit([row for row in plain if row["solver"] == solver]) for solver in ("explicit", "implicit")}
    assert not limits["implicit"].known and "oscillates" in limits["implicit"].said
    assert _errors(plain[4], limits, plain)["error"] is None
    assert _errors(plain[1], limits, plain)["error_other"] == pytest.approx(1 - 0.32 / 0.35)
    assert not _limit(rows("explicit", [0.3, None, 0.35])).known


def test_whether_a_run_out_converges_is_open_where_the_ensembles_are_too_small_to_tell():
    plain = rows("explicit", [0.351, 0.350, 0.3505], error=0.01) + rows("implicit", [0.30, 0.40, 0.35])
    limits = {solver: _limit([row for row in plain if row["solver"] == solver]) for solver in ("explicit", "implicit")}
    found = {one["name"]: one["holds"] for one in _checks(plain, plain, limits)}
    assert found["explicit run-out converges"] is None and found["implicit run-out converges"] is False


def test_claims_are_judged_by_the_difference_of_ensembles():
    """float32 0.1 % off in each pair; another step as scattered as 3 %; the solvers 33 % apart."""
    plain = rows("explicit", RISING) + rows("implicit", FALLING)
    plain += rows("explicit, float32", [1.001 * value for value in RISING])
    steps = [row | {"changed": "cfl0.25"} for row in rows("explicit", RISING, error=0.01)[2:]]
    limits = {solver: _limit(rows(solver, RISING)) for solver in ("explicit", "implicit")}
    found = {one["name"]: one["holds"] for one in _checks(plain + steps, plain, limits)}
    assert found == {
        "explicit run-out converges": True,
        "implicit run-out converges": True,
        "solvers agree on their finest grids": False,
        "float32 gives the run-out of float64": True,
        "explicit run-out hardly depends on the step": None,
        "implicit run-out hardly depends on the step": None,  # no such run
    }


def test_the_softened_body_is_what_the_implicit_solver_follows():
    """E = 600 rho g h0 and nu = 0.3, of lambda0 = 0.5 and rho = 2000: 5.886 MPa."""
    settings = dict(item.split("=") for item in softened_settings("column_0.5", []))
    assert float(settings["material.young"]) == pytest.approx(600 * 2000 * 9.81 * 0.5)
    assert float(settings["material.poisson"]) == pytest.approx(0.3)
    assert softened_settings("column_0.5", ["material.cohesion=1000.0"]) == ()  # keeps its moduli


def test_of_a_nearly_incompressible_body_the_shear_modulus_is_softened_less():
    """nu = 0.49: K = E/0.06 and G = E/2.98 for E = 584 MPa are beyond most/1.2 and most/2.6."""
    young, poisson = (float(item.split("=")[1]) for item in softened_settings("column_0.5", ["material.poisson=0.49"]))
    most = 600 * 2000 * 9.81 * 0.5
    assert young / (3 * (1 - 2 * poisson)) == pytest.approx(most / 1.2)
    assert young / (2 * (1 + poisson)) == pytest.approx(most / 2.6)


def timed(solver, young, seconds, used=None, changed=""):
    row = {"solver": solver, "young": young, "seconds": seconds, "young_used": used or young, "changed": changed}
    return row | {"cells": 8, "precision": "float64"}


def test_crossover_of_a_flat_and_a_rising_line():
    """Explicit 1 s at 1 MPa, rising with the square root of E; implicit 3 s throughout: they cross at 9 MPa."""
    stiff = [timed("explicit", young, root) for young, root in ((1e6, 1.0), (1e8, 10.0))]
    implicit = [timed("implicit", young, 3.0) for young in (1e6, 1e8)]
    found, sentence = crossover(stiff + implicit)
    assert found == pytest.approx(9e6)
    assert "below which the explicit one is faster" in sentence
    found, sentence = crossover(stiff + [row | {"seconds": 1e-3} for row in implicit])
    assert found is None and "the implicit solver is the faster one" in sentence


def test_like_is_compared_with_like():
    """Both follow 2 MPa in place of 100: implicit 3 s, explicit 1.5 s."""
    soft = timed("explicit", 2e6, 1.5, changed="soft")
    stiff = [timed("implicit", 1e6, 2.0), timed("implicit", 1e8, 3.0, used=2e6, changed="E100")]
    (sentence,) = like_with_like(stiff, [soft])
    assert "with E = 2 MPa in both solvers" in sentence and "time is 2.00 at 100 MPa" in sentence
    assert like_with_like(stiff[:1], [soft]) == []
    three = [timed("implicit", factor * 1e6, factor**0.5, changed=f"E{factor}") for factor in (10, 100)]
    found = stiffness_check([timed("implicit", 1e6, 1.0), *three], 1e6)
    assert (found["value"], found["holds"]) == (10.0, False)
    assert found["name"] == "implicit cost hardly depends on stiffness"


def test_the_cost_of_stiffness_says_which_runs_are_one_computation():
    """E = 10 and 100 MPa are both followed with 2."""
    alike = [timed("implicit", factor * 1e6, 1.5, used=2e6, changed=f"E{factor}") for factor in (10, 100)]
    found = stiffness_check([timed("implicit", 1e6, 1.0), *alike], 1e6)
    assert (found["name"], found["value"]) == ("implicit cost hardly depends on stiffness, after softening", 1.5)
    assert "E = 10 and 100 MPa are followed with 2 MPa" in found["sentence"]


def test_the_ladder_has_a_job_for_every_point():
    jobs = {one.name: one for one in ladder("column_small", [], [4, 5, 8], [10], "cpu")}
    expected = {f"explicit-{count}" for count in (4, 5, 8, 10)} | {f"implicit-{count}" for count in (4, 5, 8)}
    expected |= {f"explicit-{count}-float32" for count in (4, 5, 8)}
    expected |= {f"{mode}-5-E{factor}" for mode in ("explicit", "implicit") for factor in (10, 100)}
    expected |= {"explicit-5-soft", "explicit-8-cfl0.25", "explicit-8-cfl1.0"}
    assert jobs.keys() == expected | {"implicit-8-reach0.15", "implicit-8-reach0.6"}
    scene = load_scene("column_small")
    assert jobs["explicit-5-E100"].scene.material.young == 100 * scene.material.young
    assert jobs["explicit-5-soft"].scene.material.young < 100 * scene.material.young


def test_no_run_is_compared_with_itself(tmp_path):
    """Whatever precision and Courant number a scene file has."""
    file = tmp_path / "own.toml"
    column = "geometry = {shape = 'column', radius = 1.0, aspect_ratio = 0.5}"
    material = "material = {young = 1e6, poisson = 0.3, density = 2000.0, friction_angle = 37.55}"
    explicit = "explicit = {precision = 'float32', cfl = 0.25}"
    file.write_text(f"name = 'own'\n{column}\n{material}\ngrid = {{cell = 0.25}}\n{explicit}\n")
    for reference in ("column_small", str(file)):
        jobs = ladder(reference, [], [4, 5, 8], [10], "cpu")
        assert len({one.key for one in jobs}) == len(jobs) == 19


@pytest.mark.parametrize("setting", ["explicit.precision=float32", "explicit.cfl=0.25", "explicit.time_step=1e-4"])
def test_what_the_study_varies_cannot_be_set(setting):
    with pytest.raises(SceneError, match=setting.partition("=")[0]):
        ladder("column_small", [setting], [4, 5, 8], [], "cpu")


def test_three_resolutions_are_needed_to_extrapolate(capsys, tmp_path):
    assert repose("study", "error", "column_small", "--cells", "4", "8", "--out", tmp_path / "out") == 2
    assert "three different resolutions at least" in capsys.readouterr().err
    with pytest.raises(SceneError, match=r"grid\.scatter=0\.1: the study sets it itself"):
        ladder("column_small", ["grid.scatter=0.1"], [4, 5, 8], [], "cpu")


@needs_implicit
def test_the_study_has_a_point_for_every_resolution_precision_step_and_stiffness(tmp_path):
    folder = tmp_path / "out"
    settings = ("--set", "explicit.max_time=0.1", "--set", "implicit.max_steps=2", "--realisations", "2")
    asked = ("study", "error", "column_small", "--cells", "2", "3", "4", *settings, "--jobs", "2", "--out", folder)
    assert repose(*asked) == 0
    report = json.loads((folder / "report.json").read_text())
    assert len(rows_of(folder)) == len(report["rows"]) == 18
    for row in report["rows"]:
        label = "-float32" if row["family"].endswith("float32") else f"-{row['changed']}" if row["changed"] else ""
        name = f"{row['solver']}-{row['cells']:g}{label}"
        found = [json.loads(path.read_text()) for path in folder.glob(f"runs/{name}-r?-*/summary.json")]
        assert len(found) == row["R_995_n"] == 2
        assert row["R_995"] == pytest.approx(np.mean([one["R_995"] for one in found]))
        assert row["seconds"] == pytest.approx(np.median([one["wall_s"] for one in found]))
    of_soft = [row for row in report["rows"] if row["changed"] in ("E100", "soft")]
    used = {row["solver"] + row["changed"]: row["young_used"] for row in of_soft}
    assert used["implicitE100"] == pytest.approx(used["explicitsoft"])
    assert all(math.isfinite(row["error_other"]) for row in report["rows"])
