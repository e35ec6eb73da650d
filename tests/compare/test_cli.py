"""The command line as a user meets it: what is written and printed, exit codes, and messages without tracebacks.

Most calls run `compare.cli.main.main` in this process; Ctrl-C and a machine without dolfinx need one of their own.
"""

import importlib.util
import json
import re
import signal
import subprocess
import sys
from importlib import metadata
from typing import NamedTuple
from xml.etree import ElementTree

import h5py
import meshio
import numpy as np
import pytest

from compare.cli import main as cli
from explicit.run import HISTORY_ROWS, MAX_TIME
from mpm.caches import COMPILING
from mpm.fields import UNITS
from mpm.load import load_scene, preset_names
from mpm.provenance import how_to_get_dolfinx
from mpm.results import Results
from mpm.scene import Explicit, Output

COARSE = ("column_small", "--set", "grid.cell=0.25")
TINY = (*COARSE, "--set", "explicit.until=0.05", "--set", "output.every=0.02")
CONTRACT = {
    *("mode", "scene", "points", "cells_per_radius", "precision", "device", "steps", "sim_time", "wall_s", "setup_s"),
    *("stop_reason", "R_max", "R_995", "R_connected", "h_inf", "mass_error", "grid_ke_ratio", "peak_memory_mb"),
    *("point_steps_per_s", "eq4", "eq45"),
}
IMPLICIT_CONTRACT = {
    *(CONTRACT - {"mass_error", "grid_ke_ratio"}),
    *("newton_iterations", "linear_iterations", "failed_steps", "unbalanced_ratio", "regularisation"),
}
needs_dolfinx = pytest.mark.skipif(
    None in (importlib.util.find_spec("dolfinx"), importlib.util.find_spec("petsc4py")),
    reason="dolfinx or petsc4py is not installed (see ./repose info)",
)
PROGRAM = (sys.executable, "-c", "from compare.cli.main import main; main()")


class Answer(NamedTuple):
    code: int
    out: str
    err: str


def call(capsys, *arguments) -> Answer:
    """`repose ARGUMENTS` in this process; any exception but SystemExit would be a traceback for the user."""
    capsys.readouterr()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["repose", *map(str, arguments)])
        with pytest.raises(SystemExit) as end:
            cli.main()
    printed = capsys.readouterr()
    assert "Traceback" not in printed.err + printed.out
    return Answer(end.value.code or 0, printed.out, but_compiling(printed.err))


def but_compiling(err: str) -> str:
    """What was said on stderr but for the line that the first test to need a kernel on this machine brings."""
    return err.replace(f"{COMPILING}\n", "")


@pytest.fixture
def repose(capsys, tmp_path, monkeypatch):
    """Calls the program in an empty folder."""
    monkeypatch.chdir(tmp_path)
    return lambda *arguments: call(capsys, *arguments)


@pytest.fixture
def refused(repose):
    """Calls the program, which must refuse: its message, of whole lines that start with "error: "."""

    def refuse(*arguments) -> str:
        answer = repose(*arguments)
        assert answer.code == 2
        assert answer.out == ""
        assert all(line.startswith("error: ") for line in answer.err.splitlines())
        return answer.err

    return refuse


