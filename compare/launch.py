"""Programs on several MPI ranks: the launcher that starts them, what it is told, and how they are stopped."""

import importlib.util
import os
import pickle
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from mpm.errors import INTERRUPTED, SceneError
from mpm.ranks import GPUS, started, too_few_gpus

PLAIN_OUTPUT = "REPOSE_PLAIN_OUTPUT"  # set for ranks whose output is no terminal: a launcher may give them one
ONE_THREAD = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")}
# Open MPI 4 and 5 start more ranks than cores, and root's, only when told to. They would bind two runs side by side to
# the same cores, the first ones; and a rank that waits would not let another program have its core, for which the rank
# that it waits for may have to wait: a run on a busy machine was five times slower. Other MPIs do not read these.
OPEN_MPI = {
    "OMPI_MCA_rmaps_base_oversubscribe": "1",
    "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",
    "OMPI_MCA_hwloc_base_binding_policy": "none",
    "PRTE_MCA_hwloc_default_binding_policy": "none",
    "OMPI_MCA_mpi_yield_when_idle": "1",
    "OMPI_ALLOW_RUN_AS_ROOT": "1",
    "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
}
# Ranks on one host need no network, whose search for a way Open MPI 5 comments on where it finds none.
ON_THIS_HOST = {"OMPI_MCA_btl": "^tcp"}
LEFT_BY_MPI = ("OMPI_", "PMIX_", "PRTE_", "PMI_")
RULE = 40 * "-"  # of the lines between which a launcher speaks of itself
STOPPED_EARLY = (128 + signal.SIGUSR1, -signal.SIGUSR1)  # exit codes where Ctrl-C came before anything listened to it


def cores() -> int:
    """Physical cores that this process may use, as far as the system tells."""
    may_use = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set(range(os.cpu_count() or 1))
    try:
        blocks = Path("/proc/cpuinfo").read_text().strip().split("\n\n")
    except OSError:
        return len(may_use)
    fields = [dict(line.partition(":")[::2] for line in block.replace("\t", "").splitlines()) for block in blocks]
    mine = [each for each in fields if each.get("processor", "").strip() in map(str, may_use)]
    known = {(each.get("physical id"), each["core id"]) for each in mine if "core id" in each}
    return len(known) or len(may_use)


def count_of(ranks: int | str, device: str = "cpu") -> int:
    """The number of ranks that "2", 2 or "all" asks for: a rank a core, or a GPU where `device` is "cuda".

    Raises SceneError for anything else.
    """
    if ranks == "all":
        return max(_gpu_count(), 1) if device == GPUS else cores()
    count = int(ranks) if str(ranks).isdecimal() else 0
    if count < 1:
        raise SceneError(f"--ranks {ranks}: must be a number of MPI ranks, 1 or more, or 'all'")
    return count


def may_take_ranks(device: str) -> bool:
    """Whether a run on `device` may take several ranks: on "cpu", and on "cuda", a GPU for each."""
    return device in ("cpu", GPUS)


def refuse_ranks(device: str, here: int = 1):
    """Raises SceneError where `device` is for one rank alone, or has not a GPU for each of those that start `here`, on
    this machine."""
    if not may_take_ranks(device):
        raise SceneError(
            f"--ranks, --device {device}: that is one device, for one rank; --device {GPUS} gives each rank a GPU of "
            "its own"
        )
    if device == GPUS and here > (there := _gpu_count()):
        raise SceneError(too_few_gpus(here, there))


def _gpu_count() -> int:
    from mpm.devices import gpu_count  # here and not above: importing Warp takes most of a second

    return gpu_count()


def refuse_nested(what: str):
    """Raises SceneError where `what`, which starts ranks of its own, was itself started on ranks."""
    if started():
        raise SceneError(f"{what} starts its ranks itself: call it without mpirun; --ranks N says how many")


def start(ranks: int, words: list[str], plain: bool = True, **options) -> subprocess.Popen:
    """The process of the launcher that starts `python WORDS` on so many ranks, or on one that of Python itself.

    `plain`: print no progress bar. `options`: those of Popen. Raises SceneError where there is no MPI.
    """
    env = _environment(options.pop("env", os.environ)) | ({PLAIN_OUTPUT: "1"} if plain else {})
    program = [*((_launcher(), "-n", str(ranks)) if ranks > 1 else ()), sys.executable, *words]
    # In a session of its own: a terminal's Ctrl-C reaches this process alone, which hands it on.
    return subprocess.Popen(program, env=env, start_new_session=True, **options)


