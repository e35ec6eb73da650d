"""The script `./repose`, run on a machine made of stubs: no network, no installation, no real Python.

A copy of the script stands in a project of two files. PATH is a folder of stubs and of links to the few
tools the script may count on; Debian's Python, whose path the script fixes, is replaced in the copy.
"""

import os
import re
import shutil
import signal
import subprocess
import time
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[1] / "repose"
TOOLS = [
    "cat",
    "chmod",
    "cksum",
    "cp",
    "date",
    "env",
    "find",
    "grep",
    "mkdir",
    "mv",
    "readlink",
    "rm",
    "rmdir",
    "seq",
    "tail",
]

# Answers what the script asks of a Python; `-m venv` copies it, pip "installs" the command line.
PYTHON = """#!/bin/sh
echo "python $*" >>"$STATE/calls"
case "$*" in
*"print(sys.version_info"*) echo "(3, 11)" ;;
*libc_ver*) [ -e "$STATE/wheel_fits" ] ;;
*"version_info < "*) [ ! -e "$STATE/old_python" ] ;;
*ensurepip*) [ ! -e "$STATE/no_venv" ] ;;
*find_spec*) [ -e "$STATE/dolfinx" ] ;;
*importlib.metadata*) echo "numpy<3" ;;
*"-m venv"*) for venv; do :; done; mkdir -p "$venv/bin" && cp "$0" "$venv/bin/python" ;;
*"-m pip"*)
    [ ! -e "$STATE/no_network" ] || { echo "ERROR: no route to host"; seq 20; exit 1; }
    while [ -e "$STATE/slow_network" ]; do sleep 1; done
    printf '#!/bin/sh\\nprintf "%%s|" "$PWD" "$@"\\n' >"${0%/*}/repose" && chmod +x "${0%/*}/repose" ;;
*"-m pytest"*) printf '%s|' "$PWD" "$@" ;;
*) echo "unexpected: $*" >&2; exit 9 ;;
esac
"""
APT_GET = """#!/bin/sh
echo "apt-get $*" >>"$STATE/calls"
[ ! -e "$STATE/no_network" ] || exit 100
case "$*" in *python3-venv*) rm -f "$STATE/no_venv" ;; *dolfinx*) : >"$STATE/dolfinx" ;; esac
"""
DPKG_QUERY = '#!/bin/sh\n[ ! -e "$STATE/dolfinx" ] || printf installed\n'
APT_LINE = "apt-get update && apt-get install -y --no-install-recommends"


class Machine:
    """A Debian with everything installed, where apt may be used by nobody; tests take things away or give."""

    def __init__(self, folder: Path):
        self.root = folder / "the project"
        self.bin = folder / "bin"
        self.state = folder / "state"
        for path in (self.root, self.bin, self.state):
            path.mkdir()
        (self.root / "pyproject.toml").write_text("[project]\n")
        python = folder / "debian" / "python3"
        python.parent.mkdir()
        text = SCRIPT.read_text()
        for name, path in {"debian_python": python, "debian_dolfinx": self.state / "dolfinx"}.items():
            text, count = re.subn(rf"(?m)^{name}=.*$", f"{name}='{path}'", text)
            assert count == 1
        self.executable(self.root / "repose", text)
        self.executable(python, PYTHON)
        self.debian_python = python
        self.set("dolfinx")
        for tool in TOOLS:
            (self.bin / tool).symlink_to(shutil.which(tool))
        self.stub("sleep", "#!/bin/sh\nPATH=/usr/bin:/bin exec sleep 0.05\n")
        self.stub("id", "#!/bin/sh\necho 1000\n")
        self.stub("dpkg-query", DPKG_QUERY)
        self.stub("apt-get", APT_GET)

    @staticmethod
    def executable(path: Path, text: str):
        path.write_text(text)
        path.chmod(0o755)

    def stub(self, name: str, text: str):
        self.executable(self.bin / name, text)

    def set(self, *states: str):
        for state in states:
            (self.state / state).touch()

    def unset(self, state: str):
        (self.state / state).unlink()

    def start(self, *arguments: str, program: Path | str | None = None, cwd: Path | None = None) -> subprocess.Popen:
        return subprocess.Popen(
            [program or self.root / "repose", *arguments],
            cwd=cwd or self.root.parent,
            env={"PATH": str(self.bin), "STATE": str(self.state)},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )

    def run(self, *arguments: str, **where) -> subprocess.CompletedProcess:
        process = self.start(*arguments, **where)
        out, err = process.communicate(timeout=20)
        return subprocess.CompletedProcess(arguments, process.returncode, out, err)

    def calls(self) -> str:
        """What was asked of Python and apt since the last look."""
        path = self.state / "calls"
        text = path.read_text() if path.exists() else ""
        path.unlink(missing_ok=True)
        return text

    @property
    def stamp(self) -> Path:
        return self.root / ".venv" / "setup.stamp"


