"""Scene files: what the presets say, what is refused, and that every refusal tells the user what to do."""

import json
import math
from pathlib import Path
from typing import get_args

import pytest
from pydantic import BaseModel

from mpm import scene as config
from mpm import wording
from mpm.errors import SceneError
from mpm.load import load_scene, parse_scene, preset_names
from mpm.scene import Scene

PAPER = {"column_0.5": 0.5, "column_1": 1.0, "column_2": 2.0, "column_4": 4.0}
BOX = "elastic_bar"
COLUMN = "column_small"


def problems(reference, *overrides):
    with pytest.raises(SceneError) as refusal:
        load_scene(str(reference), list(overrides))
    return refusal.value.problems


def the_problem(reference, *overrides):
    """The one line that refuses the scene."""
    (line,) = problems(reference, *overrides)
    return line


def write(path: Path, text: str) -> str:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return str(path)


COLUMN_TEXT = """
name = "mine"
[geometry]
shape = "column"
radius = 1.0
aspect_ratio = 1.0
[grid]
cell = 0.25
[material]
young = 1e6
poisson = 0.3
density = 2000
friction_angle = 30
"""


# Presets


def test_the_presets_are_the_papers_columns_and_four_small_scenes():
    assert set(preset_names()) == {*PAPER, "column_small", "column_sand", "elastic_bar", "self_weight"}


@pytest.mark.parametrize("name", preset_names())
def test_preset_validates_under_its_own_name(name):
    assert load_scene(name).name == name


@pytest.mark.parametrize(("name", "lambda0"), PAPER.items())
def test_paper_presets_have_the_papers_numbers(name, lambda0):
    scene = load_scene(name)
    assert scene.geometry.shape == "column"
    assert scene.geometry.symmetry == "quarter"
    assert scene.geometry.radius == 1.0
    assert scene.geometry.height == lambda0
    assert scene.grid.cell == 0.05
    material = scene.material
    assert (material.young, material.poisson, material.density) == (5.84e6, 0.3, 2000.0)
    assert (material.cohesion, material.dilatancy_angle) == (0.0, 0.0)
    assert math.tan(math.radians(material.friction_angle)) == pytest.approx(0.77, abs=2e-3)
    assert scene.loads.gravity == 9.81
    assert scene.explicit.damping == 0.05
    assert scene.explicit.until == "rest"


def test_elastic_presets_have_the_closed_forms_that_their_heading_names():
    bar, block = load_scene("elastic_bar"), load_scene("self_weight")
    assert bar.material.constants().p_wave_speed == pytest.approx(100.0)
    assert 4 * bar.geometry.size[2] / 100.0 == pytest.approx(0.08)
    assert bar.explicit.damping == 0.0
    assert block.material.constants().p_wave_modulus == pytest.approx(7.86154e6, rel=1e-6)


# Units


def sections(model=Scene):
    """Every model a scene file can hold, `Scene` first."""
    found = [model]
    for field in model.model_fields.values():
        for part in (field.annotation, *get_args(field.annotation)):
            if isinstance(part, type) and issubclass(part, BaseModel):
                found += sections(part)
    return found


def is_number(annotation) -> bool:
    return annotation is float or any(is_number(part) for part in get_args(annotation))


NUMBERS = [
    (model, name) for model in sections() for name, field in model.model_fields.items() if is_number(field.annotation)
]


def test_the_walk_over_the_sections_misses_none():
    names = {model.__name__ for model in sections()}
    assert names == {
        "Scene",
        "Column",
        "Box",
        "Walls",
        "Mesh",
        "Grid",
        "Material",
        "Loads",
        "Explicit",
        "Implicit",
        "Output",
    }
    assert len(NUMBERS) >= 18


@pytest.mark.parametrize(("model", "name"), NUMBERS, ids=lambda part: getattr(part, "__name__", part))
def test_every_number_says_its_unit_in_description_and_schema(model, name):
    unit = model.model_json_schema()["properties"][name]["unit"]
    assert unit in {"m", "s", "Pa", "kg/m3", "m/s2", "degrees", "-"}
    assert model.model_fields[name].description.endswith(f"[{unit}]")