def start(*arguments, cwd) -> subprocess.Popen:
    command = [*PROGRAM, *map(str, arguments)]
    return subprocess.Popen(command, cwd=cwd, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


# run, plot, resume


def test_run_writes_results_summary_and_paraview_files(repose, tmp_path):
    answer = repose("run", *TINY)
    assert answer.code == 0
    assert answer.err == ""
    folder = tmp_path / "runs" / "column_small-explicit"
    assert {path.name for path in folder.iterdir()} == {"results.h5", "checkpoint.h5", "summary.json", "vtk"}
    assert (folder / "vtk" / "run.pvd").is_file()
    summary = json.loads((folder / "summary.json").read_text())
    assert set(summary) >= CONTRACT
    assert (summary["mode"], summary["scene"], summary["device"]) == ("explicit", "column_small", "cpu")
    assert (summary["points"], summary["cells_per_radius"], summary["precision"]) == (208, 4.0, "float64")
    assert summary["sim_time"] == pytest.approx(0.05)
    assert summary["stop_reason"] == "end_time"
    assert summary["mass_error"] < 1e-12
    assert 0 < summary["grid_ke_ratio"] <= 1
    # tan(37.55 degrees) is 0.7687, so the values differ a little from those for 0.77
    assert (summary["eq4"], summary["eq45"]) == pytest.approx((0.3069, 0.4183), rel=4e-3)
    run = Results.open(folder)
    np.testing.assert_allclose(run.times, [0.0, 0.02, 0.04, 0.05])
    assert run.scene.grid.cell == 0.25
    assert run.read_static("x0").shape == (208, 3)
    assert np.all(np.diff(run.history()["time"]) > 0)


def test_run_prints_banner_and_table_with_units(repose):
    printed = repose("run", *TINY, "--out", "mine").out
    assert "column_small: explicit, 208 points" in printed
    assert "float64, cpu" in printed
    for text in ("final height h_inf [m]", "simulated time [s]", "time stepping [s]", "peak memory [MB]", "end_time"):
        assert text in printed
    assert "results in mine (`repose plot mine` draws them; ParaView opens vtk/run.pvd)" in printed


def test_paraview_is_not_mentioned_where_nothing_was_written_for_it(repose, tmp_path):
    answer = repose("run", *TINY, "--set", "output.vtk=false", "--out", "mine")
    assert "ParaView" not in answer.out
    assert not (tmp_path / "mine" / "vtk").exists()


def test_a_folder_name_with_brackets_is_printed_as_it_is(repose, tmp_path):
    answer = repose("run", *TINY, "--out", "[a] :s: [b]")
    assert "results in [a] :s: [b] (" in answer.out
    assert (tmp_path / "[a] :s: [b]" / "results.h5").is_file()


def test_plot_makes_three_pictures(repose, tmp_path):
    repose("run", *TINY, "--out", "mine")
    answer = repose("plot", "mine")
    assert answer.code == 0
    assert answer.out.split() == ["mine/morphology.png", "mine/profile.png", "mine/history.png"]
    for name in answer.out.split():
        assert (tmp_path / name).read_bytes().startswith(b"\x89PNG")


def test_a_box_is_plotted_without_a_radial_profile(repose, tmp_path):
    scene = ("self_weight", "--set", "explicit.until=0.01")
    assert repose("run", *scene, "--out", "box").code == 0
    answer = repose("plot", "box")
    assert answer.code == 0
    assert answer.out.split() == ["box/morphology.png", "box/history.png"]
    assert json.loads((tmp_path / "box" / "summary.json").read_text())["eq4"] is None


def test_a_folder_in_use_is_refused_and_force_replaces_the_run(repose, refused, tmp_path):
    repose("run", *TINY, "--out", "mine")
    (tmp_path / "mine" / "notes.txt").write_text("keep me")
    before = (tmp_path / "mine" / "results.h5").read_bytes()
    message = refused("run", *TINY, "--out", "mine")
    assert "mine is not empty" in message
    assert "--force" in message and "repose resume mine" in message
    assert (tmp_path / "mine" / "results.h5").read_bytes() == before
    assert len(list((tmp_path / "mine" / "vtk").glob("*.vtu"))) == 4
    assert repose("run", *COARSE, "--set", "explicit.until=0.01", "--out", "mine", "--force").code == 0
    assert json.loads((tmp_path / "mine" / "summary.json").read_text())["sim_time"] == pytest.approx(0.01)
    assert len(list((tmp_path / "mine" / "vtk").glob("*.vtu"))) == 2
    assert (tmp_path / "mine" / "notes.txt").read_text() == "keep me"


# export


def test_export_writes_chosen_fields_again_as_vtu_or_csv(repose, refused, tmp_path):
    repose("run", *TINY, "--set", "output.vtk=false", "--out", "mine")
    answer = repose("export", "mine")
    assert (answer.code, answer.out) == (0, "mine/vtk/run.pvd lists 4 snapshots\n")
    assert set(meshio.read("mine/vtk/000003.vtu").point_data) == set(UNITS) - {"volume"}  # not stored by default
    answer = repose("export", "mine", "--fields", "pressure", "velocity", "--out", "there")
    assert answer.out == "there/run.pvd lists 4 snapshots\n"
    assert set(meshio.read("there/000003.vtu").point_data) == {"pressure", "velocity"}
    answer = repose("export", "mine", "--format", "csv", "--fields", "pressure", "eps_p_eqv")
    assert answer.out == "mine/csv/snapshots.csv lists 4 snapshots\n"
    heading, *rows = (tmp_path / "mine" / "csv" / "000003.csv").read_text().splitlines()
    assert heading == "x [m],y [m],z [m],pressure [Pa],eps_p_eqv [-]"
    assert len(rows) == 208
    message = refused("export", "mine", "--fields", "velocity", "speed")
    assert message.startswith("error: no field speed in mine: it has displacement, ")
    assert "no run in nowhere" in refused("export", "nowhere")


# scenes, info, validate


def test_scenes_lists_every_preset_in_a_line(repose):
    answer = repose("scenes")
    lines = answer.out.splitlines()
    assert (answer.code, [line.split()[0] for line in lines]) == (0, preset_names())
    assert all(line.endswith(".") for line in lines)  # the whole sentence, not its first line
    assert "lambda0 = 4" in next(line for line in lines if line.startswith("column_4"))


def test_a_scene_that_is_shown_is_the_preset_s_file(repose, refused, tmp_path):
    """Printed into a file it is a scene to start from, whatever else of that name lies in the folder."""
    (tmp_path / "column_small").write_text("not a scene")
    answer = repose("scenes", "--show", "column_small")
    assert (answer.code, answer.err) == (0, "")
    (tmp_path / "mine.toml").write_text(answer.out)
    (tmp_path / "column_small").unlink()
    assert load_scene("mine.toml") == load_scene("column_small")
    assert answer.out.startswith("# A small column for a first look")
    message = refused("scenes", "--show", "column_smal")
    assert message.startswith("error: scene 'column_smal': no such preset; did you mean 'column_small'?")
    assert "no such preset" in refused("scenes", "--show", "mine.toml")


@pytest.mark.parametrize("before", ["run", "validate", "compare", "study error", "scenes --show"])
def test_the_shell_completes_names_of_presets(repose, monkeypatch, before):
    """Of files, as `my.to`, nothing is said: a shell completes them itself."""
    monkeypatch.setenv("_REPOSE_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_CWORD", str(1 + len(before.split())))
    for typed, names in (("", preset_names()), ("column_s", ["column_small"]), ("my.to", [])):
        monkeypatch.setenv("COMP_WORDS", f"repose {before} {typed}")
        answer = repose()
        assert (answer.code, answer.out.split()) == (0, names)


def test_version_is_that_of_the_package(repose):
    answer = repose("--version")
    assert (answer.code, answer.err) == (0, "")
    assert answer.out == f"repose {metadata.version('repose')}\n"


def test_info_lists_versions_and_devices(repose):
    answer = repose("info")
    assert (answer.code, answer.err) == (0, "")
    assert re.search(rf"numpy +{re.escape(np.__version__)} +everything", answer.out)
    assert re.search(r"warp +\d+\.\d+\.\d+ +the explicit solver", answer.out)
    assert re.search(r"device cpu: .+, [\d,]+ MB", answer.out)
    assert re.search(r"commit ([0-9a-f]{40}|unknown)", answer.out)


@needs_dolfinx
def test_info_lists_what_the_implicit_solver_runs_on(repose):
    from implicit._dolfinx import libraries

    answer = repose("info")
    for name, version in libraries().items():
        assert re.search(rf"\n +{name} +{re.escape(version)} +the implicit solver", answer.out)


def test_info_says_how_to_get_what_is_missing_in_a_line_to_copy(tmp_path):
    command = [sys.executable, "-c", HIDE_DOLFINX, "info"]
    answer = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert (answer.returncode, answer.stderr) == (0, "")
    assert "explicit solver" in answer.stdout
    (line,) = [line for line in answer.stdout.splitlines() if line.startswith("the implicit solver needs dolfinx")]
    assert how_to_get_dolfinx() in line


def test_validate_says_what_would_run(repose, tmp_path):
    answer = repose("validate", *COARSE)
    assert (answer.code, answer.err) == (0, "")
    assert "column_small: valid. 208 points, cell 0.25 m" in answer.out
    assert "first time step 0.001994 s" in answer.out  # 0.5 * 0.25 m / 62.70 m/s, the P-wave's speed
    assert "sqrt(h0/g) = 0.2258 s" in answer.out
    assert "eq4 = 0.307" in answer.out and "eq45 = 0.419" in answer.out
    assert list(tmp_path.iterdir()) == []


def test_validate_of_a_box_has_no_theory_and_takes_a_fixed_time_step(repose):
    answer = repose("validate", "elastic_bar", "--set", "explicit.time_step=1e-5")
    assert answer.code == 0
    assert len(answer.out.splitlines()) == 2
    assert "first time step 1e-05 s" in answer.out


def test_validate_refuses_what_run_refuses_at_its_first_step_in_the_same_words(repose, tmp_path):
    """h/c = 3.988 ms; for the implicit solver, which has no such step, the scene is valid."""
    setting = ("--set", "explicit.time_step=1.0")
    validated, run = repose("validate", *COARSE, *setting), repose("run", *COARSE, *setting)
    assert (validated.code, run.code) == (2, 2)
    assert validated.err == run.err and validated.out == run.out == ""
    assert "explicit.time_step = 1: over the Courant limit, must be at most h/(c + |v|) = 0.003988 [s]" in run.err
    assert list(tmp_path.iterdir()) == []


@needs_dolfinx
def test_validate_speaks_for_the_solver_that_is_asked_for_and_tells_of_the_other(repose):
    answer = repose("validate", *COARSE, "--set", "explicit.time_step=1.0", "--mode", "implicit")
    assert (answer.code, answer.err) == (0, "")
    assert "the explicit solver would refuse it: explicit.time_step = 1: over the Courant limit" in answer.out
    assert "first time step" not in answer.out
    setting = ("--set", "loads.ramp=0.5")
    answer = repose("validate", *COARSE, *setting)
    assert (answer.code, answer.err) == (0, "")
    assert "the implicit solver would refuse it: loads.ramp = 0.5" in answer.out
    validated = repose("validate", *COARSE, *setting, "--mode", "implicit")
    run = repose("run", *COARSE, *setting, "--mode", "implicit")
    assert validated.code == run.code == 2 and validated.err == run.err


@pytest.mark.parametrize(
    ("setting", "doubt"),
    [
        ("material.friction_angle=0.655", "warning: material.friction_angle = 0.655: is it in degrees? in radians"),
        ("material.young=4e5", "warning: material.young = 400000: is it in Pa?"),
        ("material.density=2", "warning: material.density = 2: is it in kg/m3?"),
    ],
)
def test_values_that_look_like_another_unit_are_taken_with_a_warning(repose, setting, doubt):
    for arguments in (("validate", *TINY), ("run", *TINY, "--set", "explicit.until=0.002")):
        answer = repose(*arguments, "--set", setting)
        assert answer.code == 0
        assert answer.err.startswith(doubt) and len(answer.err.splitlines()) == 1


def test_what_stands_has_no_eq4_and_is_said_to_stand(repose, tmp_path):
    for arguments in (("validate", *TINY), ("run", *TINY)):
        answer = repose(*arguments, "--set", "material.cohesion=5000")
        assert (answer.code, answer.err) == (0, "")
        assert "column_small: it stands: its height 0.5 m is below" in answer.out
        assert "theory" not in answer.out and "eq4 =" not in answer.out
    summary = json.loads((tmp_path / "runs" / "column_small-explicit" / "summary.json").read_text())
    assert summary["eq4"] is None and summary["eq45"] is None
    assert repose("plot", "runs/column_small-explicit").code == 0


def test_messages_name_the_program_as_it_was_called(repose, refused, monkeypatch):
    monkeypatch.setenv("REPOSE_COMMAND", "./repose")
    assert "(`./repose plot 'my run'` draws them" in repose("run", *TINY, "--out", "my run").out
    assert "`./repose resume 'my run'` continues it" in refused("run", *TINY, "--out", "my run")
    assert "(`./repose scenes` lists them)" in refused("run", "no_such_scene")


def test_the_defaults_that_the_keys_descriptions_state_are_the_run_loops():
    keys = Output.model_fields | Explicit.model_fields
    assert f"default {MAX_TIME:g} sqrt(height/gravity)" in keys["max_time"].description
    assert f"default sqrt(height/gravity)/{HISTORY_ROWS:g}" in keys["history_every"].description


def test_table1_is_for_quarter_columns(repose):
    answer = repose("validate", "elastic_bar", "--table1")
    assert answer.code == 2
    assert "quarter columns only" in answer.err


def test_help_names_every_command(repose):
    answer = repose("--help")
    assert answer.code == 0
    for command in ("run", "resume", "plot", "validate", "scenes", "info", "demo"):
        assert re.search(rf"\b{command}\b", answer.out)
    assert "./repose test" in answer.out  # which the script of that name answers itself


# Exit code 2: the input is wrong

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


HIDE_DOLFINX = """
import sys
class Hide:
    def find_spec(self, name, path=None, target=None):
        if name in ("dolfinx", "ufl"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Hide())
from compare.cli.main import main
main()
"""


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


# Implicit mode


@needs_dolfinx
def test_implicit_mode_stops_resumes_and_is_drawn_as_the_explicit_one(repose, tmp_path):
    class Impatient(cli.Monitor):
        def row(self, run, row):
            super().row(run, row)
            if row["step"] == 3:
                signal.raise_signal(signal.SIGINT)

    settings = ("--set", "implicit.max_steps=6", "--set", "output.every=0.2")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cli, "Monitor", Impatient)
        answer = repose("run", *COARSE, *settings, "--mode", "implicit")
    assert answer.code == 130
    assert re.match(r"column_small: implicit, 208 points, \d+ unknowns, dt = \S+ s, float64, cpu \(.+\), ", answer.out)
    so_far = r"\nstep 1 of at most 6, about \d+% of the way to rest, run-out .+, unbalanced \d\.\de-\d\d\n"
    assert re.search(so_far, answer.out)
    where = "runs/column_small-implicit"
    assert re.fullmatch(rf"stopped at t = \S+ s; `repose resume {where}` goes on\n", answer.err)

    answer = repose("resume", where)
    assert (answer.code, answer.err) == (0, "")
    for text in ("pseudo-time [s]", "Newton iterations", "failed steps", "external forces", "max_steps"):
        assert text in answer.out
    assert "kinetic" not in answer.out
    folder = tmp_path / where
    summary = json.loads((folder / "summary.json").read_text())
    assert set(summary) >= IMPLICIT_CONTRACT
    assert (summary["mode"], summary["device"], summary["precision"]) == ("implicit", "cpu", "float64")
    assert (folder / "vtk" / "run.pvd").is_file()
    assert repose("plot", where).out.split() == [f"{where}/{name}.png" for name in ("morphology", "profile", "history")]