def stop(process: subprocess.Popen):
    """Hand Ctrl-C on to the ranks of a launcher, so that a checkpoint is saved."""
    process.send_signal(signal.SIGUSR1)  # of SIGINT it would kill them


@contextmanager
def handing_on(process: subprocess.Popen):
    """Ctrl-C and `kill` of this process stop `process`, as long as it runs."""
    if threading.current_thread() is not threading.main_thread():  # which alone is told of signals
        yield
        return

    def ask(_signal, _frame):
        if process.poll() is None:
            stop(process)

    previous = {number: signal.signal(number, ask) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def exit_code(code: int) -> int:
    """The exit code of what a launcher has started, from the launcher's own."""
    return INTERRUPTED if code in STOPPED_EARLY else code


def call(ranks: int, function: Callable, *arguments) -> Any:
    """`function(*arguments)` on the first of so many ranks, with the others at its service; what it returns.

    What it prints is shown here line by line. All that goes and comes is pickled. Raises what it raises, SceneError
    where there is no MPI, and ChildProcessError where a rank was killed.
    """
    with tempfile.TemporaryDirectory() as folder:
        asked, answer = Path(folder) / "asked", Path(folder) / "answer"
        asked.write_bytes(pickle.dumps((function, arguments)))
        words = ["-P", "-m", "compare.launch", str(asked), str(answer)]
        pipe = subprocess.PIPE
        process = start(ranks, words, stdin=subprocess.DEVNULL, stdout=pipe, stderr=pipe, text=True)
        said = Said(process.stderr)
        with handing_on(process):
            for line in process.stdout:
                print(line.rstrip())
            code = exit_code(process.wait())
        said.join()
        if answer.is_file():
            raised, value = pickle.loads(answer.read_bytes())
            if raised:
                raise value
            return value
    if code == INTERRUPTED:
        raise KeyboardInterrupt
    killed = f"a rank was killed by signal {code - 128}" if code > 128 else ""
    why = killed or " ".join("".join(said.ranks[-1:] or said.launcher).split())
    raise ChildProcessError(f"the ranks ended with exit code {code}: {why}")


class Said(threading.Thread):
    """Repeats what ranks say on standard error, without what the launcher says of itself between two rules.

    `ranks`, `launcher`: lines of either.
    """

    def __init__(self, stream):
        super().__init__(daemon=True)
        self.stream, self.ranks, self.launcher = stream, [], []
        self.start()

    def run(self):
        """Read to the end."""
        for line, is_launchers in sorted_lines(self.stream):
            (self.launcher if is_launchers else self.ranks).append(line)
            if not is_launchers:
                sys.stderr.write(line)
                sys.stderr.flush()


def sorted_lines(lines):
    """Each line with whether the launcher says it, of itself; the rules between which it does are left out."""
    quoting = False
    for line in lines:
        line = line.replace("\0", "")  # Open MPI 5 may send one ahead of the line before an abort
        said, rule, rest = line.partition(RULE)
        if rule and said:  # a rank's line whose end the launcher has overtaken
            yield said + rest.strip("-"), quoting
        if rule:
            quoting = not quoting
        else:
            yield line, quoting


def _launcher() -> str:
    """What starts ranks of the MPI that mpi4py was built for. Raises SceneError where that is missing."""
    if importlib.util.find_spec("mpi4py") is None:
        raise SceneError("--ranks needs mpi4py and an MPI, which come with dolfinx: see `repose info`")
    beside = Path(sys.executable).with_name("mpiexec")  # a wheel's MPI lies beside Python
    found = str(beside) if beside.is_file() else shutil.which("mpiexec")
    if found is None:
        raise SceneError("--ranks: there is no mpiexec in PATH")
    return found


def _environment(env) -> dict[str, str]:
    """`env` for ranks: where MPI ran in a process above this one, without what it left there for its own."""
    if env.keys() & {"PMIX_RANK", "OMPI_COMM_WORLD_RANK"}:
        env = {name: value for name, value in env.items() if not name.startswith(LEFT_BY_MPI)}
    return {**ON_THIS_HOST, **env, **ONE_THREAD, **OPEN_MPI}


def _answer(asked: Path, answer: Path):
    """Call what `asked` holds, and leave what it gives in `answer`."""
    function, arguments = pickle.loads(asked.read_bytes())
    try:
        told = False, function(*arguments)
    except (KeyboardInterrupt, Exception) as error:
        told = True, error
    answer.write_bytes(pickle.dumps(told))


if __name__ == "__main__":
    from compare.cli.ranks import take_part

    take_part(lambda: _answer(*map(Path, sys.argv[1:])))
