"""`repose bench`: figures that do not depend on the machine, and what it refuses. Times are not asserted."""

import csv
import json

import pytest
from installed import needs_implicit, needs_ranks
from typer.testing import CliRunner

from compare.bench import scaling
from compare.bench.ladder import FLOOR_BYTES
from compare.cli.main import app
from mpm.errors import SceneError


def bench(folder, *arguments):
    answer = CliRunner().invoke(app, ["bench", *arguments, "--out", str(folder)])
    if answer.exception and not isinstance(answer.exception, SystemExit):
        raise answer.exception
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    with open(folder / "table.csv", newline="", encoding="utf-8") as file:
        return report, list(csv.DictReader(file))


def table(report, title):
    (section,) = [section for section in report["sections"] if section["title"] == title]
    return section["tables"][0]


def test_explicit_table_page_and_phases_are_of_the_same_runs(tmp_path):
    report, rows = bench(tmp_path, "explicit", "--cells", "4", "6", "--precision", "float32")
    assert [int(row["points"]) for row in rows] == [208, 672]
    # No second set of state: half of float64's 136, and 12 for what positions would lose.
    assert [int(row["bytes_per_point"]) for row in rows] == [80, 80]
    throughput = table(report, "Throughput")["rows"]
    for row, shown in zip(rows, throughput, strict=True):
        rate = float(row["point_steps_per_s"])
        assert float(row["slowest"]) <= rate <= float(row["fastest"])
        assert shown[2] == pytest.approx(rate / 1e6)
        assert shown[5] == pytest.approx(float(row["over_yardstick"]))
        share = rate * FLOOR_BYTES["float32"] / float(row["bandwidth"])
        assert shown[7] == f"{share:.1%}"
    ratios = [float(row["over_yardstick"]) for row in rows]
    assert report["checks"][0]["value"] == pytest.approx(max(ratios) / min(ratios) - 1)
    phases = table(report, "Phases")["rows"]
    assert [phase[0] for phase in phases] == [
        "begin_step", "clear_grid", "p2g", "update_grid", "g2p2g", "hold_walls", "strain_points", "apply_node_law",
        "update_stress", "sum",
    ]  # fmt: skip
    assert phases[-1][1] == pytest.approx(sum(phase[1] for phase in phases[:-1]))
    nodes = table(report, "Only what holds material")["rows"]
    assert [(row[0], row[1], row[2]) for row in nodes[:4]] == [
        (0.5, 25120, 30375),
        (1.0, 50240, 180625),
        (2.0, 100480, 1225125),
        (4.0, 200960, 8978125),
    ]  # fmt: skip  (Table 1 of the paper)
    assert nodes[3][3] < 0.01 * nodes[3][2]
    assert (tmp_path / "report.html").is_file()


@needs_implicit
def test_implicit_phases_add_up_to_the_time_taken(tmp_path):
    report, (row,) = bench(tmp_path, "implicit", "--cells", "4")
    assert (int(row["points"]), int(row["unknowns"]) % 3) == (208, 0)
    phases = report["rows"][0]["phases"]
    assert sum(phases.values()) == pytest.approx(float(row["seconds"]))
    assert all(seconds > 0 for seconds in phases.values())


@needs_ranks
def test_speed_over_ranks_has_its_table_picture_and_predictions(tmp_path, monkeypatch):
    monkeypatch.setattr(scaling, "ROUNDS", 1)
    report, rows = bench(tmp_path, "explicit", "--ranks", "2", "--cells", "4")
    assert [(row["kind"], row["ranks"], row["points"]) for row in rows] == [
        ("strong", "1", "208"), ("strong", "2", "208"), ("weak", "2", "448"),
    ]  # fmt: skip
    one, *two = rows
    assert (float(one["over_one_rank"]), float(one["efficiency"]), one["shared"]) == (1.0, 1.0, "0")
    for row in two:
        over = float(row["point_steps_per_s"]) / float(one["point_steps_per_s"])
        assert float(row["over_one_rank"]) == pytest.approx(over)
        assert float(row["efficiency"]) == pytest.approx(over / 2)
        assert 0 < int(row["shared"]) == int(row["sent"]) <= int(row["nodes"])  # one peer: each goes out once
        assert all(float(row[name]) > 0 for name in ("latency", "bandwidth", "handling", "packing"))
    assert report["checks"][0]["limit"] == scaling.AGREES
    with open(tmp_path / "predicted.csv", newline="", encoding="utf-8") as file:
        predicted = list(csv.DictReader(file))
    assert {(row["machine"], row["ranks"]) for row in predicted} == {
        ("16 cores", "16"), ("4 GPUs", "4"), ("64 hosts of 16 cores", "1024"),
    }  # fmt: skip
    assert (tmp_path / "scaling.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "report.html").is_file()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("implicit", "--precision", "float32"), "the implicit solver runs on the CPU in float64"),
        (("explicit", "--device", "cuda:7"), "cuda:7"),
        (("explicit", "--cells", "4.3"), "grid.cell"),
        (("explicit", "--cells", "4.3", "--ranks", "2"), "grid.cell"),
        (("explicit", "--cells", "0"), r"^--cells 0: must be a number of cells per r0 > 0 \[-\]$"),
        (("implicit", "--cells", "-4"), "^--cells -4: must be"),
        (("explicit", "--cells", "0", "--ranks", "2"), "^--cells 0: must be"),
        (("explicit", "--cells", "0.3", "--ranks", "2"), "grid.cell"),
        (("explicit", "--cells", "nan", "--ranks", "2"), "^--cells nan: must be"),
        (("explicit", "--ranks", "0"), "must be a number of MPI ranks"),
        (("explicit", "--ranks", "2", "--device", "cuda:0"), "on CPU cores"),
    ],
)
def test_what_cannot_be_measured_is_refused_before_anything_is_written(tmp_path, arguments, said):
    with pytest.raises(SceneError, match=said):
        bench(tmp_path / "out", *arguments)
    assert not (tmp_path / "out").exists()