@needs_dolfinx
def test_implicit_mode_refuses_a_gpu(refused, tmp_path):
    message = refused("run", *COARSE, "--mode", "implicit", "--device", "cuda:0")
    assert message == "error: --device cuda:0: the implicit solver runs on the CPU\n"
    assert list(tmp_path.iterdir()) == []


@needs_dolfinx
def test_demo_ends_with_the_page_to_open_that_compare_makes(repose, tmp_path, monkeypatch):
    monkeypatch.setattr(
        cli, "DEMO", ("column_small", ["grid.cell=0.25", "explicit.max_time=0.2", "implicit.max_steps=3"])
    )
    answer = repose("demo")
    assert (answer.code, answer.err) == (0, "")
    report = json.loads((tmp_path / "runs" / "demo" / "report.json").read_text())
    runs = {name: report["runs"][name]["R_995"] for name in ("explicit, D = 0.4", "implicit")}
    explicit, implicit = (f"{value:.4f}" for value in runs.values())
    *_, run_outs, page = answer.out.splitlines()
    assert run_outs == f"run-out R_995: explicit {explicit}, implicit {implicit}; quasistatic theory (Eq. 4) 0.3074"
    assert page == "open runs/demo/report.html in a browser"
    assert "draws them" not in answer.out
    html = (tmp_path / "runs" / "demo" / "report.html").read_text(encoding="utf-8")
    assert html.count("data:image/png;base64,") == 5
    assert len(list(tmp_path.glob("runs/demo/runs/*/vtk/run.pvd"))) == 4
    assert repose("demo").code == 0  # replaces the last one


