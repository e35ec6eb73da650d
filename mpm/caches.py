"""Where Warp, dolfinx and matplotlib keep what they compile or look up once, and word of it when they compile."""

import os
import stat
import sys
import tempfile
from functools import cache
from pathlib import Path

COMPILING = "compiling kernels (once for each version on a machine: 10 to 30 s on a CPU, longer on a GPU)"
SOURCES = (".c", ".cpp", ".cu")  # what compilers are given: dolfinx's forms, Warp's kernels for a CPU and for a GPU


@cache
def prepare_caches():
    """Give Warp, dolfinx and matplotlib a folder that can be written; call it before they look for theirs.

    Where one of theirs cannot be written, or there is no home, all use a folder of this user's in the temporary one,
    and so do the processes that this one starts. One line on stderr says so.
    """
    home = Path(os.path.expanduser("~"))  # "~" as it is for a user without one
    folders = _folders(home)
    at_home = os.access(home, os.R_OK | os.X_OK)
    refused = [folder for folder in folders.values() if not _can_be_written(folder)]
    if at_home and not refused:
        return
    own = _own_temporary_folder()
    os.environ |= {"XDG_CACHE_HOME": str(own), "WARP_CACHE_PATH": str(own / "warp"), "MPLCONFIGDIR": str(own / "mpl")}
    if not at_home:
        os.environ["HOME"] = str(own)  # dolfinx reads a file of options there, and fails where it may not look
    why = f"{refused[0]} cannot be written" if at_home else "there is no home folder that can be read"
    where = f"compiled kernels are kept in {own} (WARP_CACHE_PATH and XDG_CACHE_HOME name another place)"
    print(f"warning: {why}; {where}", file=sys.stderr)


@cache
def announce_compilation():
    """From now on, say on stderr that kernels are being compiled as the first source is handed to a compiler.

    Neither Warp nor dolfinx tell beforehand; that they write a source into their cache is how Python can know.
    """
    prepare_caches()
    folders = _folders(Path(os.path.expanduser("~")))
    caches = tuple(os.path.realpath(folders[name]) + os.sep for name in ("kernels", "forms"))
    said = False

    def hear(event, arguments):
        nonlocal said
        if event != "open" or said:
            return
        path, mode, _ = arguments
        if mode not in ("w", "x") or not isinstance(path, str | os.PathLike) or not str(path).endswith(SOURCES):
            return
        # dolfinx opens a source that is there already to learn just that.
        if os.path.realpath(path).startswith(caches) and not os.path.exists(path):
            said = True
            print(COMPILING, file=sys.stderr, flush=True)

    sys.addaudithook(hear)


def _folders(home: Path) -> dict[str, Path]:
    """Where kernels (Warp), forms (dolfinx) and fonts (matplotlib) go, by the variables that each of them follows."""
    caches = Path(os.environ.get("XDG_CACHE_HOME") or home / ".cache")
    settings = Path(os.environ.get("XDG_CONFIG_HOME") or home / ".config")
    return {
        "kernels": Path(os.environ.get("WARP_CACHE_PATH") or caches / "warp"),
        "forms": caches / "fenics",
        "fonts": Path(os.environ.get("MPLCONFIGDIR") or settings / "matplotlib"),
    }


def _can_be_written(folder: Path) -> bool:
    """Whether files can be made in `folder`, which need not exist yet."""
    # os.path and not Path: it answers for folders under one that may not be looked into, too.
    there = next(path for path in (folder, *folder.absolute().parents) if os.path.exists(path))
    return os.path.isdir(there) and os.access(there, os.W_OK | os.X_OK)


def _own_temporary_folder() -> Path:
    """A folder that only this user can write, the same at each call; another one if somebody else has taken it."""
    own = Path(tempfile.gettempdir()) / f"repose-{os.getuid()}"
    own.mkdir(mode=0o700, exist_ok=True)
    found = own.lstat()
    # Compiled code is loaded from here.
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or stat.S_IMODE(found.st_mode) != 0o700:
        return Path(tempfile.mkdtemp(prefix="repose-"))
    return own
