"""Newton's method converges as it should, and leaves nothing behind."""

import os
from pathlib import Path

import numpy as np
import pytest

from mpm.config import load_scene
from mpm.devices import start_warp
from mpm.errors import SceneError
from mpm.scene import build

pytest.importorskip("implicit._dolfinx", reason="dolfinx or petsc4py is not installed", exc_type=SceneError)
from implicit.newton import solve
from implicit.solver import STATIC_GHOST, ImplicitSolver

ROUND_OFF = 1e-12  # of the weight
PAGE = os.sysconf("SC_PAGE_SIZE")


def elastic_column(young):
    """System of an elastic column whose whole weight comes in one step, and the norm of that weight [N]."""
    start_warp()
    changes = ["material.model=elastic", f"material.young={young}", "implicit.initial_stress=none", "grid.cell=0.25"]
    solver = ImplicitSolver(build(load_scene("column_small", changes)))
    solver.state.load.numpy()[:, 2] = -solver.gravity * solver.state.mass
    system = solver._new_system()
    system.resist(ghost=STATIC_GHOST * solver.body.constants.shear * solver.cell)
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
