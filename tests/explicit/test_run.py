"""How a run ends: divergence keeps the last good checkpoint, a finished run is not run on."""

from pathlib import Path

import numpy as np
import pytest

from explicit.run import ExplicitRun, resume, run, solver_of
from mpm.body import build
from mpm.errors import NumericalError, SceneError
from mpm.load import load_scene
from mpm.results import Results
from mpm.run import body_of

COARSE = ["grid.cell=0.25", "explicit.until=0.3", "output.every=0.1"]


def started(directory, *settings):
    scene = load_scene("column_1", [*COARSE, *settings])
    place = {"device": "cpu", "device_name": "-"}
    results = Results.create(directory, scene, place)
    body = build(scene)
    part = ExplicitRun(body, results, solver_of(body, "cpu"))
    part.begin()
    return part


def steps_until(part, time):
    while part.solver.time < time:
        part.advance()


def test_a_point_that_is_not_finite_stops_the_run_by_name(tmp_path):
    part = started(tmp_path)
    steps_until(part, 0.15)
    saved = part.results.read_checkpoint()
    v = part.solver.v.numpy()
    v[7] = np.nan
    part.solver.v.assign(v)
    with pytest.raises(NumericalError, match=r"point \d+: its velocity is not finite.*\nlast good state: t = 0\.1 s"):
        part.go(0.0, None)
    after = part.results.read_checkpoint()
    assert np.array_equal(after["x"], saved["x"]) and np.isfinite(after["v"]).all()
    assert resume(tmp_path)["sim_time"] == pytest.approx(0.3)


def test_a_point_that_outruns_the_grid_stops_the_run_by_name(tmp_path):
    part = started(tmp_path)
    steps_until(part, 0.05)
    v = part.solver.v.numpy()
    v[3] = [0.0, 0.0, 1e6]
    part.solver.v.assign(v)
    with pytest.raises(NumericalError, match="crossed more than half a cell in one step"):
        part.go(0.0, None)


def test_growing_energy_stops_the_run_and_keeps_the_checkpoint_before_it(tmp_path):
    """All points thrown upwards in mid-run: kinetic energy that gravity never supplied."""
    part = started(tmp_path)
    steps_until(part, 0.15)
    v = part.solver.v.numpy()
    part.solver.v.assign(v + np.array([0.0, 0.0, 5.0]))
    with pytest.raises(NumericalError, match="exceeds what gravity supplied"):
        part.go(0.0, None)
    assert part.results.read_checkpoint()["clock"][0] == pytest.approx(0.1)


def test_a_refused_time_step_saves_the_state_it_started_from(tmp_path):
    part = started(tmp_path, "explicit.time_step=0.00396")  # h/c = 3.988 ms: too long from |v| = 0.44 m/s on
    with pytest.raises(NumericalError, match="Courant limit"):
        part.go(0.0, None)
    state = part.results.read_checkpoint()
    assert state["clock"][0] > 0.0 and np.isfinite(state["x"]).all()


def test_a_finished_run_is_not_resumed(tmp_path):
    run(load_scene("column_1", COARSE), tmp_path)
    with pytest.raises(SceneError, match=r"ended at t = 0\.3 s \(end_time\)"):
        resume(tmp_path)


def test_elastic_column_at_rest_stops_by_itself(tmp_path):
    """`until = "rest"`: the block settles, and the run says so."""
    summary = run(load_scene("self_weight", ["grid.cell=0.25", "explicit.damping=0.4"]), tmp_path)
    assert summary["stop_reason"] == "rest"
    assert summary["grid_ke_ratio"] < 1e-4 and summary["mass_error"] < 1e-13


def test_rest_does_not_depend_on_how_often_history_is_written(tmp_path):
    ends = []
    for every in ("0.02", "0.2", "0.6"):
        settings = ["grid.cell=0.25", "explicit.damping=0.4", f"output.history_every={every}"]
        ends.append(run(load_scene("self_weight", settings), tmp_path / every))
    assert [end["stop_reason"] for end in ends] == ["rest"] * 3
    assert ends[0]["sim_time"] == pytest.approx(ends[2]["sim_time"], abs=0.1)


