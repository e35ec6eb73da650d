"""Hard cases of the material law at its apex, point by point, through the kernels that the solvers use."""

import dataclasses
import math
from itertools import pairwise

import numpy as np
import warp as wp

from compare.hard.case import Finding, hard_case
from mpm.config import Material, load_scene
from mpm.devices import KERNEL_OPTIONS, start_warp
from mpm.drucker_prager import drucker_prager
from mpm.geometry import Seeds
from mpm.scene import build

SAND = {"young": 5.84e6, "poisson": 0.3, "density": 2000.0, "friction_angle": 37.55}
MODULE = "repose_hard"
VEC5 = wp.types.vector(5, wp.float64)
LAW = drucker_prager(wp.float64)

PRESSURE = 5e3  # [Pa] at the start of a path
STRETCH, SHEAR = 0.02, 0.03  # half-axes of a loop [-]
LOOPS, STEPS = 20, 200  # loops, and increments of each
IDENTITY = np.eye(3)
ROUNDING = 2.2e-15  # of a strain in an increment: ten roundings, all of one sign

wp.set_module_options(KERNEL_OPTIONS, module=wp.get_module(MODULE))


@wp.kernel(module=MODULE)
def returned(
    mean: wp.array(dtype=wp.float64),
    root: wp.array(dtype=wp.float64),
    opening: wp.array(dtype=wp.float64),
    material: LAW.Material,
    out: wp.array(dtype=VEC5),
):
    p = wp.tid()
    m, scale, opened, d_eps, work = LAW.return_map(mean[p], root[p], opening[p], material)
    out[p] = VEC5(m, scale * root[p], opened, d_eps, work)


def return_map(mean, root, opening, constants) -> np.ndarray:
    """(5, n): mean stress and sqrt(J2) [Pa] after the return, opening [-], plastic strain [-], plastic work [J/m3]."""
    start_warp()
    mean, root, opening = np.broadcast_arrays(*(np.atleast_1d(np.asarray(a, float)) for a in (mean, root, opening)))
    inputs = [wp.array(a, dtype=wp.float64, device="cpu") for a in (mean, root, opening)]
    out = wp.zeros(len(mean), dtype=VEC5, device="cpu")
    wp.launch(returned, len(mean), inputs=[*inputs, LAW.pack(constants), out], device="cpu")
    return out.numpy().T


class RatePoint:
    """One point under the explicit solver's law. `strain(g)` adds the displacement gradient's increment `g` (3, 3) [-]
    in one step; what it sums up to is the law's own measure of strain."""

    solver = "explicit"

    def __init__(self, material: Material, pressure=0.0):
        from explicit.solver import ExplicitSolver

        start_warp()
        scene = load_scene("self_weight", ["grid.cell=1.0", "geometry={shape='box', size=[0.5, 0.5, 0.5]}"])
        scene = scene.model_copy(update={"material": material})
        seeds = Seeds(np.array([[0.5, 0.5, 0.5]]), 1.0, 1.0)
        self.point = point = ExplicitSolver(build(scene, seeds))
        self.bulk = point.body.constants.bulk
        point.sigma.assign(np.array([[-pressure] * 3 + [0.0] * 3]))
        point.clock.assign(np.ones(len(point.clock)))  # a step of 1 s
        pencil, base = point.grid.pencil_of.numpy(), point.grid.base.numpy()
        i, j = np.divmod(pencil, base.shape[1])
        k = np.arange(len(pencil)) - base[i, j]
        self.nodes = np.stack([i + point.grid.i0, j + point.grid.j0, k], axis=1) - 0.5
        self.velocity = np.zeros((len(pencil), 4))
        pencils = point.k.Pencils()
        pencils.base, pencils.i0, pencils.j0 = point.grid.base, point.grid.i0, point.grid.j0
        where = [point.setup, point.material, pencils, point.clock, point.node_mapped, point.carry, point.x]
        self.inputs = [*where, point.sigma, point.volume, point.eps_p_eqv, point.opening, point.ledger, point.fault]

    def strain(self, g):
        """One step with the linear velocity field of gradient `g`."""
        self.velocity[:, :3] = self.nodes @ np.asarray(g, float).T
        self.point.node_mapped.assign(self.velocity)
        wp.launch(self.point.k.update_stress, 1, inputs=self.inputs, device="cpu")

    def follow(self, before, after):
        """The step between two points of a path of displacement gradients."""
        self.strain(after - before)

    @property
    def sigma(self) -> np.ndarray:
        """Cauchy stress (6,) [Pa]."""
        return self.point.sigma.numpy()[0].copy()

    @property
    def opening(self) -> float:
        """Volume strain opened at the apex [-]."""
        return float(self.point.opening.numpy()[0]) if self.point.opening.size else 0.0

    @property
    def volume(self) -> float:
        """ln(V/V0) [-]."""
        return math.log(self.point.volume.numpy()[0] / self.point.body.point_volume)

    @property
    def elastic_volume(self) -> float:
        """Elastic volume strain [-]."""
        return float(self.sigma[:3].mean()) / self.bulk

    @staticmethod
    def volume_of(gradient) -> float:
        """The law's own volume strain of a displacement gradient."""
        return float(np.trace(gradient))


