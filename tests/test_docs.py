"""README.md and the other pages: commands are ones that the program takes, scenes load, links and files exist, and the
tables of keys are those of the models."""

import re
import runpy
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from typer.core import TyperCommand
from typer.testing import CliRunner

from compare.cli.main import app
from mpm.load import load_scene, preset_names
from mpm.scene import Mesh

ROOT = Path(__file__).parents[1]
PAGES = [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "meshes/README.md", "benchmarks/README.md")),
    *sorted((ROOT / "docs").glob("*.md")),
]
README, SCENE_PAGE = ROOT / "README.md", ROOT / "docs" / "scene.md"
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
every_page = pytest.mark.parametrize("page", PAGES, ids=[str(page.relative_to(ROOT)) for page in PAGES])


def blocks(page: Path, language: str) -> list[str]:
    return [code for name, code in BLOCK.findall(page.read_text(encoding="utf-8")) if name == language]


def commands(page: Path) -> list[tuple[list[str], bool]]:
    """The words after `repose` of each command line of a page, and whether the text only mentions it.

    Those of `./repose test` are pytest's, not the program's.
    """
    lines = [(line, False) for code in blocks(page, "sh") for line in code.replace("\\\n", " ").splitlines()]
    text = BLOCK.sub("", page.read_text(encoding="utf-8"))
    lines += [(code, True) for code in re.findall(r"`((?:\./)?repose [^`]+)`", text)]
    found = []
    for line, mentioned in lines:
        for part in line.replace("\\|", "|").split("&&"):
            program, *words = shlex.split(part, comments=True) or [""]
            if program.removeprefix("./") == "repose" and words[:1] != ["test"]:
                found.append(([word.split("|")[0] for word in words], mentioned))
    return found


@every_page
def test_the_program_takes_every_command_of_a_page(page, monkeypatch):
    """All but computing: options, values and, of a preset, the keys that are set. A text may leave an argument out."""
    taken = []
    monkeypatch.setattr(TyperCommand, "invoke", lambda _command, context: taken.append(context.params))
    for words, mentioned in commands(page):
        answer = CliRunner().invoke(app, words)
        allowed = mentioned and "Missing argument" in answer.output
        assert answer.exit_code == 0 or allowed, f"repose {shlex.join(words)}: {answer.output}"
    for parameters in taken:
        if parameters.get("scene") in preset_names():
            load_scene(parameters["scene"], parameters["set_"])


def test_commands_of_pages_are_found():
    assert (["run", "column_2"], True) in commands(README)
    assert (["run", "column_1", "--set", "grid.cell=0.1", "--mode", "implicit"], False) in commands(README)
    assert (["bench", "explicit"], True) in commands(ROOT / "benchmarks" / "README.md")
    assert len(commands(ROOT / "docs" / "running.md")) > 20


@every_page
def test_links_pictures_and_files_of_a_page_exist(page):
    text = BLOCK.sub("", page.read_text(encoding="utf-8"))
    targets = [target for target in re.findall(r"\]\(([^)]+)\)", text) if "://" not in target]
    missing = [target for target in targets if not (page.parent / target).exists()]
    folders = "mpm|explicit|implicit|compare|docs|meshes|benchmarks|tests"
    files = re.findall(rf"(?<![\w/.])(?:{folders})/[\w./]*\.\w+", text)
    missing += [file for file in files if "NAME" not in file and not (ROOT / file).exists()]
    tables = re.findall(r"(?<![\w/.])\w+_(?:cpu|h200\w*)\.(?:csv|jsonl)", text)
    missing += [table for table in tables if not (ROOT / "benchmarks" / "results" / table).is_file()]
    assert missing == []


def test_the_readme_is_two_screens():
    assert len(README.read_text(encoding="utf-8").splitlines()) <= 120


def test_the_readme_s_python_runs(tmp_path):
    """It prints R_995 = 0.362, as docs/speed.md has it of this column at 8 cells per r0."""
    (code,) = blocks(README, "python")
    assert len(code.splitlines()) <= 10
    ran = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    assert float(re.search(r"R_995 = ([\d.]+)", ran.stdout)[1]) == pytest.approx(0.362, abs=1e-3)
    assert [path.name for path in tmp_path.iterdir()] == ["profile.png"]


def test_the_example_of_the_scene_page_is_a_scene(tmp_path):
    column, mesh = blocks(SCENE_PAGE, "toml")
    (tmp_path / "my.toml").write_text(column, encoding="utf-8")
    assert load_scene(str(tmp_path / "my.toml")).geometry == load_scene("column_0.5").geometry
    values = tomllib.loads(mesh)["geometry"]
    assert Mesh.model_validate(values).unit == "mm"
    assert values.keys() == Mesh.model_fields.keys()


def test_the_tables_of_the_scene_page_are_those_of_the_models():
    """`python docs/make_scene.py` writes them anew."""
    page = SCENE_PAGE.read_text(encoding="utf-8")
    assert runpy.run_path(str(ROOT / "docs" / "make_scene.py"))["updated"](page) == page
    assert "| `density` | number | required | > 0 | kg/m3 | bulk density |" in page
    assert '| `until` | text or number | `"rest"` | `"rest"` or > 0 | s | end time, or \'rest\' |' in page