# One refusal each: the override, and what the line must say (key, value, range, unit or a way out)

REFUSED = [
    (COLUMN, "material.density=-1", ["material.density = -1", "must be > 0", "[kg/m3]"]),
    (COLUMN, "material.friction_angle=95", ["material.friction_angle = 95", ">= 0 and <= 80", "[degrees]"]),
    (COLUMN, "material.poisson=0.5", ["material.poisson = 0.5", "<= 0.499", "[-]"]),
    (COLUMN, "geometry.aspect_ratio=0", ["geometry.aspect_ratio = 0", "must be > 0 and <= 50", "[-]"]),
    (COLUMN, "grid.cell=0", ["grid.cell = 0", "must be > 0", "[m]"]),
    (COLUMN, "explicit.damping=1", ["explicit.damping = 1", ">= 0 and < 1", "[-]"]),
    (COLUMN, "explicit.cfl=1.5", ["explicit.cfl = 1.5", "> 0 and <= 1", "[-]"]),
    (COLUMN, "explicit.time_step=0", ["explicit.time_step = 0", "must be > 0", "[s]"]),
    # wrong type
    (COLUMN, 'material.density="heavy"', ["material.density = 'heavy'", "must be a number > 0", "[kg/m3]"]),
    (COLUMN, "material.density=true", ["material.density = True", "must be a number > 0", "[kg/m3]"]),
    (COLUMN, 'material.density="2000"', ["material.density = '2000'", "must be a number"]),
    (COLUMN, "material.density=[2000]", ["material.density = [2000]", "must be a number"]),
    (COLUMN, "output.every=1979-05-27", ["output.every = ", "must be a number >= 1e-06", "[s]"]),
    (COLUMN, "output.vtk=1", ["output.vtk = 1", "boolean"]),
    (COLUMN, "grid=3", ["grid = 3", "must be a section", "[grid]"]),
    (COLUMN, "geometry=3", ["geometry = 3", "must be a section", "[geometry]"]),
    (COLUMN, "name=a b", ["name = 'a b'", "letters, digits"]),
    (BOX, "geometry.size=[1.0, 2.0]", ["geometry.size.2: missing", "[m]"]),
    (BOX, "geometry.size=[1.0, 1.0, 1.0, 1.0]", ["geometry.size = ", "at most 3"]),
    (BOX, "geometry.size=2.0", ["geometry.size = 2.0", "list"]),
    (BOX, "geometry.size=[0.1, -0.1, 2.0]", ["geometry.size.1 = -0.1", "must be > 0", "[m]"]),
    (BOX, 'geometry.size=[0.1, 0.1, "tall"]', ["geometry.size.2 = 'tall'", "must be a number > 0", "[m]"]),
    # 'rest' or a number: one line that names both
    (COLUMN, "explicit.until=rast", ["explicit.until = 'rast'", "must be 'rest' or a number > 0", "[s]"]),
    (COLUMN, "explicit.until=-1", ["explicit.until = -1", "must be 'rest' or a number > 0", "[s]"]),
    (COLUMN, "explicit.until=true", ["explicit.until = True", "must be 'rest' or a number > 0", "[s]"]),
    # not one of the words
    (COLUMN, "material.cone=round", ["material.cone = 'round'", "'inner', 'outer' or 'plane_strain'"]),
    (COLUMN, "loads.initial_stress=K0", ["loads.initial_stress = 'K0'", "'geostatic' or 'none'"]),
    (COLUMN, "geometry.symmetry=third", ["geometry.symmetry = 'third'", "'quarter', 'half' or 'full'"]),
    (COLUMN, "geometry.shape=cube", ["geometry.shape", "'column', 'box' or 'mesh'"]),
    (COLUMN, 'output.fields=["speed"]', ["output.fields.0 = 'speed'", "'velocity'", "'pressure'"]),
    (COLUMN, "grid.points_per_cell=3", ["grid.points_per_cell = 3", "must be 2"]),
    (BOX, "geometry.walls.x_min=solid", ["geometry.walls.x_min = 'solid'", "'free', 'roller' or 'fixed'"]),
    # keys that do not exist
    (COLUMN, "material.densty=3", ["material.densty: unknown key", "did you mean 'density'?"]),
    (COLUMN, "explicit.dampng=0.1", ["explicit.dampng: unknown key", "did you mean 'damping'?"]),
    (COLUMN, "explict.damping=0.1", ["explict: unknown key", "did you mean 'explicit'?"]),
    (COLUMN, "geometry.height=1.0", ["geometry.height: unknown key", "known here: ", "aspect_ratio"]),
    (COLUMN, "explicit.cell=0.1", ["explicit.cell: unknown key", "it belongs in [grid], as grid.cell"]),
    (COLUMN, "gravity=1.62", ["gravity: unknown key", "it belongs in [loads], as loads.gravity"]),
    (
        COLUMN,
        "implicit.initial_stress=none",
        ["implicit.initial_stress: unknown key", "it belongs in [loads], as loads.initial_stress"],
    ),
    (BOX, "geometry.walls.x_mn=free", ["geometry.walls.x_mn: unknown key", "did you mean 'x_min'?"]),
    # keys of earlier versions
    (
        COLUMN,
        "material.apex_memory=true",
        ["material.apex_memory: no longer a key, delete it", "opens", "always closes before"],
    ),
    (
        COLUMN,
        "explicit.pressure_averaging=false",
        ["explicit.pressure_averaging: no longer a key, delete it", "always averaged"],
    ),
    # several keys read together
    (COLUMN, "grid.cell=0.6", ["grid.cell = 0.6", "larger than the column", "height", "0.5 [m]"]),
    (COLUMN, "grid.cell=1e-5", ["grid.cell = 1e-05", "3e+15 points", "is it in [m]?"]),
    (BOX, "grid.cell=1e-320", ["grid.cell", "points", "is it in [m]?"]),
    (COLUMN, "material.dilatancy_angle=40", ["dilatancy_angle = 40", "<= friction_angle = 37.55", "[degrees]"]),
    (COLUMN, "material.friction_angle=0", ["material", "friction_angle > 0 [degrees]", "cohesion > 0 [Pa]"]),
    (BOX, "geometry.size=[0.1, 0.11, 2.0]", ["geometry.size.y = 0.11", "multiple of half a cell", "0.025 [m]"]),
    (BOX, "geometry.size=[0.125, 0.1, 2.0]", ["geometry.size.x = 0.125", "wall at x_max", "whole cells", "0.05 [m]"]),
    (BOX, "grid.extent=paper", ["grid.extent = 'paper'", "quarter column"]),
    (BOX, 'output.fields=["eps_p_eqv"]', ["output.fields", "eps_p_eqv", "elastic"]),
]


