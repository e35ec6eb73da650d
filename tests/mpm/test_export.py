"""Snapshots as tables: what is read back is what the store holds; fields that follow from others."""

import csv

import numpy as np
import pytest

from mpm.errors import SceneError
from mpm.export import Snapshots, write_csv
from mpm.fields import friction_mobilised
from mpm.load import load_scene
from mpm.results import Results

POINT_COUNT = 7
COLUMN, BOX = "column_small", "self_weight"


def store(folder, scene, names):
    run = Results.create(folder, load_scene(scene), {})
    rng = np.random.default_rng(3)
    widths = {"velocity": (3,), "stress": (6,)}
    for step, time in enumerate([0.0, 0.1]):
        fields = {name: rng.normal(size=(POINT_COUNT, *widths.get(name, ()))).astype(np.float32) for name in names}
        run.write_snapshot(time, 10 * step, {"x": rng.normal(size=(POINT_COUNT, 3)).astype(np.float32), **fields})
    return run


@pytest.fixture
def run(tmp_path):
    return store(tmp_path / "run", COLUMN, ["velocity", "stress", "eps_p_eqv", "volume_ratio"])


def table(path):
    with open(path, newline="") as file:
        heading, *rows = csv.reader(file)
    return heading, np.array(rows, float)


def test_a_table_names_components_and_units_and_reads_back_to_the_bit(run):
    path = write_csv(run, ["velocity", "stress", "eps_p_eqv"])
    assert path == run.directory / "csv" / "snapshots.csv"
    for index in range(2):
        heading, rows = table(path.parent / f"{index:06d}.csv")
        assert heading == [
            *("x [m]", "y [m]", "z [m]", "velocity_x [m/s]", "velocity_y [m/s]", "velocity_z [m/s]"),
            *(f"stress_{pair} [Pa]" for pair in ("xx", "yy", "zz", "yz", "xz", "xy")),
            "eps_p_eqv [-]",
        ]
        stored = run.snapshot(index)
        columns = [stored["x"], stored["velocity"], stored["stress"], stored["eps_p_eqv"][:, None]]
        np.testing.assert_array_equal(rows.astype(np.float32), np.hstack(columns))


def test_the_list_of_snapshots_has_their_times(run):
    with open(write_csv(run), newline="") as file:
        rows = list(csv.DictReader(file))
    assert rows == [
        {"file": "000000.csv", "time [s]": "0.0", "step": "0"},
        {"file": "000001.csv", "time [s]": "0.1", "step": "10"},
    ]


def test_fields_that_are_not_stored_follow_from_those_that_are(run):
    follow = ["pressure", "deviatoric_stress", "friction_mobilised"]
    assert Snapshots(run).names == ["eps_p_eqv", "stress", "velocity", "volume_ratio", *follow]
    first = next(iter(Snapshots(run, ["friction_mobilised", "pressure"])))
    stored = run.snapshot(0)
    np.testing.assert_allclose(first["pressure"], -stored["stress"][:, :3].mean(axis=1), rtol=1e-6)
    constants = load_scene(COLUMN).material.constants()
    expected = friction_mobilised(stored["stress"], stored["volume_ratio"], constants)
    np.testing.assert_allclose(first["friction_mobilised"], expected, rtol=1e-6)
    assert first["pressure"].dtype == first["friction_mobilised"].dtype == np.float32


def test_nothing_follows_from_what_is_not_stored(tmp_path):
    assert Snapshots(store(tmp_path / "a", COLUMN, ["stress"])).names == ["stress", "pressure", "deviatoric_stress"]
    assert Snapshots(store(tmp_path / "b", COLUMN, ["velocity"])).names == ["velocity"]
    elastic = store(tmp_path / "c", BOX, ["stress", "volume_ratio"])
    assert Snapshots(elastic).names == ["stress", "volume_ratio", "pressure", "deviatoric_stress"]
    with pytest.raises(SceneError, match=r"no field friction_mobilised in .*: it has stress, volume_ratio, pressure"):
        Snapshots(elastic, ["friction_mobilised"])


def test_a_run_without_snapshots_is_refused(tmp_path):
    with pytest.raises(SceneError, match="no snapshot"):
        write_csv(Results.create(tmp_path / "empty", load_scene(COLUMN), {}))


def test_another_run_by_force_takes_the_tables_away_and_nothing_else(run):
    write_csv(run)
    (run.directory / "csv" / "mine.csv").write_text("keep me")
    Results.create(run.directory, load_scene(COLUMN), {}, force=True)
    assert [path.name for path in (run.directory / "csv").iterdir()] == ["mine.csv"]
