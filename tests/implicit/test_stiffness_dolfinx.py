"""The assembled elastic stiffness against dolfinx: the same mesh, the same quadrature, a form language instead."""

import numpy as np
import pytest
import scipy.sparse

from mpm.config import parse_scene
from mpm.devices import start_warp
from mpm.errors import SceneError
from mpm.scene import build

pytest.importorskip("implicit._dolfinx", reason="dolfinx or petsc4py is not installed", exc_type=SceneError)
import ufl

from implicit._dolfinx import dolfinx
from implicit.background import Background
from implicit.kernels.layout import LAW
from implicit.state import Basis, Points
from implicit.system import System

CELL, CELLS = 0.5, (3, 2, 2)


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
    """Linear elasticity on the material's cells, as a sparse matrix over the space's degrees of freedom."""
    space = background.space
    indicator = dolfinx.fem.Function(dolfinx.fem.FunctionSpace(background.mesh, ("DG", 0)))
    centres = indicator.function_space.tabulate_dof_coordinates()
    inside = np.all((centres > 0) & (centres < CELL * np.array(material_cells)), axis=1)
    indicator.x.array[:] = inside
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    strain = ufl.sym(ufl.grad(u))
    lame = constants.bulk - 2.0 * constants.shear / 3.0
    stress = 2.0 * constants.shear * strain + lame * ufl.tr(strain) * ufl.Identity(3)
    dx = ufl.dx(metadata={"quadrature_degree": 3})  # two Gauss points per axis
    form = dolfinx.fem.form(indicator * ufl.inner(stress, ufl.sym(ufl.grad(v))) * dx)
    matrix = dolfinx.fem.petsc.assemble_matrix(form)
    matrix.assemble()
    indptr, indices, values = matrix.getValuesCSR()
    return scipy.sparse.csr_matrix((values, indices, indptr)), int(inside.sum())


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # ffcx 0.5 calls numpy's product
def test_elastic_stiffness_is_that_of_dolfinx():
    """Points at the Gauss points of each cell with linear hats: b_e = I, u = 0, no drag and no ghost springs leave
    the stiffness of linear elasticity, to round-off. No entry of dolfinx' lies outside the block rows either."""
    start_warp()
    body = block()
    state = Points(body)
    assert state.count == 8 * np.prod(CELLS) and state.volume == CELL**3 / 8
    # each seeded point to the Gauss point of its octant
    middle = (np.floor(body.x / CELL) + 0.5) * CELL
    state.x.numpy()[:] = middle + np.sign(body.x - middle) * 0.5 * CELL / np.sqrt(3.0)
    weights, background = linear_basis(state.x.numpy(), CELL), Background(CELL, body.walls)
    background.follow(weights.base.numpy())
    system = System(state, weights, background, LAW.pack(body.constants))
    system.resist()
    assert system.count == np.prod(np.array(CELLS) + 1) and not system.held.any()
    blocks = (system.tangent(np.zeros((system.count, 3))), system.indices, system.indptr)
    ours = scipy.sparse.bsr_matrix(blocks).toarray()

    reference, cells = of_dolfinx(background, body.constants, CELLS)
    assert cells == np.prod(CELLS)
    rows = (3 * system.dofs[:, None] + np.arange(3)).ravel()
    theirs = reference[rows][:, rows].toarray()
    assert abs(reference).sum() == pytest.approx(np.abs(theirs).sum(), rel=1e-14)  # nothing outside these rows
    assert np.abs(ours - theirs).max() < 1e-12 * np.abs(theirs).max()
    assert np.linalg.matrix_rank(ours, tol=1e-9 * np.abs(ours).max()) == len(ours) - 6  # the six rigid motions
