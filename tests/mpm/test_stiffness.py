"""The moduli that the explicit solver follows a collapse with."""

import pytest

from mpm.body import build
from mpm.load import load_scene
from mpm.stiffness import limit_bulk


def moduli(*settings):
    """Constants of `column_small` as they are and as they are followed, and rho g h0 [Pa]."""
    body = build(load_scene("column_small", list(settings)))
    return body.constants, limit_bulk(body).constants, 2000.0 * 9.81 * 0.5


def test_a_nearly_incompressible_sand_keeps_its_volume_as_well_with_less():
    own, used, weight = moduli("material.poisson=0.499")
    assert own.bulk > 50 * 500 * weight
    assert used.bulk == pytest.approx(500 * weight)
    assert used.shear == own.shear
    assert used.p_wave_speed < own.p_wave_speed / 8


@pytest.mark.parametrize("young", [5.84e5, 5.84e6, 5.84e8])
def test_stiffness_is_kept_where_poissons_ratio_is_that_of_sand(young):
    own, used, _ = moduli("material.poisson=0.3", f"material.young={young}")
    assert used.bulk == pytest.approx(own.bulk, rel=1e-12)


def test_a_stiff_and_nearly_incompressible_sand_is_followed_with_a_bulk_modulus_of_nu_03():
    own, used, weight = moduli("material.poisson=0.499", "material.young=5.84e8")
    assert used.bulk == pytest.approx(1.3 / 0.6 * own.shear)
    assert used.bulk > 500 * weight


@pytest.mark.parametrize("what", ["material.cohesion=100.0", "material.model=elastic"])
def test_what_can_stand_keeps_its_moduli(what):
    own, used, _ = moduli("material.poisson=0.499", what)
    assert used == own
