"""The tangent is the derivative of the residual, in every regime of the law, and as symmetric as the law makes it."""

import numpy as np
import pytest
import scipy.sparse

from mpm.body import build
from mpm.devices import start_warp
from mpm.errors import SceneError
from mpm.load import load_scene

pytest.importorskip("implicit._dolfinx", reason="dolfinx or petsc4py is not installed", exc_type=SceneError)
from implicit.kernels.layout import LAW
from implicit.mesh import BackgroundMesh
from implicit.points import Basis, Points
from implicit.system import System

STEP = 1e-8  # [m] of the differences, for directions of order one
LIMIT = 5e-9  # of the relative error: what differences at that step leave
START = "grid.cell=0.25"
ELASTIC = ("material.model=elastic",)
DILATANT = ("material.dilatancy_angle=5.0", "material.cohesion=3e3")
EVERYTHING = {"drag": 1.0, "ghost": 2e4, "viscous": 0.05, "dt": 0.03, "momentum": 0.7}


class Case:
    """A system with the Hencky strains, volume strains and increments of one regime.

    `theta`: the points' volume strain; `spread`: its scatter from node to node.
    """

    def __init__(self, overrides=(), theta=0.0, spread=0.0, deviator=0.0, jitter=0.0, u=0.0, regularised=None):
        start_warp()
        rng = np.random.default_rng(1)
        body = build(load_scene("column_small", [START, *overrides]))
        self.cell = cell = body.scene.grid.cell
        self.constants = body.constants
        self.state = state = Points(body)
        state.x.numpy()[:] += 0.1 * cell * rng.uniform(-1.0, 1.0, body.x.shape)
        strain = jitter * rng.normal(size=(state.count, 3, 3))
        strain = 0.5 * (strain + strain.transpose(0, 2, 1)) + np.diag(deviator * np.array([1, 0, -1]))
        strain -= np.trace(strain, axis1=1, axis2=2)[:, None, None] / 3.0 * np.eye(3)
        values, axes = np.linalg.eigh(strain)
        b_e = np.einsum("pij,pj,pkj->pik", axes, np.exp(2.0 * values), axes)
        state.b_e.numpy()[:] = b_e if np.any(strain) else np.eye(3)
        blocks = np.floor(body.x / cell).astype(int).sum(axis=1) % 2  # cells in turn, so that nodes differ
        state.theta.numpy()[:] = theta + spread * (2.0 * blocks - 1.0 + 0.5 * rng.normal(size=state.count))
        state.load.numpy()[:, 2] = -9.81 * state.mass
        state.v.numpy()[:] = rng.normal(size=body.x.shape)
        weights, background = Basis(state.count), BackgroundMesh(cell, body.walls)
        weights.evaluate(state.x, cell)
        background.follow(weights.base.numpy())
        self.system = System(state, weights, background, LAW.pack(body.constants))
        self.system.set_regularisation(**(regularised or {}))
        self.u = u * cell * rng.normal(size=(self.system.count, 3))
        self.direction = rng.normal(size=self.u.shape)
        self.places = cell * (self.system.place_in_lattice + background.corner)  # of the nodes [m]
        self.u[self.system.held] = self.direction[self.system.held] = 0.0

    def blocks(self):
        """The assembled block rows."""
        s = self.system
        return scipy.sparse.bsr_matrix((s.tangent(self.u).copy(), s.indices, s.indptr)).tocsr()

    def matrix(self):
        """The whole tangent, dense: block rows and coupling."""
        blocks = self.blocks().toarray()
        return blocks + np.stack([self.system.coupling(column) for column in np.eye(len(blocks))], axis=1)

    def error(self):
        """Relative error of tangent times direction against central differences of the residual."""
        direction = self.direction.ravel()
        product = (self.blocks() @ direction + self.system.coupling(direction)).reshape(-1, 3)
        ahead = self.system.residual(self.u + STEP * self.direction)
        behind = self.system.residual(self.u - STEP * self.direction)
        difference = (ahead - behind) / (2.0 * STEP)
        return np.linalg.norm(product - difference) / np.linalg.norm(difference)

    def asymmetry(self):
        a = self.matrix()
        return np.linalg.norm(a - a.T) / np.linalg.norm(a)

    def regime(self):
        """Share of points that yield in this increment, share of nodes that are open in it."""
        before = self.state.state()["eps_p_eqv"]
        self.system.commit(self.u)
        yields = self.state.state()["eps_p_eqv"] > before
        volume = self.system.volume
        volume.set_slopes(blend=0.0)
        return yields.mean(), (volume.slope.numpy() == 0.0).mean()


def cone(**changes):
    """All points sheared far beyond the cone, under pressure."""
    return Case(**{"theta": -6e-3, "spread": 1e-3, "deviator": 1e-2, "jitter": 3e-4, "u": 1e-4} | changes)


def test_elastic():
    assert Case(ELASTIC, theta=-6e-3, spread=2e-3, jitter=1e-3, u=5e-3).error() < LIMIT


def test_large_elastic_strain_and_rotation():
    """Strains of tens of per cent, where the geometric part and the logarithm's quotients count."""
    assert Case(ELASTIC, theta=-0.3, spread=0.1, jitter=0.1, u=0.03).error() < LIMIT