@pytest.mark.parametrize(("reference", "override", "expected"), REFUSED, ids=[case[1] for case in REFUSED])
def test_refusal_says_what_to_do(reference, override, expected):
    line = the_problem(reference, override)
    assert [part for part in expected if part not in line] == [], line
    assert "\n" not in line


@pytest.mark.parametrize(
    ("slip", "meant"),
    [
        ("material.frictionangle", "friction_angle"),
        ("material.youngs", "young"),
        ("material.poison", "poisson"),
        ("material.cohesian", "cohesion"),
        ("material.denisty", "density"),
        ("geometry.raduis", "radius"),
        ("explicit.time_steps", "time_step"),
        ("implicit.load_step", "load_steps"),
        ("output.evry", "every"),
        ("materal", "material"),
    ],
)
def test_a_slip_of_the_pen_gets_the_key_that_was_meant(slip, meant):
    assert the_problem(COLUMN, f"{slip}=1") == f"{slip}: unknown key; did you mean '{meant}'?"


@pytest.mark.parametrize(
    "key",
    ["material.basal_friction", "material.basal_friction_angle", "material.wall_friction_angle",
     "material.bulk_density", "material.viscosity", "explicit.min_time", "explicit.max_steps", "output.freq"],
)  # fmt: skip
def test_a_key_that_means_something_else_gets_no_near_one(key):
    """A key of another section may be named all the same: max_steps belongs in [implicit]."""
    line = the_problem(COLUMN, f"{key}=30")
    assert line.startswith(f"{key}: unknown key; ") and "did you mean" not in line
    assert "known here: " in line or "it belongs in [implicit], as implicit.max_steps" in line


