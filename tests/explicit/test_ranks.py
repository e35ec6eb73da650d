"""The explicit solver on several MPI ranks: the same run as on one, and what ends one rank ends all."""

import os
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from installed import HAS_RANKS, NO_RANKS

import repose
from compare.launch import call, start
from mpm.devices import gpu_count
from mpm.results import CHECKPOINT, Results

if not HAS_RANKS:
    pytest.skip(NO_RANKS, allow_module_level=True)

PROGRAM = (sys.executable, "-c", "from compare.cli.main import main; main()")
LONGEST = 120  # seconds: nothing hangs
SHORT = ("--set", "explicit.until=0.3", "--set", "output.every=0.1", "--set", "output.vtk=false")


def command(*words, code=0):
    """Run the command line; its standard error."""
    done = subprocess.run([*PROGRAM, *map(str, words)], capture_output=True, text=True, timeout=LONGEST)
    assert done.returncode == code, done.stderr
    return done.stderr


def state(folder):
    return Results.open(folder).read_checkpoint()


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    folder = tmp_path_factory.mktemp("alone") / "run"
    command("run", "column_small", *SHORT, "--out", folder)
    return folder


@pytest.mark.parametrize("ranks", [2, 3, 4])
def test_a_run_on_several_ranks_is_the_run_on_one(alone, tmp_path, ranks):
    """Points cross the cuts, which a quarter column has along its axis: positions to round-off, sums as well."""
    command("run", "column_small", *SHORT, "--out", tmp_path / "run", "--ranks", ranks)
    one, many = state(alone), state(tmp_path / "run")
    np.testing.assert_allclose(many["x"], one["x"], rtol=0, atol=1e-12)
    np.testing.assert_allclose(many["tau"], one["tau"], rtol=0, atol=1e-6 * np.abs(one["tau"]).max())
    a, b = (Results.open(folder).history() for folder in (alone, tmp_path / "run"))
    for name in ("W_ext", "W_damping", "W_plastic", "KE_grid", "KE_points", "E_elastic", "R_995", "volume_ratio"):
        np.testing.assert_allclose(b[name], a[name], rtol=1e-9, atol=1e-9 * a["W_ext"][-1], err_msg=name)
    assert Results.open(tmp_path / "run").summary()["mass_error"] < 1e-12


def test_volume_is_counted_from_a_stressed_start_whatever_ranks_points_go_to(tmp_path):
    settings = (*SHORT, "--set", "loads.initial_stress=geostatic")
    for ranks in (1, 3):
        command("run", "column_small", *settings, "--out", tmp_path / str(ranks), "--ranks", ranks)
    one, three = (Results.open(tmp_path / name).history()["volume_ratio"] for name in ("1", "3"))
    assert one[0] == three[0] == 1.0
    np.testing.assert_allclose(three, one, rtol=1e-9)


def test_the_same_ranks_give_the_same_bits(tmp_path):
    for name in ("first", "second"):
        command("run", "column_small", *SHORT, "--out", tmp_path / name, "--ranks", 3)
    one, other = state(tmp_path / "first"), state(tmp_path / "second")
    for name in ("x", "v", "tau", "theta", "ledger"):
        np.testing.assert_array_equal(one[name], other[name])


def test_ranks_without_points_and_walls_on_every_side(tmp_path):
    """A bar two cells wide has fewer pencils than four ranks can share."""
    for name, ranks in (("one", 1), ("four", 4)):
        settings = ("--set", "explicit.until=0.05", "--set", "grid.cell=0.1", "--set", "output.vtk=false")
        command("run", "elastic_bar", *settings, "--out", tmp_path / name, "--ranks", ranks)
    np.testing.assert_allclose(state(tmp_path / "four")["x"], state(tmp_path / "one")["x"], rtol=0, atol=1e-12)


def test_ctrl_c_saves_a_checkpoint_from_which_any_number_of_ranks_goes_on(alone, tmp_path):
    folder = tmp_path / "run"
    process = running(folder, 2)
    process.send_signal(signal.SIGINT)
    said = process.communicate(timeout=LONGEST)[1]
    assert process.returncode == 130, said
    assert "goes on" in said and "-----" not in said
    reached = float(state(folder)["clock"][0])
    assert 0.05 < reached < 6.0

    # The rest of a short run on three ranks, from there: as one rank would have it.
    one, three = tmp_path / "one", tmp_path / "three"
    for target, ranks in ((one, 1), (three, 3)):
        shutil.copytree(folder, target)
        process = subprocess.Popen([*PROGRAM, "resume", str(target), "--ranks", str(ranks)], stdout=subprocess.DEVNULL)
        wait_for(lambda target=target: float(state(target)["clock"][0]) > reached, process)
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=LONGEST) == 130
    a, b = (Results.open(target).history() for target in (one, three))
    common = min(len(a["time"]), len(b["time"]))
    np.testing.assert_allclose(a["R_995"][:common], b["R_995"][:common], rtol=0, atol=1e-9)


