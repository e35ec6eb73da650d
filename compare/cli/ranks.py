"""The command line on several MPI ranks: how it starts them, and what each of them does then."""

import signal
import subprocess
import sys

import typer

from compare.cli.terminal import err
from compare.launch import Said, cores, count_of, exit_code, handing_on, refuse_nested, refuse_ranks, start
from mpm.errors import INTERRUPTED, NumericalError, SceneError
from mpm.ranks import started, world


def spread(ranks: str, device: str):
    """Start this command on `ranks` (see `compare.launch.count_of`) and exit as it does; return where that is one, or
    where it was. Raises SceneError for what is no number of ranks, what takes one rank alone and where there is no
    MPI."""
    if started():
        refuse_ranks(device)
        return
    count = count_of(ranks, device)
    if count > 1:
        refuse_ranks(device, count)
        raise typer.Exit(_start(count))


def runs_at_a_time(jobs: int | None, ranks: int, usual: int = 1) -> int:
    """How many runs of a study go at a time: `jobs`; where that is None, `usual`, or as many as the cores hold.

    A warning says where those asked for take more cores than there are. Raises SceneError in a study on ranks.
    """
    refuse_nested("a study or comparison")
    runs = jobs or max(1, min(usual, cores() // ranks))
    if runs * ranks > cores():
        each = f"on {ranks} ranks each " if ranks > 1 else ""
        err.print(
            f"warning: {runs} runs at a time {each}take {runs * ranks} cores, and there are {cores()}: they slow each "
            "other down, and their times say little",
            style="yellow",
        )
    return runs


def _start(ranks: int) -> int:
    """Start this very command on so many ranks and wait; its exit code."""
    words = ["-c", "from compare.cli.main import main; main()", *sys.argv[1:]]
    process = start(ranks, words, plain=not sys.stdout.isatty(), stderr=subprocess.PIPE, text=True)
    said = Said(process.stderr)
    with handing_on(process):
        code = exit_code(process.wait())
        said.join()
    if code and not said.ranks and code != INTERRUPTED:  # nothing ran
        sys.stderr.writelines(said.launcher)
    if code not in (0, 1, SceneError.exit_code, NumericalError.exit_code, INTERRUPTED):
        err.print(f"a rank was killed (exit code {code}): all have stopped; `resume` goes on from the last checkpoint")
    return code


def take_part(main):
    """Call `main`; where the program was started on several ranks, on the first of them, with the others at its
    service."""
    if (comm := world()) is None:
        return main()
    from mpm.parts import abort, dismiss, serve

    if comm.rank == 0:
        signal.signal(signal.SIGUSR1, signal.default_int_handler)  # Ctrl-C, as the launcher hands it on
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
        abort(comm, error)
