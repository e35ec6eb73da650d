"""The results store: round trips, what it refuses, what a kill or a damaged file leaves."""

import json
import os
import subprocess
import sys

import h5py
import numpy as np
import pytest

from mpm.errors import SceneError
from mpm.load import load_scene
from mpm.results import RESULTS, Results

SCENE = load_scene("column_small")
OTHER = load_scene("elastic_bar")
PROVENANCE = {"repose": "0.1.0", "device": "cpu", "points": 12, "cfl": 0.5}


@pytest.fixture
def run(tmp_path):
    return Results.create(tmp_path / "run", SCENE, PROVENANCE)


def write_two_snapshots(run):
    x = np.random.default_rng(0).normal(size=(7, 3))
    run.write_snapshot(0.0, 0, {"x": x, "volume": np.ones(7, dtype=np.float32)})
    run.write_snapshot(0.25, 40, {"x": x + 1.0, "volume": np.full(7, 2.0, dtype=np.float32)})
    return x


def test_scene_and_provenance_come_back_from_a_new_object(run):
    again = Results.open(run.directory)
    assert again.scene == SCENE
    assert again.provenance == PROVENANCE


def test_a_scene_of_an_earlier_version_that_no_longer_validates_is_a_scene_error(run):
    with h5py.File(run.directory / "results.h5", "r+") as file:
        file.attrs["scene"] = file.attrs["scene"].replace('"cfl"', '"courant"')
    again = Results.open(run.directory)
    with pytest.raises(SceneError, match=r"made by another version of Repose; run its scene again.*courant"):
        again.scene  # noqa: B018
    assert again.provenance == PROVENANCE  # the rest can be read all the same


def test_a_scene_larger_than_an_hdf5_attribute_header_is_kept(tmp_path):
    scene = load_scene("column_small", sections={"name": "x" * 200_000})
    assert Results.create(tmp_path / "run", scene, {}).scene == scene


def test_static_array_is_kept_and_written_once(run):
    x0 = np.arange(6.0).reshape(2, 3)
    run.write_static("x0", x0)
    np.testing.assert_array_equal(run.read_static("x0"), x0)
    with pytest.raises(ValueError, match="exists"):
        run.write_static("x0", x0 + 1)
    np.testing.assert_array_equal(run.read_static("x0"), x0)


def test_snapshots_round_trip_with_time_step_and_precision(run):
    x = write_two_snapshots(run)
    assert run.snapshot_count == 2
    assert run.field_names == ["volume", "x"]
    np.testing.assert_array_equal(run.times, [0.0, 0.25])
    last = run.snapshot(-1)
    assert (last["time"], last["step"]) == (0.25, 40)
    np.testing.assert_array_equal(last["x"], x + 1.0)
    assert last["volume"].dtype == np.float32
    assert set(run.snapshot(0, names=["volume"])) == {"volume", "time", "step"}


def test_absent_snapshot_and_field_raise(run):
    assert run.field_names == []
    with pytest.raises(SceneError, match="IndexError"):
        run.snapshot(-1)
    write_two_snapshots(run)
    with pytest.raises(SceneError, match="pressure"):
        run.snapshot(0, names=["pressure"])


def test_snapshots_are_named_and_compressed_as_documented(run):
    run.write_snapshot(0.0, 0, {"zeros": np.zeros(100_000)})
    with h5py.File(run.directory / "results.h5") as file:
        data = file["snapshots/000000/zeros"]
        assert (data.compression, data.compression_opts, data.shuffle) == ("gzip", 1, True)
        assert data.id.get_storage_size() < 8000


def test_history_appends_rows_in_order(run):
    run.append_history([{"time": 0.0, "KE": 1.0}, {"time": 0.1, "KE": 2.0}])
    run.append_history([])
    run.append_history([{"KE": 3.0, "time": 0.2}])
    history = run.history()
    assert set(history) == {"time", "KE"}
    np.testing.assert_array_equal(history["time"], [0.0, 0.1, 0.2])
    np.testing.assert_array_equal(history["KE"], [1.0, 2.0, 3.0])


@pytest.mark.parametrize("longer", ["time", "KE"])
def test_a_kill_between_two_columns_leaves_whole_rows(run, longer):
    run.append_history([{"time": 0.0, "KE": 1.0}, {"time": 0.1, "KE": 2.0}])
    with h5py.File(run.directory / RESULTS, "a") as file:
        file["history"][longer].resize(3, axis=0)  # the row itself was not written any more
    for _ in range(2):
        history = run.history()
        assert (history["time"].tolist(), history["KE"].tolist()) == ([0.0, 0.1], [1.0, 2.0])
        run.truncate_after(0.1)
    run.append_history([{"time": 0.2, "KE": 3.0}])
    history = run.history()
    assert (history["time"].tolist(), history["KE"].tolist()) == ([0.0, 0.1, 0.2], [1.0, 2.0, 3.0])


