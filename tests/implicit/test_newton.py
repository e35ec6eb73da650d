"""Newton's method converges as it should, and leaves nothing behind."""

import os
from pathlib import Path

import numpy as np
import pytest

from mpm.body import build
from mpm.devices import start_warp
from mpm.errors import SceneError
from mpm.load import load_scene, parse_scene

pytest.importorskip("implicit._dolfinx", reason="dolfinx or petsc4py is not installed", exc_type=SceneError)
from implicit import newton
from implicit.newton import solve
from implicit.solver import GOES_ON, STATIC_GHOST, ImplicitSolver

ROUND_OFF = 1e-12  # of the weight
PAGE = os.sysconf("SC_PAGE_SIZE")


def elastic_column(young):
    """System of an elastic column whose whole weight comes in one step, and the norm of that weight [N]."""
    start_warp()
    changes = ["material.model=elastic", f"material.young={young}", "loads.initial_stress=none", "grid.cell=0.25"]
    solver = ImplicitSolver(build(load_scene("column_small", changes)))
    solver.material_points.load.numpy()[:, 2] = -solver.gravity * solver.material_points.mass
    system = solver._new_system()
    system.set_regularisation(ghost=STATIC_GHOST * solver.body.constants.shear * solver.cell)
    return system, float(np.linalg.norm(system.load))


@pytest.mark.parametrize("young", [5e4, 1e5, 3e5])
def test_quadratic_convergence(young):
    """A smooth problem, strains of 3 to 20 %, linear systems solved to 1e-10: the residual is squared each time.

    Order ln(r_k+2/r_k+1)/ln(r_k+1/r_k), as long as the last of the three is above round-off.
    """
    system, weight = elastic_column(young)
    outcome = solve(system, ROUND_OFF * weight, 1e-10)
    residuals = np.array(outcome.residuals) / weight
    assert outcome.converged and outcome.iterations <= 6
    assert residuals[0] == pytest.approx(1.0) and residuals[-1] < ROUND_OFF
    above = residuals[residuals > 10 * ROUND_OFF]
    orders = np.log(above[2:] / above[1:-1]) / np.log(above[1:-1] / above[:-2])
    assert len(orders) >= 1 and np.all(orders > 1.8), (residuals, orders)
    # and the balance is one of forces, whatever the solver says
    assert np.linalg.norm(system.residual(outcome.u)) < ROUND_OFF * weight


def loaded_beam():
    """System of a beam of 6 x 0.5 x 0.5 m that is held at one end, a twentieth of its weight on it, and that load."""
    start_warp()
    walls = {"x_min": "fixed", "z_min": "free"}
    table = {
        "name": "beam",
        "geometry": {"shape": "box", "size": [6.0, 0.5, 0.5], "walls": walls},
        "grid": {"cell": 0.125},
        "material": {"model": "elastic", "young": 1e9, "poisson": 0.3, "density": 2000.0},
        "loads": {"initial_stress": "none"},
    }
    solver = ImplicitSolver(build(parse_scene(table)))
    solver.material_points.load.numpy()[:, 2] = -0.05 * solver.gravity * solver.material_points.mass
    system = solver._new_system()
    system.set_regularisation(ghost=STATIC_GHOST * solver.body.constants.shear * solver.cell)
    return system, float(np.linalg.norm(system.load))


@pytest.mark.parametrize(("most", "last"), [(300, "ilu"), (100, "lu")])
def test_a_slender_beam_is_solved_by_the_next_preconditioner(monkeypatch, most, last):
    """Sweeps do not converge in 300 iterations, ILU(1) needs some 220 and LU of the assembled rows 17.

    Each hands over to the next, at the same solution as LU from the start.
    """
    system, weight = loaded_beam()
    monkeypatch.setattr(newton, "MOST_LINEAR_ITERATIONS", most)
    outcome = solve(system, 1e-9 * weight, 1e-6)
    assert outcome.converged and outcome.preconditioner == last
    monkeypatch.setattr(newton, "PRECONDITIONERS", ("lu",))
    direct = solve(system, 1e-9 * weight, 1e-6)
    assert direct.converged and direct.linear_iterations < 25 * direct.iterations
    assert outcome.u == pytest.approx(direct.u, rel=1e-6, abs=1e-6 * np.abs(direct.u).max())


def test_no_preconditioner_is_left(monkeypatch):
    """The last one fails too: not converged, and no exception."""
    system, weight = loaded_beam()
    monkeypatch.setattr(newton, "MOST_LINEAR_ITERATIONS", 3)
    outcome = solve(system, 1e-9 * weight, 1e-6)
    assert not outcome.converged and outcome.preconditioner == "lu"


def resident():
    """Memory [bytes] that this process holds now."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * PAGE


def test_solves_leave_no_memory_behind():
    """PETSc's objects are destroyed by hand: 200 solves of a small system hold no more than the first 50 did.

    Kept, a Krylov space of 150 vectors a solve would take 80 MB.
    """
    system, weight = elastic_column(1e6)
    for _ in range(50):
        solve(system, 1e-6 * weight, 1e-3)
    before = resident()
    for _ in range(200):
        solve(system, 1e-6 * weight, 1e-3)
    assert resident() - before < 8e6


def falling_column(steps):
    """A column of sand after so many steps of its collapse, with the system of the next one."""
    start_warp()
    solver = ImplicitSolver(build(load_scene("column_small", ["grid.cell=0.2"])))
    for _ in range(steps):
        solver.advance()
    system = solver._new_system()
    system.set_regularisation(**solver.regularisation.of_step(solver.body, solver.length.dt))
    return solver, system


@pytest.mark.parametrize("steps", [2, 6, 12])
def test_the_last_step_tells_newton_where_to_start_and_not_where_to_end(steps):
    """From how nodes moved in the last step it finds the increment that it finds from none, in fewer iterations."""
    solver, system = falling_column(steps)
    tolerance = 1e-9 * system.norm(system.load)
    start = solver.length.dt * system.field_of(solver.node_place, GOES_ON * solver.node_velocity)
    assert np.abs(start).max() > 0.0
    guessed, from_none = solve(system, tolerance, 1e-6, start), solve(system, tolerance, 1e-6)
    assert guessed.converged and from_none.converged
    assert guessed.u == pytest.approx(from_none.u, abs=1e-6 * np.abs(from_none.u).max())
    assert guessed.iterations <= from_none.iterations


def test_a_nodal_field_is_found_again_in_the_next_system():
    """At nodes that both systems have it is the same, at new ones nothing; walls hold their components."""
    _, system = falling_column(3)
    places = system.places
    values = places + np.array([0.25, 0.5, 0.75])
    order = np.random.default_rng(1).permutation(len(places))[:-5]
    found = system.field_of(places[order], values[order])
    expected = np.where(system.held, 0.0, values)
    expected[np.setdiff1d(np.arange(len(places)), order)] = 0.0
    assert found == pytest.approx(expected)
    assert system.held[np.any(found != values, axis=1) & (found != 0).any(axis=1)].any()
    assert not np.any(system.field_of(places + np.array([0, 0, 1000]), values))


def test_a_start_at_which_a_point_would_collapse_is_not_taken():
    solver, system = falling_column(2)
    solver.system = system
    falling = np.zeros((system.count, 3))
    falling[:, 2] = -10.0 * system.place_in_lattice[:, 2] * solver.cell / solver.length.dt  # det F = 1 - 10
    falling[system.held] = 0.0
    assert not solver._first_guess(falling).any()
    assert solver._first_guess(0.001 * falling).any()
