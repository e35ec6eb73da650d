"""The Python face: what a script or a notebook calls."""

import os
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from installed import needs_implicit, needs_ranks
from matplotlib.figure import Figure

import repose
from mpm.load import preset_names, to_toml

COARSE = {"grid": {"cell": 0.25}, "explicit": {"damping": 0.4, "until": 0.4}, "output": {"every": 0.1}}


@pytest.fixture(scope="module")
def result():
    return repose.run(repose.load_scene("column_small", **COARSE), progress=False)


def test_sections_change_single_keys_of_a_preset():
    scene = repose.load_scene("column_small", **COARSE)
    assert (scene.grid.cell, scene.explicit.damping, scene.explicit.cfl) == (0.25, 0.4, 0.5)
    assert scene.geometry == repose.load_scene("column_small").geometry


def test_every_problem_of_a_scene_is_told_at_once():
    with pytest.raises(repose.SceneError) as error:
        repose.load_scene("column_small", grid={"cell": -1}, material={"poisson": 0.7}, explicit={"dampening": 0.1})
    assert len(error.value.problems) == 3
    assert "did you mean 'damping'?" in str(error.value)


def test_results_are_arrays_and_figures(result):
    assert result.summary["stop_reason"] == "end_time"
    np.testing.assert_allclose(result.times, [0.0, 0.1, 0.2, 0.3, 0.4])
    assert result.history["time"][-1] == pytest.approx(0.4)
    assert result.points.shape == (len(repose.Solver(result.scene).x), 3)
    np.testing.assert_array_equal(result.points, result.snapshot(4)["x"])
    assert result.snapshot(0)["stress"].shape == (len(result.points), 6)
    for figure in (result.plot_profile(), result.plot_morphology(), result.plot_history()):
        assert isinstance(figure, Figure) and figure.axes
    assert "R_995" in repr(result)


def test_a_run_without_a_folder_leaves_nothing_behind():
    short = repose.load_scene("column_small", grid={"cell": 0.25}, explicit={"until": 0.01})
    result = repose.run(short, progress=False)
    folder = result.directory
    assert (folder / "results.h5").is_file()
    del result
    assert not folder.exists()


def test_a_cell_can_be_run_again_and_another_scene_is_not_overwritten(tmp_path, capsys):
    scene = repose.load_scene("column_small", grid={"cell": 0.25}, explicit={"until": 0.01})
    first = repose.run(scene, tmp_path / "run", progress=False)
    written = (first.directory / "results.h5").stat().st_mtime_ns
    again = repose.run(scene, tmp_path / "run")
    assert (again.directory / "results.h5").stat().st_mtime_ns == written
    assert capsys.readouterr().out == ""  # no banner, and nothing to wait for
    other = repose.load_scene("column_small", grid={"cell": 0.25}, explicit={"until": 0.02})
    with pytest.raises(repose.SceneError, match="not empty"):
        repose.run(other, tmp_path / "run", progress=False)
    assert repose.run(other, tmp_path / "run", force=True, progress=False).summary["sim_time"] == pytest.approx(0.02)


def test_another_mesh_under_the_same_name_is_another_scene(tmp_path):
    def block(height):
        x = [f"v {i} {j} {k * height}" for k in (0, 1) for j in (0, 1) for i in (0, 1)]
        return "\n".join([*x, "f 1 3 4 2", "f 5 6 8 7", "f 1 2 6 5", "f 2 4 8 6", "f 4 3 7 8", "f 3 1 5 7"])

    mesh, scene = tmp_path / "body.obj", tmp_path / "scene.toml"
    scene.write_text(
        'name = "m"\n[geometry]\nshape = "mesh"\nfile = "body.obj"\n[grid]\ncell = 0.25\n[explicit]\nuntil = 0.01\n'
        "[material]\nyoung = 1e6\npoisson = 0.3\ndensity = 2000.0\nfriction_angle = 30.0\n"
    )
    mesh.write_text(block(1.0))
    assert repose.run(scene, tmp_path / "run", progress=False).summary["points"] == 512
    assert repose.run(scene, tmp_path / "run", progress=False).summary["points"] == 512
    mesh.write_text(block(0.5))
    with pytest.raises(repose.SceneError, match="not empty"):
        repose.run(scene, tmp_path / "run", progress=False)
    assert repose.run(scene, tmp_path / "run", force=True, progress=False).summary["points"] == 256


@needs_ranks
def test_ranks_compute_the_same_run(result):
    many = repose.run(result.scene, ranks=2, progress=False)
    assert many.summary["ranks"] == 2 and result.summary["ranks"] == 1
    np.testing.assert_allclose(many.points, result.points, rtol=0, atol=1e-6)  # snapshots are in single precision
    assert many.history.keys() == result.history.keys()
    assert {path.name for path in many.directory.iterdir()} == {path.name for path in result.directory.iterdir()}


@needs_ranks
def test_what_ends_a_run_on_ranks_badly_is_raised_here(tmp_path):
    tiny = repose.load_scene("column_small", grid={"cell": 0.25}, explicit={"until": 0.01})
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "file").touch()
    with pytest.raises(repose.SceneError, match="not empty"):
        repose.run(tiny, tmp_path / "taken", ranks=2)
    doomed = repose.load_scene("column_small", grid={"cell": 0.25}, explicit={"time_step": 0.003986})
    with pytest.raises(repose.NumericalError, match=r"Courant limit[\s\S]*last good state"):
        repose.run(doomed, ranks=2, progress=False)