@pytest.fixture
def machine(tmp_path) -> Machine:
    return Machine(tmp_path)


@pytest.mark.parametrize("shell", ["dash", "sh", "bash"])
def test_is_valid_shell(shell):
    if shutil.which(shell) is None:
        pytest.skip(f"no {shell} here")
    check = subprocess.run([shell, "-n", SCRIPT], capture_output=True, text=True)
    assert (check.returncode, check.stderr) == (0, "")
    assert os.access(SCRIPT, os.X_OK)


def test_hands_its_arguments_on_in_the_callers_folder(machine, tmp_path):
    elsewhere = tmp_path / "else where"
    elsewhere.mkdir()
    first = machine.run("run", "a scene.toml", "*", "", cwd=elsewhere)
    assert first.returncode == 0
    assert first.stdout == f"{elsewhere}|run|a scene.toml|*||"
    assert first.stderr.count("\n") == 1 and "making the Python environment" in first.stderr
    calls = machine.calls()
    assert "--system-site-packages" in calls
    assert f"--only-binary=:all: -e {machine.root}[test] numpy<3\n" in calls  # the numpy of Debian's dolfinx


def test_is_found_through_symbolic_links(machine, tmp_path):
    (tmp_path / "links").mkdir()
    absolute = tmp_path / "links" / "absolute"
    absolute.symlink_to(machine.root / "repose")
    relative = tmp_path / "links" / "relative"
    relative.symlink_to("absolute")
    assert machine.run("demo", program=relative, cwd=tmp_path).stdout == f"{tmp_path}|demo|"
    assert machine.stamp.exists()


def test_the_program_is_told_how_it_was_called(machine):
    machine.run()
    machine.executable(machine.root / ".venv" / "bin" / "repose", '#!/bin/sh\nprintf %s "$REPOSE_COMMAND"\n')
    assert machine.run(program="./repose", cwd=machine.root).stdout == "./repose"
    assert machine.run().stdout == str(machine.root / "repose")


def test_a_fresh_environment_costs_one_look_and_says_nothing(machine):
    machine.run()
    machine.calls()
    again = machine.run("info")
    assert (again.stdout, again.stderr) == (f"{machine.root.parent}|info|", "")
    assert machine.calls().count("\n") == 1


def test_test_runs_pytest_in_the_project_and_the_users_marker_comes_last(machine):
    answer = machine.run("test", "-m", "slow or gpu", "tests/mpm")
    assert answer.stdout == f"{machine.root}|-m|pytest|-m|not slow|-n|auto|--dist|loadfile|-m|slow or gpu|tests/mpm|"


def test_without_dolfinx_and_without_apt_rights_it_warns_and_goes_on(machine):
    machine.unset("dolfinx")
    answer = machine.run("info")
    assert answer.returncode == 0 and answer.stdout.endswith("|info|")
    assert "warning" in answer.stderr and "implicit solver will not run" in answer.stderr
    assert f"{APT_LINE} python3-dolfinx-real python3-petsc4py-real\n" in answer.stderr
    calls = machine.calls()
    assert "apt-get" not in calls
    assert f"-e {machine.root}[test]\n" in calls