def test_rest_is_no_turning_point_of_a_swing(tmp_path):
    """Grid kinetic energy stays under its bound for sqrt(h0/g) before a lightly damped block counts as at rest.

    Its bound: 1e-4 of its peak or, where that is more, 1e-6 of M g h0 = 2000 x 0.125 x 9.81 x 2 J.
    """
    summary = run(load_scene("self_weight", ["output.history_every=0.01"]), tmp_path)
    history = Results.open(tmp_path).history()
    assert summary["stop_reason"] == "rest"
    last = history["time"] >= summary["sim_time"] - np.sqrt(2.0 / 9.81)
    assert last.sum() > 40
    assert history["KE_grid"][last].max() < max(1e-4 * history["KE_grid"].max(), 1e-6 * 2000.0 * 0.125 * 9.81 * 2.0)


def test_a_mesh_run_resumes_without_its_mesh_file(tmp_path):
    mesh = tmp_path / "body.stl"
    mesh.write_bytes((Path(__file__).parents[2] / "meshes" / "cylinder.stl").read_bytes())
    shape = f"geometry={{shape='mesh', file='{mesh}', symmetry='quarter'}}"
    part = started(tmp_path / "run", shape)
    steps_until(part, 0.15)
    mesh.unlink()
    assert resume(tmp_path / "run")["sim_time"] == pytest.approx(0.3)


def test_a_reopened_mesh_run_is_measured_about_the_same_axis(tmp_path):
    mesh = Path(__file__).parents[2] / "meshes" / "cylinder.stl"
    part = started(tmp_path, f"geometry={{shape='mesh', file='{mesh}', offset=[3.0, -2.0, 0.0]}}")
    assert body_of(part.results).measure == part.body.measure
    assert part.body.measure.axis == pytest.approx((3.0, -2.0), abs=1e-3)
    assert part.body.measure.reference == pytest.approx(1.0, abs=2e-3)


def test_a_point_under_the_floor_stops_the_run_by_name(tmp_path):
    part = started(tmp_path)
    steps_until(part, 0.15)
    x = part.solver.x.numpy()
    x[5, 2] = -0.2  # 0.8 cells
    part.solver.x.assign(x)
    part.solver.fit_grid()
    with pytest.raises(NumericalError, match=r"point 5 lies 0\.\d+ cells beyond a wall"):
        part.go(0.0, None)


def test_a_volume_out_of_range_stops_the_run(tmp_path):
    part = started(tmp_path)
    steps_until(part, 0.15)
    part.solver.theta_start -= 0.3  # as if the body had grown by e^0.3 since its start
    with pytest.raises(NumericalError, match=r"volume is 1\.3\d* of the initial one \(0\.7 to 1\.3 allowed\)"):
        part.go(0.0, None)


def test_a_heap_that_stands_is_at_rest_at_once(tmp_path):
    """Sand between rollers, from the geostatic state: rest is seen after the 2 sqrt(h0/g) that it is judged over."""
    walls = "{x_min='roller', x_max='roller', y_min='roller', y_max='roller', z_min='fixed'}"
    sand = ["material.model=drucker_prager", "material.friction_angle=37.55", f"geometry.walls={walls}"]
    settings = [*sand, "geometry.size=[0.5, 0.5, 0.5]", "loads.initial_stress=geostatic"]
    summary = run(load_scene("self_weight", settings), tmp_path)
    assert summary["stop_reason"] == "rest"
    assert summary["sim_time"] == pytest.approx(2.0 * np.sqrt(0.5 / 9.81), rel=0.05)
    assert np.abs(Results.open(tmp_path).snapshot(-1)["x"] - build(load_scene("self_weight", settings)).x).max() < 1e-4


def test_a_body_is_not_at_rest_before_gravity_is_whole(tmp_path):
    """Gravity grows for 1 s, slowly enough for the block to stand still against the energy of its fall."""
    summary = run(load_scene("self_weight", ["loads.ramp=1.0", "grid.cell=0.25"]), tmp_path)
    assert summary["stop_reason"] == "rest" and summary["sim_time"] > 1.0 + 2.0 * np.sqrt(2.0 / 9.81)


def test_without_gravity_the_ledger_is_no_hindrance(tmp_path):
    settings = ["loads.gravity=0.0", "explicit.until=0.01", "output.history_every=0.005"]
    assert run(load_scene("self_weight", settings), tmp_path)["energy_residual"] == 0.0
