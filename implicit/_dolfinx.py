"""The one place that imports dolfinx and petsc4py, so that the rest of Repose works without them."""

import sys

from mpm.errors import SceneError
from mpm.provenance import DOLFINX_APT


def _import_dolfinx():
    """Import dolfinx without what its `__init__` does to every import after it.

    dolfinx 0.5 sets RTLD_GLOBAL for all shared libraries loaded from then on and leaves it set. h5py and VTK
    bring their own HDF5, whose symbols then mix with those of Debian's: importing them fails or crashes.
    Debian's dolfinx runs without the flag, in parallel too.
    """
    set_flags = sys.setdlopenflags
    sys.setdlopenflags = lambda flags: None
    try:
        import dolfinx
        import dolfinx.io
    finally:
        sys.setdlopenflags = set_flags
    return dolfinx


try:
    import ufl
    from mpi4py import MPI
    from petsc4py import PETSc

    dolfinx = _import_dolfinx()
except ImportError as error:
    raise SceneError(
        f"the implicit solver needs dolfinx and petsc4py, which cannot be imported ({error}); "
        f"on Debian 12 install them, as root, with: {DOLFINX_APT}; the explicit half works without them"
    ) from error

__all__ = ["MPI", "PETSc", "dolfinx", "ufl"]
