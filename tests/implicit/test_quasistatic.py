"""Quasistatic collapses by the implicit solver: where they come to rest, and that hard inputs end in a result."""

import numpy as np
import pytest
from installed import HAS_IMPLICIT, NO_IMPLICIT

from mpm.body import build
from mpm.devices import start_warp
from mpm.load import load_scene
from mpm.runout import run_out
from mpm.seed import seed
from mpm.theory import theory

if not HAS_IMPLICIT:
    pytest.skip(NO_IMPLICIT, allow_module_level=True)

from implicit.pseudo_time import Regularisation, Rest
from implicit.solver import ImplicitSolver


def collapse(scene, *settings, change=lambda x, cell: x, most=400, steps=None, **regularisation):
    """Run to rest, or for `steps`; the solver and its run-outs, measured about where `change` moved the axis to."""
    start_warp()
    scene = load_scene(scene, list(settings))
    seeds, x = seed(scene.geometry, scene.grid.cell), build(scene).x
    moved = change(x.copy(), scene.grid.cell)
    body = build(scene, seeds._replace(x=moved))
    solver, rest = ImplicitSolver(body, Regularisation(**regularisation)), Rest(body.time_scale)
    axis = np.append(np.median(moved[: len(x), :2] - x[:, :2], axis=0), 0.0)
    while solver.steps < most:
        solver.advance()
        measures = run_out(solver.x - axis, body.measure)
        rests = rest(solver.time, measures["R_995"], solver.unbalanced_ratio)
        if rests if steps is None else solver.steps == steps:
            return solver, measures
    raise AssertionError(f"no rest after {most} steps, unbalanced ratio {solver.unbalanced_ratio:.2g}")


@pytest.fixture(scope="module")
def small():
    """The 8 cells per r0, lambda0 = 0.5 column at rest: solver and run-outs."""
    return collapse("column_small")


def test_a_small_column_rests_near_eq4_without_a_failed_step(small):
    """R_995 10 % beyond Eq. 4 on so few cells, the top at h0."""
    solver, measures = small
    assert 1.0 < measures["R_995"] / theory(solver.body.scene)["eq4"] < 1.13
    assert measures["h_inf"] == pytest.approx(0.5, abs=0.01)
    assert solver.failed_steps == 0
    assert solver.unbalanced_ratio <= 5e-3


def test_at_rest_the_front_does_not_climb():
    """Another 4 sqrt(h0/g) in pseudo-time move it by less than 0.5 %."""
    solver, measures = collapse("column_small")
    solver.advance_to(solver.time + 4.0 * solver.body.time_scale)
    after = run_out(solver.x, solver.body.measure)["R_995"]
    assert 0.0 <= after - measures["R_995"] < 0.005 * measures["R_995"]


def test_the_deposit_keeps_its_volume(small):
    """At psi = 0 sand neither swells nor packs: within 1 % (with the law at the points it gained 6 %)."""
    solver, _ = small
    assert abs(solver.material_points.jacobian.numpy().mean() - 1.0) < 0.01


def test_stiffness_costs_nothing_and_hardly_moves_the_front(small):
    """A hundred times stiffer, and softened for its collapse."""
    solver, measures = collapse("column_small", "material.young=5.84e8")
    assert measures["R_995"] == pytest.approx(small[1]["R_995"], rel=0.03)
    assert solver.newton_iterations < 2 * small[0].newton_iterations
    assert solver.unbalanced_ratio <= 5e-3


