"""A validated scene -> what a solver starts from: points, walls, constants, how to measure the run-out."""

from dataclasses import dataclass

import numpy as np

from mpm.drucker_prager import Constants
from mpm.fit import Fit
from mpm.runout import Measure
from mpm.scene import Box, Scene
from mpm.seed import Seeds, scattered, seed
from mpm.walls import Walls, walls_of


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

    @property
    def overburden(self) -> float:
        """rho g h0 [Pa], the vertical stress at the base of a column."""
        return self.constants.density * self.scene.loads.gravity * self.height


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
    measure = Measure(axes, seeds.reference, scene.grid.half_length, cell, seeds.axis)
    constants = scene.material.constants()
    return Body(
        scene=scene,
        x=seeds.x,
        point_volume=scene.grid.point_volume,
        point_mass=constants.density * scene.grid.point_volume,
        constants=constants,
        walls=walls_of(scene),
        measure=measure,
        height=seeds.height,
        fit=seeds.fit,
    )
