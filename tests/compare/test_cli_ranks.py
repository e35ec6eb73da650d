"""`--ranks` and `--jobs` on the command line, and what a banner says of cores that have nothing to do."""

from types import SimpleNamespace

import pytest
from typer.testing import CliRunner

import repose
from compare import launch
from compare.batch import Workers
from compare.cli import main, ranks, terminal
from mpm.errors import SceneError


@pytest.fixture
def four_cores(monkeypatch):
    for module in (ranks, terminal):
        monkeypatch.setattr(module, "cores", lambda: 4)


class Reached(Exception):
    pass


def stand_in(*its):
    """Stands for what computes a report: says how many ranks it was to take."""
    raise Reached(its[-1])


@pytest.fixture
def reached(monkeypatch):
    """`reached(study, *arguments)`: what the program hands to the function `study` last."""

    def call(study, *arguments):
        monkeypatch.setattr(study, stand_in)
        answer = CliRunner().invoke(main.app, [*arguments])
        assert isinstance(answer.exception, Reached), answer.output
        return answer.exception.args[0]

    return call


@pytest.mark.parametrize(
    ("jobs", "count", "usual", "runs", "warned"),
    [
        (None, 1, 1, 1, ""),
        (None, 1, 2, 2, ""),
        (None, 3, 2, 1, ""),  # two times three cores: the usual two runs at a time do not fit
        (None, 8, 1, 1, "1 runs at a time on 8 ranks each take 8 cores, and there are 4"),
        (2, 2, 1, 2, ""),
        (3, 2, 1, 3, "3 runs at a time on 2 ranks each take 6 cores, and there are 4"),
        (5, 1, 2, 5, "5 runs at a time take 5 cores, and there are 4"),
    ],
)
def test_runs_at_a_time_take_no_more_cores_than_there_are_unless_they_are_asked_for(
    four_cores, capsys, jobs, count, usual, runs, warned
):
    assert ranks.runs_at_a_time(jobs, count, usual) == runs
    said = capsys.readouterr().err
    assert warned in said and bool(said) == bool(warned)


def test_a_study_on_ranks_is_refused(monkeypatch):
    monkeypatch.setenv("PMI_SIZE", "2")
    with pytest.raises(SceneError, match="without mpirun"):
        ranks.runs_at_a_time(None, 1)


@pytest.mark.parametrize(
    ("arguments", "module", "passed"),
    [
        (("compare", "column_small"), "compare.comparison.compare_solvers", 2),
        (("study", "error", "column_small", "--jobs", "2"), "compare.studies.error.study_error", Workers(2, 2)),
        (("study", "paper"), "compare.studies.paper.study.study_paper", Workers(2, 2)),
    ],
)
def test_studies_and_comparisons_hand_ranks_on(reached, four_cores, tmp_path, arguments, module, passed):
    assert reached(module, *arguments, "--ranks", "2", "--out", str(tmp_path / "out")) == passed


@pytest.mark.parametrize(
    ("arguments", "module"),
    [
        (("compare", "column_small"), "compare.comparison.compare_solvers"),
        (("study", "error", "column_small"), "compare.studies.error.study_error"),
        (("study", "paper"), "compare.studies.paper.study.study_paper"),
        (("study", "damping", "column_small", "--target", "eq4"), "compare.studies.damping.study_damping"),
    ],
)
def test_all_ranks_of_a_study_on_gpus_are_as_many_as_there_are_gpus(
    reached, four_cores, monkeypatch, tmp_path, arguments, module
):
    monkeypatch.setattr(launch, "cores", lambda: 4)
    monkeypatch.setattr(launch, "_gpu_count", lambda: 3)
    for device, count in (("cuda", 3), ("cpu", 4)):
        passed = reached(module, *arguments, "--ranks", "all", "--device", device, "--out", str(tmp_path / "out"))
        assert getattr(passed, "ranks", passed) == count


def test_all_ranks_of_a_comparison_in_python_are_as_many_as_there_are_gpus(monkeypatch, tmp_path):
    monkeypatch.setattr("compare.comparison.compare_solvers", stand_in)
    monkeypatch.setattr(launch, "cores", lambda: 4)
    monkeypatch.setattr(launch, "_gpu_count", lambda: 3)
    with pytest.raises(Reached, match="3"):
        repose.compare("column_small", tmp_path / "out", device="cuda", ranks="all")


def test_a_large_run_on_one_core_is_told_of_the_others(four_cores, monkeypatch):
    def run(mode="explicit", device="cpu", points=25_120):
        return SimpleNamespace(mode=mode, device=device, solver=SimpleNamespace(points=points))

    assert terminal.idle_cores(run()) == "this takes one of 4 cores; --ranks 4 (or all) takes all of them"
    assert terminal.idle_cores(run(points=3_160)) == ""
    assert terminal.idle_cores(run(device="cuda:0")) == ""
    monkeypatch.setattr(terminal, "cores", lambda: 1)
    assert terminal.idle_cores(run()) == ""
    monkeypatch.setattr(terminal, "cores", lambda: 4)
    monkeypatch.setenv("OMPI_COMM_WORLD_SIZE", "2")
    assert terminal.idle_cores(run()) == ""