@pytest.mark.parametrize("row", [{"time": 1.0}, {"time": 1.0, "KE": 0.0, "more": 0.0}])
def test_history_columns_are_fixed_by_the_first_rows(run, row):
    run.append_history([{"time": 0.0, "KE": 1.0}])
    with pytest.raises(ValueError, match="exactly these columns"):
        run.append_history([row])
    assert [len(column) for column in run.history().values()] == [1, 1]


def test_history_without_time_is_refused(run):
    with pytest.raises(ValueError, match="time"):
        run.append_history([{"KE": 1.0}])
    assert run.history() == {}


def test_truncate_after_keeps_the_given_time_and_lets_the_run_go_on(run):
    x = write_two_snapshots(run)
    run.write_snapshot(0.5, 80, {"x": x})
    run.append_history([{"time": t, "KE": 10 * t} for t in (0.0, 0.25, 0.3, 0.5)])
    run.finish({"R_max": 0.3})
    run.truncate_after(0.25)
    np.testing.assert_array_equal(run.times, [0.0, 0.25])
    np.testing.assert_array_equal(run.history()["KE"], [0.0, 2.5])
    assert run.summary() is None
    run.write_snapshot(0.4, 70, {"x": x})
    run.append_history([{"time": 0.4, "KE": 4.0}])
    np.testing.assert_array_equal(run.times, [0.0, 0.25, 0.4])
    np.testing.assert_array_equal(run.history()["time"], [0.0, 0.25, 0.4])


def test_create_refuses_a_folder_in_use_and_names_both_ways_out(run):
    with pytest.raises(SceneError) as caught:
        Results.create(run.directory, OTHER, {})
    for word in (str(run.directory), "--force", f"repose resume {run.directory}"):
        assert word in str(caught.value)
    assert Results.open(run.directory).scene == SCENE


def test_create_takes_an_empty_folder(tmp_path):
    assert Results.create(tmp_path, SCENE, {}).snapshot_count == 0


def test_force_replaces_the_run_and_leaves_foreign_files(run):
    write_two_snapshots(run)
    run.write_checkpoint({"step": 3})
    run.finish({})
    foreign = ["notes.txt", "photo.png", "vtk/view.pvsm"]
    ours = [
        "checkpoint.h5.tmp",
        "vtk/000000.vtu",
        "vtk/run.pvd",
        "morphology.png",
        "profile.png",
        "history.png",
    ]
    (run.directory / "vtk").mkdir()
    for name in foreign + ours:
        (run.directory / name).write_text("x")
    fresh = Results.create(run.directory, OTHER, {}, force=True)
    left = sorted(str(p.relative_to(run.directory)) for p in run.directory.rglob("*") if p.is_file())
    assert left == sorted([*foreign, "results.h5"])
    assert fresh.scene == OTHER
    assert (fresh.snapshot_count, fresh.has_checkpoint, fresh.summary()) == (0, False, None)


def test_force_removes_the_vtk_folder_when_only_ours_was_in_it(run):
    (run.directory / "vtk").mkdir()
    (run.directory / "vtk" / "000000.vtu").write_text("x")
    Results.create(run.directory, SCENE, {}, force=True)
    assert [p.name for p in run.directory.iterdir()] == ["results.h5"]


