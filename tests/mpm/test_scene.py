"""Where Eq. 4 speaks of a scene, and what is said of a column with cohesion, of which it does not."""

import numpy as np
import pytest

from mpm.body import build
from mpm.load import load_scene
from mpm.theory import critical_height, outlook, theory

NONE = {"eq4": None, "eq45": None}


def test_a_column_of_sand_has_both_run_outs():
    """By hand, tan(37.55 degrees) = 0.7687, lambda0 = 0.5: a = 0.6505, (a + (4 - a^2/3)^(1/2))/2 - 1 = 0.3074."""
    found = theory(load_scene("column_small"))
    assert found["eq4"] == pytest.approx(0.3074, abs=1e-4)
    assert found["eq45"] == pytest.approx(0.4193, abs=1e-4)
    assert outlook(build(load_scene("column_small"))) == ""


@pytest.mark.parametrize(
    "settings",
    [
        ["material.cohesion=5000"],
        ["material.cohesion=1"],
        ["material.friction_angle=0", "material.cohesion=1"],
        ["material.model=elastic"],
        ["loads.gravity=0", "explicit.until=1", "output.history_every=0.1"],
    ],
    ids=str,
)
def test_eq4_is_for_what_friction_alone_holds(settings):
    assert theory(load_scene("column_small", settings)) == NONE


def test_a_box_has_no_eq4():
    assert theory(load_scene("self_weight", ["material.model=drucker_prager", "material.friction_angle=30"])) == NONE


def test_critical_height_of_a_vertical_cut():
    """Clay of 10 kPa and 20 kN/m3: 1.915 m. phi = 30 degrees: tan(60 degrees) = 3^(1/2) times as much."""
    assert critical_height(1e4, 2000.0, 10.0, 0.0) == pytest.approx(1.915)
    assert critical_height(1e4, 2000.0, 10.0, 30.0) == pytest.approx(1.915 * np.sqrt(3.0))


def test_a_column_stands_up_to_the_critical_height():
    """h0 = 0.5 m, phi = 37.55 degrees, tan(63.775 degrees) = 2.0300: 0.5 m at c = 1262 Pa. (Runs: 1.3 kPa stands, 1.1
    falls.)"""
    stands, falls = (outlook(build(load_scene("column_small", [f"material.cohesion={c}"]))) for c in (1270, 1255))
    assert stands.startswith("it stands: its height 0.5 m is below") and "= 0.503 m" in stands
    assert falls.startswith("no Eq. 4") and "is above" in falls and "= 0.497 m" in falls


def test_nothing_is_said_of_what_is_no_column_of_soil():
    for reference, settings in (
        ("self_weight", []),
        ("column_small", ["material.model=elastic", "material.cohesion=5000"]),
        ("column_small", ["material.cohesion=1", "loads.gravity=0", "explicit.until=1", "output.history_every=0.1"]),
    ):
        assert outlook(build(load_scene(reference, settings))) == ""
