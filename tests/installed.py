"""What only some tests need: whether it is installed here, and why those tests are skipped where it is not."""

import importlib.util
import shutil

import pytest

HAS_IMPLICIT = None not in (importlib.util.find_spec("dolfinx"), importlib.util.find_spec("petsc4py"))
NO_IMPLICIT = "dolfinx or petsc4py is not installed (see ./repose info)"
HAS_RANKS = importlib.util.find_spec("mpi4py") is not None and shutil.which("mpiexec") is not None
NO_RANKS = "no mpi4py, or no mpiexec in PATH: they come with dolfinx (see ./repose info)"

needs_implicit = pytest.mark.skipif(not HAS_IMPLICIT, reason=NO_IMPLICIT)
needs_ranks = pytest.mark.skipif(not HAS_RANKS, reason=NO_RANKS)
