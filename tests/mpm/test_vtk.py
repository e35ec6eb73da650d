"""ParaView files: what meshio reads back is what the store holds."""

from xml.etree import ElementTree

import meshio
import numpy as np
import pytest

from mpm.errors import SceneError
from mpm.fields import FOLLOWS
from mpm.load import load_scene
from mpm.results import Results
from mpm.vtk import write_vtk

POINT_COUNT = 11


@pytest.fixture
def run(tmp_path):
    """Two snapshots with a scalar, a vector, a symmetric tensor and an integer field."""
    run = Results.create(tmp_path / "run", load_scene("column_small"), {})
    rng = np.random.default_rng(3)
    for step, time in enumerate([0.0, 0.1]):
        fields = {
            "x": rng.normal(size=(POINT_COUNT, 3)),
            "v": rng.normal(size=(POINT_COUNT, 3)),
            "stress": rng.normal(size=(POINT_COUNT, 6)),
            "volume": rng.random(POINT_COUNT).astype(np.float32),
            "body": np.arange(POINT_COUNT),
        }
        run.write_snapshot(time, step, fields)
    return run


def test_every_field_reads_back_equal(run):
    write_vtk(run)
    for index in range(2):
        stored = run.snapshot(index)
        mesh = meshio.read(run.directory / "vtk" / f"{index:06d}.vtu")
        np.testing.assert_array_equal(mesh.points, stored["x"])
        follow = {name for name, (needed, _) in FOLLOWS.items() if set(needed) <= {"stress"}}
        assert set(mesh.point_data) == {"v", "stress", "volume", "body"} | follow and "pressure" in follow
        pressure = -stored["stress"][:, :3].mean(axis=1)
        np.testing.assert_array_equal(mesh.point_data["pressure"], pressure.astype(np.float32))
        for name in ("v", "volume", "body"):
            np.testing.assert_array_equal(mesh.point_data[name], stored[name])
            assert mesh.point_data[name].dtype == stored[name].dtype


def test_each_point_is_a_vertex_cell(run):
    write_vtk(run)
    (cells,) = meshio.read(run.directory / "vtk" / "000000.vtu").cells
    assert cells.type == "vertex"
    np.testing.assert_array_equal(cells.data.ravel(), np.arange(POINT_COUNT))


def test_tensor_components_are_in_paraviews_order(run):
    xx, yy, zz, yz, xz, xy = run.snapshot(1)["stress"].T
    write_vtk(run, ["stress"])
    written = meshio.read(run.directory / "vtk" / "000001.vtu").point_data["stress"]
    np.testing.assert_array_equal(written, np.column_stack([xx, yy, zz, xy, yz, xz]))


def test_data_is_compressed_binary(run):
    write_vtk(run)
    text = (run.directory / "vtk" / "000000.vtu").read_text()
    assert "vtkZLibDataCompressor" in text
    assert 'format="ascii"' not in text


def test_collection_lists_every_snapshot_with_its_time(run):
    path = write_vtk(run)
    assert path == run.directory / "vtk" / "run.pvd"
    entries = ElementTree.parse(path).getroot().findall("Collection/DataSet")
    assert [float(entry.get("timestep")) for entry in entries] == list(run.times)
    assert all((path.parent / entry.get("file")).is_file() for entry in entries)
    assert len(entries) == 2


def test_selection_and_folder_are_followed(run, tmp_path):
    path = write_vtk(run, ["volume"], tmp_path / "elsewhere" / "deep")
    mesh = meshio.read(path.parent / "000000.vtu")
    assert set(mesh.point_data) == {"volume"}
    assert not (run.directory / "vtk").exists()


def test_unknown_field_names_the_available_ones(run):
    with pytest.raises(SceneError, match=r"no field speed in .*: it has body, stress, v, volume, pressure"):
        write_vtk(run, ["v", "speed"])
    assert not (run.directory / "vtk").exists()


def test_run_without_snapshots_is_a_scene_error(tmp_path):
    run = Results.create(tmp_path / "empty", load_scene("column_small"), {})
    with pytest.raises(SceneError, match="no snapshot"):
        write_vtk(run)