def test_everything_on_the_cone():
    case = cone()
    assert case.error() < LIMIT
    assert case.regime() == (1.0, 0.0)


def test_everything_on_the_cone_with_dilatancy():
    """Closed nodes: plastic dilation builds pressure in the point itself."""
    case = cone(overrides=DILATANT)
    assert case.error() < LIMIT
    assert case.regime() == (1.0, 0.0)


def test_everything_at_the_apex():
    """Cohesive, so that the apex carries stress: what is left of the tangent is its geometric part."""
    case = Case(DILATANT, theta=8e-3, deviator=1e-4, jitter=1e-4, u=1e-4)
    assert case.error() < LIMIT
    assert case.regime() == (1.0, 1.0)


def test_dilatancy_that_fills_what_is_open():
    """Nodes open by less than the points dilate: the whole of K returns, at points and not at nodes."""
    case = Case(("material.dilatancy_angle=20.0",), theta=2e-4, spread=1e-4, deviator=1e-2, jitter=3e-4, u=1e-4)
    assert case.error() < LIMIT
    assert case.system.volume.filled.numpy().min() == 1.0
    yields, opens = case.regime()
    assert yields == 1.0 and opens > 0.2


def test_everything_open_and_cohesionless():
    """No stress and no stiffness: the points leave nothing but round-off in the matrix, and the drag remains."""
    case = Case(theta=1.2e-2, jitter=1e-4, u=1e-4)
    free = ~case.system.held.ravel()
    assert abs(case.matrix()[free][:, free]).max() < 1e-15 * case.constants.shear * case.cell
    case = Case(theta=1.2e-2, jitter=1e-4, u=1e-4, regularised=EVERYTHING | {"viscous": 0.0})
    assert case.error() < LIMIT
    assert case.regime() == (1.0, 1.0)


@pytest.mark.parametrize("overrides", [(), DILATANT], ids=["cohesionless", "dilatant and cohesive"])
def test_mixed(overrides):
    """Nodes open, nodes closed; points elastic, on the cone, open."""
    case = Case(overrides, theta=-1e-3, spread=3e-3, jitter=1e-3, u=2e-3)
    assert case.error() < LIMIT
    yields, opens = case.regime()
    assert 0.2 < yields < 0.98 and 0.05 < opens < 0.95


@pytest.mark.parametrize("overrides", [(), DILATANT], ids=["cohesionless", "dilatant and cohesive"])
def test_mixed_with_ripples_smoothed(overrides):
    """K = 25 G, and volume strains as much smaller: nodes open, nodes closed; points elastic, on the cone, open."""
    case = Case((*overrides, "material.poisson=0.48"), theta=-1e-4, spread=3e-4, jitter=1e-3, u=2e-4)
    assert case.error() < LIMIT
    yields, opens = case.regime()
    assert 0.2 < yields < 0.98 and 0.05 < opens < 0.95


def test_nodes_that_close_in_the_step():
    """Open before the increment, closed in it."""
    case = Case(theta=2e-3, spread=1e-4, jitter=1e-3, u=1e-4)
    case.u = -4e-3 * case.places  # squeezes by 1.2 %
    case.u[case.system.held] = 0.0
    assert case.error() < LIMIT
    assert case.regime()[1] < 0.5


def test_repeated_principal_stretches():
    """b_e = I exactly and u = 0: all principal stretches coincide, the deviator has no direction."""
    case = Case(ELASTIC)
    assert np.array_equal(case.state.b_e.numpy()[0], np.eye(3))
    assert case.error() < LIMIT


def test_two_equal_stretches_on_the_cone():
    """The K0-like state of a column, beyond the cone, with u = 0: the lateral principal stretches coincide."""
    case = cone(jitter=0.0, deviator=0.0, u=0.0)
    case.state.b_e.numpy()[:] = np.diag(np.exp([0.0106, 0.0106, -0.0212]))
    assert case.error() < LIMIT
    assert case.regime() == (1.0, 0.0)


@pytest.mark.parametrize("overrides", [(), DILATANT], ids=["cohesionless", "dilatant"])
def test_with_ghost_springs_drag_momentum_and_viscosity(overrides):
    case = Case(overrides, theta=-1e-3, spread=3e-3, jitter=1e-3, u=2e-3, regularised=EVERYTHING)
    assert len(case.system.triples) > 0
    assert case.error() < LIMIT


def test_viscosity_on_the_cone():
    case = cone(regularised={"viscous": 0.1})
    assert case.error() < LIMIT
    assert case.regime() == (1.0, 0.0)


def test_symmetric_where_there_is_a_potential():
    """Elastic, at rest or far strained: the nodes' law has an energy, the averages are symmetric. Not on the cone,
    where the deviator follows the nodes' mean stress and that does not follow the deviator."""
    assert Case(ELASTIC).asymmetry() < 1e-14
    assert Case(ELASTIC, theta=-6e-2, spread=2e-2, jitter=2e-2, u=2e-2).asymmetry() < 1e-13
    assert cone().asymmetry() > 1e-2
