"""The implicit solver on several MPI ranks: the same system, and the same collapse, as on one."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from installed import HAS_IMPLICIT, HAS_RANKS, NO_IMPLICIT, NO_RANKS

if not HAS_IMPLICIT:
    pytest.skip(NO_IMPLICIT, allow_module_level=True)
if not HAS_RANKS:
    pytest.skip(NO_RANKS, allow_module_level=True)

from system_on_ranks import collapses, fields, settled

from compare import launch
from compare.ensembles import paired, within
from implicit._dolfinx import MPI
from implicit.newton import PRECONDITIONERS
from implicit.ranks import Domain
from mpm.body import build
from mpm.domains import cut_plan, owner_of
from mpm.errors import SceneError
from mpm.gimp import HALF_LENGTH_IN_CELLS
from mpm.results import CHECKPOINT, Results
from mpm.runout import front

PROGRAM = (sys.executable, "-c", "from compare.cli.main import main; main()")
SYSTEM = Path(__file__).with_name("system_on_ranks.py")
LONGEST = 600  # seconds: nothing hangs
QUIET = ("--mode", "implicit", "--set", "output.vtk=false")
COARSE = (*QUIET, "--set", "grid.cell=0.25")
SIX_CELLS = (*QUIET, "--set", f"grid.cell={1 / 6}")


def command(*words, code=0):
    """Run the command line; its standard error."""
    done = subprocess.run([*PROGRAM, *map(str, words)], capture_output=True, text=True, timeout=LONGEST)
    assert done.returncode == code, done.stderr
    return done.stderr


def launched(ranks, *words):
    """Run Python with `words` on so many ranks; exit code and standard error, without what the launcher says itself."""
    process = launch.start(ranks, list(map(str, words)), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    try:
        said = process.communicate(timeout=LONGEST)[1]
    finally:
        process.kill()
    return process.returncode, [
        line for line, is_launchers in launch.sorted_lines(said.splitlines()) if not is_launchers
    ]


@pytest.mark.parametrize(("ranks", "symmetry"), [(2, "quarter"), (3, "quarter"), (2, "full"), (4, "full")])
def test_residual_and_tangent_are_those_of_one_rank(tmp_path, ranks, symmetry):
    """Every regime of the law, all regularisation, a point in the air, cuts through a full column's axis."""
    code, said = launched(ranks, SYSTEM, tmp_path / "found.npz", symmetry)
    assert code == 0, said
    alone = fields(MPI.COMM_SELF, symmetry)
    with np.load(tmp_path / "found.npz") as found:
        np.testing.assert_array_equal(found["place"], alone["place"])
        for name in ("mass", "momentum", "unbalanced", "residual", "product"):
            limit = 1e-12 * np.abs(alone[name]).max()
            np.testing.assert_allclose(found[name], alone[name], rtol=0, atol=limit, err_msg=name)
        for each in (found, alone):  # PETSc may keep what it has worked out of the values before
            np.testing.assert_array_equal(each["sweep"], each["sweep_of_new"])
        assert np.bincount(found["owner"], minlength=ranks).min() > 10
        if symmetry == "full":
            next_to_axis = np.abs(found["place"][:, :2]).max(axis=1) <= 1
            assert len(set(found["owner"][next_to_axis])) == ranks


def test_each_preconditioner_solves_as_on_one_rank(tmp_path):
    """Sweeps in each rank's rows, additive Schwarz with ILU(1), MUMPS: quadratic, to the same balance of forces."""
    code, said = launched(2, SYSTEM, tmp_path / "found.npz", "settled")
    assert code == 0, said
    alone = settled(MPI.COMM_SELF)
    with np.load(tmp_path / "found.npz") as found:
        for kind in PRECONDITIONERS:
            limit = 1e-8 * np.abs(alone["lu"]).max()
            np.testing.assert_allclose(found[kind], alone["lu"], rtol=0, atol=limit, err_msg=kind)


MORE = 0.05  # of Newton's iterations
# Iterations from one start differ by 5 % on ranks: their mean over 30 is then known to 1.8 %, over 60 to 1.3 %.
STARTS = 30


@pytest.fixture(scope="module")
def collapsed(tmp_path_factory):
    """Collapses on one rank."""
    return collapses(str(tmp_path_factory.mktemp("one")), STARTS)


