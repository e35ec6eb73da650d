"""implicit/_dolfinx.py: h5py survives the import of dolfinx, and what does not fit is refused with what helps.

Each test runs its own interpreter: what matters is the order of the first imports, and a crash.
"""

import os
import subprocess
import sys

import pytest
from installed import needs_implicit

from mpm.caches import COMPILING
from mpm.provenance import how_to_get_dolfinx


def run(code: str, *arguments: str) -> subprocess.CompletedProcess:
    return subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True)


@needs_implicit
def test_h5py_works_after_dolfinx(tmp_path):
    code = """
import sys
flags = sys.getdlopenflags()
set_flags = sys.setdlopenflags
from implicit._dolfinx import MPI, PETSc, dolfinx
assert sys.getdlopenflags() == flags and sys.setdlopenflags is set_flags
import h5py
with h5py.File(sys.argv[1], "w") as file:
    file["x"] = [1.0, 2.0]
with h5py.File(sys.argv[1]) as file:
    print(file["x"][:].sum(), MPI.COMM_WORLD.size, PETSc.Sys.getVersion()[0], dolfinx.__name__)
"""
    answer = run(code, str(tmp_path / "a.h5"))
    assert answer.returncode == 0, answer.stderr
    assert answer.stdout.split() == ["3.0", "1", "3", "dolfinx"]


@needs_implicit
def test_libraries_are_those_that_were_loaded():
    code = """
from implicit._dolfinx import MPI, PETSc, dolfinx, libraries
found = libraries()
assert found["dolfinx"] == dolfinx.__version__
assert found["petsc"].split(".") == [str(number) for number in PETSc.Sys.getVersion()]
assert MPI.Get_library_version().split()[0] in found["mpi"]
print(sorted(found), "\\n" in "".join(found.values()))
"""
    answer = run(code)
    assert answer.stdout == "['dolfinx', 'mpi', 'mpi4py', 'petsc', 'petsc4py'] False\n", answer.stderr


@needs_implicit
def test_elements_are_compiled_once_quietly_and_not_untold(tmp_path):
    code = """
import logging
import numpy as np
from mpm.caches import announce_compilation
announce_compilation()
from implicit._dolfinx import MPI, function_space, hexahedra
handlers = logging.root.handlers[:]
points = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], float)
mesh = hexahedra(MPI.COMM_SELF, np.arange(8).reshape(1, 8), points)
vectors, scalars = function_space(mesh, "Lagrange", 1, (3,)), function_space(mesh, "DG", 0)
assert vectors.dofmap.bs == 3 and vectors.dofmap.index_map.size_global == 8
assert scalars.dofmap.bs == 1 and scalars.dofmap.index_map.size_global == 1
assert (logging.root.level, logging.root.handlers, logging.root.manager.disable) == (logging.WARNING, handlers, 0)
"""
    env = os.environ | {"XDG_CACHE_HOME": str(tmp_path)}
    first, second = (
        subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=env) for _ in range(2)
    )
    assert (first.returncode, first.stdout) == (0, ""), first.stderr
    compiled = list(tmp_path.glob("fenics/*.c"))  # dolfinx from 0.10 on compiles no elements
    assert first.stderr == (f"{COMPILING}\n" if compiled else "")
    assert (second.returncode, second.stdout, second.stderr) == (0, "", "")


# An import hook that hides a module, or puts in its place an empty one with an attribute.
REFUSED = """
import sys
from importlib.machinery import ModuleSpec
from types import ModuleType, SimpleNamespace
from mpm.errors import SceneError

hidden, shown = sys.argv[1:]

class Installed:
    def find_spec(self, name, path=None, target=None):
        if name == hidden:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        if name.split(".")[0] in ("dolfinx", "dolfinx_solver", "petsc4py", "mpi4py", "ufl"):
            return ModuleSpec(name, self, is_package=True)

    def create_module(self, spec):
        return ModuleType(spec.name)

    def exec_module(self, module):
        scalar = SimpleNamespace(__name__="complex128" if shown == "complex" else "float64")
        module.__version__ = {"dolfinx": shown, "petsc4py": "3.24.0"}.get(module.__name__, "1.0")
        module.MPI, module.PETSc = SimpleNamespace(COMM_SELF=None), SimpleNamespace(ScalarType=scalar)
        module.init = lambda comm: None

sys.meta_path.insert(0, Installed())
set_flags = sys.setdlopenflags
try:
    import implicit._dolfinx
except SceneError as error:
    assert sys.setdlopenflags is set_flags
    print(error)
else:
    print("accepted")
"""


@pytest.mark.parametrize("hidden", ["dolfinx", "petsc4py", "mpi4py", "ufl"])
def test_without_it_the_message_says_how_to_get_it(hidden):
    answer = run(REFUSED, hidden, "0.9.0")
    assert answer.returncode == 0, answer.stderr
    assert answer.stdout.count("\n") == 1
    assert f"{hidden} is not installed" in answer.stdout
    assert how_to_get_dolfinx() in answer.stdout
    assert "the explicit half works without them" in answer.stdout


def test_complex_scalars_are_refused_by_name(monkeypatch):
    monkeypatch.setenv("PETSC_DIR", "/usr/lib/petscdir/complex")
    answer = run(REFUSED, "", "complex")
    assert answer.returncode == 0, answer.stderr
    assert answer.stdout.count("\n") == 1
    assert "but petsc4py 3.24.0 has complex scalars (PETSC_DIR is /usr/lib/petscdir/complex); " in answer.stdout
    assert how_to_get_dolfinx() in answer.stdout


@pytest.mark.parametrize("version", ["0.4.1", "0.12.0", "1.0.0.dev0", "2019.1.0"])
def test_a_version_outside_the_range_is_refused_by_name(version):
    answer = run(REFUSED, "", version)
    assert answer.returncode == 0, answer.stderr
    assert answer.stdout.count("\n") == 1
    assert f"needs dolfinx 0.5 to 0.11 and petsc4py with real scalars, but dolfinx is {version}; " in answer.stdout
    assert how_to_get_dolfinx(from_apt=False) in answer.stdout


@pytest.mark.parametrize("version", ["0.5.0", "0.10.0.post2", "0.11.0.post0"])
def test_versions_in_the_range_are_accepted(version):
    assert run(REFUSED, "", version).stdout == "accepted\n"
