"""How an implicit run ends and goes on: rest, the most steps, an interrupt, a Newton that fails, a scene refused."""

import signal
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
from installed import HAS_IMPLICIT, NO_IMPLICIT

from mpm.body import build
from mpm.errors import NumericalError, SceneError
from mpm.load import load_scene, parse_scene
from mpm.results import Results
from mpm.run import Interrupted

if not HAS_IMPLICIT:
    pytest.skip(NO_IMPLICIT, allow_module_level=True)

from implicit import solver
from implicit._dolfinx import dolfinx
from implicit.newton import NewtonResult
from implicit.pseudo_time import REST_UNBALANCED, Regularisation
from implicit.run import ImplicitRun, resume, run

COARSE = ["grid.cell=0.25", "output.every=0.2"]
FIELDS = ["displacement", "velocity", "stress", "eps_p_eqv", "pressure", "volume", "volume_ratio", "friction_mobilised"]


def column(*settings):
    return load_scene("column_small", [*COARSE, *settings])


class Impatient:
    """A monitor that asks the run to stop, as Ctrl-C does, after the row of step `step`."""

    def __init__(self, step):
        self.step = step

    def start(self, _run):
        pass

    stop = start

    def row(self, _run, row):
        if row["step"] == self.step:
            signal.raise_signal(signal.SIGINT)


def test_a_column_comes_to_rest_with_all_its_outputs(tmp_path):
    summary = run(column(f"output.fields={FIELDS}"), tmp_path)
    results = Results.open(tmp_path)
    assert summary == results.summary()
    assert (summary["mode"], summary["precision"], summary["device"]) == ("implicit", "float64", "cpu")
    assert (summary["scene"], summary["points"], summary["stop_reason"]) == ("column_small", 208, "rest")
    assert summary["unbalanced_ratio"] < 1e-2
    assert 0.2 < summary["R_995"] < 0.6
    assert summary["eq4"] == pytest.approx(0.3074, abs=1e-4)
    assert summary["regularisation"]["drag"] == Regularisation().drag
    assert summary["nodes_stored_max"] > summary["nodes_stored_start"] > 0

    with h5py.File(tmp_path / "vtk" / "background.h5") as file:
        increment = file["Function/increment/0"][()]
        nodes = file["Mesh/mesh/geometry"][()]
    assert 0 < np.abs(increment).max() < 0.25
    assert np.abs(increment[nodes[:, 2] < 1e-9]).max() < 1e-12  # the base is held

    history = results.history()
    assert list(history["step"]) == list(range(summary["steps"] + 1))
    assert history["newton"].sum() == summary["newton_iterations"] > 0
    assert history["failed"].sum() == summary["failed_steps"]
    assert history["time"][-1] == summary["sim_time"]
    assert set(history) == {
        *("time", "step", "dt", "R_max", "R_995", "height", "unbalanced", "newton", "failed", "volume_ratio")
    }

    times = results.times
    assert times[0] == 0.0 and times[-1] == summary["sim_time"]
    assert set(times) <= set(history["time"]) and np.all(np.diff(times) > 0)
    last = results.snapshot(-1)
    assert {*FIELDS, "x"} <= set(last)
    assert all(last[name].dtype == np.float32 and np.isfinite(last[name]).all() for name in FIELDS)
    np.testing.assert_allclose(last["pressure"], -last["stress"][:, :3].mean(axis=1), atol=1.0)
    first = results.snapshot(0)
    np.testing.assert_allclose(first["volume"], 0.125**3, rtol=0.01)
    assert first["pressure"].mean() > 1e3  # it starts under its own weight
    # at rest sqrt(J2)/p = 3^(1/2) (1 - K0)/(1 + 2 K0), K0 = nu/(1 - nu) = 3/7, over eta = sin(phi)
    at_rest = np.sqrt(3.0) * (4 / 7) / (13 / 7) / np.sin(np.radians(37.55))
    np.testing.assert_allclose(first["friction_mobilised"], at_rest, rtol=1e-5)
    assert last["friction_mobilised"].max() == pytest.approx(1.0, abs=1e-3)
    np.testing.assert_allclose(last["volume"], 0.125**3 * last["volume_ratio"], rtol=1e-6)
    assert results.provenance["mode"] == "implicit"
    assert results.provenance["dolfinx"] == dolfinx.__version__