@pytest.mark.parametrize("ranks", [2, *(pytest.param(more, marks=pytest.mark.slow) for more in (3, 4))])
def test_collapses_are_those_of_one_rank(collapsed, tmp_path, found_by_processes, ranks):
    """Newton's counts too, though linear systems are solved to a tenth and sweeps go over the rows of each rank.

    So Newton's way is another one, and a single collapse can take 10 % more or fewer iterations, as one from another
    start can: pairs from many starts are compared. Both ends of the mean's interval are within the limit.
    """
    found = launch.call(ranks, collapses, str(tmp_path), STARTS)
    assert all((each["stop_reason"], each["failed_steps"]) == ("rest", 0) for each in found)
    for name, limit in (("newton_iterations", MORE), ("R_995", 0.015), ("h_inf", 0.005)):
        over = paired([each[name] for each in found], [each[name] for each in collapsed])
        assert within(over, -limit, limit), f"{name}: {over.said('+.2%')}"
    for many, one in zip(found, collapsed, strict=True):
        assert many["nodes_stored_start"] == one["nodes_stored_start"]
    assert all(crossed(Results.open(folder), ranks) > 0 for folder in tmp_path.iterdir())


def crossed(results, ranks) -> int:
    """Points that have ended in the domain of another rank, as the plan was cut first."""
    start, end = domains(results, ranks)
    return int((start != end).sum())


def domains(results, ranks):
    """In whose domain, as the plan was cut first, each point starts and ends."""
    start, end = (
        np.floor(x[:, :2] / results.scene.grid.cell - HALF_LENGTH_IN_CELLS).astype(int)
        for x in (results.read_static("x0"), results.read_checkpoint()["x"])
    )
    cut = cut_plan(*np.unique(start, axis=0, return_counts=True), ranks)
    return owner_of(start, cut), owner_of(end, cut)


def test_load_steps_with_ranks_that_have_no_points(tmp_path):
    """A bar of one row of cells on three ranks settles as the closed form says."""
    row = ("--set", "geometry.size=[0.125, 0.125, 2.0]", "--mode", "implicit")
    command("run", "self_weight", *row, "--out", tmp_path / "run", "--ranks", 3)
    results = Results.open(tmp_path / "run")
    summary = results.summary()
    assert len(set(domains(results, 3)[0])) == 1
    assert summary["stop_reason"] == "rest"
    assert 2.0 - summary["h_inf"] == pytest.approx(2000 * 9.81 * 2.0**2 / (2 * 7.86154e6), rel=0.01)
    assert (tmp_path / "run" / "vtk" / "background.xdmf").is_file()


def test_a_collapse_with_ranks_that_have_no_points(tmp_path):
    """A pillar one cell wide on three ranks, under its own weight from the start."""
    column = ("--set", "geometry={shape='box', size=[0.25, 0.25, 1.0]}", "--set", "implicit.max_steps=3")
    for ranks in (1, 3):
        command("run", "column_small", *COARSE, *column, "--out", tmp_path / str(ranks), "--ranks", ranks)
    one, many = (Results.open(tmp_path / name) for name in ("1", "3"))
    assert len(set(domains(many, 3)[0])) == 1
    assert many.summary()["steps"] == 3
    after_a_step = [results.history()["height"][1] for results in (one, many)]  # the next is as long as Newton lets it
    assert 1.0 - after_a_step[1] == pytest.approx(1.0 - after_a_step[0], rel=0.01)


def test_a_run_that_was_stopped_goes_on_to_the_same_rest_on_another_number_of_ranks(tmp_path):
    command("run", "column_small", *COARSE, "--out", tmp_path / "one")
    folder = tmp_path / "many"
    process = running(folder, 2, COARSE)
    process.send_signal(signal.SIGINT)
    said = process.communicate(timeout=LONGEST)[1]
    assert process.returncode == 130, said
    assert "goes on" in said
    one = Results.open(tmp_path / "one").summary()
    assert 0 < Results.open(folder).read_checkpoint()["steps"] < one["steps"]
    command("resume", folder, "--ranks", 3)
    many = Results.open(folder).summary()
    assert many["stop_reason"] == "rest"
    assert many["R_995"] == pytest.approx(one["R_995"], rel=0.015)


def running(folder, ranks, settings):
    """A collapse on so many ranks, when its first steps are saved."""
    words = ("run", "column_small", *settings, "--set", "output.every=0.05", "--out", folder, "--ranks", ranks)
    process = subprocess.Popen(
        [*PROGRAM, *map(str, words)], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )
    started = time.monotonic()
    while snapshots(folder) < 3:
        assert process.poll() is None, process.stderr.read()
        assert time.monotonic() - started < LONGEST
        time.sleep(0.05)
    return process


def snapshots(folder) -> int:
    try:
        return Results.open(folder).snapshot_count if (folder / CHECKPOINT).is_file() else 0
    except SceneError:  # in the middle of a write
        return 0