def snapshots_for_paraview(folder) -> list[float]:
    """Times [s] that folder/vtk/run.pvd lists; the files are there."""
    entries = ElementTree.parse(folder / "vtk" / "run.pvd").getroot().findall("Collection/DataSet")
    assert all((folder / "vtk" / entry.get("file")).is_file() for entry in entries)
    return [float(entry.get("timestep")) for entry in entries]


# Exit code 3: the numbers go wrong


def test_a_time_step_that_motion_makes_too_long_names_the_courant_limit(repose, tmp_path):
    scene = load_scene("column_small", ["grid.cell=0.25"])
    step = 0.9995 * scene.grid.cell / scene.material.constants().p_wave_speed
    answer = repose("run", *TINY, "--set", f"explicit.time_step={step}", "--out", "mine")
    assert answer.code == 3
    assert re.match(r"numerical failure: time step refused at t = 0\.0\d+ s, step \d+: ", answer.err)
    assert f"explicit.time_step = {step:.4g}: over the Courant limit, must be at most h/(c + |v|) = " in answer.err
    assert re.search(r"last good state: t = 0\.0\d+ s in mine/checkpoint\.h5", answer.err)
    assert answer.out.endswith("ParaView opens mine/vtk/run.pvd, up to the last snapshot\n")
    assert snapshots_for_paraview(tmp_path / "mine") == list(Results.open(tmp_path / "mine").times)
    state = Results.open(tmp_path / "mine").read_checkpoint()
    assert state["x"].shape == (208, 3)
    assert np.isfinite(state["x"]).all()
    assert not (tmp_path / "mine" / "summary.json").exists()


