"""implicit/_dolfinx.py: h5py survives the import of dolfinx, and without dolfinx the message helps.

Each test runs its own interpreter: what matters is the order of the first imports, and a crash.
"""

import importlib.util
import subprocess
import sys

import pytest

needs_dolfinx = pytest.mark.skipif(
    None in (importlib.util.find_spec("dolfinx"), importlib.util.find_spec("petsc4py")),
    reason="dolfinx or petsc4py is not installed (see ./repose info)",
)


def run(code: str, *arguments: str) -> subprocess.CompletedProcess:
    return subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True)


@needs_dolfinx
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


@pytest.mark.parametrize("hidden", ["dolfinx", "petsc4py", "mpi4py", "ufl"])
def test_without_it_the_message_says_how_to_get_it(hidden):
    code = """
import sys
from mpm.errors import SceneError

class Hide:
    def find_spec(self, name, path=None, target=None):
        if name == sys.argv[1]:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Hide())
set_flags = sys.setdlopenflags
try:
    import implicit._dolfinx
except SceneError as error:
    assert sys.setdlopenflags is set_flags
    print(error)
"""
    answer = run(code, hidden)
    assert answer.returncode == 0, answer.stderr
    line = "apt-get install --no-install-recommends python3-dolfinx-real python3-petsc4py-real"
    assert line in answer.stdout
    assert "the explicit half works without them" in answer.stdout
