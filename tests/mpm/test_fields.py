"""Pressure and mobilised friction against the closed forms, and of a solver's own points."""

import numpy as np
import pytest

from explicit.run import run
from mpm.fields import PLASTIC, UNITS, deviatoric_stress, friction_mobilised, pressure
from mpm.load import load_scene
from mpm.results import Results
from mpm.scene import Material

SAND = {"young": 1e7, "poisson": 0.3, "density": 2000.0}


def constants(**more):
    return Material(**SAND, **more).constants()


def test_pressure_is_minus_the_mean_stress():
    np.testing.assert_allclose(pressure(np.array([[-1.0, -2.0, -6.0, 9.0, 9.0, 9.0]])), [3.0])


def test_deviatoric_stress_is_that_of_the_triaxial_test_in_any_axes():
    """sigma_1 - sigma_3 = 70 kPa in compression and in extension, turned at random; sqrt(3) tau in simple shear."""
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    for axial, radial in ((-1e5, -3e4), (-3e4, -1e5)):
        s = turn @ np.diag([radial, radial, axial]) @ turn.T
        voigt = np.array([[s[0, 0], s[1, 1], s[2, 2], s[1, 2], s[0, 2], s[0, 1]]])
        assert deviatoric_stress(voigt) == pytest.approx([7e4])
    assert deviatoric_stress(np.array([[-1e5, -1e5, -1e5, 0.0, 3e4, 0.0]])) == pytest.approx([3e4 * np.sqrt(3.0)])


def test_simple_shear_mobilises_shear_over_strength():
    """sqrt(J2) = |tau| = 30 kPa at p = 100 kPa, phi = 30 degrees, psi = 0: eta = 0.5, xi = c cos(phi)."""
    stress = np.array([[-1e5, -1e5, -1e5, 0.0, 3e4, 0.0]])
    assert friction_mobilised(stress, [1.0], constants(friction_angle=30.0)) == pytest.approx([0.6])
    cohesive = constants(friction_angle=30.0, cohesion=1e4)
    assert friction_mobilised(stress, [1.0], cohesive) == pytest.approx([3e4 / (5e4 + 1e4 * np.cos(np.pi / 6))])


def test_the_cone_is_one_of_kirchhoff_stress():
    """J = 1.1 takes sqrt(J2) and p along, but not c: clay of 10 kPa bears 10/1.1 kPa of Cauchy stress."""
    stress = np.array([[0.0, 0.0, 0.0, 5e3, 0.0, 0.0]])
    clay = constants(friction_angle=0.0, cohesion=1e4)
    assert friction_mobilised(stress, [1.1], clay) == pytest.approx([0.55])
    sand = constants(friction_angle=30.0)
    stress = np.array([[-1e5, -1e5, -1e5, 0.0, 3e4, 0.0]])
    assert friction_mobilised(stress, [1.1], sand) == pytest.approx(friction_mobilised(stress, [1.0], sand))


def test_mobilised_friction_is_0_without_stress_and_never_above_1():
    sand = constants(friction_angle=30.0)
    stress = np.array([[0, 0, 0, 0, 0, 0], [-100, -100, -100, 60, 0, 0], [0, 0, 0, 1, 0, 0], [1, 1, 1, 1, 0, 0]])
    np.testing.assert_array_equal(friction_mobilised(stress, np.ones(4), sand), [0.0, 1.0, 0.0, 0.0])


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_a_run_stores_any_field_in_single_precision_and_they_agree(tmp_path, precision):
    """A column at rest under gravity, at sqrt(J2)/p = 3^(1/2) (1 - K0)/(1 + 2 K0) with K0 = nu/(1 - nu) = 3/7, over
    eta = sin(37.55 degrees): 0.8744. After 0.3 s most of it flows."""
    settings = ["grid.cell=0.25", "explicit.until=0.3", "output.every=0.3", f"output.fields={list(UNITS)}"]
    settings.append("loads.initial_stress=geostatic")
    scene = load_scene("column_small", [*settings, f"explicit.precision={precision}", "output.vtk=false"])
    run(scene, tmp_path / "run")
    results = Results.open(tmp_path / "run")
    last = results.snapshot(-1)
    assert {name for name in last if name not in ("time", "step", "x")} == set(UNITS)
    assert {last[name].dtype for name in UNITS} == {np.dtype(np.float32)}
    np.testing.assert_allclose(last["displacement"], last["x"] - results.read_static("x0"), atol=1e-6)
    np.testing.assert_allclose(last["volume"], 0.125**3 * last["volume_ratio"], rtol=1e-6)
    np.testing.assert_allclose(last["pressure"], pressure(last["stress"]), rtol=1e-4, atol=1e-2)
    np.testing.assert_allclose(last["deviatoric_stress"], deviatoric_stress(last["stress"]), rtol=1e-3, atol=1.0)
    mobilised = last["friction_mobilised"]
    assert mobilised.min() >= 0.0 and mobilised.max() == pytest.approx(1.0, abs=1e-5)
    again = friction_mobilised(last["stress"], last["volume_ratio"], scene.material.constants())
    loaded = last["pressure"] > 10.0  # below, single precision of the stress shows
    np.testing.assert_allclose(mobilised[loaded], again[loaded], atol=1e-3)
    at_rest = np.sqrt(3.0) * (4 / 7) / (13 / 7) / np.sin(np.radians(37.55))
    np.testing.assert_allclose(results.snapshot(0)["friction_mobilised"], at_rest, rtol=1e-5)
    assert np.mean(mobilised > 0.999) > 0.5


def test_elastic_scenes_have_no_plastic_fields():
    assert set(load_scene("column_small", ["material.model=elastic"]).output.fields).isdisjoint(PLASTIC)
    assert "volume_ratio" in load_scene("column_small").output.fields