def test_a_wide_cell_is_compared_with_the_radius_of_a_tall_column():
    line = the_problem("column_4", "grid.cell=1.5")
    assert "radius = 1 [m]" in line


def test_paper_extent_is_refused_for_a_full_column():
    line = the_problem(COLUMN, "geometry.symmetry=full", "grid.extent=paper")
    assert "only for a quarter column" in line


def test_the_papers_walls_must_not_stand_inside_the_column():
    """They are at 4 h0: lambda0 = 1/4 just fits."""
    settings = ["grid.extent=paper", "grid.cell=0.125"]
    assert load_scene(COLUMN, [*settings, "geometry.aspect_ratio=0.25"]).geometry.height == 0.25
    line = the_problem(COLUMN, *settings, "geometry.aspect_ratio=0.125")
    assert "walls at x, y = 4 h0 = 0.5" in line and "aspect_ratio must be >= 0.25 [-]" in line


def test_without_gravity_rest_has_no_time_scale():
    rest, history = problems(COLUMN, "loads.gravity=0")
    assert rest.startswith("explicit.until = 'rest'") and "[s]" in rest
    assert history.startswith("output.history_every") and "[s]" in history
    scene = load_scene(COLUMN, ["loads.gravity=0", "explicit.until=1", "output.history_every=0.1"])
    assert scene.explicit.until == 1.0


def test_a_free_face_takes_half_a_cell_and_a_wall_does_not():
    """Points sit half a cell apart, but a wall is a plane of nodes."""
    assert load_scene(BOX, ["geometry.size=[0.1, 0.1, 2.025]"]).geometry.size[2] == 2.025
    assert "z_max" in the_problem(BOX, "geometry.size=[0.1, 0.1, 2.025]", "geometry.walls.z_max=roller")


def test_dilatancy_may_equal_friction():
    assert load_scene(COLUMN, ["material.dilatancy_angle=37.55"]).material.dilatancy_angle == 37.55


@pytest.mark.parametrize("value", ["inf", "-inf", "nan"])
@pytest.mark.parametrize("key", ["material.density", "grid.cell", "loads.gravity", "explicit.until", "output.every"])
def test_infinities_and_nan_are_refused(key, value):
    line = the_problem(COLUMN, f"{key}={value}")
    assert line.startswith(f"{key} = {value}: must be ") and "a number" in line


def test_a_rejected_value_is_repeated_in_short():
    """Also where Python would not write it: an integer of more than 4300 digits."""
    assert len(the_problem(COLUMN, f'name="{"long " * 1000}"')) < 200
    assert len(the_problem(COLUMN, "material.cone=0x" + "f" * 5000)) < 200


def test_all_problems_are_reported_at_once():
    found = problems(
        COLUMN,
        "material.density=-1",
        "grid.cel=0.1",
        "explicit.until=never",
        "material.cone=round",
        "geometry.radius=0",
    )
    keys = {line.split(":")[0].split(" = ")[0] for line in found}
    assert keys == {"material.density", "grid.cel", "explicit.until", "material.cone", "geometry.radius"}
    assert len(found) == 5


