"""The tangent is the derivative of the residual, in every regime of the law, and as symmetric as the law makes it."""

import numpy as np
import pytest
import scipy.sparse

from mpm.config import load_scene
from mpm.devices import start_warp
from mpm.errors import SceneError
from mpm.scene import build

pytest.importorskip("implicit._dolfinx", reason="dolfinx or petsc4py is not installed", exc_type=SceneError)
from implicit.background import Background
from implicit.kernels.layout import LAW
from implicit.state import Basis, Points
from implicit.system import System

STEP = 1e-8  # [m] of the differences, for directions of order one
START = "grid.cell=0.25"
ELASTIC = ("material.model=elastic",)
DILATANT = ("material.dilatancy_angle=5.0", "material.cohesion=3e3")
EVERYTHING = {"drag": 1.0, "ghost": 2e4, "viscous": 0.05, "dt": 0.03, "momentum": 0.7}


class Case:
    """A system with the Hencky strains, openings and increments of one regime."""

    def __init__(self, overrides=(), isotropic=0.0, deviator=0.0, jitter=0.0, opening=0.0, u=0.0, resist=None):
        start_warp()
        rng = np.random.default_rng(1)
        body = build(load_scene("column_small", [START, *overrides]))
        cell = body.scene.grid.cell
        self.state = state = Points(body)
        state.x.numpy()[:] += 0.1 * cell * rng.uniform(-1.0, 1.0, body.x.shape)
        strain = jitter * rng.normal(size=(state.count, 3, 3))
        strain = 0.5 * (strain + strain.transpose(0, 2, 1)) + np.diag(isotropic + deviator * np.array([1, 0, -1]))
        values, axes = np.linalg.eigh(strain)
        b_e = np.einsum("pij,pj,pkj->pik", axes, np.exp(2.0 * values), axes)
        state.b_e.numpy()[:] = b_e if np.any(strain) else np.eye(3)
        if opening:
            state.opening.numpy()[:] = np.where(rng.random(state.count) < 0.5, opening, 0.0)
        state.load.numpy()[:, 2] = -9.81 * state.mass
        state.v.numpy()[:] = rng.normal(size=body.x.shape)
        weights, background = Basis(state.count), Background(cell, body.walls)
        weights.evaluate(state.x, cell)
        background.follow(weights.base.numpy())
        self.system = System(state, weights, background, LAW.pack(body.constants))
        self.system.resist(**(resist or {}))
        self.u = u * cell * rng.normal(size=(self.system.count, 3))
        self.direction = rng.normal(size=self.u.shape)
        self.u[self.system.held] = self.direction[self.system.held] = 0.0

    def matrix(self):
        s = self.system
        return scipy.sparse.bsr_matrix((s.tangent(self.u).copy(), s.indices, s.indptr)).tocsr()

    def error(self):
        """Relative error of tangent times direction against central differences of the residual."""
        product = (self.matrix() @ self.direction.ravel()).reshape(-1, 3)
        ahead = self.system.residual(self.u + STEP * self.direction)
        behind = self.system.residual(self.u - STEP * self.direction)
        difference = (ahead - behind) / (2.0 * STEP)
        return np.linalg.norm(product - difference) / np.linalg.norm(difference)

    def asymmetry(self):
        a = self.matrix()
        return scipy.sparse.linalg.norm(a - a.T) / scipy.sparse.linalg.norm(a)

    def regime(self):
        """Share of points that yield in this increment, share that are open after it."""
        before = self.state.eps_p_eqv.numpy().copy()
        self.system.commit(self.u)
        yields = self.state.eps_p_eqv.numpy() > before
        return yields.mean(), (self.state.opening.numpy() > 0.0).mean()


def cone(**changes):
    """All points sheared far beyond the cone, under pressure."""
    return Case(**{"isotropic": -2e-3, "deviator": 1e-2, "jitter": 3e-4, "u": 1e-4} | changes)