class FinitePoint:
    """One point under the implicit solver's law, in the middle of a cell of eight nodes. `strain(g)`: F = I + g."""

    solver = "implicit"

    def __init__(self, material: Material, pressure=0.0):
        from implicit.kernels import points
        from implicit.kernels.layout import OUTSIDE, STENCIL, mat33, real, vec3, vec6

        start_warp()
        constants = material.constants()
        self.kernels, self.vec6, self.real, self.material = points, vec6, real, LAW.pack(constants)
        nodes = np.full((1, STENCIL), OUTSIDE, np.int32)
        corners = np.argwhere(np.ones((2, 2, 2)))
        nodes[0, corners @ [9, 3, 1]] = np.arange(8)
        self.corners = corners - 0.5

        def array(value, dtype):
            return wp.array(value, dtype=dtype, device="cpu")

        self.u = array(np.zeros((8, 3)), vec3)
        weight, slope = np.tile([0.5, 0.5, 0.0], (1, 3, 1)), np.tile([-1.0, 1.0, 0.0], (1, 3, 1))
        seen = [array(nodes, wp.int32), array([[2, 2, 2]], wp.vec3i), array(weight, mat33), array(slope, mat33)]
        self.b_e = array([math.exp(-2.0 * pressure / (3.0 * constants.bulk)) * IDENTITY], mat33)
        self.jacobian, self.eps_p_eqv = array([1.0], real), array([0.0], real)
        self.opened = array(np.zeros(int(constants.plastic and constants.apex_memory)), real)
        self.x, self.moved = array(np.zeros((1, 3)), vec3), array(np.zeros((1, 3)), vec3)
        state = [self.x, self.b_e, self.jacobian, self.opened, self.eps_p_eqv, self.moved]
        self.inputs = [self.u, *seen, self.material, real(0.0), *state]

    def strain(self, g):
        """One step with F = I + `g`."""
        self.u.numpy()[:] = self.corners @ np.asarray(g, float).T
        wp.launch(self.kernels.commit, 1, inputs=self.inputs, device="cpu")

    def follow(self, before, after):
        """The step between two points of a path of displacement gradients: F = F_after F_before^-1."""
        self.strain((after - before) @ np.linalg.inv(IDENTITY + before))

    @property
    def sigma(self) -> np.ndarray:
        """Cauchy stress (6,) [Pa]."""
        sigma = wp.zeros(1, dtype=self.vec6, device="cpu")
        wp.launch(self.kernels.cauchy, 1, inputs=[self.b_e, self.jacobian, self.material, sigma], device="cpu")
        return sigma.numpy()[0]

    @property
    def opening(self) -> float:
        """Volume strain opened at the apex [-]."""
        return float(self.opened.numpy()[0]) if self.opened.size else 0.0

    @property
    def volume(self) -> float:
        """ln(V/V0) [-]."""
        return math.log(self.jacobian.numpy()[0])

    @property
    def elastic_volume(self) -> float:
        """Elastic volume strain [-]."""
        return 0.5 * math.log(np.linalg.det(self.b_e.numpy()[0]))

    @staticmethod
    def volume_of(gradient) -> float:
        """The law's own volume strain of a displacement gradient."""
        return math.log(np.linalg.det(IDENTITY + gradient))


LAWS = (RatePoint, FinitePoint)


@hard_case("apex")
def apex():
    """What opens in tension closes before pressure returns, loop after loop, with no NaN where there is no deviator."""
    for law in LAWS:
        yield from _open_and_close(law)
    for law in LAWS:
        yield from _loops(law)
    for law in LAWS:
        yield _no_deviator(law)
    yield _below_normal_numbers()


def _open_and_close(law):
    """Isotropic extension from a pressure to 2 %, then back beyond the start."""
    point, bulk = law(Material(**SAND), PRESSURE), Material(**SAND).constants().bulk
    path = [e * IDENTITY / 3.0 for e in (*np.linspace(0.0, 0.02, 200), *np.linspace(0.02, -0.002, 220)[1:])]
    start, held, off = -PRESSURE / bulk, 0.0, 0.0
    states = {"open": 0, "closed again": 0}
    for before, after in pairwise(path):
        point.follow(before, after)
        exact = min(start + law.volume_of(after), 0.0)  # elastic volume strain of a gap that closes first
        if point.opening > 0.0:
            held = max(held, float(np.abs(point.sigma).max()) / SAND["young"])
        off = max(off, abs(point.elastic_volume - exact))
        states["open"] += point.opening > 0.0
        states["closed again"] += states["open"] > 0 and point.opening == 0.0
    if not all(states.values()):
        held = off = math.nan
    note = ", ".join(f"{count} states {state}" for state, count in states.items())
    yield Finding(
        "stress while open, over E", law.solver, held, 1e-13, "c = 0: the apex is zero stress, but for round-off", note
    )
    yield Finding(
        "elastic volume strain beside min(strain since the start, 0)",
        law.solver,
        off,
        len(path) * ROUNDING,
        "a gap closes at zero pressure and only then takes pressure: closed form, but for round-off",
        note,
    )


