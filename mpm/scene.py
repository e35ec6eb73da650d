"""A validated scene -> what a solver starts from: points, walls, constants, how to measure the run-out."""

from dataclasses import dataclass

import numpy as np

from mpm.analytic import critical_height, eq4, eq45
from mpm.config import Box, Column, Scene
from mpm.drucker_prager import Constants
from mpm.fit import Fit
from mpm.geometry import Seeds, scattered, seed
from mpm.gimp import HALF_LENGTH_IN_CELLS
from mpm.lattice import Walls, walls_of
from mpm.runout import Measure


@dataclass(frozen=True)
class Body:
    """Initial state of a scene: `x` (n, 3) [m], `point_volume` [m3], `point_mass` [kg], all points alike; `fit`: its
    points held against the body of a mesh file, None where there is none."""

    scene: Scene
    x: np.ndarray
    point_volume: float
    point_mass: float
    constants: Constants
    walls: Walls
    measure: Measure
    height: float
    fit: Fit | None = None

    @property
    def time_scale(self) -> float:
        """sqrt(h0/g) [s], the time of free fall up to a factor; infinite without gravity."""
        gravity = self.scene.loads.gravity
        return float(np.sqrt(self.height / gravity)) if gravity > 0 else float("inf")


def build(scene: Scene, seeds: Seeds | None = None) -> Body:
    """Seed the points of a scene, or take `seeds` kept from an earlier time (a mesh file may be gone by then).

    Raises SceneError for geometry that cannot be seeded.
    """
    cell = scene.grid.cell
    if seeds is None:
        seeds = seed(scene.geometry, cell)
        if scene.grid.scatter > 0:
            seeds = scattered(seeds, 0.5 * cell, scene.grid.scatter, scene.grid.realisation)
    axes = (0,) if isinstance(scene.geometry, Box) else (0, 1)
    measure = Measure(axes, seeds.reference, HALF_LENGTH_IN_CELLS * cell, cell, seeds.axis)
    constants = scene.material.constants()
    volume = (0.5 * cell) ** 3
    return Body(
        scene=scene,
        x=seeds.x,
        point_volume=volume,
        point_mass=constants.density * volume,
        constants=constants,
        walls=walls_of(scene),
        measure=measure,
        height=seeds.height,
        fit=seeds.fit,
    )


def has_eq4(scene: dict) -> bool:
    """Whether Eq. 4 speaks of this resolved scene (`Scene.model_dump(mode="json")`): a column that only friction holds
    and that gravity pulls."""
    material = scene["material"]
    only_friction = material["model"] != "elastic" and material["cohesion"] == 0 and material["friction_angle"] > 0
    return scene["geometry"]["shape"] == "column" and only_friction and scene["loads"]["gravity"] > 0


def theory(scene: Scene) -> dict[str, float | None]:
    """Run-outs of Eq. 4 and of Eq. 5 in Eq. 4 with theta = phi [-]; None where Eq. 4 does not speak of the scene."""
    if not has_eq4(scene.model_dump(mode="json")):
        return {"eq4": None, "eq45": None}
    lambda0, tangent = scene.geometry.aspect_ratio, float(np.tan(np.radians(scene.material.friction_angle)))
    return {"eq4": float(eq4(lambda0, tangent)), "eq45": float(eq45(lambda0, tangent))}


def outlook(body: Body) -> str:
    """What is to be expected of a column with cohesion, of which Eq. 4 does not speak, in a line; "" of all others.

    It stands where it is no higher than a vertical cut that stands (`mpm.analytic.critical_height`).
    """
    scene, material = body.scene, body.scene.material
    cohesive = material.model != "elastic" and material.cohesion > 0 and scene.loads.gravity > 0
    if not (cohesive and isinstance(scene.geometry, Column)):
        return ""
    critical = critical_height(material.cohesion, material.density, scene.loads.gravity, material.friction_angle)
    cut = f"that of a vertical cut that just stands, 3.83 c/(rho g) tan(45 degrees + phi/2) = {critical:.3g} m"
    if body.height <= critical:
        return f"it stands: its height {body.height:g} m is below {cut}; no Eq. 4, as there is no run-out"
    return f"no Eq. 4, which is for what only friction holds: the height {body.height:g} m is above {cut}"
