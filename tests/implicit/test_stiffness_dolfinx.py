"""The assembled elastic stiffness against dolfinx: the same mesh, the same quadrature, a form language instead."""

import shutil
import sysconfig

import numpy as np
import pytest
import scipy.sparse

from mpm.body import build
from mpm.devices import start_warp
from mpm.errors import SceneError
from mpm.load import parse_scene

pytest.importorskip("implicit._dolfinx", reason="dolfinx or petsc4py is not installed", exc_type=SceneError)
from implicit._dolfinx import dolfinx, function_space, ufl
from implicit.kernels.layout import LAW
from implicit.mesh import BackgroundMesh
from implicit.points import Basis, Points
from implicit.system import System

CELL, CELLS = 0.5, (3, 2, 2)
COMPILER = sysconfig.get_config_var("CC").split()[0]


def block():
    size = [CELL * n for n in CELLS]
    scene = {
        "name": "block",
        "geometry": {"shape": "box", "size": size, "walls": {"z_min": "free"}},
        "grid": {"cell": CELL},
        "material": {"model": "elastic", "young": 3e6, "poisson": 0.3, "density": 1.0},
    }
    return build(parse_scene(scene))


def linear_basis(x, cell):
    """Linear hats of the cell in which each point lies, in the arrays that otherwise hold uGIMP."""
    basis = Basis(len(x))
    first = np.floor(x / cell).astype(int)
    along = x / cell - first
    basis.base.numpy()[:] = first
    basis.reach.numpy()[:] = 2
    basis.weight.numpy()[:] = np.stack([1.0 - along, along, 0.0 * along], axis=2)
    basis.slope.numpy()[:] = np.array([-1.0, 1.0, 0.0]) / cell
    return basis


def of_dolfinx(background, constants, material_cells):
    """Linear elasticity on the material's cells, as a sparse matrix over the space's degrees of freedom, with the
    volume strain as it is and as the nodes average it; and the number of cells.

    With C_ij the integral of phi_i div(u_j), M that of phi_i phi_j and D the integral of phi_i, the volume strain of
    the nodes is theta = D^-1 M D^-1 C u and their share of the stiffness K C^T theta.
    """
    space = background.space
    indicator = dolfinx.fem.Function(function_space(background.mesh, "DG", 0))
    centres = indicator.function_space.tabulate_dof_coordinates()
    inside = np.all((centres > 0) & (centres < CELL * np.array(material_cells)), axis=1)
    indicator.x.array[:] = inside
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    scalars = function_space(background.mesh, "Lagrange", 1)
    theta, phi = ufl.TrialFunction(scalars), ufl.TestFunction(scalars)
    dx = ufl.dx(metadata={"quadrature_degree": 3})  # two Gauss points per axis

    def matrix(integrand):
        assembled = dolfinx.fem.petsc.assemble_matrix(dolfinx.fem.form(indicator * integrand * dx))
        assembled.assemble()
        indptr, indices, values = assembled.getValuesCSR()
        return scipy.sparse.csr_matrix((values, indices, indptr), shape=assembled.getSize())

    strain, trace = ufl.sym(ufl.grad(u)), ufl.tr(ufl.sym(ufl.grad(u)))
    shear = matrix(2.0 * constants.shear * ufl.inner(ufl.dev(strain), ufl.sym(ufl.grad(v))))
    pointwise = matrix(constants.bulk * trace * ufl.div(v))
    divergence, mass = matrix(phi * trace), matrix(phi * theta)
    size = mass @ np.ones(mass.shape[0])
    inverse = scipy.sparse.diags(np.where(size > 0, 1.0 / np.where(size > 0, size, 1.0), 0.0))
    averaged = constants.bulk * divergence.T @ inverse @ mass @ inverse @ divergence
    return shear + pointwise, shear + averaged, int(inside.sum())


@pytest.mark.skipif(shutil.which(COMPILER) is None, reason=f"dolfinx compiles forms with {COMPILER}: not installed")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # ffcx 0.5 calls numpy's product
def test_elastic_stiffness_is_that_of_dolfinx():
    """Points at the Gauss points of each cell with linear hats: b_e = I, u = 0, no drag and no ghost springs leave
    the stiffness of linear elasticity with nodal volume strains, to round-off. No entry of dolfinx' lies outside the
    rows either. In a uniform strain the averages change nothing: there the force is that of first-order hexahedra."""
    start_warp()
    body = block()
    state = Points(body)
    assert state.count == 8 * np.prod(CELLS) and state.volume == CELL**3 / 8
    # each seeded point to the Gauss point of its octant
    middle = (np.floor(body.x / CELL) + 0.5) * CELL
    state.x.numpy()[:] = middle + np.sign(body.x - middle) * 0.5 * CELL / np.sqrt(3.0)
    weights, background = linear_basis(state.x.numpy(), CELL), BackgroundMesh(CELL, body.walls)
    background.follow(weights.base.numpy())
    system = System(state, weights, background, LAW.pack(body.constants))
    system.set_regularisation()
    assert system.count == np.prod(np.array(CELLS) + 1) and not system.held.any()
    blocks = (system.tangent(np.zeros((system.count, 3))), system.indices, system.indptr)
    assembled = scipy.sparse.bsr_matrix(blocks).toarray()
    ours = assembled + np.stack([system.coupling(column) for column in np.eye(len(assembled))], axis=1)

    pointwise, averaged, cells = of_dolfinx(background, body.constants, CELLS)
    assert cells == np.prod(CELLS)
    rows = (3 * system.dofs[:, None] + np.arange(3)).ravel()
    theirs = averaged[rows][:, rows].toarray()
    assert abs(averaged).sum() == pytest.approx(np.abs(theirs).sum(), rel=1e-13)  # nothing outside these rows
    assert np.abs(ours - theirs).max() < 1e-12 * np.abs(theirs).max()
    assert np.linalg.matrix_rank(ours, tol=1e-9 * np.abs(ours).max()) == len(ours) - 6  # the six rigid motions

    x = CELL * (system.place_in_lattice + background.corner)
    uniform = (x @ np.random.default_rng(0).normal(size=(3, 3))).ravel()
    force = pointwise[rows][:, rows] @ uniform
    assert np.abs(ours @ uniform - force).max() < 1e-12 * np.abs(force).max()