def test_elastic():
    assert Case(ELASTIC, isotropic=-2e-3, jitter=1e-3, u=5e-3).error() < 1e-6


def test_large_elastic_strain_and_rotation():
    """Strains of tens of per cent, where the geometric part and the logarithm's quotients count."""
    assert Case(ELASTIC, isotropic=-0.1, jitter=0.1, u=0.03).error() < 1e-6


def test_everything_on_the_cone():
    case = cone()
    assert case.error() < 1e-6
    assert case.regime() == (1.0, 0.0)


def test_everything_at_the_apex():
    """Cohesive, so that the apex carries stress: what is left of the tangent is its geometric part."""
    case = Case(DILATANT, isotropic=4e-3, deviator=1e-4, jitter=1e-4, u=1e-4)
    assert case.error() < 1e-6
    assert case.regime() == (1.0, 1.0)


def test_everything_open_and_cohesionless():
    """No stress and no stiffness: the points leave nothing in the matrix, to the last bit, and the drag remains."""
    case = Case(isotropic=4e-3, jitter=1e-4, u=1e-4)
    free = ~case.system.held.ravel()
    assert abs(case.matrix()[free][:, free]).max() == 0.0
    case = Case(isotropic=4e-3, jitter=1e-4, u=1e-4, resist=EVERYTHING | {"viscous": 0.0})
    assert case.error() < 1e-6
    assert case.regime() == (1.0, 1.0)


def test_mixed_with_dilatancy_and_cohesion():
    case = Case(DILATANT, isotropic=-5e-4, jitter=1e-3, opening=1e-3, u=2e-3)
    assert case.error() < 1e-6
    yields, opens = case.regime()
    assert 0.2 < yields < 0.98 and 0.05 < opens < 0.95


def test_mixed_and_cohesionless_with_openings():
    case = Case(isotropic=-1.5e-3, jitter=1e-3, opening=2e-3, u=2e-3)
    assert case.error() < 1e-6
    yields, opens = case.regime()
    assert 0.2 < yields < 0.98 and 0.05 < opens < 0.95


def test_repeated_principal_stretches():
    """b_e = I exactly and u = 0: all principal stretches coincide, the deviator has no direction."""
    case = Case(ELASTIC)
    assert np.array_equal(case.state.b_e.numpy()[0], np.eye(3))
    assert case.error() < 1e-6


def test_two_equal_stretches_on_the_cone():
    """The K0-like state of a column, beyond the cone, with u = 0: the lateral principal stretches coincide."""
    case = cone(jitter=0.0, deviator=0.0, u=0.0)
    case.state.b_e.numpy()[:] = np.diag(np.exp([0.008, 0.008, -0.024]))
    assert case.error() < 1e-6
    assert case.regime() == (1.0, 0.0)


@pytest.mark.parametrize("overrides", [(), DILATANT], ids=["cohesionless", "dilatant"])
def test_with_ghost_springs_drag_momentum_and_viscosity(overrides):
    case = Case(overrides, isotropic=-1e-3, jitter=1e-3, opening=1e-3, u=2e-3, resist=EVERYTHING)
    assert len(case.system.triples) > 0
    assert case.error() < 1e-6


def test_viscosity_on_the_cone():
    case = cone(resist={"viscous": 0.1})
    assert case.error() < 1e-6
    assert case.regime() == (1.0, 0.0)


def test_symmetric_where_there_is_a_potential():
    """Elastic, at rest or far strained (the Hencky law has an energy), and associated flow; not with psi < phi."""
    assert Case(ELASTIC).asymmetry() < 1e-14
    assert Case(ELASTIC, isotropic=-2e-2, jitter=2e-2, u=2e-2).asymmetry() < 1e-13
    assert cone(overrides=("material.dilatancy_angle=37.55",)).asymmetry() < 1e-13
    assert cone(overrides=("material.dilatancy_angle=5.0",)).asymmetry() > 1e-2
    assert cone().asymmetry() > 1e-2