# Exit code 1: the machine fails


def test_a_full_disk_is_an_error_line(repose, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Results, "write_snapshot", full)
    answer = repose("run", *TINY)
    assert answer.code == 1
    assert answer.err == "error: [Errno 28] No space left on device\n"


# Ctrl-C


def test_ctrl_c_leaves_a_checkpoint_from_which_resume_finishes(tmp_path):
    until = 20.0  # a second or two: long enough to be interrupted
    settings = ["--set", f"explicit.until={until}", "--set", "output.every=5", "--set", "output.vtk=false"]
    process = start("run", *COARSE, *settings, "--out", "mine", cwd=tmp_path)
    assert process.stdout.readline().startswith("column_small: explicit, 208 points")
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "Traceback" not in err
    assert re.fullmatch(r"stopped at t = \S+ s; `repose resume mine` goes on\n|interrupted\n", but_compiling(err))
    stopped = Results.open(tmp_path / "mine").read_checkpoint()["clock"][0]
    assert stopped < until
    assert not (tmp_path / "mine" / "summary.json").exists()

    process = start("resume", "mine", cwd=tmp_path)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, but_compiling(err)) == (0, "")
    assert "end_time" in out
    run = Results.open(tmp_path / "mine")
    times = run.history()["time"]
    assert times[0] == 0.0
    assert times[-1] == pytest.approx(until)
    assert np.all(np.diff(times) > 0)
    np.testing.assert_allclose(run.times, [0.0, 5.0, 10.0, 15.0, 20.0])
    assert run.summary()["sim_time"] == pytest.approx(until)
    with h5py.File(tmp_path / "mine" / "results.h5") as file:
        assert bool(file.attrs["finished"])


