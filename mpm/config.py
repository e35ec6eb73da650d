"""The scene file: TOML in, validated models out. Every quantity has its unit; an unknown key is an error.

`load_scene` reports every problem of a file at once, one line each: key, value, accepted range, unit.
"""

import difflib
import math
import os
import tomllib
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from mpm.command import command
from mpm.drucker_prager import CONES, Constants, dilatancy_slope, friction_cone
from mpm.errors import SceneError
from mpm.fields import PLASTIC, UNITS
from mpm.wording import explain, says_less, shown

Wall = Literal["free", "roller", "fixed"]
Symmetry = Literal["quarter", "half", "full"]
FIELDS = tuple(UNITS)
MOST_POINTS = 1e9  # beyond this a length was meant in another unit; it would exhaust memory


def quantity(unit: str, description: str, default: Any = ..., **bounds):
    """A field with its unit: part of the description, of error messages and of the schema."""
    return Field(default, description=f"{description} [{unit}]", json_schema_extra={"unit": unit}, **bounds)


class Section(BaseModel):
    # Strict: without it `density = true` is 1 kg/m3 and `vtk = "off"` is false. An integer is a number all the same.
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)


class Column(Section):
    """Upright cylinder on a rough base; symmetry planes x = 0 (quarter) and y = 0 (quarter, half)."""

    shape: Literal["column"] = Field(description="geometry: column, box or mesh")
    radius: float = quantity("m", "initial radius r0", gt=0)
    aspect_ratio: float = quantity("-", "lambda0 = h0/r0", gt=0, le=50)
    symmetry: Symmetry = Field("quarter", description="part of the column that is computed")

    @property
    def height(self) -> float:
        """h0 [m]."""
        return self.radius * self.aspect_ratio


class Walls(Section):
    """Condition on each face of a box; a roller holds the normal component, fixed holds all."""

    x_min: Wall = Field("free", description="face x = 0")
    x_max: Wall = Field("free", description="face x = size[0]")
    y_min: Wall = Field("free", description="face y = 0")
    y_max: Wall = Field("free", description="face y = size[1]")
    z_min: Wall = Field("fixed", description="face z = 0")
    z_max: Wall = Field("free", description="face z = size[2]")


class Box(Section):
    """Rectangular block from the origin to `size`, with a wall condition on each face."""

    shape: Literal["box"] = Field(description="geometry: column, box or mesh")
    size: tuple[Annotated[float, Field(gt=0)], Annotated[float, Field(gt=0)], Annotated[float, Field(gt=0)]] = quantity(
        "m",
        "edge lengths along x, y, z",
        strict=False,  # TOML has lists, no tuples
    )
    walls: Walls = Field(Walls(), description="condition on each face")


class Mesh(Section):
    """Body read from a mesh file (`mpm.mesh_file`), surface or volume cells: its coordinates times unit plus offset."""

    shape: Literal["mesh"] = Field(description="geometry: column, box or mesh")
    file: str = Field(description="mesh file, relative to the scene file")
    symmetry: Symmetry = Field("full", description="part of the body that is computed")
    unit: Literal["m", "cm", "mm"] = Field("m", description="unit of the file's coordinates")
    offset: tuple[float, float, float] = quantity(
        "m",
        "added to the file's coordinates",
        (0.0, 0.0, 0.0),
        strict=False,  # TOML has lists, no tuples
    )
    base: Literal["floor", "as_is"] = Field(
        "floor", description="floor: the body must stand on z = 0; as_is: it may start above it"
    )


class Grid(Section):
    cell: float = quantity("m", "edge length h of a background cell", gt=0)
    points_per_cell: Literal[2] = Field(2, description="points per cell and axis; the uGIMP half-length is h/4")
    extent: Literal["material", "paper"] = Field(
        "material",
        description="material: the grid follows the points; paper: rollers at x, y = 4 h0 as in Table 1",
    )
    scatter: float = quantity("-", "share of their spacing within which points start at random places", 0.0, ge=0, le=1)
    realisation: int = quantity("-", "which of the random starts, where scatter > 0", 0, ge=0)


class Material(Section):
    model: Literal["drucker_prager", "elastic"] = Field("drucker_prager", description="constitutive law")
    young: float = quantity("Pa", "Young's modulus E", gt=0)
    poisson: float = quantity("-", "Poisson's ratio", ge=0, le=0.499)
    density: float = quantity("kg/m3", "bulk density", gt=0)
    friction_angle: float = quantity("degrees", "angle of friction phi", 0.0, ge=0, le=80)
    cohesion: float = quantity("Pa", "cohesion c", 0.0, ge=0)
    dilatancy_angle: float = quantity("degrees", "angle of dilatancy psi", 0.0, ge=0, le=80)
    cone: Literal[CONES] = Field("plane_strain", description="how the cone is matched to Mohr-Coulomb")

    def constants(self) -> Constants:
        """Moduli and cone constants (see `mpm.drucker_prager`)."""
        eta, xi = friction_cone(self.friction_angle, self.cohesion, self.dilatancy_angle, self.cone)
        return Constants(
            bulk=self.young / (3.0 * (1.0 - 2.0 * self.poisson)),
            shear=self.young / (2.0 * (1.0 + self.poisson)),
            eta=eta,
            eta_bar=dilatancy_slope(self.dilatancy_angle, self.cone),
            xi=xi,
            density=self.density,
            plastic=self.model == "drucker_prager",
        )


