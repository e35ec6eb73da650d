"""The CUDA path: same physics as the CPU, step graphs included. Skipped, with the reason, without a GPU."""

import numpy as np
import pytest
import warp as wp
from installed import needs_ranks

from compare.launch import call
from explicit.run import run
from explicit.solver import ExplicitSolver
from mpm.body import build
from mpm.devices import start_warp
from mpm.load import load_scene
from mpm.results import Results
from mpm.watch import look

start_warp()
pytestmark = [
    pytest.mark.gpu,
    pytest.mark.skipif(wp.get_cuda_device_count() == 0, reason="no CUDA device on this machine"),
]


@pytest.mark.parametrize(("precision", "tolerance"), [("float64", 1e-9), ("float32", 2e-4)])
def test_gpu_follows_the_cpu(solver_of, run_to, precision, tolerance):
    """Positions after 0.15 s: only the order of sums differs."""
    settings = ("grid.cell=0.125", f"explicit.precision={precision}")
    solvers = [solver_of("column_1", *settings, device=device) for device in ("cpu", "cuda:0")]
    for solver in solvers:
        list(run_to(solver, 0.15))
    assert solvers[0].steps == solvers[1].steps
    assert np.abs(solvers[0].x.numpy() - solvers[1].x.numpy()).max() < tolerance
    energies = [solver.energies() for solver in solvers]
    for name, value in energies[0].items():
        assert energies[1][name] == pytest.approx(value, rel=1e3 * tolerance, abs=1e-3), name


def test_gpu_smooths_ripples_as_the_cpu_does(solver_of):
    """K is 500 G: the GPU takes the step as phases."""
    settings = ("grid.cell=0.125", "material.cohesion=2000.0", "material.poisson=0.499")
    one, other = (solver_of("column_small", *settings, device=device) for device in ("cpu", "cuda:0"))
    for solver in (one, other):
        solver.advance_to(0.02)
    assert one.steps == other.steps
    assert np.abs(one.x.numpy() - other.x.numpy()).max() < 1e-12
    np.testing.assert_allclose(other.theta.numpy(), one.theta.numpy(), rtol=0, atol=1e-9)


def test_the_stored_nodes_follow_and_rows_are_written_without_the_host(solver_of):
    """Over many fits, with batches as in a run; rows say what NumPy finds of the same points."""
    solver = solver_of("column_1", "grid.cell=0.125", "explicit.damping=0.05", device="cuda:0")
    solver.set_target(10.0)
    while solver.time < 0.6:
        solver.advance(solver.time + 0.02)
        seen, right = solver.observe()[1], look(solver.x.numpy(), solver.volume_ratio, solver.body)
        assert seen.front == pytest.approx(right.front, rel=1e-12)
        assert seen.volume_ratio == pytest.approx(right.volume_ratio, rel=1e-12)
        assert (seen.beyond.cells, seen.beyond.point) == (right.beyond.cells, right.beyond.point)
    assert solver.grid_mass() == pytest.approx(solver.points * solver.body.point_mass, rel=1e-12)
    assert solver.nodes_stored_max > 1.2 * solver.nodes_stored_start


def on_ranks(settings):
    """A column at 0.15 s on the ranks of this program, all on the first GPU: steps, positions, energies, mass."""
    from explicit.ranks import RankedSolver
    from mpm.ranks import world

    solver = RankedSolver(build(load_scene("column_1", list(settings))), "cuda:0", world())
    solver.advance_to(0.15)
    return solver.steps, solver.x.numpy(), solver.energies(), solver.grid_mass()


@needs_ranks
@pytest.mark.parametrize(("precision", "tolerance"), [("float64", 1e-9), ("float32", 2e-4)])
def test_two_ranks_on_one_gpu_are_one_rank_on_it(solver_of, found_by_processes, precision, tolerance):
    """A user's ranks take a GPU each; what they pack, carry and add is the same where they share one."""
    settings = ("grid.cell=0.125", f"explicit.precision={precision}")
    alone = solver_of("column_1", *settings, device="cuda:0")
    alone.advance_to(0.15)
    steps, x, energies, mass = call(2, on_ranks, settings)
    assert steps == alone.steps
    assert np.abs(x - alone.x.numpy()).max() < tolerance
    for name, value in alone.energies().items():
        assert energies[name] == pytest.approx(value, rel=1e3 * tolerance, abs=1e-3), name
    assert mass == pytest.approx(alone.grid_mass(), rel=1e-3 * tolerance if precision == "float64" else 1e-6)


def test_gpu_run_ends_like_the_cpu_run(tmp_path):
    scene = load_scene("column_1", ["grid.cell=0.125", "explicit.damping=0.4", "explicit.until=1.5"])
    summaries = [run(scene, tmp_path / device[:4], device) for device in ("cpu", "cuda:0")]
    assert summaries[1]["R_995"] == pytest.approx(summaries[0]["R_995"], rel=0.01)
    assert summaries[1]["mass_error"] < 1e-12


def test_run_started_on_the_gpu_goes_on_on_the_cpu(tmp_path):
    scene = load_scene("column_1", ["grid.cell=0.25", "explicit.until=0.3"])
    run(scene, tmp_path, "cuda:0")
    before = Results.open(tmp_path).read_checkpoint()
    solver = ExplicitSolver(build(scene), "cpu")
    solver.restore(before)
    assert solver.time == pytest.approx(0.3)
    assert solver.energies()["W_ext"] == pytest.approx(before["ledger"].sum(axis=1)[0])
