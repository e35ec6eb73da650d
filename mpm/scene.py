"""The models of a scene file. Every quantity has its unit; an unknown key is an error (see `mpm.load`)."""

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from mpm.drucker_prager import CONES, Constants, dilatancy_slope, friction_cone
from mpm.fields import UNITS
from mpm.gimp import HALF_LENGTH_IN_CELLS

Wall = Literal["free", "roller", "fixed"]
Symmetry = Literal["quarter", "half", "full"]
FIELDS = tuple(UNITS)


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

    @property
    def half_length(self) -> float:
        """Half-length l [m] of a point's domain."""
        return HALF_LENGTH_IN_CELLS * self.cell

    @property
    def point_volume(self) -> float:
        """Initial volume [m3] of a point."""
        return (self.cell / self.points_per_cell) ** 3


class Material(Section):
    model: Literal["drucker_prager", "elastic"] = Field("drucker_prager", description="constitutive law")
    young: float = quantity("Pa", "Young's modulus E", gt=0)
    poisson: float = quantity("-", "Poisson's ratio", ge=0, le=0.499)
    density: float = quantity("kg/m3", "bulk density", gt=0)
    friction_angle: float = quantity("degrees", "angle of friction phi", 0.0, ge=0, le=80)
    cohesion: float = quantity("Pa", "cohesion c", 0.0, ge=0)
    dilatancy_angle: float = quantity("degrees", "angle of dilatancy psi", 0.0, ge=0, le=80)
    cone: Literal[CONES] = Field("plane_strain", description="how the cone is matched to Mohr-Coulomb")  # type: ignore[valid-type]

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
    fields: tuple[Literal[FIELDS], ...] = Field(  # type: ignore[valid-type]
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