def test_a_killed_rank_ends_all_and_the_checkpoint_is_whole(tmp_path, ranks_below):
    folder = tmp_path / "run"
    process = running(folder, 3)
    os.kill(ranks_below(process.pid)[-1], signal.SIGKILL)
    said = process.communicate(timeout=LONGEST)[1]
    assert process.returncode != 0
    assert "a rank was killed" in said and "resume" in said
    assert np.isfinite(state(folder)["x"]).all()


def test_a_divergence_is_told_once_with_the_points_number_in_the_whole_body(tmp_path):
    settings = (
        "--set",
        "explicit.time_step=0.00099",
        "--set",
        "material.cohesion=0.0",
        "--set",
        "loads.gravity=2000.0",
    )
    said = command("run", "column_small", *settings, "--out", tmp_path / "run", "--ranks", 2, code=3)
    assert said.count("numerical failure") == 1
    assert "last good state" in said


def test_bad_input_is_told_once(tmp_path):
    assert command("run", "column_small", "--set", "grid.cell=-1", "--ranks", 2, code=2).count("error:") == 1
    for ranks in ("0", "two", "-1"):
        assert "must be a number" in command("run", "column_small", "--ranks", ranks, code=2)


def test_more_ranks_than_gpus_and_ranks_on_one_are_refused(tmp_path):
    """Before any rank is started; under a launcher by the ranks, once, and nothing is written."""
    words = ("run", "column_small", "--out", tmp_path / "run")
    said = command(*words, "--ranks", 99, "--device", "cuda", code=2)
    assert said.startswith("error: --device cuda: each of 99 ranks takes a GPU of its own, and this machine has ")
    assert "that is one device, for one rank" in command(*words, "--ranks", 2, "--device", "cuda:0", code=2)
    process = start(
        gpu_count() + 2, [*PROGRAM[1:], *map(str, words), "--device", "cuda"], stderr=subprocess.PIPE, text=True
    )
    said = process.communicate(timeout=LONGEST)[1]
    assert (process.returncode, said.count("error: ")) == (2, 1), said
    assert not (tmp_path / "run").exists()


def times_gathered(folder, history_every):
    """How often a run gathers an array of the whole body, and its history rows."""
    from compare.solvers import runs_of
    from explicit.ranks import RankedSolver
    from mpm.load import load_scene

    ask, gathered = RankedSolver.ask, []

    def counting(solver, order, *arguments):
        gathered.append(order == "gathered")
        return ask(solver, order, *arguments)

    RankedSolver.ask = counting
    output = {"every": 0.1, "history_every": history_every, "vtk": False}
    scene = load_scene("column_small", sections={"explicit": {"until": 0.1}, "output": output})
    runs_of("explicit").run(scene, folder)
    return sum(gathered), len(Results.open(folder).history()["time"])


def test_history_rows_gather_nothing(tmp_path, found_by_processes):
    """Snapshots and checkpoints do: the body need not fit one machine for more than those."""
    few, many = (call(2, times_gathered, tmp_path / str(every), every) for every in (0.05, 0.005))
    assert few[1] < 5 < 15 < many[1]
    assert few[0] == many[0]


def two_at_a_time():
    """Positions of two bodies on the ranks of this program, stepped in turn, each at its time."""
    from explicit.ranks import RankedSolver
    from mpm.body import build
    from mpm.load import load_scene
    from mpm.ranks import world

    bodies = (build(load_scene("column_small", ["grid.cell=0.25", f"explicit.damping={d}"])) for d in (0.0, 0.4))
    solvers = [RankedSolver(body, "cpu", world()) for body in bodies]
    for time_ in (0.1, 0.2):
        for solver in solvers:
            solver.advance_to(time_)
    return [solver.x.numpy() for solver in solvers]


def test_ranks_know_the_parts_of_several_bodies(found_by_processes, solver_of):
    for damping, x in zip((0.0, 0.4), call(2, two_at_a_time), strict=True):
        alone = solver_of("column_small", "grid.cell=0.25", f"explicit.damping={damping}")
        for time_ in (0.1, 0.2):
            alone.advance_to(time_)
        np.testing.assert_allclose(x, alone.x.numpy(), rtol=0, atol=1e-12)


def running(folder, ranks):
    """A run of 6 s on so many ranks, when it has written three snapshots."""
    settings = ("--set", "explicit.until=6.0", "--set", "output.every=0.05", "--set", "output.vtk=false")
    process = subprocess.Popen(
        [*PROGRAM, "run", "column_small", *settings, "--out", str(folder), "--ranks", str(ranks)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    wait_for(lambda: snapshots(folder) > 2, process)
    return process


def snapshots(folder) -> int:
    try:
        return Results.open(folder).snapshot_count if (folder / CHECKPOINT).is_file() else 0
    except repose.SceneError:  # in the middle of a write
        return 0


def wait_for(happened, process):
    started = time.monotonic()
    while not happened():
        assert process.poll() is None, process.stderr and process.stderr.read()
        assert time.monotonic() - started < LONGEST
        time.sleep(0.05)