def test_ctrl_c_in_the_middle_says_where_it_stopped(repose, tmp_path):
    """Without timing: the signal arrives as the third history row is shown."""

    class Impatient(cli.Monitor):
        rows = 0

        def row(self, run, row):
            self.rows += 1
            if self.rows == 3:
                signal.raise_signal(signal.SIGINT)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cli, "Monitor", Impatient)
        answer = repose("run", *COARSE, "--set", "explicit.until=0.2", "--out", "mine")
    assert answer.code == 130
    run = Results.open(tmp_path / "mine")
    stopped = float(run.read_checkpoint()["clock"][0])
    assert 0 < stopped < 0.2
    assert answer.err == f"stopped at t = {stopped:.6g} s; `repose resume mine` goes on\n"
    assert answer.out.endswith("ParaView opens mine/vtk/run.pvd, up to the last snapshot\n")
    assert snapshots_for_paraview(tmp_path / "mine") == list(run.times) == [0.0]
    assert run.history()["time"][-1] == pytest.approx(stopped)
    assert repose("resume", "mine").code == 0
    times = run.history()["time"]
    assert np.all(np.diff(times) > 0)
    assert times[-1] == pytest.approx(0.2)
    assert snapshots_for_paraview(tmp_path / "mine") == list(run.times)