def test_all_cross_checks_are_reported_at_once():
    found = problems(BOX, "geometry.size=[0.11, 0.12, 2.0]", "grid.extent=paper", 'output.fields=["eps_p_eqv"]')
    assert [line.split(":")[0] for line in found] == [
        "geometry.size.x = 0.11",
        "geometry.size.y = 0.12",
        "grid.extent = 'paper'",
        "output.fields",
    ]


def test_missing_keys_are_named_with_their_meaning_and_unit(tmp_path):
    path = write(tmp_path / "scene.toml", COLUMN_TEXT.replace("density = 2000", "").replace("cell = 0.25", ""))
    assert problems(path) == [
        "grid.cell: missing, and it has no default (edge length h of a background cell [m])",
        "material.density: missing, and it has no default (bulk density [kg/m3])",
    ]


def test_an_empty_file_names_the_sections_it_needs(tmp_path):
    found = problems(write(tmp_path / "scene.toml", ""))
    assert [line.split(":")[0] for line in found] == ["name", "geometry", "grid", "material"]


# Overrides


def test_overrides_take_toml_values_and_bare_words():
    scene = load_scene(
        COLUMN,
        [
            "explicit.damping=0.25",
            "explicit.until=2",
            "material.cone=inner",
            'explicit.precision="float32"',
            "output.vtk=false",
            'output.fields=["velocity", "stress"]',
            " grid.cell = 0.25",
        ],
    )
    assert scene.explicit.damping == 0.25
    assert scene.explicit.until == 2.0
    assert scene.material.cone == "inner"
    assert scene.explicit.precision == "float32"
    assert scene.output.vtk is False
    assert scene.output.fields == ("velocity", "stress")
    assert scene.grid.cell == 0.25


def test_an_override_may_name_a_section_that_the_file_leaves_out(tmp_path):
    path = write(tmp_path / "scene.toml", COLUMN_TEXT)
    assert load_scene(path, ["loads.ramp=0.5"]).loads.ramp == 0.5


def test_the_last_override_of_a_key_wins():
    assert load_scene(COLUMN, ["explicit.damping=0.1", "explicit.damping=0.2"]).explicit.damping == 0.2


@pytest.mark.parametrize("item", ["explicit.damping", "=0.4", " = 3", ""])
def test_an_override_without_key_or_value_shows_the_form(item):
    assert the_problem(COLUMN, item) == f"--set {item}: expected key=value, for example explicit.damping=0.4"


def test_an_override_below_a_value_is_refused():
    assert the_problem(COLUMN, "grid.cell.x=3") == "--set grid.cell.x=3: 'cell' is not a section"


def test_every_bad_override_is_reported():
    assert len(problems(COLUMN, "nonsense", "grid.cell.x=3", "explicit.damping=0.1")) == 2


# Files


def test_broken_toml_gives_the_place(tmp_path):
    line = the_problem(write(tmp_path / "scene.toml", 'name = "a"\n[grid\ncell = 1\n'))
    assert "scene.toml" in line and "not a readable TOML file" in line and "line 2" in line


@pytest.mark.parametrize(
    "data",
    [b"\xff\xfe\x00", b"x = " + b"[" * 5000, b"x = " + b"9" * 5000, b"x = 2020-13-45", b"a = 1\na = 2"],
    ids=["not UTF-8", "deeply nested", "a number too long", "no such date", "key given twice"],
)
def test_unreadable_files_are_scene_errors(tmp_path, data):
    path = tmp_path / "scene.toml"
    path.write_bytes(data)
    assert "not a readable TOML file" in the_problem(path)