def _loops(law):
    """Closed loops of stretch and shear that open and close the point, psi = 0."""
    angle = 2.0 * np.pi * np.arange(STEPS + 1) / STEPS
    path = np.zeros((STEPS + 1, 3, 3))
    path[:, 0, 0] = STRETCH * np.sin(angle)
    path[:, 2, 2] = 0.5 * STRETCH * np.sin(2.0 * angle)
    path[:, 0, 1] = SHEAR * (1.0 - np.cos(angle))
    path[-1] = path[0]  # closed to the bit
    squares = np.sum(np.diff(path, axis=0) ** 2)
    gained = {}
    for memory, loops in ((False, 2), (True, LOOPS)):
        point = law(Material(**SAND, apex_memory=memory), PRESSURE)
        start, ends, peaks, left = point.elastic_volume, [], [], []
        for _ in range(loops):
            peak = 0.0
            for before, after in pairwise(path):
                point.follow(before, after)
                peak = max(peak, point.opening)
            ends.append(abs(point.elastic_volume + point.opening - start))
            peaks.append(peak)
            left.append(point.opening)
        gained[memory] = max(ends)
    growth = np.abs(np.array(peaks) - peaks[0]).max()
    if gained[False] < 1e-3 or peaks[0] < 1e-3:
        gained[True] = growth = left[0] = math.nan  # loops that never open say nothing
    note = f"{LOOPS} loops of {STEPS} steps, open by {max(peaks):.3f}"
    rounding = LOOPS * STEPS * ROUNDING
    yield Finding(
        "volume strain that the law gains in loops",
        law.solver,
        gained[True],
        rounding,
        "psi = 0: all plastic volume strain is opening, so a closed path recovers it; round-off",
        f"{note}; {gained[False]:.2g} without the memory of the apex",
    )
    yield Finding(
        "opening left at the end of a loop",
        law.solver,
        float(np.max(left)),
        rounding,
        "a loop ends under the pressure that it began with, closed",
        note,
    )
    yield Finding(
        "largest opening of a loop beside the first loop's",
        law.solver,
        float(growth),
        rounding,
        "no ratcheting: the next loop opens as far",
        note,
    )
    rate = law is RatePoint
    yield Finding(
        "ln(V/V0) of the point after the loops",
        law.solver,
        abs(point.volume),
        0.5 * LOOPS * squares * 1.01 if rate else rounding,
        "V times det(I + dL) beside a strain that adds up tr dL: half the sum of |dL|^2" if rate else "round-off",
        note,
    )


def _no_deviator(law):
    """Paths whose trial stress is isotropic, zero or at the apex, for every kind of material."""
    tension, still = 1e-3 * IDENTITY, 0.0 * IDENTITY
    paths = {
        "nothing": [still, still],
        "tension, then nothing, then back": [tension, still, -tension, -tension],
        "pressure, then just to zero": [-tension, tension, still],
        "tension, shear, tension": [tension, 1e-3 * np.diag([1.0, -1.0, 0.0]), tension],
    }
    kinds = [
        {"dilatancy_angle": psi, "cohesion": cohesion, "apex_memory": memory}
        for psi in (0.0, 10.0)
        for cohesion in (0.0, 1e3)
        for memory in (True, False)
    ]
    kinds += [{"friction_angle": 0.0, "cohesion": 1e3}, {"model": "elastic"}]
    bad, last, runs = 0, "", 0
    for kind in kinds:
        for name, path in paths.items():
            runs += 1
            point = law(Material(**(SAND | kind)))
            for g in path:
                point.strain(g)
            if not np.isfinite([*point.sigma, point.opening, point.volume]).all():
                bad, last = bad + 1, f"; {name} with {kind}"
    return Finding(
        "paths without deviator that end in NaN",
        law.solver,
        float(bad),
        0.0,
        "the return divides by sqrt(J2)",
        f"of {runs}: psi 0 and 10 degrees, c 0 and 1 kPa, with and without memory, phi = 0, elastic{last}",
    )


def _below_normal_numbers():
    """Isotropic tension down to the smallest number there is, where products underflow."""
    trial = np.array([1e-300, 1e-310, 1e-316, 1e-317, 1e-318, 1e-320, 5e-324])
    bad = np.zeros(len(trial), bool)
    for kind in ({}, {"dilatancy_angle": 10.0}):
        constants = Material(**(SAND | kind)).constants()
        for memory in (True, False):
            law = dataclasses.replace(constants, apex_memory=memory)
            bad |= ~np.isfinite(return_map(trial, 0.0, 0.0, law)).all(axis=0)
    return Finding(
        "isotropic tensions of 1e-300 Pa and less that return NaN",
        "law",
        float(bad.sum()),
        0.0,
        "a stress that underflows is zero stress",
        f"of {len(trial)}" + (f"; up to {trial[bad].max():.0e} Pa" if bad.any() else ""),
    )