def test_create_below_a_file_gives_the_systems_reason(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(SceneError, match="Not a directory"):
        Results.create(tmp_path / "file" / "run", SCENE, {})


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_create_in_a_read_only_folder_gives_the_systems_reason(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(SceneError, match="Permission denied"):
        Results.create(tmp_path, SCENE, {})


def test_open_says_what_is_missing(tmp_path):
    with pytest.raises(SceneError, match=r"results\.h5 is missing"):
        Results.open(tmp_path / "nowhere")


def test_open_refuses_truncated_empty_and_foreign_files(run):
    path = run.directory / "results.h5"
    run.write_snapshot(0.0, 0, {"x": np.random.default_rng(0).normal(size=(500, 3))})
    whole = path.read_bytes()
    for content in (whole[: len(whole) // 2], b"", b"not HDF5 at all"):
        path.write_bytes(content)
        with pytest.raises(SceneError, match="cannot be read"):
            Results.open(run.directory)
    with h5py.File(path, "w") as file:
        file["temperature"] = 1.0
    with pytest.raises(SceneError, match="not a Repose results file"):
        Results.open(run.directory)


def test_damaged_data_inside_a_whole_file_is_a_scene_error(run):
    run.write_snapshot(0.0, 0, {"x": np.random.default_rng(0).normal(size=(500, 3))})
    path = run.directory / "results.h5"
    with h5py.File(path) as file:
        chunk = file["snapshots/000000/x"].id.get_chunk_info(0)
    content = bytearray(path.read_bytes())
    content[chunk.byte_offset : chunk.byte_offset + chunk.size] = bytes(chunk.size)
    path.write_bytes(content)
    with pytest.raises(SceneError, match="cannot be read"):
        Results.open(run.directory).snapshot(0)


def test_a_reader_elsewhere_does_not_make_the_solvers_write_fail(run):
    """`repose plot` on a run that is still going must not lock the file."""
    hold = (
        "import sys; from mpm.results import Results\n"
        "with Results.open(sys.argv[1])._reading(): print(flush=True); input()"
    )
    pipe = subprocess.PIPE
    with subprocess.Popen([sys.executable, "-c", hold, run.directory], stdin=pipe, stdout=pipe) as reader:
        reader.stdout.readline()  # the other process has the file open now
        run.append_history([{"time": 0.5}])
        reader.communicate(b"\n")
    assert reader.returncode == 0
    np.testing.assert_array_equal(run.history()["time"], [0.5])


def test_checkpoint_round_trip_is_exact_in_bits_and_types(run):
    state = {
        "x": np.random.default_rng(1).normal(size=(5, 3)),
        "odd": np.array([np.nan, np.inf, -0.0, 5e-324]),
        "v": np.array([[0.1, 0.2]], dtype=np.float32),
        "ids": np.array([2**62, -1]),
        "mask": np.array([True, False]),
        "nothing": np.zeros((0, 3)),
        "single": np.float32(0.1),
        "time": 0.1 + 0.2,
        "step": 2**53 + 1,
        "phase": "collapse",
        "empty": "",
    }
    run.write_checkpoint(state)
    back = Results.open(run.directory).read_checkpoint()
    assert set(back) == set(state)
    for name, value in state.items():
        assert type(back[name]) is type(value), name
        if isinstance(value, np.ndarray | np.generic):
            assert back[name].dtype == value.dtype and back[name].shape == value.shape, name
            assert back[name].tobytes() == value.tobytes(), name
        else:
            assert back[name] == value, name


def test_checkpoint_name_that_is_a_path_is_refused(run):
    with pytest.raises(ValueError, match="a/b"):
        run.write_checkpoint({"a/b": np.zeros(2)})
    assert not run.has_checkpoint


def fail(*_args, **_kwargs):
    raise OSError("disk went away")


@pytest.mark.parametrize(
    "target", ["os.replace", "os.fsync", "h5py.File.create_dataset"], ids=["rename", "sync", "write"]
)
def test_interrupted_checkpoint_leaves_the_earlier_one(run, monkeypatch, target):
    run.write_checkpoint({"step": 1, "x": np.ones(4)})
    with monkeypatch.context() as patch:
        patch.setattr(target, fail)
        with pytest.raises(OSError, match="disk went away"):
            run.write_checkpoint({"step": 2, "x": np.zeros(4)})
    back = run.read_checkpoint()
    assert back["step"] == 1
    np.testing.assert_array_equal(back["x"], np.ones(4))
    assert not (run.directory / "checkpoint.h5.tmp").exists()


def test_half_written_temporary_of_a_killed_run_does_no_harm(run):
    run.write_checkpoint({"step": 1})
    (run.directory / "checkpoint.h5.tmp").write_bytes(b"\x89HDF cut short")
    assert run.read_checkpoint() == {"step": 1}
    run.write_checkpoint({"step": 2})
    assert run.read_checkpoint() == {"step": 2}


def test_missing_or_damaged_checkpoint_is_a_scene_error(run):
    assert not run.has_checkpoint
    with pytest.raises(SceneError, match=r"checkpoint\.h5 is missing"):
        run.read_checkpoint()
    run.write_checkpoint({"x": np.zeros(1000)})
    path = run.directory / "checkpoint.h5"
    path.write_bytes(path.read_bytes()[:3000])
    with pytest.raises(SceneError, match="cannot be read"):
        run.read_checkpoint()


def test_summary_is_strict_json_with_null_for_what_is_not_finite(run):
    assert run.summary() is None
    run.finish({"R_max": np.float64(0.3), "steps": np.int64(7), "drift": [1.0, float("nan")], "t": np.inf})
    text = (run.directory / "summary.json").read_text()
    expected = {"R_max": 0.3, "steps": 7, "drift": [1.0, None], "t": None}
    assert json.loads(text, parse_constant=fail) == expected
    assert '\n  "R_max": 0.3' in text
    assert Results.open(run.directory).summary() == expected