def test_a_byte_order_mark_does_no_harm(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_bytes(b"\xef\xbb\xbf" + COLUMN_TEXT.encode())
    assert load_scene(str(path)).name == "mine"


def test_integers_are_numbers(tmp_path):
    scene = load_scene(write(tmp_path / "scene.toml", COLUMN_TEXT))
    assert scene.material.density == 2000.0
    assert isinstance(scene.material.density, float)


def test_an_unknown_preset_gives_the_nearest_name():
    line = the_problem("colum_2")
    assert "'colum_2': no such file or preset" in line
    assert "did you mean 'column_2'?" in line
    assert "repose scenes" in line


@pytest.mark.parametrize("reference", ["no/such/file.toml", ".", "", "x" * 300, "a\0b"])
def test_what_is_neither_file_nor_preset_is_refused(reference):
    assert "no such file or preset" in the_problem(reference)


def test_a_file_is_preferred_over_a_preset_of_its_name(tmp_path, monkeypatch):
    write(tmp_path / "column_1", COLUMN_TEXT)
    monkeypatch.chdir(tmp_path)
    assert load_scene("column_1").name == "mine"


MESH_TEXT = 'name = "body"\ngeometry = { shape = "mesh", file = "%s" }\n' + COLUMN_TEXT.split("aspect_ratio = 1.0\n")[1]


def test_a_mesh_path_starts_from_the_scenes_folder(tmp_path, monkeypatch):
    path = write(tmp_path / "scenes" / "scene.toml", MESH_TEXT % "../meshes/body.stl")
    monkeypatch.chdir("/")
    assert load_scene(path).geometry.file == str(tmp_path / "meshes" / "body.stl")


def test_an_absolute_mesh_path_stays(tmp_path):
    path = write(tmp_path / "scene.toml", MESH_TEXT % "/data/body.stl")
    assert load_scene(path).geometry.file == "/data/body.stl"


def test_a_mesh_path_that_no_file_can_have_is_refused(tmp_path):
    path = write(tmp_path / "scene.toml", MESH_TEXT % "a\\u0000b")
    assert the_problem(path).startswith("geometry.file = ")


# The resolved scene, as a run stores it


@pytest.mark.parametrize("name", preset_names())
def test_a_resolved_preset_parses_back_to_itself(name):
    scene = load_scene(name)
    assert parse_scene(json.loads(json.dumps(scene.model_dump(mode="json")))) == scene


@pytest.mark.parametrize(
    "overrides",
    [
        ["explicit.until=0.5", "explicit.time_step=1e-4", "output.history_every=0.01", "output.fields=[]"],
        ["material.model=elastic"],  # the default fields are then without eps_p_eqv, and must stay so
        ["geometry.symmetry=full", "explicit.precision=float32", "loads.initial_stress=geostatic"],
    ],
)
def test_a_resolved_scene_parses_back_to_itself(overrides):
    scene = load_scene(COLUMN, overrides)
    assert parse_scene(json.loads(json.dumps(scene.model_dump(mode="json")))) == scene


def test_elastic_scenes_store_no_plastic_strain_by_default():
    assert "eps_p_eqv" in load_scene(COLUMN).output.fields
    assert "eps_p_eqv" not in load_scene(COLUMN, ["material.model=elastic"]).output.fields


def test_initial_stress_is_left_to_the_solver_unless_given():
    """Default None: geostatic in implicit mode, none in explicit mode. The self-weight block settles from no stress."""
    assert load_scene(COLUMN).loads.initial_stress is None
    assert load_scene(COLUMN, ["loads.initial_stress=geostatic"]).loads.initial_stress == "geostatic"
    assert load_scene("self_weight").loads.initial_stress == "none"


@pytest.mark.parametrize("name", sorted(wording.RETIRED))
def test_a_retired_key_is_no_key(name):
    section, key = name.split(".")
    assert key not in Scene.model_fields[section].annotation.model_fields


def test_a_scene_cannot_be_changed():
    scene = load_scene(COLUMN)
    with pytest.raises(ValueError, match="frozen"):
        scene.grid.cell = 0.5


def test_field_names_are_offered_in_full():
    """The list in `config.FIELDS` is what a scene accepts, all at once and one by one."""
    for name in config.FIELDS:
        assert load_scene(COLUMN, [f'output.fields=["{name}"]']).output.fields == (name,)
