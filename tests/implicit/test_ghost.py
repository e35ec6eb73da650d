"""The ghost penalty: small cuts no longer spoil the matrix, and linear motion passes freely."""

import numpy as np
import pytest
from installed import HAS_IMPLICIT, NO_IMPLICIT

from compare.hard.rest import condition
from mpm.body import build
from mpm.devices import start_warp
from mpm.load import load_scene
from mpm.seed import seed

if not HAS_IMPLICIT:
    pytest.skip(NO_IMPLICIT, allow_module_level=True)

from implicit.pseudo_time import Regularisation
from implicit.solver import ImplicitSolver


def system_of(overlap, **regularisation):
    """The first system of a column of 4 cells per r0 whose points' domains reach `overlap` cells over node planes."""
    start_warp()
    scene = load_scene("column_small", ["grid.cell=0.25"])
    seeds = seed(scene.geometry, scene.grid.cell)
    body = build(scene, seeds._replace(x=seeds.x + overlap * scene.grid.cell * np.array([1.0, 1.0, 0.0])))
    solver = ImplicitSolver(body)
    solver.system.set_regularisation(**Regularisation(**regularisation).of_step(body, 0.05))
    return solver.system


def test_the_condition_number_stays_bounded_as_material_moves_over_the_grid():
    """Overlaps of 1e-1 to 1e-5 cells leave nodes with as little as 1e-10 of a point's mass."""
    overlaps = [1e-1, 1e-2, 1e-3, 1e-4, 1e-5]
    tied = [condition(system_of(overlap)) for overlap in overlaps]
    free = [condition(system_of(overlap, ghost=0.0)) for overlap in overlaps]
    assert system_of(1e-5).node_mass.min() < 1e-9 * system_of(1e-5).state.mass
    assert max(tied) < 100 * min(tied)
    assert free[-1] > 1e4 * max(tied)


def test_a_linear_motion_is_not_resisted():
    """u = A x has no jump of its gradient: the springs exert no force, and a kink they do resist."""
    system = system_of(1e-2, ghost=1.0, drag=0.0)
    x = system.place_in_lattice.astype(float)
    gradient = np.random.default_rng(0).normal(size=(3, 3)) * 1e-6

    def pull(u):
        return system.residual(u) - system.unbalanced

    linear, kinked = x @ gradient.T, np.abs(x - 3.0) * 1e-6
    free = ~system.held
    assert np.abs(pull(linear)[free]).max() < 1e-9 * np.abs(pull(kinked)[free]).max()
