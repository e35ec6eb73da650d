"""A scene file or a preset's name -> a validated scene, or every problem at once, one line each."""

import difflib
import json
import math
import os
import tomllib
from collections.abc import Sequence
from importlib import resources
from pathlib import Path

from pydantic import ValidationError

from mpm.command import command
from mpm.errors import SceneError
from mpm.fields import PLASTIC
from mpm.scene import Box, Column, Mesh, Scene
from mpm.wording import explain, says_less, shown

MOST_POINTS = 1e9  # beyond this a length was meant in another unit; it would exhaust memory


def preset_names() -> list[str]:
    """Names of the scenes that come with Repose."""
    folder = resources.files("mpm") / "presets"
    return sorted(item.name.removesuffix(".toml") for item in folder.iterdir() if item.name.endswith(".toml"))


def preset_file(name: str, wanted: str = "preset") -> Path:
    """File of a preset. Raises SceneError, with the nearest name, where there is none: no such `wanted`."""
    if name not in preset_names():
        near = difflib.get_close_matches(name, preset_names(), n=1)
        hint = f"; did you mean '{near[0]}'?" if near else ""
        raise SceneError(f"scene '{name}': no such {wanted}{hint} (`{command('scenes')}` lists them)")
    return Path(str(resources.files("mpm") / "presets" / f"{name}.toml"))


def read_scene_file(reference: str) -> tuple[dict, Path]:
    """Raw TOML table of a file or a preset's name, and the folder that relative paths start from.

    Raises SceneError when there is no such file or preset, or the text is not TOML.
    """
    path = Path(reference)
    if not os.path.isfile(path):  # Path.is_file raises on a name that is too long
        path = preset_file(reference, "file or preset")
    try:
        # -sig: some Windows editors put a byte-order mark first
        return tomllib.loads(path.read_text(encoding="utf-8-sig")), path.resolve().parent
    except (ValueError, RecursionError, OSError) as error:  # ValueError: not TOML, not UTF-8, a number too long
        raise SceneError(f"scene '{reference}': not a readable TOML file: {error}") from None


def load_scene(reference: str, overrides: Sequence[str] = (), sections: dict | None = None) -> Scene:
    """Validated scene from a file or preset name, with `key=value` overrides (dotted keys, TOML values).

    `sections`: keys to set, section by section, as {"explicit": {"damping": 0.4}}; "name" is a text.
    Raises SceneError with every problem found, one line each.
    """
    table, folder = read_scene_file(reference)
    for name, value in (sections or {}).items():
        both = isinstance(value, dict) and isinstance(table.get(name), dict)
        table[name] = table[name] | value if both else value
    problems = [problem for item in overrides if (problem := _override(table, item))]
    if problems:
        raise SceneError(problems)
    geometry = table.get("geometry")
    if isinstance(geometry, dict) and isinstance(geometry.get("file"), str):
        try:
            geometry["file"] = str((folder / geometry["file"]).resolve())
        except (ValueError, OSError, RuntimeError) as error:  # a zero byte, a loop of links
            raise SceneError(f"geometry.file = {shown(geometry['file'])}: not a file name: {error}") from None
    return parse_scene(table)


def parse_scene(table: dict) -> Scene:
    """Validated scene from a raw table. Raises SceneError with every problem found, one line each."""
    try:
        scene = Scene.model_validate(table)
    except ValidationError as error:
        problems = [explain(item, Scene) for item in error.errors() if not says_less(item)]
        raise SceneError(problems) from None
    if scene.material.model == "elastic" and "fields" not in scene.output.model_fields_set:
        fields = tuple(name for name in scene.output.fields if name not in PLASTIC)
        scene = scene.model_copy(update={"output": scene.output.model_copy(update={"fields": fields})})
    problems = _cross_checks(scene)
    if problems:
        raise SceneError(problems)
    return scene


def _override(table: dict, item: str) -> str | None:
    """Apply `a.b=value` to the raw table; the problem, if any."""
    key, equals, text = item.partition("=")
    if not equals or not key.strip():
        return f"--set {item}: expected key=value, for example explicit.damping=0.4"
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except (ValueError, RecursionError):
        value = text  # a bare word is a string: --set material.cone=inner
    *path, last = key.strip().split(".")
    for name in path:
        table = table.setdefault(name, {})
        if not isinstance(table, dict):
            return f"--set {item}: '{name}' is not a section"
    table[last] = value
    return None


