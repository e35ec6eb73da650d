"""What is known of a run before its first step: refusals of each solver, and values that look like another unit."""

import math

import pytest

from mpm.body import build
from mpm.errors import SceneError
from mpm.load import load_scene, preset_names
from mpm.precheck import doubts, refusals, refuse

COARSE = "grid.cell=0.25"
COURANT = 0.25 / math.sqrt((5.84e6 / 1.2 + 4 / 3 * 5.84e6 / 2.6) / 2000.0)  # h/c of the coarse column [s]


def column(*settings):
    return build(load_scene("column_small", [COARSE, *settings]))


@pytest.mark.parametrize("name", preset_names())
def test_presets_are_neither_refused_nor_doubted(name):
    body = build(load_scene(name))
    assert [refusals(body, mode) for mode in ("explicit", "implicit")] == [[], []]
    assert doubts(body) == []


def test_a_fixed_time_step_may_reach_the_courant_limit_and_no_more():
    assert refusals(column(f"explicit.time_step={0.9999 * COURANT}"), "explicit") == []
    body = column(f"explicit.time_step={1.0001 * COURANT}")
    (line,) = refusals(body, "explicit")
    assert line.startswith("explicit.time_step = 0.003988: over the Courant limit, must be at most ")
    assert "= 0.003988 [s]" in line
    assert refusals(body, "implicit") == []  # it takes no such step
    with pytest.raises(SceneError, match="Courant limit"):
        refuse(body, "explicit")


def test_an_end_of_a_run_to_rest_is_refused_where_another_is_set():
    body = column("explicit.max_time=20", "explicit.until=0.5")
    (line,) = refusals(body, "explicit")
    assert line.startswith("explicit.max_time = 20: ends a run to rest, and explicit.until = 0.5 [s] ends this one")
    assert refusals(body, "implicit") == []  # it knows neither
    assert refusals(column("explicit.max_time=20"), "explicit") == []
    assert refusals(column("explicit.until=0.5"), "explicit") == []


def test_the_number_of_a_random_start_is_refused_where_points_start_on_a_lattice():
    for mode in ("explicit", "implicit"):
        (line,) = refusals(column("grid.realisation=3"), mode)
        assert line.startswith("grid.realisation = 3: ") and "grid.scatter = 0" in line and "[-]" in line
        assert refusals(column("grid.realisation=3", "grid.scatter=0.5"), mode) == []
        assert refusals(column("grid.realisation=0"), mode) == []


def test_the_implicit_solver_refuses_what_has_no_quasistatic_reading():
    weightless = ("loads.gravity=0", "explicit.until=1.0", "output.history_every=0.1")
    body = column("loads.ramp=0.5", *weightless)
    assert [line.split(" = ")[0] for line in refusals(body, "implicit")] == ["loads.gravity", "loads.ramp"]
    assert refusals(body, "explicit") == []


def test_a_body_that_its_weight_would_flatten_is_no_geostatic_one():
    """Compressed by rho g (h0 - h/4) / (1.346 E) at the lowest points, sideways by nothing: 1 at E = 6.4 kPa."""
    least = 2000.0 * 9.81 * 0.4375 / (1 / 1.2 + 4 / 3 / 2.6)
    for start in ("material.cohesion=100", "loads.initial_stress=geostatic"):
        assert refusals(column(start, f"material.young={1.01 * least}"), "implicit") == []
        (line,) = refusals(column(start, f"material.young={0.99 * least}"), "implicit")
        assert line.startswith("material.young = ") and "Hencky strain of 1.01" in line and "[Pa]" in line
    soft = f"material.young={0.99 * least}"
    assert refusals(column(soft), "explicit") == []  # starts without stress
    assert len(refusals(column(soft, "loads.initial_stress=geostatic"), "explicit")) == 1
    assert refusals(column(soft, "loads.initial_stress=none"), "implicit") == []


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("material.friction_angle=0.655", "material.friction_angle = 0.655: is it in degrees? in radians it would be "
                                          "37.53 degrees"),
        ("material.friction_angle=1.9", "material.friction_angle = 1.9: is it in degrees?"),
        ("material.young=5.84", "material.young = 5.84: is it in Pa?"),
        ("material.young=4.9e5", "material.young = 490000: is it in Pa? It is 50 rho g h0"),  # 50 are 490,500 Pa
        ("material.density=2", "material.density = 2: is it in kg/m3?"),
    ],
)  # fmt: skip
def test_a_value_that_looks_like_another_unit_is_doubted_in_a_line(setting, said):
    (line,) = doubts(column(setting))
    assert line.startswith(said) and "\n" not in line


@pytest.mark.parametrize(
    "setting",
    ["material.friction_angle=2", "material.young=4.91e5", "material.density=100", "loads.gravity=1.62"],
)
def test_a_value_that_is_merely_small_is_not_doubted(setting):
    assert doubts(column(setting)) == []


def test_clay_and_elastic_bodies_may_have_no_friction():
    assert doubts(column("material.friction_angle=0", "material.cohesion=1000")) == []
    assert doubts(column("material.model=elastic", "material.friction_angle=0.6")) == []
