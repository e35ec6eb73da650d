"""Starting the program on several MPI ranks, and what a rank is to do when it was."""

import importlib.util
import os
import shutil
import signal
import subprocess
import sys
import threading
from pathlib import Path

import typer

from compare.cli.terminal import err
from mpm.errors import INTERRUPTED, NumericalError, SceneError
from mpm.ranks import started, world

# Open MPI 4 and 5 start more ranks than cores, and root's, only when told to; other MPIs do not read these.
OPEN_MPI = {
    "OMPI_MCA_rmaps_base_oversubscribe": "1",
    "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",
    "OMPI_ALLOW_RUN_AS_ROOT": "1",
    "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
}
LEFT_BY_MPI = ("OMPI_", "PMIX_", "PRTE_", "PMI_")
RULE = "-----"  # starts the lines between which a launcher speaks of itself


def spread(ranks: str, mode: str):
    """Start this command on `ranks` ("all": a rank a core) and exit as it does; return where that is one, or where it
    was. Raises SceneError for what is no number of ranks, an implicit run and where there is no MPI."""
    if started():
        _refuse_implicit(mode)
        return
    count = _cores() if ranks == "all" else int(ranks) if ranks.isdecimal() else 0
    if count < 1:
        raise SceneError(f"--ranks {ranks}: must be a number of MPI ranks, 1 or more, or 'all'")
    if count > 1:
        _refuse_implicit(mode)
        raise typer.Exit(start(count))


def _refuse_implicit(mode: str):
    if mode == "implicit":
        raise SceneError("--ranks: the implicit solver runs on one rank")


def _cores() -> int:
    """Physical cores of this machine, as far as the system tells."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    named = [line.partition(":")[2] for line in lines if line.startswith(("physical id", "core id"))]
    return len(set(zip(named[::2], named[1::2], strict=False))) or os.cpu_count() or 1


def start(ranks: int) -> int:
    """Start this very command on so many ranks and wait; its exit code. Ctrl-C is handed on, so that a checkpoint is
    saved. Raises SceneError where there is no MPI."""
    program = (sys.executable, "-c", "from compare.cli.main import main; main()", *sys.argv[1:])
    process = subprocess.Popen(
        [_launcher(), "-n", str(ranks), *program],
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,  # Ctrl-C reaches this process alone
        env=_environment(),
    )
    told: dict[str, list[str]] = {"ranks": [], "launcher": []}
    reader = threading.Thread(target=_repeat, args=(process.stderr, told))
    reader.start()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: process.send_signal(signal.SIGUSR1))
    code = process.wait()
    reader.join()
    if code and not told["ranks"]:  # nothing ran
        sys.stderr.writelines(told["launcher"])
    if code not in (0, 1, SceneError.exit_code, NumericalError.exit_code, INTERRUPTED):
        err.print(f"a rank was killed (exit code {code}): all have stopped; `resume` goes on from the last checkpoint")
    return code


def _launcher() -> str:
    """What starts ranks of the MPI that mpi4py was built for. Raises SceneError where that is missing."""
    if importlib.util.find_spec("mpi4py") is None:
        raise SceneError("--ranks needs mpi4py and an MPI, which come with dolfinx: see `repose info`")
    beside = Path(sys.executable).with_name("mpiexec")  # a wheel's MPI lies beside Python
    found = str(beside) if beside.is_file() else shutil.which("mpiexec")
    if found is None:
        raise SceneError("--ranks: there is no mpiexec in PATH")
    return found


def _environment() -> dict[str, str]:
    """This process's, for ranks: where MPI ran in a process above this one, without what it left there for its own."""
    kept = dict(os.environ)
    if kept.keys() & {"PMIX_RANK", "OMPI_COMM_WORLD_RANK"}:
        kept = {name: value for name, value in kept.items() if not name.startswith(LEFT_BY_MPI)}
    return kept | {"OMP_NUM_THREADS": "1"} | OPEN_MPI


def _repeat(stream, told):
    """Repeat what ranks say on standard error, without what the launcher says of itself between two rules; both are
    noted in `told`."""
    quoting = False
    for line in stream:
        if line.startswith(RULE):
            quoting = not quoting
            continue
        told["launcher" if quoting else "ranks"].append(line)
        if not quoting:
            sys.stderr.write(line)
            sys.stderr.flush()


def take_part(main):
    """Call `main` on the first of the ranks and let the others serve it."""
    from explicit.ranks import dismiss, serve

    comm = world()
    if comm.rank == 0:
        try:
            main()
        finally:
            dismiss(comm)
        return
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGUSR1):
        signal.signal(number, signal.SIG_IGN)  # the first rank decides
    try:
        serve(comm)
    except BaseException as error:
        print(f"error: rank {comm.rank}: {error or type(error).__name__}", file=sys.stderr, flush=True)
        comm.Abort(1)
