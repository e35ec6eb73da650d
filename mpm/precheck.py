"""What is known of a run before its first step: what a solver refuses, and values that look like another unit."""

import numpy as np

from mpm.body import Body
from mpm.errors import SceneError
from mpm.geostatic import geostatic_strain
from mpm.stiffness import limit_bulk

LEAST_ANGLE = 2.0  # degrees; a friction angle below may be in radians: 2 degrees are 0.035, 80 are 1.4
LEAST_STIFFNESS = 50.0  # E over rho g h0
LEAST_DENSITY = 100.0  # kg/m3; a density below may be in g/cm3 or t/m3
MOST_GEOSTATIC = 1.0  # Hencky strain [-] of the state at rest, which is one of small strains


def refuse(body: Body, mode: str):
    """Raises SceneError with all that `refusals` finds."""
    if problems := refusals(body, mode):
        raise SceneError(problems)


def refusals(body: Body, mode: str) -> list[str]:
    """Why the solver `mode`, "explicit" or "implicit", would not take its first step; empty where it would.

    What is wrong with a scene whatever solves it, `mpm.load.load_scene` and `mpm.body.build` refuse.
    """
    return {"explicit": _explicit, "implicit": _implicit}[mode](body) + _geostatic(body, mode) + _lattice(body)


def over_courant(time_step: float, limit: float) -> str:
    """In words, that the fixed `time_step` is longer than the Courant `limit` [s]."""
    return (
        f"explicit.time_step = {time_step:.4g}: over the Courant limit, must be at most h/(c + |v|) = {limit:.4g} [s]; "
        "lower it, or leave it out for the adaptive step"
    )


def _explicit(body: Body) -> list[str]:
    """A step that is too long, and an end that would be passed over in silence."""
    asked, limit = body.scene.explicit, body.scene.grid.cell / limit_bulk(body).constants.p_wave_speed
    problems = []
    if asked.time_step and asked.time_step > limit:
        problems.append(over_courant(asked.time_step, limit))
    if asked.max_time and asked.until != "rest":
        problems.append(
            f"explicit.max_time = {asked.max_time:g}: ends a run to rest, and explicit.until = {asked.until:g} [s] "
            "ends this one; leave it out, or set explicit.until = 'rest'"
        )
    return problems


def _implicit(body: Body) -> list[str]:
    """Scenes without a quasistatic reading."""
    loads, problems = body.scene.loads, []
    if loads.gravity == 0:
        problems.append("loads.gravity = 0: the implicit solver follows a body under its weight, must be > 0 [m/s2]")
    if loads.ramp > 0:
        problems.append(
            f"loads.ramp = {loads.ramp:g}: a time for the explicit solver only; the implicit one adds gravity in "
            "implicit.load_steps with loads.initial_stress = 'none'"
        )
    return problems


def _lattice(body: Body) -> list[str]:
    """A random start that is asked for by number alone: all numbers would give the same points."""
    grid = body.scene.grid
    if not grid.realisation or grid.scatter > 0:
        return []
    return [
        f"grid.realisation = {grid.realisation}: points start on a lattice, as grid.scatter = 0; that must be > 0 and "
        "<= 1 [-] for random starts; or leave grid.realisation out"
    ]


def _geostatic(body: Body, mode: str) -> list[str]:
    """A body too soft to be at rest under its weight as it stands."""
    start = body.scene.loads.initial_stress or ("geostatic" if mode == "implicit" else "none")
    strain = np.abs(geostatic_strain(body)).max() if start == "geostatic" else 0.0
    if strain <= MOST_GEOSTATIC:
        return []
    young = body.scene.material.young
    return [
        f"material.young = {young:g}: at rest under gravity the body would be compressed by a Hencky strain of "
        f"{strain:.3g}, must be >= {young * strain / MOST_GEOSTATIC:.3g} [Pa]; or start with "
        "loads.initial_stress = 'none'"
    ]


def doubts(body: Body) -> list[str]:
    """Values that look like another unit than the key's, a line each; a run takes them all the same."""
    material, weight = body.scene.material, body.overburden
    angle, found = material.friction_angle, []
    if material.model != "elastic" and 0 < angle < LEAST_ANGLE:
        meant = np.degrees(angle)
        in_radians = f"in radians it would be {meant:.4g} degrees" if meant <= 80 else "sand has 25 to 45"
        found.append(f"material.friction_angle = {angle:g}: is it in degrees? {in_radians}")
    if material.young < LEAST_STIFFNESS * weight:
        found.append(
            f"material.young = {material.young:g}: is it in Pa? It is {material.young / weight:.2g} rho g h0, and a "
            f"body below {LEAST_STIFFNESS:g} is compacted visibly by its own weight"
        )
    if material.density < LEAST_DENSITY:
        found.append(f"material.density = {material.density:g}: is it in kg/m3? Sand has 1300 to 2100")
    return found
