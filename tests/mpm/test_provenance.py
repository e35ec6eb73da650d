"""Provenance: what a result says about itself holds true, and asking costs no heavy import."""

import importlib.util
import os
import re
import shutil
import subprocess
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from mpm import provenance as pv


def python(code: str) -> str:
    """What a fresh interpreter prints: here an import of this test session would hide one of the module."""
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip()


def test_says_what_the_run_was_computed_with():
    record = pv.provenance("cpu", "float64")
    assert record["numpy"] == np.__version__
    assert record["python"] == ".".join(map(str, sys.version_info[:3]))
    assert re.fullmatch(r"\d+\.\d+\.\d+", record["repose"])
    assert re.fullmatch(r"unknown|[0-9a-f]{40}(-dirty)?", record["commit"])
    assert (record["device"], record["precision"]) == ("cpu", "float64")
    assert record["device_name"] == record["cpu"] != ""
    assert record["cores"] == os.cpu_count()
    age = datetime.now(UTC) - datetime.fromisoformat(record["date"])
    assert timedelta(seconds=-1) < age < timedelta(minutes=1)


def test_every_entry_fits_an_hdf5_attribute(tmp_path):
    import h5py

    record = pv.provenance("cpu", "float32")
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file.attrs.update(record)
        assert dict(file.attrs) == record


def test_on_the_host_nothing_heavy_is_imported():
    code = """
import sys
from mpm.provenance import installed, provenance
provenance("cpu", "float64"), installed()
print(sorted({"warp", "numpy", "scipy", "dolfinx", "petsc4py", "matplotlib"} & set(sys.modules)))
"""
    assert python(code) == "[]"


@pytest.mark.gpu
def test_on_a_gpu_the_device_has_its_own_name():
    wp = pytest.importorskip("warp")
    if not wp.is_cuda_available():
        pytest.skip("no CUDA device here")
    assert pv.provenance("cuda:0", "float32")["device_name"] == wp.get_device("cuda:0").name


@pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")
def test_commit_follows_the_checkout(tmp_path, monkeypatch):
    for variable in [name for name in os.environ if name.startswith("GIT_")]:
        monkeypatch.delenv(variable)  # set while a hook runs these tests: git would look elsewhere

    def git(*words: str) -> str:
        return subprocess.run(
            ["git", "-C", str(tmp_path), "-c", "user.name=a", "-c", "user.email=a@b.c", *words],
            capture_output=True,
            text=True,
            check=True,
        ).stdout.strip()

    assert pv.git_commit(tmp_path) == "unknown"
    git("init", "--quiet")
    assert pv.git_commit(tmp_path) == "unknown"  # a repository without a commit
    file = tmp_path / "a.txt"
    file.write_text("one")
    git("add", "a.txt")
    git("commit", "--quiet", "--no-gpg-sign", "-m", "one")
    git("tag", "-a", "v1", "-m", "tags do not replace the commit")
    head = git("rev-parse", "HEAD")
    assert pv.git_commit(tmp_path) == head
    (tmp_path / "untracked.h5").write_text("a result")
    assert pv.git_commit(tmp_path) == head
    file.write_text("two")
    assert pv.git_commit(tmp_path) == f"{head}-dirty"
    inside = tmp_path / "installed" / "copy"
    inside.mkdir(parents=True)
    assert pv.git_commit(inside) == "unknown"  # another project's repository is not this one's


def test_without_git_the_commit_is_unknown(tmp_path, monkeypatch):
    (tmp_path / ".git").mkdir()
    monkeypatch.setenv("PATH", str(tmp_path))
    assert pv.git_commit(tmp_path) == "unknown"
    assert pv.provenance("cpu", "float64")["commit"] == "unknown"


def test_peak_memory_is_this_process_and_grows_by_what_is_allocated():
    larger_parent = bytearray(b"x" * 200_000_000)  # Linux would pass its peak on to a child
    before = float(python("from mpm.provenance import peak_memory_mb as peak; print(peak())"))
    after = float(python("from mpm.provenance import peak_memory_mb as peak; b = b'x' * 200_000_000; print(peak())"))
    assert 5 < before < 100 < len(larger_parent) / 1e6
    assert after - before == pytest.approx(200, abs=20)


def test_installed_lists_each_library_with_its_version():
    packages = {package.name: package for package in pv.installed()}
    names = "numpy scipy pydantic h5py meshio matplotlib jinja2 warp"
    assert set(packages) == set(names.split())
    assert packages["numpy"].version == np.__version__
    assert all(package.needed_for for package in packages.values())


