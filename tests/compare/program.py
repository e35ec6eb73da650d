"""`repose` called in this process or in one of its own, for the tests of the command line."""

import subprocess
import sys
from typing import NamedTuple

import pytest

from compare.cli import main as cli
from mpm.caches import COMPILING

COARSE = ("column_small", "--set", "grid.cell=0.25")
TINY = (*COARSE, "--set", "explicit.until=0.05", "--set", "output.every=0.02")
PROGRAM = (sys.executable, "-c", "from compare.cli.main import main; main()")


class Answer(NamedTuple):
    code: int
    out: str
    err: str


def call(capsys, *arguments) -> Answer:
    """`repose ARGUMENTS` in this process; any exception but SystemExit would be a traceback for the user."""
    capsys.readouterr()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["repose", *map(str, arguments)])
        with pytest.raises(SystemExit) as end:
            cli.main()
    printed = capsys.readouterr()
    assert "Traceback" not in printed.err + printed.out
    return Answer(end.value.code or 0, printed.out, but_compiling(printed.err))


def but_compiling(err: str) -> str:
    """What was said on stderr but for the line that the first test to need a kernel on this machine brings."""
    return err.replace(f"{COMPILING}\n", "")


HIDE_DOLFINX = """
import sys
class Hide:
    def find_spec(self, name, path=None, target=None):
        if name in ("dolfinx", "ufl"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Hide())
from compare.cli.main import main
main()
"""


def start(*arguments, cwd) -> subprocess.Popen:
    command = [*PROGRAM, *map(str, arguments)]
    return subprocess.Popen(command, cwd=cwd, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