def test_without_the_systems_dolfinx_it_takes_the_wheel_where_that_fits(machine):
    """Into an environment that sees nothing of the system: its mpi4py would bring another MPI library."""
    machine.unset("dolfinx")
    machine.set("wheel_fits")
    answer = machine.run("info")
    assert answer.returncode == 0 and answer.stdout.endswith("|info|")
    assert "warning" not in answer.stderr
    calls = machine.calls()
    assert f"-e {machine.root}[test,implicit]\n" in calls
    assert "--system-site-packages" not in calls


@pytest.mark.parametrize("later", ["installed", "removed"])
def test_an_environment_is_made_anew_when_the_systems_dolfinx_comes_or_goes(machine, later):
    if later == "installed":
        machine.unset("dolfinx")
    machine.run()
    machine.calls()
    machine.set("dolfinx") if later == "installed" else machine.unset("dolfinx")
    machine.run()
    calls = machine.calls()
    assert "-m venv" in calls
    assert ("--system-site-packages" in calls) == (later == "installed")
    assert machine.run().stderr == ""


def test_without_venv_and_without_apt_rights_it_stops_with_the_line_to_run(machine):
    machine.set("no_venv")
    machine.unset("dolfinx")
    answer = machine.run("info")
    assert (answer.returncode, answer.stdout) == (1, "")
    assert answer.stderr.count("\n") == 1
    assert f"{APT_LINE} python3-venv python3-dolfinx-real python3-petsc4py-real\n" in answer.stderr
    assert "apt-get" not in machine.calls()
    assert not machine.stamp.exists()


def test_without_any_python_and_without_apt_rights_it_stops_with_the_line_to_run(machine):
    machine.debian_python.unlink()
    answer = machine.run("info")
    assert answer.returncode == 1
    assert f"no Python; run as root: {APT_LINE} python3-venv python3-dolfinx-real" in answer.stderr


@pytest.mark.parametrize("right", ["root", "sudo"])
def test_with_apt_rights_it_installs_what_is_missing(machine, right):
    machine.set("no_venv")
    machine.unset("dolfinx")
    if right == "root":
        machine.stub("id", "#!/bin/sh\necho 0\n")
    else:
        machine.stub("true", "#!/bin/sh\n")
        machine.stub("sudo", '#!/bin/sh\n[ "$1" = -n ] || exit 1\nshift\n"$@"\n')
    answer = machine.run("info")
    assert answer.returncode == 0
    assert "warning" not in answer.stderr
    apt = [line for line in machine.calls().splitlines() if line.startswith("apt-get")]
    assert apt[0] == "apt-get update"
    assert apt[1].endswith("install -y --no-install-recommends python3-venv")
    assert apt[2].endswith("install -y --no-install-recommends python3-dolfinx-real python3-petsc4py-real")
    assert len(apt) == 3


def test_where_apt_fails_a_missing_dolfinx_is_still_only_a_warning(machine):
    machine.unset("dolfinx")
    machine.stub("id", "#!/bin/sh\necho 0\n")
    machine.stub("apt-get", "#!/bin/sh\nexit 100\n")
    answer = machine.run("info")
    assert answer.returncode == 0
    assert "apt-get could not install" in answer.stderr
    assert str(machine.root / ".venv" / "setup.log") in answer.stderr


def test_without_apt_it_goes_on_with_the_python_there_is(machine):
    (machine.bin / "apt-get").unlink()
    (machine.bin / "dpkg-query").unlink()
    machine.debian_python.rename(machine.bin / "python3")
    machine.unset("dolfinx")
    answer = machine.run("info")
    assert answer.returncode == 0
    assert "warning" in answer.stderr and "apt-get" not in answer.stderr


def test_too_old_a_python_is_an_error(machine):
    machine.set("old_python")
    answer = machine.run("info")
    assert answer.returncode == 1
    assert answer.stderr.startswith("repose: error: Python 3.11 or newer is needed")
    assert not machine.stamp.exists()


def test_a_set_up_that_failed_names_its_log_and_is_begun_again(machine):
    machine.set("no_network")
    answer = machine.run("info")
    log = machine.root / ".venv" / "setup.log"
    assert (answer.returncode, answer.stdout) == (1, "")
    last = answer.stderr.splitlines()
    assert last[-1].endswith(f"the log: {log}")
    assert last[-2] == "ERROR: no route to host"  # what pip said, not only where
    assert "no route to host" in log.read_text()
    assert not machine.stamp.exists()
    machine.unset("no_network")
    machine.calls()
    assert machine.run("info").returncode == 0
    assert "-m venv" in machine.calls()