class Loads(Section):
    gravity: float = quantity("m/s2", "gravity along -z", 9.81, ge=0)
    ramp: float = quantity("s", "time over which gravity grows linearly to its full value", 0.0, ge=0)
    initial_stress: Literal["geostatic", "none"] | None = Field(
        None,
        description="start at rest under gravity (K0), or without stress; default: geostatic if implicit, else none",
    )


class Explicit(Section):
    damping: float = quantity("-", "local damping D", 0.05, ge=0, lt=1)
    cfl: float = quantity("-", "Courant number of the adaptive time step", 0.5, gt=0, le=1)
    time_step: float | None = quantity("s", "fixed time step in place of the adaptive one", None, gt=0)
    until: Literal["rest"] | Annotated[float, Field(gt=0)] = quantity("s", "end time, or 'rest'", "rest")
    max_time: float | None = quantity("s", "end time if rest never comes; default 60 sqrt(height/gravity)", None, gt=0)
    unseen_decay: float | None = quantity(
        "s",
        "decay time of what the grid does not see of a point's velocity; default 4 sqrt(height/gravity)/damping",
        None,
        gt=0,
    )
    precision: Literal["float32", "float64"] = Field("float64", description="floating-point type of the state")


class Implicit(Section):
    load_steps: int = quantity(
        "-", "equal parts in which gravity is added when loads.initial_stress = 'none'", 20, ge=1
    )
    max_steps: int = quantity("-", "most steps of a run that never comes to rest", 1000, ge=1)


class Output(Section):
    every: float = quantity("s", "simulated time between snapshots (and checkpoints)", 0.1, ge=1e-6)
    history_every: float | None = quantity(
        "s",
        "time between history rows; default sqrt(height/gravity)/20, also the most until rest",
        None,
        ge=1e-6,
    )
    fields: tuple[Literal[FIELDS], ...] = Field(
        ("displacement", "velocity", "stress", "eps_p_eqv", "volume_ratio"),
        description="point fields of the snapshots",
        strict=False,
    )
    vtk: bool = Field(True, description="also write ParaView files (vtk/run.pvd)")


class Scene(Section):
    """A validated scene: what to compute, none of how the machine does it."""

    name: str = Field(description="name of the scene", pattern=r"^[A-Za-z0-9._-]+$")
    geometry: Annotated[Column | Box | Mesh, Field(discriminator="shape")]
    grid: Grid
    material: Material
    loads: Loads = Loads()
    explicit: Explicit = Explicit()
    implicit: Implicit = Implicit()
    output: Output = Output()


def preset_names() -> list[str]:
    """Names of the scenes that come with Repose."""
    folder = resources.files("mpm") / "presets"
    return sorted(item.name.removesuffix(".toml") for item in folder.iterdir() if item.name.endswith(".toml"))


def read_scene_file(reference: str) -> tuple[dict, Path]:
    """Raw TOML table of a file or a preset's name, and the folder that relative paths start from.

    Raises SceneError when there is no such file or preset, or the text is not TOML.
    """
    path = Path(reference)
    if not os.path.isfile(path):  # Path.is_file raises on a name that is too long
        if reference not in preset_names():
            near = difflib.get_close_matches(reference, preset_names(), n=1)
            hint = f"; did you mean '{near[0]}'?" if near else ""
            raise SceneError(f"scene '{reference}': no such file or preset{hint} (`{command('scenes')}` lists them)")
        path = Path(str(resources.files("mpm") / "presets" / f"{reference}.toml"))
    try:
        # -sig: some Windows editors put a byte-order mark first
        return tomllib.loads(path.read_text(encoding="utf-8-sig")), path.resolve().parent
    except (ValueError, RecursionError, OSError) as error:  # ValueError: not TOML, not UTF-8, a number too long
        raise SceneError(f"scene '{reference}': not a readable TOML file: {error}") from None


def load_scene(reference: str, overrides: list[str] = ()) -> Scene:
    """Validated scene from a file or preset name, with `key=value` overrides (dotted keys, TOML values).

    Raises SceneError with every problem found, one line each.
    """
    table, folder = read_scene_file(reference)
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
