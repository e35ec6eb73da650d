"""The command line's words on scenes and this machine: scenes, info, validate, help, and what a run warns of."""

import json
import re
import subprocess
import sys
from importlib import metadata

import numpy as np
import pytest
from installed import needs_implicit
from program import COARSE, HIDE_DOLFINX, TINY

from explicit.run import HISTORY_ROWS, MAX_TIME
from mpm.load import load_scene, preset_names
from mpm.provenance import how_to_get_dolfinx
from mpm.scene import Explicit, Output


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
    for typed, names in (("", preset_names()), ("column_sm", ["column_small"]), ("my.to", [])):
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


@needs_implicit
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


@needs_implicit
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