def test_an_interrupted_set_up_leaves_neither_stamp_nor_lock(machine):
    machine.set("slow_network")
    process = machine.start("info")
    deadline = time.monotonic() + 10
    while "-m pip" not in machine.calls() and time.monotonic() < deadline:
        time.sleep(0.02)
    os.killpg(process.pid, signal.SIGTERM)
    out, err = process.communicate(timeout=20)
    assert (process.returncode, out) == (1, "")
    assert err.splitlines()[-1] == "repose: error: set-up interrupted; the next run starts it again"
    assert [path.name for path in (machine.root / ".venv").glob("setup.*")] == ["setup.log"]


@pytest.mark.parametrize("changed", ["pyproject.toml", "repose"])
def test_changed_sources_are_installed_into_the_same_environment(machine, changed):
    machine.run()
    machine.calls()
    with (machine.root / changed).open("a") as file:
        file.write("# changed\n")
    assert "bringing" in machine.run().stderr
    calls = machine.calls()
    assert "-m pip" in calls and "-m venv" not in calls
    assert machine.run().stderr == ""


def test_a_half_done_update_does_not_count_as_the_old_environment(machine):
    machine.run()
    before = (machine.root / "pyproject.toml").read_text()
    (machine.root / "pyproject.toml").write_text(before + "# changed\n")
    machine.set("no_network")
    assert machine.run().returncode == 1
    machine.unset("no_network")
    (machine.root / "pyproject.toml").write_text(before)
    assert "making the Python environment" in machine.run().stderr


@pytest.mark.parametrize("damage", ["moved", "python broken", "command line gone", "no stamp"])
def test_an_environment_that_cannot_be_kept_is_made_anew(machine, damage):
    machine.run()
    left_over = machine.root / ".venv" / ".left over"
    left_over.touch()
    if damage == "moved":
        machine.root = machine.root.rename(machine.root.parent / "moved")
    elif damage == "python broken":
        (machine.root / ".venv" / "bin" / "python").write_text("#!/nowhere\n")
    elif damage == "command line gone":
        shutil.rmtree(machine.root / ".venv" / "bin")
    else:
        machine.stamp.unlink()
    machine.calls()
    answer = machine.run("info")
    assert answer.stdout.endswith("|info|")
    assert "-m venv" in machine.calls()
    assert not (machine.root / ".venv" / left_over.name).exists()
    assert machine.run().stderr == ""


def test_waits_for_another_set_up_and_does_not_repeat_it(machine):
    machine.run()
    stamp = machine.stamp.read_text()
    machine.stamp.unlink()
    lock = machine.root / ".venv" / "setup.lock"
    lock.mkdir()
    (lock / "pid").write_text(f"{os.getpid()}\n")  # this test is the other set-up
    machine.calls()
    process = machine.start("info")
    assert process.stderr.readline() == "repose: another ./repose is setting up; waiting for it\n"
    time.sleep(0.2)
    assert process.poll() is None
    machine.stamp.write_text(stamp)
    shutil.rmtree(lock)
    out, err = process.communicate(timeout=20)
    assert out.endswith("|info|") and err == ""
    assert "-m pip" not in machine.calls()
    assert not lock.exists()


@pytest.mark.parametrize("owner", ["gone", "unnamed"])
def test_takes_over_the_lock_of_a_set_up_that_was_cut_off(machine, owner):
    lock = machine.root / ".venv" / "setup.lock"
    lock.mkdir(parents=True)
    if owner == "gone":
        ended = subprocess.Popen(["true"])
        ended.wait()
        (lock / "pid").write_text(f"{ended.pid}\n")
    both = [machine.start("info"), machine.start("info")]
    answers = [process.communicate(timeout=20) for process in both]
    assert all(out.endswith("|info|") for out, _ in answers)
    assert machine.calls().count("-m venv") == 1
    assert not lock.exists()
