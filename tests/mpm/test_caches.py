"""Folders for what is compiled: a home that cannot be written, and word of compiling only where that happens.

Each call is a process of its own, without root's right to write everywhere.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from mpm.caches import COMPILING
from mpm.devices import start_warp

ORDINARY = ["setpriv", "--bounding-set=-all", "--inh-caps=-all"] if os.geteuid() == 0 else []
CACHE = "from mpm.devices import start_warp; print(start_warp().config.kernel_cache_dir)"
REPOSE = "from compare.cli.main import main; main()"
VARIABLES = ("HOME", "XDG_CACHE_HOME", "XDG_CONFIG_HOME", "WARP_CACHE_PATH", "MPLCONFIGDIR")
SHORT = ("column_small", "--set", "grid.cell=0.25", "--set", "explicit.until=0.01", "--set", "output.vtk=false")


@pytest.fixture
def home(tmp_path):
    (tmp_path / "home").mkdir()
    return tmp_path / "home"


@pytest.fixture
def call(tmp_path, home):
    """`call(code, *arguments, VARIABLE=folder, ...)`: Python as an ordinary user, caches where VARIABLEs say."""
    if ORDINARY and shutil.which("setpriv") is None:
        pytest.skip("root can write everywhere, and there is no setpriv to be somebody else with")
    (tmp_path / "tmp").mkdir(exist_ok=True)

    def run(code, *arguments, **variables):
        kept = {name: value for name, value in os.environ.items() if name not in VARIABLES}
        env = kept | {"HOME": home, "TMPDIR": tmp_path / "tmp", **variables}
        command = [*ORDINARY, sys.executable, "-c", code, *arguments]
        return subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, text=True)

    return run


@pytest.fixture
def own(tmp_path):
    """The user's temporary folder, with the kernels of these tests in it: they take a while to compile."""
    own = tmp_path / "tmp" / f"repose-{os.getuid()}"
    own.mkdir(mode=0o700, parents=True)
    (own / "warp").symlink_to(Path(start_warp().config.kernel_cache_dir).parent)
    return own


def test_a_home_that_can_be_written_is_used_without_a_word(call, home, tmp_path):
    answer = call(CACHE)
    assert (answer.returncode, answer.stderr) == (0, "")
    assert answer.stdout.startswith(f"{home}/.cache/warp/")
    assert list((tmp_path / "tmp").iterdir()) == []


@pytest.mark.parametrize("arguments", [("run", *SHORT), ("info",)], ids=["run", "info"])
@pytest.mark.parametrize("kind", ["missing", "read-only", "closed"])
def test_without_a_usable_home_it_works_and_warns_once(own, call, home, kind, arguments):
    home.chmod({"missing": 0o555, "read-only": 0o555, "closed": 0o000}[kind])
    where = home / "nobody" if kind == "missing" else home
    answer = call(REPOSE, *arguments, HOME=where)
    home.chmod(0o755)
    assert answer.returncode == 0, answer.stderr
    (warning,) = [line for line in answer.stderr.splitlines() if line != COMPILING]
    assert warning.startswith("warning: ")
    assert f"compiled kernels are kept in {own} (WARP_CACHE_PATH and XDG_CACHE_HOME name another place)" in warning
    assert list(home.iterdir()) == []


@pytest.mark.parametrize("variable", ["XDG_CACHE_HOME", "WARP_CACHE_PATH"])
def test_a_cache_that_is_read_only_is_named(call, tmp_path, variable):
    cache = tmp_path / "cache"
    cache.mkdir(mode=0o555)
    answer = call(
        "from mpm.devices import start_warp; print(start_warp().config.kernel_cache_dir)", **{variable: cache}
    )
    assert answer.returncode == 0
    assert answer.stdout.startswith(f"{tmp_path}/tmp/repose-{os.getuid()}/warp/")
    assert answer.stderr.startswith(f"warning: {cache}") and answer.stderr.count("\n") == 1


def test_a_folder_that_others_can_write_is_not_trusted(call, home, tmp_path):
    """Compiled code is loaded from it."""
    call("")
    taken = tmp_path / "tmp" / f"repose-{os.getuid()}"
    taken.mkdir()
    taken.chmod(0o777)
    home.chmod(0o555)
    answer = call("import os, mpm.caches as c; c.prepare_caches(); print(os.environ['WARP_CACHE_PATH'])")
    home.chmod(0o755)
    kept = Path(answer.stdout.strip())
    assert kept.parent.parent == taken.parent and kept.parent != taken
    assert kept.parent.stat().st_mode & 0o777 == 0o700


def test_says_that_it_compiles_when_it_does_and_only_then(call, tmp_path):
    (tmp_path / "doubling.py").write_text("""
import sys
from mpm.caches import announce_compilation
announce_compilation()
from mpm.devices import start_warp
wp = start_warp()

@wp.kernel
def double(x: wp.array(dtype=float)):
    x[wp.tid()] *= 2.0

print("start", file=sys.stderr)
x = wp.ones(3)
wp.launch(double, 3, [x])
print(x.numpy().sum(), file=sys.stderr)
""")
    program = "import runpy; runpy.run_path('doubling.py')"
    assert call(program).stderr.splitlines() == ["start", COMPILING, "6.0"]
    assert call(program).stderr.splitlines() == ["start", "6.0"]
