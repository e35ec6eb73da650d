"""The command line as fixtures: called in an empty folder, and where it must refuse."""

import pytest
from program import call


@pytest.fixture
def repose(capsys, tmp_path, monkeypatch):
    """Calls the program in an empty folder."""
    monkeypatch.chdir(tmp_path)
    return lambda *arguments: call(capsys, *arguments)


@pytest.fixture
def refused(repose):
    """Calls the program, which must refuse: its message, of whole lines that start with "error: "."""

    def refuse(*arguments) -> str:
        answer = repose(*arguments)
        assert answer.code == 2
        assert answer.out == ""
        assert all(line.startswith("error: ") for line in answer.err.splitlines())
        return answer.err

    return refuse
