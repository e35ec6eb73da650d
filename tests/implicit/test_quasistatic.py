"""Quasistatic collapses by the implicit solver: where they come to rest, and that hard inputs end in a result."""

import importlib.util

import numpy as np
import pytest

from mpm.config import load_scene
from mpm.devices import start_warp
from mpm.geometry import seed
from mpm.runout import run_out
from mpm.scene import build, theory

if None in (importlib.util.find_spec("dolfinx"), importlib.util.find_spec("petsc4py")):
    pytest.skip("dolfinx or petsc4py is not installed (see ./repose info)", allow_module_level=True)

from implicit.relaxation import Regularisation, Rest
from implicit.solver import ImplicitSolver

# R_995 at D = 0.4 of the explicit solver at the same 10 cells per r0 (`repose run column_L --set grid.cell=0.1
# --set explicit.damping=0.4`, benchmarks/results/implicit_runs_cpu.csv).
EXPLICIT = {0.5: 0.308, 1: 0.599, 2: 1.040}


def collapse(scene, *settings, change=lambda x, cell: x, most=400, **regularisation):
    """Run to rest; the solver and its run-outs, measured about where `change` moved the axis to."""
    start_warp()
    scene = load_scene(scene, list(settings))
    seeds = seed(scene.geometry, scene.grid.cell)
    moved = change(seeds.x.copy(), scene.grid.cell)
    body = build(scene, seeds._replace(x=moved))
    solver, rest = ImplicitSolver(body, Regularisation(**regularisation)), Rest(body.time_scale)
    axis = np.append(np.median(moved[: len(seeds.x), :2] - seeds.x[:, :2], axis=0), 0.0)
    while solver.steps < most:
        solver.advance()
        measures = run_out(solver.x - axis, body.measure)
        if rest(solver.time, measures["R_995"], solver.unbalanced_ratio):
            return solver, measures
    raise AssertionError(f"no rest after {most} steps, unbalanced ratio {solver.unbalanced_ratio:.2g}")


@pytest.fixture(scope="module")
def small():
    """The 8 cells per r0, lambda0 = 0.5 column at rest: solver and run-outs."""
    return collapse("column_small")


def test_a_small_column_rests_near_eq4_without_a_failed_step(small):
    """R_995 within 10 % of Eq. 4, the top at h0."""
    solver, measures = small
    assert measures["R_995"] == pytest.approx(theory(solver.body.scene)["eq4"], rel=0.10)
    assert measures["h_inf"] == pytest.approx(0.5, abs=0.01)
    assert solver.failed_steps == 0
    assert solver.unbalanced_ratio <= 1e-2


def test_stiffness_costs_nothing_and_hardly_moves_the_front(small):
    """A hundred times stiffer. Followed with its own modulus it ends at R_995 = 0.299, after 5,738 Newton iterations
    (benchmarks/results/implicit_runs_cpu.csv); softened, at 0.306 to 0.309 in five runs that differ in the tolerance
    of the linear solves alone. The limit is the 3 % that softening does and the 1.5 % by which collapses scatter."""
    solver, measures = collapse("column_small", "material.young=5.84e8")
    assert measures["R_995"] == pytest.approx(0.299, rel=0.045)
    assert measures["R_995"] == pytest.approx(small[1]["R_995"], rel=0.03)
    assert solver.newton_iterations < 2 * small[0].newton_iterations
    assert solver.unbalanced_ratio <= 1e-2


def test_only_a_cohesionless_collapse_is_softened():
    """E = 600 rho g h0 at most, Poisson's ratio kept; what can stand keeps its own modulus."""

    def moduli(scene, *settings):
        body = build(load_scene(scene, list(settings)))
        return body.constants, Regularisation().softened(body).constants

    given, used = moduli("column_small", "material.young=5.84e8")
    young = 9.0 * used.bulk * used.shear / (3.0 * used.bulk + used.shear)
    assert young == pytest.approx(600 * 2000 * 9.81 * 0.5)
    assert used.bulk / used.shear == pytest.approx(given.bulk / given.shear)
    for scene, *settings in (
        ("column_small",),
        ("column_small", "material.young=5.84e8", "material.cohesion=100.0"),
        ("column_small", "material.young=5.84e8", "implicit.initial_stress=none"),
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
def test_ten_cells_per_radius_agree_with_eq4_and_the_damped_explicit_runs(lambda0):
    solver, measures = collapse(f"column_{lambda0}", "grid.cell=0.1")
    assert measures["R_995"] == pytest.approx(theory(solver.body.scene)["eq4"], rel=0.10)
    assert measures["R_995"] == pytest.approx(EXPLICIT[lambda0], rel=0.10)
    assert solver.failed_steps <= 0.05 * solver.steps


@pytest.mark.slow
@pytest.mark.parametrize("changed", [{"ghost": 0.2}, {"ghost": 0.8}, {"reach": 0.15}, {"cap": 1.5}], ids=str)
def test_regularisation_moves_the_front_by_less_than_three_per_cent(changed):
    reference = collapse("column_0.5", "grid.cell=0.1")[1]["R_995"]
    assert collapse("column_0.5", "grid.cell=0.1", **changed)[1]["R_995"] == pytest.approx(reference, rel=0.03)


@pytest.mark.parametrize("cohesion", [5000, 1000])
def test_a_cohesive_column_stands(cohesion):
    """Equilibrium within a handful of steps, and no collapse."""
    solver, measures = collapse("column_small", f"material.cohesion={cohesion}", most=8)
    assert solver.steps <= 8
    assert np.abs(solver.x - solver.body.x).max() < 0.01
    assert measures["h_inf"] == pytest.approx(0.5, abs=1e-3)


@pytest.mark.parametrize(("angle", "low", "high"), [(20, 0.40, 0.70), (45, 0.20, 0.32)])
def test_friction_angles_at_both_ends(angle, low, high):
    """phi = 20 degrees, whose K0 state lies outside the cone, and 45: at rest on either side of 37.55 degrees' 0.31.

    Eq. 4 gives 0.567 and 0.240.
    """
    _, measures = collapse("column_small", f"material.friction_angle={angle}")
    assert low < measures["R_995"] < high


@pytest.mark.slow
def test_a_nearly_incompressible_column(small):
    """nu = 0.49 costs Newton and the linear solver more, and ends at the same deposit within 5 %."""
    measures = collapse("column_small", "material.poisson=0.49")[1]
    assert measures["R_995"] == pytest.approx(small[1]["R_995"], rel=0.05)


def test_a_grain_in_the_air_falls_and_rests():
    solver, measures = collapse("column_small", change=lambda x, cell: np.vstack([x, [[0.3, 0.3, 1.0]]]))
    assert solver.x[-1, 2] < 0.8
    assert measures["R_995"] == pytest.approx(theory(solver.body.scene)["eq4"], rel=0.10)


@pytest.mark.slow
@pytest.mark.xfail(strict=False, reason="measured at 8 cells per r0: R_995 0.313 against 0.307, 2.2 % instead of 1 %")
def test_a_column_off_the_lattice_rests_at_the_same_place():
    """A full column shifted by a seventh of a cell along x and y.

    Not along z, where it would stand on a seventh of a cell of nothing: its lowest points already share the base's
    nodes, so the gap never closes (the top stays as much higher, and R_995 is 0.336).
    """
    whole = collapse("column_small", "geometry.symmetry=full")[1]["R_995"]

    def shift(x, cell):
        return x + cell * np.array([1 / 7, 1 / 7, 0.0])

    shifted = collapse("column_small", "geometry.symmetry=full", change=shift)[1]["R_995"]
    assert shifted == pytest.approx(whole, rel=0.01)