def test_only_a_cohesionless_collapse_is_softened():
    """K and G of E = 600 rho g h0, nu = 0.3 at most; what can stand keeps its own moduli."""

    def moduli(scene, *settings):
        body = build(load_scene(scene, list(settings)))
        return body.constants, Regularisation().limit_stiffness(body).constants

    _given, used = moduli("column_small", "material.young=5.84e8")
    young = 9.0 * used.bulk * used.shear / (3.0 * used.bulk + used.shear)
    assert young == pytest.approx(600 * 2000 * 9.81 * 0.5)
    assert used.bulk / used.shear == pytest.approx(1.3 / 0.6)
    given, used = moduli("column_small", "material.poisson=0.49")
    assert used.bulk == pytest.approx(500 * 2000 * 9.81 * 0.5) and used.shear == given.shear
    for scene, *settings in (
        ("column_small",),
        ("column_small", "material.young=5.84e8", "material.cohesion=100.0"),
        ("column_small", "material.young=5.84e8", "loads.initial_stress=none"),
        ("self_weight", "material.young=5.84e8"),
    ):
        given, used = moduli(scene, *settings)
        assert used == given


def test_inertia_carries_the_front_farther(small):
    """Full momentum (carry-over 1) is the dynamic collapse: it must overshoot the quasistatic one."""
    dynamic = collapse("column_small", momentum=1.0)[1]["R_995"]
    assert dynamic > 1.15 * small[1]["R_995"]


@pytest.mark.slow
@pytest.mark.parametrize("lambda0", [0.5, 1, 2])
def test_ten_cells_per_radius_agree_with_eq4(lambda0):
    solver, measures = collapse(f"column_{lambda0}", "grid.cell=0.1")
    assert measures["R_995"] == pytest.approx(theory(solver.body.scene)["eq4"], rel=0.10)
    assert solver.failed_steps <= 0.05 * solver.steps


@pytest.mark.slow
@pytest.mark.parametrize("changed", [{"ghost": 0.2}, {"ghost": 0.8}, {"reach": 0.15}, {"cap": 6.0}], ids=str)
def test_regularisation_moves_the_front_by_less_than_three_per_cent(changed):
    reference = collapse("column_0.5", "grid.cell=0.1")[1]["R_995"]
    assert collapse("column_0.5", "grid.cell=0.1", **changed)[1]["R_995"] == pytest.approx(reference, rel=0.03)


@pytest.fixture(scope="module")
def tall():
    return tall_column()


def tall_column(*settings):
    """lambda0 = 8 at 6 cells per r0, at rest: run-outs, and the number of points (i, j, k) in the cells."""
    solver, measures = collapse("column_1", "geometry.aspect_ratio=8.0", f"grid.cell={1 / 6!r}", *settings, most=800)
    cells = np.floor(solver.x / solver.cell).astype(int)
    count = np.zeros(cells.max(axis=0) + 1, int)
    np.add.at(count, tuple(cells.T), 1)
    return measures, count


def void_share(count):
    """Empty cells over the cells under the surface, the highest cell of each column that is at least half full."""
    half_full = count >= 4
    top = np.where(half_full.any(axis=2), count.shape[2] - 1 - half_full[:, :, ::-1].argmax(axis=2), -1)
    under = np.arange(count.shape[2]) <= top[:, :, None]
    return (count[under] == 0).mean()


@pytest.mark.slow
@pytest.mark.xfail(strict=True, reason="2.6 % of the cells under the surface are empty, others hold up to 38 points")
def test_a_tall_column_leaves_no_void(tall):
    assert void_share(tall[1]) == 0.0


@pytest.mark.slow
def test_a_tall_column_ends_at_eq4_with_as_many_voids_as_are_known(tall):
    """Eq. 4 gives 2.147 (R = 2.158 here). With the law at the points a crust stood over one void."""
    measures, count = tall
    assert measures["R_995"] == pytest.approx(2.147, rel=0.03)
    assert 0.015 < void_share(count) < 0.04
    assert 30 < count.max() < 46


@pytest.mark.slow
def test_a_tall_column_whose_points_start_at_random_leaves_no_void():
    """Within their whole spacing: R = 2.188, at most 17 points in a cell."""
    measures, count = tall_column("grid.scatter=1.0")
    assert void_share(count) == 0.0
    assert count.max() <= 20
    assert measures["R_995"] == pytest.approx(2.147, rel=0.03)