def killed_at_a_snapshot(number, tmp_path) -> Results:
    """A run whose process gets the signal `number` once its third snapshot is there."""
    settings = ("--set", "explicit.until=20", "--set", "output.every=0.5")
    process = start("run", *COARSE, *settings, "--out", "mine", cwd=tmp_path)
    assert process.stdout.readline().startswith("column_small: explicit, 208 points")
    run = Results.open(tmp_path / "mine")
    while run.read_checkpoint()["snapshots"] < 3:  # replaced whole, where the results are in the middle of a write
        assert process.poll() is None
    process.send_signal(number)
    _, err = process.communicate(timeout=60)
    assert process.returncode == (130 if number == signal.SIGTERM else -number), err
    assert not (tmp_path / "mine" / "summary.json").exists()
    return run


def test_a_killed_run_is_exported_and_resumed_with_all_its_paraview_files(repose, tmp_path):
    """kill -9: nothing can be written at that moment."""
    run = killed_at_a_snapshot(signal.SIGKILL, tmp_path)
    assert not (tmp_path / "mine" / "vtk").exists()
    assert repose("export", "mine").code == 0
    assert snapshots_for_paraview(tmp_path / "mine") == list(run.times)
    assert repose("resume", "mine").code == 0
    np.testing.assert_allclose(snapshots_for_paraview(tmp_path / "mine"), np.arange(41) * 0.5)


def test_kill_stops_a_run_as_ctrl_c_does(repose, tmp_path):
    run = killed_at_a_snapshot(signal.SIGTERM, tmp_path)
    assert snapshots_for_paraview(tmp_path / "mine") == list(run.times)
    assert repose("resume", "mine").code == 0
    assert run.summary()["sim_time"] == pytest.approx(20.0)
