"""Exit code 2: the input is wrong, and the message says what, in whole lines."""

import json
import subprocess
import sys

import meshio
import numpy as np
import pytest
from program import HIDE_DOLFINX, TINY

from mpm.load import load_scene
from mpm.provenance import how_to_get_dolfinx
from mpm.results import Results

BAD_SETTINGS = [
    ("material.densty=3", "material.densty: unknown key; did you mean 'density'?"),
    ("material.density=-1", "material.density = -1: must be > 0 [kg/m3]"),
    ("material.friction_angle=95", "material.friction_angle = 95: must be >= 0 and <= 80 [degrees]"),
    ("grid.cell=5", "grid.cell = 5: the cell is larger than the column"),
    ("geometry.aspect_ratio=0", "geometry.aspect_ratio = 0: must be > 0 and <= 50 [-]"),
    ("grid.cell=1e-6", "grid.cell = 1e-06: about 3e+18 points"),
    ("explicit.damping", "--set explicit.damping: expected key=value"),
]


@pytest.mark.parametrize("command", ["run", "validate"])
@pytest.mark.parametrize(("setting", "expected"), BAD_SETTINGS, ids=[setting for setting, _ in BAD_SETTINGS])
def test_bad_settings(refused, tmp_path, command, setting, expected):
    assert expected in refused(command, "column_small", "--set", setting)
    assert list(tmp_path.iterdir()) == []


def test_all_problems_come_at_once_a_line_each(refused):
    message = refused("run", "column_small", "--set", "material.density=-1", "--set", "material.friction_angle=95")
    assert [line.split(" = ")[0] for line in message.splitlines()] == [
        "error: material.density",
        "error: material.friction_angle",
    ]


def test_long_messages_are_not_broken_into_lines(refused, tmp_path):
    """They name paths to copy, and are read by scripts."""
    name = "deep/" * 40 + "scene.toml"
    assert len(refused("run", name).splitlines()) == 1


def test_unknown_scene(refused):
    assert "did you mean 'column_small'?" in refused("run", "column_smal")


@pytest.mark.parametrize("reference", ["x" * 300, ".", "/"])
def test_what_cannot_be_a_scene_file(refused, reference):
    assert "no such file or preset" in refused("validate", reference)


def test_broken_scene_file(refused, tmp_path):
    (tmp_path / "scene.toml").write_text("name = \n")
    message = refused("run", "scene.toml")
    assert "scene 'scene.toml': not a readable TOML file" in message and "line 1" in message


@pytest.mark.parametrize("device", ["cuda:99", "gpu", ""])
def test_nonexistent_device_lists_those_there_are(refused, tmp_path, device):
    message = refused("run", *TINY, "--device", device)
    assert f"--device {device}: no such device" in message
    assert "this machine has: cpu" in message
    assert list(tmp_path.iterdir()) == []


MESH_SCENE = """name = "body"
geometry = { shape = "mesh", file = "body.stl" }
grid = { cell = 0.25 }
material = { young = 1e6, poisson = 0.3, density = 2000, friction_angle = 30 }
explicit = { until = 0.01 }
"""


def write_cube(path, faces=12):
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    triangles = np.array([[quad[a] for a in half] for quad in quads for half in ((0, 1, 2), (0, 2, 3))])
    meshio.Mesh(corners, [("triangle", triangles[:faces])]).write(path, file_format="stl", binary=True)


def test_missing_mesh_file(refused, tmp_path):
    (tmp_path / "scene.toml").write_text(MESH_SCENE)
    assert f"geometry.file = {tmp_path / 'body.stl'}: there is no such file" in refused("run", "scene.toml")


def test_open_surface_mesh(refused, tmp_path):
    (tmp_path / "scene.toml").write_text(MESH_SCENE)
    write_cube(tmp_path / "body.stl", faces=11)
    message = refused("run", "scene.toml")
    assert "body.stl: the surface is not closed" in message
    assert "3 are open" in message
    assert not (tmp_path / "runs").exists()


def test_closed_surface_mesh_runs(repose, tmp_path):
    (tmp_path / "scene.toml").write_text(MESH_SCENE)
    write_cube(tmp_path / "body.stl")
    assert repose("run", "scene.toml").code == 0
    assert json.loads((tmp_path / "runs/body-explicit/summary.json").read_text())["points"] == 8**3


def test_validate_holds_a_mesh_bodys_points_against_it(repose, tmp_path):
    (tmp_path / "scene.toml").write_text(MESH_SCENE)
    write_cube(tmp_path / "body.stl")
    said = repose("validate", "scene.toml").out
    assert "points fill 1 m3, the mesh encloses 1 m3: +0.0%" in said
    assert "body (0, 0, 0) to (1, 1, 1) m, points (0, 0, 0) to (1, 1, 1) m, lowest point z = 0 m" in said
    assert "off the lattice by 0, 0, 0 of a spacing" in said


def test_output_folder_that_cannot_be_made(refused, tmp_path):
    (tmp_path / "file").write_text("")
    assert "cannot write to file" in refused("run", *TINY, "--out", "file")


@pytest.mark.parametrize("command", ["resume", "plot"])
def test_a_folder_without_a_run(refused, tmp_path, command):
    (tmp_path / "empty").mkdir()
    assert "no run in empty: results.h5 is missing" in refused(command, "empty")
    assert "no run in nowhere: results.h5 is missing" in refused(command, "nowhere")


def test_resume_without_a_checkpoint(refused, tmp_path):
    Results.create(tmp_path / "run", load_scene("column_small"), {"device": "cpu"})
    assert "run: no checkpoint" in refused("resume", "run")


@pytest.mark.parametrize("command", ["resume", "plot"])
def test_a_damaged_results_file(refused, tmp_path, command):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "results.h5").write_bytes(b"not HDF5")
    assert "run/results.h5 cannot be read" in refused(command, "run")


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("run",), "SCENE"),
        (("run", "column_small", "--mode", "both"), "--mode"),
        (("run", "column_small", "--dt", "1"), "--dt"),
        (("crun", "column_small"), "crun"),
    ],
)
def test_wrong_usage(repose, arguments, expected):
    answer = repose(*arguments)
    assert answer.code == 2
    assert expected in answer.err


@pytest.mark.parametrize(
    "arguments",
    [
        ["run", *TINY, "--mode", "implicit"],
        ["validate", *TINY, "--mode", "implicit"],
        ["compare", "column_small"],
        ["demo"],
        ["study", "error", "column_small"],
        ["study", "paper", "--quick"],
        ["bench", "implicit"],
    ],
    ids=lambda arguments: " ".join(arguments[:2]),
)
def test_without_dolfinx_what_needs_it_says_so_before_anything_runs(tmp_path, arguments):
    """In a process of its own: here dolfinx may be imported already."""
    command = [sys.executable, "-c", HIDE_DOLFINX, *arguments]
    answer = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert (answer.returncode, answer.stdout) == (2, "")
    assert answer.stderr.startswith("error: ")
    assert len(answer.stderr.splitlines()) == 1
    assert how_to_get_dolfinx() in answer.stderr
    assert list(tmp_path.iterdir()) == []