@pytest.mark.parametrize("cohesion", [5000, 1300])
def test_a_cohesive_column_stands(cohesion):
    """Equilibrium within a handful of steps, and no collapse.

    A vertical cut of height h0 stands from c = rho g h0/(4 tan(45 deg + phi/2)) on, 1,210 Pa here (plane strain, plane
    slip surface).
    """
    solver, measures = collapse("column_small", f"material.cohesion={cohesion}", most=8)
    assert solver.steps <= 8
    assert np.abs(solver.x - solver.body.x).max() < 0.01
    assert measures["h_inf"] == pytest.approx(0.5, abs=1e-3)


def test_a_column_of_too_little_cohesion_falls():
    """c = 1,100 Pa, 9 % below what a vertical cut needs: not just a settlement."""
    solver, measures = collapse("column_small", "material.cohesion=1100.0")
    assert measures["R_995"] > 0.1
    assert abs(solver.material_points.jacobian.numpy().mean() - 1.0) < 0.01


@pytest.mark.parametrize(("angle", "low", "high"), [(20, 0.40, 0.70), (45, 0.20, 0.32)])
def test_friction_angles_at_both_ends(angle, low, high):
    """phi = 20 degrees, whose K0 state lies outside the cone, and 45: at rest on either side of 37.55 degrees' 0.31.

    Eq. 4 gives 0.567 and 0.240.
    """
    _, measures = collapse("column_small", f"material.friction_angle={angle}")
    assert low < measures["R_995"] < high


def test_no_step_of_a_nearly_incompressible_column_fails():
    """The first 20 steps at nu = 0.49, in which it spreads most."""
    start_warp()
    solver = ImplicitSolver(build(load_scene("column_small", ["material.poisson=0.49"])))
    for _ in range(20):
        solver.advance()
    assert solver.failed_steps == 0
    assert solver.newton_iterations < 11 * solver.steps


@pytest.mark.parametrize("poisson", [0.49, 0.499])
def test_a_nearly_incompressible_column_rests_where_any_does(small, poisson):
    """Its collapse is followed with K of at most 500 rho g h0, so that it takes no more iterations."""
    solver, measures = collapse("column_small", f"material.poisson={poisson}")
    assert solver.failed_steps == 0
    assert solver.newton_iterations < 1.5 * small[0].newton_iterations
    assert measures["R_995"] == pytest.approx(small[1]["R_995"], rel=0.03)


def test_a_grain_in_the_air_falls_and_rests(small):
    solver, measures = collapse("column_small", change=lambda x, cell: np.vstack([x, [[0.3, 0.3, 1.0]]]))
    assert solver.x[-1, 2] < 0.8
    assert measures["R_995"] == pytest.approx(small[1]["R_995"], rel=0.02)


@pytest.fixture(scope="module")
def off_the_lattice():
    """R_995 of a full column shifted by a seventh of a cell along x and y, over that of one on the lattice.

    Not along z, where it would stand on a seventh of a cell of nothing: its lowest points already share the base's
    nodes, so the gap never closes, and it is a column as much taller.
    """

    def shift(x, cell):
        return x + cell * np.array([1 / 7, 1 / 7, 0.0])

    whole = collapse("column_small", "geometry.symmetry=full")[1]["R_995"]
    return collapse("column_small", "geometry.symmetry=full", change=shift)[1]["R_995"] / whole


@pytest.mark.slow
@pytest.mark.xfail(strict=True, reason="1.6 % short, 1 % allowed: both creep at rest, by 0.3 % in 4 sqrt(h0/g)")
def test_a_column_off_the_lattice_rests_at_the_same_place(off_the_lattice):
    assert off_the_lattice == pytest.approx(1.0, abs=0.01)


@pytest.mark.slow
def test_a_column_off_the_lattice_ends_as_far_off_as_is_known(off_the_lattice):
    assert off_the_lattice - 1.0 == pytest.approx(-0.016, abs=0.006)