def test_an_interrupted_run_ends_bitwise_as_an_uninterrupted_one(tmp_path):
    scene = column("implicit.max_steps=14")
    strong = Regularisation(ghost=0.5)
    run(scene, tmp_path / "whole", regularisation=strong)
    with pytest.raises(Interrupted, match=r"stopped at t = \S+ s; `repose resume .*cut` goes on"):
        run(scene, tmp_path / "cut", monitor=Impatient(5), regularisation=strong)
    with pytest.raises(Interrupted):
        resume(tmp_path / "cut", monitor=Impatient(9))
    assert resume(tmp_path / "cut")["stop_reason"] == "max_steps"
    assert_same_end(tmp_path)


def test_gravity_added_in_steps_goes_on_bitwise_and_settles_as_the_closed_form_says(tmp_path):
    scene = load_scene("self_weight")
    summary = run(scene, tmp_path / "whole")
    settlement = 2000 * 9.81 * 2.0**2 / (2 * 7.86154e6)
    assert summary["stop_reason"] == "rest" and summary["steps"] > scene.implicit.load_steps == 10
    assert 2.0 - summary["h_inf"] == pytest.approx(settlement, rel=0.01)
    with pytest.raises(Interrupted):
        run(scene, tmp_path / "cut", monitor=Impatient(4))
    with pytest.raises(Interrupted):  # in the steps after it, of which rest is judged
        resume(tmp_path / "cut", monitor=Impatient(12))
    resume(tmp_path / "cut")
    assert_same_end(tmp_path)


def assert_same_end(folder):
    whole, cut = (Results.open(folder / name) for name in ("whole", "cut"))
    assert_same(whole.read_checkpoint(), cut.read_checkpoint())
    assert_same(whole.history(), cut.history())
    assert_same(whole.snapshot(-1), cut.snapshot(-1))
    np.testing.assert_array_equal(whole.times, cut.times)
    own = {"wall_s", "setup_s", "peak_memory_mb", "point_steps_per_s"}
    ends = [{key: value for key, value in each.summary().items() if key not in own} for each in (whole, cut)]
    assert ends[0] == ends[1]


def assert_same(one, other):
    assert set(one) == set(other)
    for name in set(one) - {"wall_before"}:
        assert np.array_equal(one[name], other[name]), name


def test_an_ended_run_is_not_resumed(tmp_path):
    run(column("implicit.max_steps=1"), tmp_path)
    with pytest.raises(SceneError, match=r"this run ended at t = .* s \(max_steps\)"):
        resume(tmp_path)


def test_where_newton_fails_the_last_good_state_is_saved_and_named(tmp_path, monkeypatch):
    fails = []

    def solve(system, *tolerances):
        if len(fails) < 4:
            fails.append(None)
            return real_solve(system, *tolerances)
        return NewtonResult(np.zeros((system.count, 3)), False, 25, 100, [1.0, 1.0])

    real_solve = solver.solve
    monkeypatch.setattr(solver, "solve", solve)
    with pytest.raises(NumericalError) as caught:
        run(column("output.every=100"), tmp_path)
    state = Results.open(tmp_path).read_checkpoint()
    assert state["time"] > 0 and state["steps"] == 4 and state["failed_steps"] > 1
    assert np.isfinite(state["x"]).all() and state["v"].any()
    first, last = str(caught.value).splitlines()
    assert "Newton failed at the smallest step" in first
    assert last == f"last good state: t = {state['time']:.6g} s in {tmp_path / 'checkpoint.h5'}"
    assert list(Results.open(tmp_path).history()["step"]) == [0, 1, 2, 3, 4]
    assert not (tmp_path / "summary.json").exists()
    with pytest.raises(NumericalError, match="Newton failed at the smallest step") as again:  # before it has a row
        resume(tmp_path)
    assert str(again.value).splitlines()[1] == last
    assert list(Results.open(tmp_path).history()["step"]) == [0, 1, 2, 3, 4]


def test_points_that_are_not_finite_are_never_saved(tmp_path):
    class Broken:
        start = stop = lambda *_: None

        def row(self, this, row):
            if row["step"] == 3:
                this.solver.material_points.x.numpy()[7] = np.nan

    with pytest.raises(NumericalError, match=r"step 3: x of point 7 is not finite\nlast good state: t = 0 s"):
        run(column("output.every=100"), tmp_path, monitor=Broken())
    assert np.isfinite(Results.open(tmp_path).read_checkpoint()["x"]).all()


