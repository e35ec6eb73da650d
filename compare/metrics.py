"""What is measured on a deposit: its profile and how far two profiles are apart, flank angle, run-outs, height.

A profile and a run-out come from points `x` (n, 3) [m] and its scene.
"""

from dataclasses import dataclass

import numpy as np

from mpm.errors import SceneError
from mpm.results import Results
from mpm.run import body_of
from mpm.runout import run_out
from mpm.scene import Box, Column, Scene
from mpm.seed import SHARE
from mpm.theory import eq4, tan_phi

FLANK = (0.10, 0.85)  # thickness over the greatest one, between which a ring counts as flank


@dataclass(frozen=True)
class Profile:
    """Mean thickness of a deposit on concentric rings about the axis or, for a box, on strips across x.

    `edges` (m+1,) [m], rising; `thickness` (m,) [m]: volume standing on a ring over the ring's area. The area
    within an edge is `scale` edge^`power`: 2 and sector pi for rings, 1 and the width [m] for strips.
    """

    edges: np.ndarray
    thickness: np.ndarray
    power: int
    scale: float

    @property
    def area(self) -> np.ndarray:
        """Area (m,) [m2] of each ring or strip."""
        return self.scale * np.diff(self.edges**self.power)

    @property
    def volume(self) -> float:
        """Volume [m3] under the profile."""
        return float(self.thickness @ self.area)


def axis_of(results: Results) -> np.ndarray:
    """Where the vertical axis (x, y) [m] stands that run-outs of this run are measured about."""
    return np.append(results.read_static("extent"), [0.0, 0.0])[2:4]  # earlier versions wrote no axis: it was x = y = 0


def profile(x, scene: Scene, axis=(0.0, 0.0)) -> Profile:
    """Profile of points `x` (n, 3) [m] on rings (box: strips) one cell wide, from the axis to the farthest point.

    `axis` (x, y) [m]: where the vertical axis stands (see `axis_of`).

    Each point counts with its initial volume, that is its mass over the initial density: the profile says where
    the mass is and holds all of it, however much the deposit has swollen.
    """
    # A point stands for its domain: as four quarters in plan it errs three times less where rings cut the lattice.
    quarter = scene.grid.half_length / 2 * np.array([[-1, -1, 0], [-1, 1, 0], [1, -1, 0], [1, 1, 0]])
    about_axis = np.asarray(x, float) - [*axis, 0.0]
    ring, edges = _rings((about_axis[:, None] + quarter).reshape(-1, 3), scene)
    power, scale = _area_within(scene)
    volume = np.bincount(ring) * scene.grid.point_volume / len(quarter)
    return Profile(edges, volume / (scale * np.diff(edges**power)), power, scale)


def highest(x, scene: Scene) -> np.ndarray:
    """Top [m] of the highest point on each ring of `profile(x, scene)`, half-length included; NaN where empty."""
    ring, edges = _rings(x, scene)
    top = np.full(len(edges) - 1, -np.inf)
    np.maximum.at(top, ring, np.asarray(x, float)[:, 2] + scene.grid.half_length)
    return np.where(np.isinf(top), np.nan, top)


def eq4_profile(scene: Scene, edges) -> Profile:
    """Eq. 4's solid (`mpm.theory.quasistatic_profile`) averaged exactly over rings with `edges` (m+1,) [m].

    Slope: the scene's friction angle. Its volume is the column's where the edges reach from the axis to the foot.
    Raises SceneError for a scene that is not a column, or has no friction.
    """
    column, tangent = scene.geometry, tan_phi(scene)
    if not isinstance(column, Column) or tangent == 0:
        raise SceneError("Eq. 4 is for a column with an angle of friction above 0")
    height = column.height
    foot = column.radius * (1.0 + float(eq4(column.aspect_ratio, tangent)))
    rim = max(foot - height / tangent, 0.0)  # a full cone has no flat top
    edges = np.asarray(edges, float)
    # Integral of h(r) r dr from the axis: to the rim of the flat top, then down the flank.
    top, flank = np.minimum(edges, rim), np.clip(edges, rim, foot)
    inside = height * top**2 / 2 + tangent * (foot * (flank**2 - rim**2) / 2 - (flank**3 - rim**3) / 3)
    power, scale = _area_within(scene)
    return Profile(edges, 2.0 * np.diff(inside) / np.diff(edges**2), power, scale)


