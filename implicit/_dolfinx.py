"""The one place that imports dolfinx and petsc4py and knows their versions; the rest of Repose works without them."""

import logging
import os
import sys
from contextlib import contextmanager
from importlib.util import find_spec
from inspect import signature

import numpy as np

from mpm.caches import prepare_caches
from mpm.errors import SceneError
from mpm.provenance import how_to_get_dolfinx

OLDEST, NEWEST = (0, 5), (0, 11)  # versions of dolfinx that Repose works with


def _import_dolfinx():
    """Import dolfinx without what its `__init__` does to every import after it. SceneError for an unknown version.

    dolfinx before 0.8 sets RTLD_GLOBAL for all shared libraries loaded from then on and leaves it set. h5py and VTK
    bring their own HDF5, whose symbols then mix with those of Debian's: importing them fails or crashes.
    Debian's dolfinx runs without the flag, in parallel too.
    """
    set_flags = sys.setdlopenflags
    sys.setdlopenflags = lambda flags: None
    try:
        import dolfinx

        _check_version(dolfinx.__version__)
        import dolfinx.fem.petsc
        import dolfinx.io
    finally:
        sys.setdlopenflags = set_flags
    return dolfinx


def _refused(found: str, how: str) -> SceneError:
    oldest, newest = (".".join(map(str, version)) for version in (OLDEST, NEWEST))
    return SceneError(
        f"the implicit solver needs dolfinx {oldest} to {newest} and petsc4py with real scalars, but {found}; "
        f"to get them, {how}; the explicit half works without them"
    )


def _check_version(version: str):
    """Raises SceneError for a dolfinx that is older or newer than Repose knows."""
    if not OLDEST <= tuple(int(number) for number in version.split(".")[:2]) <= NEWEST:
        raise _refused(f"dolfinx is {version}", how_to_get_dolfinx(from_apt=False))


prepare_caches()  # dolfinx reads where its cache is as it is imported
try:
    if find_spec("dolfinx_solver"):  # PyPI's wheel: loads the MPI library that all the others must share
        import dolfinx_solver  # noqa: F401
    import petsc4py
    import ufl
    from mpi4py import MPI

    # Of all ranks the first alone may import this, and PETSc starts together with the ranks of its communicator.
    petsc4py.init(comm=MPI.COMM_SELF)
    from petsc4py import PETSc

    if PETSc.ScalarType.__name__.startswith("complex"):
        chosen = f" (PETSC_DIR is {os.environ['PETSC_DIR']})" if "PETSC_DIR" in os.environ else ""
        raise _refused(f"petsc4py {petsc4py.__version__} has complex scalars{chosen}", how_to_get_dolfinx())
    dolfinx = _import_dolfinx()
except ModuleNotFoundError as error:
    raise _refused(f"{error.name} is not installed", how_to_get_dolfinx()) from error
except ImportError as error:
    raise _refused(f"what is installed cannot be loaded ({error})", how_to_get_dolfinx()) from error


@contextmanager
def _quietly():
    """Without INFO lines: setuptools, with which dolfinx compiles its elements, makes the root logger write them."""
    root = logging.getLogger()
    level, handlers = root.level, root.handlers[:]
    logging.disable(logging.INFO)
    try:
        yield
    finally:
        logging.disable(logging.NOTSET)
        root.setLevel(level)
        root.handlers[:] = handlers


def libraries() -> dict[str, str]:
    """Versions of dolfinx, PETSc, petsc4py, mpi4py and the MPI library, as a run's provenance keeps them."""
    import mpi4py

    # "Open MPI v4.1.4, package: ..." or "MPICH Version:      5.0.2" and more lines.
    mpi = MPI.Get_library_version().splitlines()[0].split(",")[0].replace("Version:", "")
    return {
        "dolfinx": dolfinx.__version__,
        "petsc": ".".join(map(str, PETSc.Sys.getVersion())),
        "petsc4py": petsc4py.__version__,
        "mpi4py": mpi4py.__version__,
        "mpi": " ".join(mpi.split()),
    }


@_quietly()
def hexahedra(comm, cells, points, ghosts=None):
    """dolfinx mesh of first-order hexahedra `cells` (m, 8) int64, their corners x fastest, on `points` (n, 3) [m].

    Of several ranks each gives the cells that it is to own, at least one (dolfinx waits for ever where a rank has
    none), which other ranks are to have them as ghosts, `ghosts` (m, ranks) bool, and its share of the points, which
    are numbered in the order of ranks.
    """
    if hasattr(dolfinx.fem, "functionspace"):  # from 0.7 on
        from basix.ufl import element

        domain = ufl.Mesh(element("Lagrange", "hexahedron", 1, shape=(3,)))
    else:
        domain = ufl.Mesh(ufl.VectorElement("Lagrange", ufl.Cell("hexahedron"), 1))
    # By name: 0.10 exchanged points and domain.
    name = "domain" if "domain" in signature(dolfinx.mesh.create_mesh).parameters else "e"
    given = {"x": points, name: domain}
    if ghosts is not None:
        of_cells = _destinations(comm.rank, ghosts)
        given["partitioner"] = lambda *_: of_cells
    return dolfinx.mesh.create_mesh(comm, cells, **given)


def _destinations(owner, ghosts):
    """dolfinx's list of the ranks that a cell goes to, its owner first."""
    rows, columns = np.nonzero(np.insert(ghosts, 0, True, axis=1))
    ends = np.searchsorted(rows, np.arange(len(ghosts) + 1))
    ranks = np.where(columns == 0, owner, columns - 1)
    return dolfinx.cpp.graph.AdjacencyList_int32(ranks.astype(np.int32), ends.astype(np.int32))


@_quietly()
def function_space(mesh, family: str, degree: int, shape: tuple[int, ...] = ()):
    """dolfinx space of functions on `mesh` with values of `shape`: () for scalars, (3,) for vectors."""
    if hasattr(dolfinx.fem, "functionspace"):  # from 0.7 on
        return dolfinx.fem.functionspace(mesh, (family, degree, shape) if shape else (family, degree))
    return (dolfinx.fem.VectorFunctionSpace if shape else dolfinx.fem.FunctionSpace)(mesh, (family, degree))


__all__ = ["MPI", "PETSc", "dolfinx", "function_space", "hexahedra", "libraries", "ufl"]