def test_a_folder_in_use_is_refused_and_force_replaces_the_run(tmp_path):
    scene = column("implicit.max_steps=1")
    run(scene, tmp_path)
    with pytest.raises(SceneError, match=r"is not empty: `--force` replaces"):
        run(scene, tmp_path)
    assert run(column("implicit.max_steps=2"), tmp_path, force=True)["steps"] == 2


@pytest.mark.parametrize("device", ["cuda:0", "gpu"])
def test_only_the_cpu_is_taken(tmp_path, device):
    with pytest.raises(SceneError, match=rf"^--device {device}: the implicit solver runs on the CPU$"):
        run(column(), tmp_path / "run", device)
    assert not (tmp_path / "run").exists()
    run(column("implicit.max_steps=1"), tmp_path / "run")
    (tmp_path / "run" / "summary.json").unlink()
    with pytest.raises(SceneError, match="runs on the CPU"):
        resume(tmp_path / "run", device)


def test_a_scene_without_a_quasistatic_reading_is_refused_with_all_its_problems(tmp_path):
    weightless = ["loads.gravity=0", "explicit.until=1.0", "output.history_every=0.1"]
    with pytest.raises(SceneError) as caught:
        run(column("loads.ramp=0.5", *weightless), tmp_path / "run")
    assert [problem.split(" = ")[0] for problem in caught.value.problems] == ["loads.gravity", "loads.ramp"]
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("cell", "softer"),
    [(0.25, 0.20), pytest.param(0.125, 0.04, marks=pytest.mark.slow)],  # averaged volume strains bend too easily
)
def test_a_slender_beam_comes_to_rest_under_its_own_weight(tmp_path, cell, softer):
    """6 x 0.5 x 0.5 m, held at one end, E = 1 GPa, gravity in load steps; sweeps alone do not solve its systems.

    Deflection of a rod at x: q x^2 (6 l^2 - 4 l x + x^2)/(24 E I) of bending and q (l x - x^2/2)/(5/6 G A) of shear.
    """
    length, height, young, poisson, density = 6.0, 0.5, 1e9, 0.3, 2000.0
    table = {
        "name": "beam",
        "geometry": {
            "shape": "box",
            "size": [length, height, height],
            "walls": {"x_min": "fixed", "z_min": "free"},
        },
        "grid": {"cell": cell},
        "material": {"model": "elastic", "young": young, "poisson": poisson, "density": density},
        "loads": {"initial_stress": "none"},
        "output": {"vtk": False},
    }
    summary = run(parse_scene(table), tmp_path / "run")
    assert (summary["stop_reason"], summary["failed_steps"]) == ("rest", 0)
    results = Results.open(tmp_path / "run")
    x0 = results.read_static("x0")
    end = x0[:, 0] > length - 0.5 * cell
    x, sunk = x0[end, 0].mean(), (x0 - results.snapshot(-1)["x"])[end, 2].mean()
    load = density * 9.81 * height**2
    bent = load * x**2 * (6 * length**2 - 4 * length * x + x**2) / (24 * young * height**4 / 12)
    sheared = load * (length * x - x**2 / 2) / (5 / 6 * young / (2 * (1 + poisson)) * height**2)
    assert 1.0 < sunk / (bent + sheared) < 1.0 + softer


def test_progress_is_how_far_the_forces_have_come_to_balance():
    """Half of the way to rest, in logarithms, when 10 of 100 times what rest allows are left."""
    state = SimpleNamespace(unbalanced_ratio=10 * REST_UNBALANCED, steps=5)
    this = ImplicitRun(build(column("implicit.max_steps=1000")), None, state)
    this.most_unbalanced = 100 * REST_UNBALANCED
    assert this.progress == (pytest.approx(0.5), 1.0)
    state.unbalanced_ratio = 0.1 * REST_UNBALANCED  # balanced, but the front still moves
    assert this.progress == (1.0, 1.0)
    state.unbalanced_ratio, state.steps = 10 * REST_UNBALANCED, 800
    assert this.progress == (0.8, 1.0)
