"""What a result was computed with and on: versions, commit, machine; and what is installed here."""

import hashlib
import importlib.util
import os
import platform
import resource
import subprocess
import sys
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from mpm.errors import SceneError

if TYPE_CHECKING:  # it imports Warp, which takes most of a second
    from mpm.scene import Scene

PROJECT = Path(__file__).resolve().parents[1]
DOLFINX_APT = "apt-get install --no-install-recommends python3-dolfinx-real python3-petsc4py-real"
DOLFINX_PIP = 'pip install "dolfinx-solver-real<0.12"'  # a wheel with PETSc inside
SYSTEM_PYTHON = Path("/usr/bin/python3")


def provenance(device: str, precision: str) -> dict[str, str | float]:
    """What to store beside a result. `device` is Warp's alias, "cpu" or "cuda:N"."""
    return {
        "repose": _version("repose"),
        "commit": git_commit(PROJECT),
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "python": platform.python_version(),
        "numpy": _version("numpy"),
        "warp": _version("warp-lang"),
        "os": platform.platform(),
        "cpu": cpu_name(),
        "cores": os.cpu_count() or 1,
        "device": device,
        "device_name": device_name(device),
        "precision": precision,
    }


def peak_memory_mb() -> float:
    """The most memory this process has held so far [MB, 10^6 bytes]; what a GPU holds is not in it."""
    # Linux hands ru_maxrss on to child processes: a run started by a larger one would report that one's peak.
    if peak := _from_proc("/proc/self/status", "VmHWM"):
        return float(peak.removesuffix("kB")) * 1024 / 1e6
    unit = 1 if sys.platform == "darwin" else 1024  # ru_maxrss: bytes on macOS, KiB elsewhere
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6


def git_commit(checkout: Path) -> str:
    """The commit checked out there, "-dirty" after it where tracked files differ, or "unknown"."""
    # Without this look git would answer for a repository further up that merely holds an installed copy.
    if not (checkout / ".git").exists():
        return "unknown"
    # --exclude leaves every tag out, so that the name is always the full commit.
    describe = ["git", "-C", str(checkout), "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    try:
        answer = subprocess.run(describe, capture_output=True, text=True, check=True, timeout=10)
    except (OSError, subprocess.SubprocessError):
        return "unknown"
    return answer.stdout.strip()


def code_version(solver: str) -> str:
    """Digest of the source that results of `solver` ("explicit", "implicit") come from: its own package and mpm."""
    digest = hashlib.sha256()
    for package in ("mpm", solver):
        for path in sorted((PROJECT / package).rglob("*.py")):
            digest.update(path.relative_to(PROJECT).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]


def decisive(mode: str, scene: "Scene") -> dict[str, str]:
    """What beside the keys of `scene` and the device decides the results of the solver `mode`: its code and, of a body
    read from a mesh file, that file's digest.

    Raises SceneError for a mesh file that cannot be read.
    """
    decides = {"mode": mode, "code": code_version(mode)}
    if scene.geometry.shape == "mesh":
        file = Path(scene.geometry.file)
        try:
            decides["mesh_file"] = hashlib.sha256(file.read_bytes()).hexdigest()
        except OSError as error:
            raise SceneError(f"geometry.file = {file}: {error.strerror}") from error
    return decides


def device_name(device: str) -> str:
    """What the device called `device` (Warp's alias, "cpu" or "cuda:N") is sold as."""
    return cpu_name() if device == "cpu" else _warp().get_device(device).name


def cpu_name() -> str:
    """The processor's model name, as the system reports it."""
    return _from_proc("/proc/cpuinfo", "model name") or platform.machine()  # Arm's cpuinfo has no model name


class Package(NamedTuple):
    """One library as `repose info` lists it; `version` is None where it is not installed."""

    name: str
    version: str | None
    needed_for: str


def installed() -> list[Package]:
    """The libraries that pip installs with Repose and their versions here, found without importing any."""
    uses = [  # module, distribution, needed for
        ("numpy", "numpy", "everything"),
        ("scipy", "scipy", "run-out measures, pictures"),
        ("pydantic", "pydantic", "scene files"),
        ("h5py", "h5py", "results"),
        ("meshio", "meshio", "mesh files, ParaView files"),
        ("matplotlib", "matplotlib", "pictures"),
        ("jinja2", "jinja2", "reports"),
        ("warp", "warp-lang", "the explicit solver"),
    ]
    return [
        Package(module, _version(distribution) if importlib.util.find_spec(module) else None, needed_for)
        for module, distribution, needed_for in uses
    ]


def how_to_get_dolfinx(from_apt: bool = True) -> str:
    """What makes a dolfinx and petsc4py that Repose works with importable here, as an order: "run as root: ...".

    `from_apt`: whether the system's own packages are an answer; they are not where they are what does not fit.
    """
    try:
        release = platform.freedesktop_os_release()
    except OSError:
        release = {}
    family = {release.get("ID"), *release.get("ID_LIKE", "").split()}
    # The packages are for the system's own Python; where that is new enough for Repose, they exist.
    is_systems = Path(sys.executable).resolve() == SYSTEM_PYTHON.resolve()
    if from_apt and is_systems and family & {"debian", "ubuntu"}:
        return f"run as root: {DOLFINX_APT}"
    if _wheel_fits():
        return f"run: {DOLFINX_PIP}"
    return (
        "use Debian 12, Ubuntu 24.04 or newer with its own Python, or Linux on x86-64 with glibc 2.34, Python 3.12 "
        f"or newer, where {DOLFINX_PIP} does it"
    )


def _wheel_fits() -> bool:
    """Whether PyPI's wheel of dolfinx can be installed here."""
    libc, version = platform.libc_ver()
    return (
        (sys.platform, platform.machine(), libc) == ("linux", "x86_64", "glibc")
        and tuple(map(int, version.split(".")[:2])) >= (2, 34)
        and sys.version_info >= (3, 12)
    )


def warp_devices() -> list[dict[str, str | float]]:
    """The devices the explicit solver can run on: alias, name, memory [MB, 10^6 bytes]; none without Warp."""
    if importlib.util.find_spec("warp") is None:
        return []
    host_bytes = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return [
        {
            "alias": device.alias,
            "name": device.name if device.is_cuda else cpu_name(),
            "memory_mb": (device.total_memory if device.is_cuda else host_bytes) / 1e6,
        }
        for device in _warp().get_devices()
    ]


def _from_proc(path: str, key: str) -> str | None:
    """The value of the first `key: value` line there; None without one, or without /proc."""
    try:
        lines = Path(path).read_text().splitlines()
    except OSError:
        return None
    return next((line.partition(":")[2].strip() for line in lines if line.startswith(key)), None)


def _version(distribution: str) -> str:
    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return "unknown"


def _warp():
    from mpm.devices import start_warp  # here and not above: importing Warp takes most of a second

    return start_warp()