def profile_distance(a: Profile, b: Profile) -> float:
    """Distance [-] of `a` from `b`: integral of |h_a - h_b| dA over integral of h_b dA.

    0 where they are the same, 2 where no ring holds mass of both and the volumes are equal. Edges may differ, and
    so may sectors, since thicknesses are means. Raises ValueError for rings against strips.
    """
    if a.power != b.power:
        raise ValueError("a profile on rings has no distance from one on strips")
    edges = np.union1d(a.edges, b.edges)
    area = np.diff(edges**b.power)
    h_a, h_b = _thickness_between(edges, a), _thickness_between(edges, b)
    return float(np.abs(h_a - h_b) @ area / (h_b @ area))


def flank_angle(profile: Profile) -> float:
    """Slope of the flank [degrees]; NaN where fewer than three rings belong to it.

    Least-squares line through the mean thickness at each ring's centroid radius, on which those of a cone lie
    exactly. Flank: outward of the thickest ring, where the thickness is 10 % to 85 % of the greatest. Further out
    lie loose grains and a ring that the foot only partly covers; further in the top of a truncated cone, which is
    flat, and the ring that its rim crosses.
    """
    edges, power = profile.edges, profile.power
    centroid = power / (power + 1) * np.diff(edges ** (power + 1)) / np.diff(edges**power)
    relative = profile.thickness / profile.thickness.max()
    outward = np.arange(len(relative)) > np.argmax(relative)
    flank = outward & (relative >= FLANK[0]) & (relative <= FLANK[1])
    if np.count_nonzero(flank) < 3:
        return float("nan")
    slope = np.polyfit(centroid[flank], profile.thickness[flank], 1)[0]
    return float(np.degrees(np.arctan(-slope)))


def deposit(results: Results) -> dict[str, float | None]:
    """Measures of the last snapshot. Raises SceneError where there is none.

    R_max, R_995, R_connected [-] and h_inf [m] as in `mpm.runout.run_out`; flank_angle [degrees]; centre_height
    [m] of the centre of mass; volume_error [-], the volume gained over the initial one, None where the snapshot
    has no field "volume".
    """
    if results.snapshot_count == 0:
        raise SceneError(f"{results.directory} has no snapshot to measure")
    scene, last = results.scene, results.snapshot(-1)
    x = last["x"].astype(float)  # from single precision, whose sums over all points are coarse
    body = body_of(results)
    volume_error = None
    if "volume" in last:
        volume_error = float(last["volume"].astype(float).sum() / (len(x) * body.point_volume) - 1.0)
    return {
        **run_out(x, body.measure),
        "flank_angle": flank_angle(profile(x, scene, body.measure.axis)),
        "centre_height": float(x[:, 2].mean()),
        "volume_error": volume_error,
    }


def _rings(x, scene):
    """Index (n,) of the ring or strip that each point is on, and all edges [m], one cell apart from 0."""
    x, cell = np.asarray(x, float), scene.grid.cell
    # A point beyond x = 0, where there is no wall or a wall holds it but for rounding, counts on the first strip.
    is_box = isinstance(scene.geometry, Box)
    distance = np.maximum(x[:, 0], 0.0) if is_box else np.hypot(x[:, 0], x[:, 1])
    ring = (distance / cell).astype(int)
    return ring, cell * np.arange(ring.max() + 2)


def _area_within(scene):
    """Power and scale of the area within an edge (see `Profile`)."""
    geometry = scene.geometry
    if isinstance(geometry, Box):
        return 1, geometry.size[1]
    return 2, SHARE[geometry.symmetry] * np.pi


def _thickness_between(edges, profile):
    """Thickness [m] between each two of `edges`, all of the profile's among them; 0 outside the profile."""
    padded = np.concatenate([[0.0], profile.thickness, [0.0]])
    return padded[np.searchsorted(profile.edges, (edges[1:] + edges[:-1]) / 2)]