def test_installed_gives_no_version_to_what_is_missing(monkeypatch):
    found = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "h5py" else found(name))
    versions = {package.name: package.version for package in pv.installed()}
    assert versions["h5py"] is None
    assert versions["numpy"] is not None


APT = "run as root: apt-get install --no-install-recommends python3-dolfinx-real python3-petsc4py-real"
WHEEL = 'run: pip install "dolfinx-solver-real<0.12"'
DEBIAN = {"ID": "debian", "VERSION_ID": "13"}
MINT = {"ID": "linuxmint", "ID_LIKE": "ubuntu debian"}
FEDORA = {"ID": "fedora"}
NEW_GLIBC = ("glibc", "2.41")


@pytest.mark.parametrize(
    ("release", "python", "version", "machine", "libc", "how"),
    [
        (DEBIAN, "system's", (3, 13), "x86_64", NEW_GLIBC, APT),
        (MINT, "system's", (3, 12), "aarch64", NEW_GLIBC, APT),
        (DEBIAN, "own", (3, 13), "x86_64", NEW_GLIBC, WHEEL),  # a Python that does not see Debian's packages
        (FEDORA, "system's", (3, 13), "x86_64", ("glibc", "2.34"), WHEEL),
        (FEDORA, "system's", (3, 11), "x86_64", NEW_GLIBC, "use Debian 12, Ubuntu 24.04"),
        (FEDORA, "system's", (3, 13), "x86_64", ("glibc", "2.31"), "use Debian 12, Ubuntu 24.04"),
        (FEDORA, "system's", (3, 13), "aarch64", NEW_GLIBC, "use Debian 12, Ubuntu 24.04"),
        (FEDORA, "system's", (3, 13), "x86_64", ("", ""), "use Debian 12, Ubuntu 24.04"),  # musl
        (None, "own", (3, 11), "arm64", ("", ""), "use Debian 12, Ubuntu 24.04"),  # no os-release at all
    ],
)
def test_the_way_to_dolfinx_is_that_of_this_system(tmp_path, monkeypatch, release, python, version, machine, libc, how):
    def os_release():
        if release is None:
            raise OSError("no os-release")
        return release

    (tmp_path / "own").touch()
    (tmp_path / "system's").touch()
    (tmp_path / "venv").symlink_to(python)
    monkeypatch.setattr(pv, "SYSTEM_PYTHON", tmp_path / "system's")
    monkeypatch.setattr(sys, "executable", str(tmp_path / "venv"))
    monkeypatch.setattr(sys, "version_info", version)
    monkeypatch.setattr(pv.platform, "freedesktop_os_release", os_release)
    monkeypatch.setattr(pv.platform, "machine", lambda: machine)
    monkeypatch.setattr(pv.platform, "libc_ver", lambda: libc)
    assert pv.how_to_get_dolfinx().startswith(how)
    # Where the system's own packages are what does not fit, installing them again is no answer.
    assert "apt-get" not in pv.how_to_get_dolfinx(from_apt=False)


def test_warp_devices_name_the_host_first():
    pytest.importorskip("warp")
    host = pv.warp_devices()[0]
    assert host["alias"] == "cpu"
    assert host["name"] == pv.cpu_name()
    if Path("/proc/meminfo").exists():
        total_kib = int(re.search(r"MemTotal:\s+(\d+)", Path("/proc/meminfo").read_text())[1])
        assert host["memory_mb"] == pytest.approx(total_kib * 1024 / 1e6, rel=0.01)


def test_without_warp_there_are_no_devices(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert pv.warp_devices() == []


def test_code_version_is_that_of_the_solver_and_what_it_stands_on(tmp_path, monkeypatch):
    """A change in mpm concerns both solvers, one in implicit only its own; what is not Python concerns none."""
    for path in ("mpm/a.py", "explicit/kernels/b.py", "implicit/c.py"):
        (tmp_path / path).parent.mkdir(parents=True)
        (tmp_path / path).write_text("x = 1\n")
    monkeypatch.setattr(pv, "PROJECT", tmp_path)

    def versions():
        return pv.code_version("explicit"), pv.code_version("implicit")

    first = versions()
    (tmp_path / "mpm/scene.toml").write_text("y = 2\n")
    assert versions() == first
    (tmp_path / "implicit/c.py").write_text("x = 2\n")
    second = versions()
    assert (second[0] == first[0], second[1] == first[1]) == (True, False)
    (tmp_path / "mpm/a.py").write_text("x = 2\n")
    third = versions()
    assert third[0] != second[0] and third[1] != second[1]
