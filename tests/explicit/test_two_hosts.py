"""One run over two hosts: network namespaces joined by a cable, with names of their own, under `mpirun --host`."""

import importlib.util
import os
import shutil
import subprocess
import sys

import numpy as np
import pytest

from compare.launch import OPEN_MPI
from mpm.results import Results

ADDRESSES = {"a": "10.77.0.1", "b": "10.77.0.2"}
LONGEST = 300  # seconds: nothing hangs
SETTINGS = ("--set", "explicit.until=0.1", "--set", "output.every=0.05", "--set", "output.vtk=false")
# At one go, so that what two ranks say is not mixed.
MAIN = (
    "import os, socket; os.write(1, f'a rank on {socket.gethostname()}\\n'.encode());"
    "from compare.cli.main import main; main()"
)
# In place of ssh: Open MPI calls it with a host and the words of a command for a shell there.
AGENT = """#!/bin/sh
case $1 in {b}) name={name_b} ;; *) exit 1 ;; esac
shift
exec ip netns exec "$name" unshare --uts sh -c "hostname $name; $*"
"""


def command(*words):
    # Without what an MPI that other tests have started in this process left in its environment behind Python's back.
    env = dict(os.environ)
    done = subprocess.run(list(map(str, words)), capture_output=True, text=True, timeout=LONGEST, env=env)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture
def hosts():
    """Names of two namespaces with a cable between them; skips where there can be none."""
    if importlib.util.find_spec("mpi4py") is None or not shutil.which("mpirun"):
        pytest.skip("no mpi4py, or no mpirun in PATH: they come with dolfinx (see ./repose info)")
    if "Open MPI" not in command("mpirun", "--version"):
        pytest.skip("mpirun is not Open MPI's, whose way to another host is replaced here")
    if missing := [name for name in ("ip", "unshare") if not shutil.which(name)]:
        pytest.skip(f"no {' and no '.join(missing)} in PATH: packages iproute2, util-linux")
    names = {key: f"repose-{key}-{os.getpid()}" for key in ADDRESSES}
    made = subprocess.run(["ip", "netns", "add", names["a"]], capture_output=True, text=True)
    if made.returncode:
        pytest.skip(f"network namespaces are refused here: {made.stderr.strip()}")
    try:
        command("ip", "netns", "add", names["b"])
        ends = {key: f"rp{key}{os.getpid()}"[:15] for key in ADDRESSES}
        cable = subprocess.run(
            ["ip", "link", "add", ends["a"], "type", "veth", "peer", "name", ends["b"]], capture_output=True, text=True
        )
        if cable.returncode:
            pytest.skip(f"a cable between namespaces is refused here: {cable.stderr.strip()}")
        for key, name in names.items():
            command("ip", "link", "set", ends[key], "netns", name, "name", "eth0")
            command("ip", "-n", name, "address", "add", f"{ADDRESSES[key]}/24", "dev", "eth0")
            for device in ("eth0", "lo"):
                command("ip", "-n", name, "link", "set", device, "up")
        yield names
    finally:
        for name in names.values():  # the cable goes with them
            subprocess.run(["ip", "netns", "delete", name], capture_output=True)


def sent_bytes(name) -> int:
    """Bytes that a namespace has sent over its cable."""
    return int(command("ip", "netns", "exec", name, "cat", "/sys/class/net/eth0/statistics/tx_bytes"))


def test_a_run_over_two_hosts_is_the_run_on_one(hosts, tmp_path):
    agent = tmp_path / "agent"
    agent.write_text(AGENT.format(b=ADDRESSES["b"], name_b=hosts["b"]))
    agent.chmod(0o755)
    program = (sys.executable, "-c", MAIN, "run", "column_small", *SETTINGS, "--out")
    alone = command(*program, tmp_path / "alone")
    assert alone.count("a rank on") == 1
    modules = {"plm_rsh_agent": agent, "btl": "tcp,self", "btl_tcp_if_include": "eth0", "oob_tcp_if_include": "eth0"}
    chosen = [word for name, value in modules.items() for word in ("--mca", name, value)]
    told = [f"{name}={value}" for name, value in OPEN_MPI.items()]
    said = command(
        "ip", "netns", "exec", hosts["a"], "unshare", "--uts", "sh", "-c", f'hostname {hosts["a"]}; exec "$@"', "sh",
        "env", *told, "mpirun", *chosen, "--host", ",".join(ADDRESSES.values()), "-n", 2, *program, tmp_path / "two",
    )  # fmt: skip
    for name in hosts.values():
        assert f"a rank on {name}" in said
    one, two = (Results.open(tmp_path / folder) for folder in ("alone", "two"))
    assert two.summary()["ranks"] == 2
    np.testing.assert_allclose(two.read_checkpoint()["x"], one.read_checkpoint()["x"], rtol=0, atol=1e-12)
    # 13 numbers of 8 bytes a shared node and step, of which there are some hundred.
    assert min(map(sent_bytes, hosts.values())) > 104 * 100 * two.summary()["steps"]