def test_a_failure_of_newton_is_told_once_with_the_points_number_in_the_whole_body(tmp_path):
    """Gravity on a cohesionless column that starts without stress: no equilibrium in load steps."""
    coarser = ("--set", "grid.cell=0.5", "--set", "implicit.load_steps=1")
    words = ("run", "column_small", *COARSE, "--set", "loads.initial_stress=none", *coarser, "--out")
    alone, several = (command(*words, tmp_path / str(ranks), "--ranks", ranks, code=3) for ranks in (1, 2))
    for said in (alone, several):
        assert said.count("numerical failure") == 1 and "last good state" in said
    assert near(several) == near(alone)


def near(said: str) -> str:
    """The point that a failure of Newton names."""
    return said.split("largest near ")[1].split(" m;")[0]


def gathered(folder, steps):
    """A run of so many steps: how often it gathers an array of the whole body, and its history's columns."""
    from compare.solvers import runs_of
    from implicit.ranks import RankedSolver
    from mpm.load import load_scene

    ask, orders = RankedSolver.ask, []

    def counting(solver, order, *arguments):
        orders.append(order)
        return ask(solver, order, *arguments)

    RankedSolver.ask = counting
    sections = {"grid": {"cell": 0.25}, "implicit": {"max_steps": steps}, "output": {"every": 1e3, "vtk": False}}
    runs_of("implicit").run(load_scene("column_small", sections=sections), folder)
    return orders.count("gathered"), Results.open(folder).history()


def test_history_rows_gather_nothing_and_say_what_the_points_do(tmp_path, found_by_processes):
    """Snapshots and checkpoints gather: the body need not fit one machine for more than those."""
    few, many = (launch.call(2, gathered, tmp_path / str(steps), steps) for steps in (2, 8))
    assert few[0] == many[0]
    results, last = Results.open(tmp_path / "8"), {name: column[-1] for name, column in many[1].items()}
    state = results.read_checkpoint()
    assert (len(many[1]["step"]), last["step"]) == (9, 8)
    body = build(results.scene)
    for name, value in front(state["x"], body.measure).items():
        assert last[name] == pytest.approx(value, rel=1e-12), name
    assert last["volume_ratio"] == pytest.approx(state["jacobian"].mean(), rel=1e-12)


@pytest.mark.parametrize("rank", [0, 1])
def test_a_number_that_is_none_is_told_once_with_its_points_number_in_the_body(tmp_path, rank):
    program = f"""
import sys
from implicit import ranks
solved = ranks.{Domain.__name__}._accept
def spoiling(self, u):
    solved(self, u)
    if self.comm.rank == {rank} and self.steps == 2:
        print("spoilt:", self.ids[7], flush=True, file=sys.stderr)
        self.material_points.mean.numpy()[7] = float("nan")
ranks.{Domain.__name__}._accept = spoiling
from compare.cli.main import main
main()
"""
    code, said = launched(2, "-c", program, "run", "column_small", *COARSE, "--out", tmp_path / "run")
    assert code == 3, said
    (spoilt,) = (int(line.split()[1]) for line in said if line.startswith("spoilt:"))
    (failure,) = (line for line in said if "numerical failure" in line)
    assert f"mean of point {spoilt} is not finite" in failure
    assert Results.open(tmp_path / "run").read_checkpoint()["steps"] < 3


@pytest.mark.parametrize("rank", [0, 1])
def test_an_error_of_one_rank_ends_all(tmp_path, rank):
    """A program whose solver breaks on one rank in the third step, while the other waits for it."""
    program = f"""
from implicit import ranks
solved = ranks.{Domain.__name__}._accept
def broken(self, u):
    if self.comm.rank == {rank} and self.steps == 2:
        raise OSError("the disk of this rank is full")
    solved(self, u)
ranks.{Domain.__name__}._accept = broken
from compare.cli.main import main
main()
"""
    code, said = launched(2, "-c", program, "run", "column_small", *COARSE, "--out", tmp_path / "run")
    assert code not in (0, 2, 3)
    assert said.count(f"error: rank {rank}: the disk of this rank is full") == 1
    assert np.isfinite(Results.open(tmp_path / "run").read_checkpoint()["x"]).all()


def test_a_killed_rank_ends_all_and_the_checkpoint_is_whole(tmp_path, ranks_below):
    folder = tmp_path / "run"
    process = running(folder, 2, SIX_CELLS)
    os.kill(ranks_below(process.pid)[-1], signal.SIGKILL)
    said = process.communicate(timeout=LONGEST)[1]
    assert process.returncode != 0
    assert "a rank was killed" in said and "resume" in said
    assert np.isfinite(Results.open(folder).read_checkpoint()["x"]).all()
