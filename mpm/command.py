"""The program's commands as the user types them, for messages that name one."""

import os
import shlex


def command(*words) -> str:
    """`repose WORDS`, quoted for a shell; `./repose WORDS` where the script of that name started the program."""
    return shlex.join([os.environ.get("REPOSE_COMMAND", "repose"), *map(str, words)])