@needs_ranks
def test_ctrl_c_saves_a_run_on_ranks(tmp_path):
    long = repose.load_scene("column_small", explicit={"until": 60.0}, output={"every": 0.05, "vtk": False})

    def interrupt():
        while not (tmp_path / "run" / "checkpoint.h5").is_file():
            time.sleep(0.05)
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=interrupt).start()
    with pytest.raises(KeyboardInterrupt, match="goes on"):
        repose.run(long, tmp_path / "run", ranks=2, progress=False)
    assert repose.open_run(tmp_path / "run").summary == {}


def test_ranks_that_cannot_be_had_are_refused(monkeypatch):
    with pytest.raises(repose.SceneError, match="must be a number of MPI ranks"):
        repose.run("column_small", ranks=0)
    with pytest.raises(repose.SceneError, match="one device, for one rank"):
        repose.run("column_small", ranks=2, device="cuda:0")
    monkeypatch.setenv("OMPI_COMM_WORLD_SIZE", "2")
    for call in (repose.run, repose.compare):
        with pytest.raises(repose.SceneError, match="without mpirun"):
            call("column_small")


@pytest.mark.parametrize("name", preset_names())
def test_a_scene_written_as_toml_is_the_same_scene(tmp_path, name):
    scene = repose.load_scene(name)
    (tmp_path / "scene.toml").write_text(to_toml(scene))
    assert repose.load_scene(tmp_path / "scene.toml") == scene


def test_a_solver_stepped_by_hand_meets_a_run(result):
    """Positions after 0.4 s, to single precision, in which snapshots are kept."""
    solver = repose.Solver(result.scene)
    solver.advance_to(0.2)
    middle = solver.state()
    solver.advance_to(0.4)
    assert solver.time == pytest.approx(0.4)
    np.testing.assert_allclose(solver.x, result.points, atol=1e-4)
    end = solver.x
    solver.restore(middle)
    assert solver.time == pytest.approx(0.2)
    solver.advance_to(0.4)
    np.testing.assert_array_equal(solver.x, end)


def test_a_solver_refuses_what_a_run_would():
    with pytest.raises(repose.SceneError, match="Courant"):
        repose.Solver(repose.load_scene("column_small", explicit={"time_step": 1.0}))


@pytest.mark.parametrize("call", [repose.run, repose.Solver])
def test_a_solver_that_is_not_there_is_refused(call):
    with pytest.raises(repose.SceneError, match=r"^mode = 'Implicit': must be 'explicit' or 'implicit'$"):
        call("column_small", mode="Implicit")


@needs_implicit
def test_the_implicit_solver_refuses_a_gpu():
    for call in (repose.run, repose.Solver):
        with pytest.raises(repose.SceneError, match=r"^--device cuda:0: the implicit solver runs on the CPU$"):
            call("column_small", mode="implicit", device="cuda:0")


@needs_implicit
def test_the_implicit_solver_steps_in_pseudo_time():
    solver = repose.Solver(repose.load_scene("column_small", grid={"cell": 0.25}), mode="implicit")
    solver.advance_to(0.1)
    assert solver.time >= 0.1
    assert solver.arrays["theta"].shape == (len(solver.x),)


@needs_implicit
def test_a_comparison_has_its_page_and_its_runs():
    found = repose.compare(repose.load_scene("column_small", grid={"cell": 0.25}))
    assert "<html" in found.page.read_text(encoding="utf-8")
    assert {"implicit", "explicit, D = 0.4"} <= found.runs.keys()
    assert found.verdict in repr(found)


@needs_implicit
def test_a_comparison_leaves_a_users_own_files_as_they_are(tmp_path, monkeypatch):
    """A scene file in the folder that the comparison is kept in, and then another study's report there."""
    monkeypatch.chdir(tmp_path)
    short = {"explicit": {"max_time": 0.05}, "implicit": {"max_steps": 1}, "output": {"vtk": False}}
    scene = repose.load_scene("column_small", grid={"cell": 0.25}, **short)
    file = tmp_path / "scene.toml"
    file.write_text("# mine\n" + to_toml(scene))
    mine = file.read_text()
    assert repose.compare("scene.toml", ".").report["provenance"]["report made by"] == "repose.compare('scene.toml')"
    assert file.read_text() == mine
    assert repose.compare(scene, ".").report["failed"] == []
    assert file.read_text() == mine
    (kept,) = (tmp_path / "runs").glob("scene-*.toml")
    assert repose.load_scene(kept) == scene
    written = sorted(path.stat().st_mtime_ns for path in tmp_path.rglob("*"))
    another = repose.load_scene(file, material={"friction_angle": 30.0})
    with pytest.raises(repose.SceneError, match="a report about something else"):
        repose.compare(another, ".")
    assert sorted(path.stat().st_mtime_ns for path in tmp_path.rglob("*")) == written


@pytest.mark.parametrize("module", ["repose", "compare.cli.main"])
def test_importing_the_face_or_the_command_line_imports_no_numerics(module):
    """Figures, arrays and Warp take a second."""
    heavy = "{'numpy', 'warp', 'matplotlib', 'h5py', 'scipy', 'pydantic', 'dolfinx'}"
    code = f"import sys, {module}; print(sorted({heavy} & sys.modules.keys()))"
    assert subprocess.check_output([sys.executable, "-c", code], text=True).strip() == "[]"