def _cross_checks(scene: Scene) -> list[str]:
    """Problems that only show when several keys are read together."""
    cell, shape, material = scene.grid.cell, scene.geometry, scene.material
    points = _point_count(shape, cell)
    if not points <= MOST_POINTS:  # also true of NaN, from 0 * inf
        return [f"grid.cell = {cell:g}: about {points:.0e} points, must be at most {MOST_POINTS:.0e}; is it in [m]?"]
    problems = []
    if isinstance(shape, Column):
        smallest, name = min((shape.radius, "radius"), (shape.height, "height radius*aspect_ratio"))
        if cell > smallest:
            problems.append(
                f"grid.cell = {cell:g}: the cell is larger than the column, must be <= its {name} = {smallest:g} [m]"
            )
        halves = 2.0 * shape.height / cell
        if not problems and abs(halves - round(halves)) > 1e-6:
            problems.append(
                f"grid.cell = {cell:g}: half a cell must divide the column's height radius*aspect_ratio = "
                f"{shape.height:g} [m], as points are half a cell apart"
            )
        elif scene.grid.extent == "paper" and round(halves) % 2:
            problems.append(
                f"grid.cell = {cell:g}: extent = 'paper' needs whole cells in the height {shape.height:g} [m]"
            )
    if isinstance(shape, Box):
        for axis, length in zip("xyz", shape.size, strict=True):
            halves = 2.0 * length / cell
            if abs(halves - round(halves)) > 1e-6 or round(halves) < 1:
                problems.append(
                    f"geometry.size.{axis} = {length:g}: must be a multiple of half a cell, {cell / 2:g} [m]"
                )
            elif getattr(shape.walls, f"{axis}_max") != "free" and round(halves) % 2:
                problems.append(
                    f"geometry.size.{axis} = {length:g}: a wall at {axis}_max needs whole cells, {cell:g} [m]"
                )
    if material.dilatancy_angle > material.friction_angle:
        problems.append(
            f"material.dilatancy_angle = {material.dilatancy_angle:g}: must be <= friction_angle = "
            f"{material.friction_angle:g} [degrees]"
        )
    if material.model == "drucker_prager" and material.friction_angle == material.cohesion == 0:
        problems.append(
            "material: a Drucker-Prager material needs strength, friction_angle > 0 [degrees] or cohesion > 0 [Pa]"
        )
    if scene.grid.extent == "paper" and not (isinstance(shape, Column) and shape.symmetry == "quarter"):
        problems.append("grid.extent = 'paper': only for a quarter column (Table 1)")
    elif scene.grid.extent == "paper" and 4.0 * shape.height < shape.radius:
        problems.append(
            f"grid.extent = 'paper': its walls at x, y = 4 h0 = {4.0 * shape.height:g} stand inside the column, "
            "geometry.aspect_ratio must be >= 0.25 [-]"
        )
    if scene.loads.ramp > 0 and scene.loads.initial_stress == "geostatic":
        problems.append(f"loads.ramp = {scene.loads.ramp:g}: must be 0 [s] where loads.initial_stress = 'geostatic'")
    if scene.loads.gravity == 0:
        needs = {"explicit.until = 'rest'": scene.explicit.until == "rest"}
        needs |= {"output.history_every": scene.output.history_every is None}
        problems += [
            f"{key}: without gravity it has no time scale, give it in [s]" for key, yes in needs.items() if yes
        ]
    if material.model == "elastic":
        missing = [name for name in scene.output.fields if name in PLASTIC]
        problems += [f"output.fields: '{name}' does not exist when material.model = 'elastic'" for name in missing]
    return problems


def _point_count(shape, cell: float) -> float:
    """Roughly how many points fill a column or box; 0 for a mesh, which is checked once it is read."""
    if isinstance(shape, Mesh):
        return 0.0
    if isinstance(shape, Box):
        return math.prod(2.0 * length / cell for length in shape.size)
    circle = math.pi * {"quarter": 0.25, "half": 0.5, "full": 1.0}[shape.symmetry]
    return circle * (2.0 * shape.radius / cell) * (2.0 * shape.radius / cell) * (2.0 * shape.height / cell)


def to_toml(scene: Scene) -> str:
    """The scene as the text of a scene file: `load_scene` of that file gives the same scene."""
    table = scene.model_dump(mode="json", exclude_none=True)
    sections = [f"[{name}]\n" + _lines(its) for name, its in table.items() if isinstance(its, dict)]
    return "\n".join([_lines({name: its for name, its in table.items() if not isinstance(its, dict)}), *sections])


def _lines(table: dict) -> str:
    return "".join(f"{key} = {_toml(value)}\n" for key, value in table.items())


def _toml(value) -> str:
    """A value of a scene as TOML writes it: of JSON's types all but tables are the same."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {_toml(item)}" for key, item in value.items()) + " }"
    return json.dumps(value)
