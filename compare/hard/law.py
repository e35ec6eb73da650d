"""Hard cases of the material law at its apex, point by point, through the kernels that the solvers use."""

import math
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import warp as wp

from compare.hard.case import Finding, hard_case
from mpm.body import build
from mpm.devices import KERNEL_OPTIONS, start_warp
from mpm.domains import Halo
from mpm.drucker_prager import LAW_STATE, Constants, drucker_prager
from mpm.errors import NumericalError
from mpm.law_state import first_law_state
from mpm.load import load_scene
from mpm.scene import Material
from mpm.seed import Seeds

SAND = {"young": 5.84e6, "poisson": 0.3, "density": 2000.0, "friction_angle": 37.55}
MODULE = "repose_hard"
VEC5 = wp.types.vector(5, wp.float64)
LAW = drucker_prager(wp.float64)
STRAIN = list(LAW_STATE).index("eps_p_eqv")

PRESSURE = 5e3  # [Pa] at the start of a path
STRETCH, SHEAR = 0.02, 0.03  # half-axes of a loop [-]
LOOPS, STEPS = 20, 200  # loops, and increments of each
IDENTITY = np.eye(3)
ROUNDING = 2.2e-15  # of a strain in an increment: ten roundings, all of one sign

wp.set_module_options(KERNEL_OPTIONS, module=wp.get_module(MODULE))


@wp.kernel(module=MODULE)
def returned(
    sigma_m: wp.array(dtype=wp.float64),
    gap: wp.array(dtype=wp.float64),
    root_j2: wp.array(dtype=wp.float64),
    before: LAW.LawState,
    material: LAW.Material,
    out: wp.array(dtype=VEC5),
):
    p = wp.tid()
    m, scale, dilation, after, work = LAW.return_map(sigma_m[p], gap[p], root_j2[p], before, material)
    out[p] = VEC5(m, scale * root_j2[p], dilation, after[STRAIN] - before[STRAIN], work)


def law_of(constants: Constants) -> tuple:
    """What the law's functions take after the stresses: the state that it starts from, and the material."""
    return LAW.LawState(*constants.law_state_start), LAW.pack(constants)


def return_map(sigma_m, gap, root_j2, constants) -> np.ndarray:
    """(5, ...): mean stress and sqrt(J2) [Pa] after the return, plastic volume strain [-], equivalent plastic strain
    [-], plastic work [J/m3]. `sigma_m`, `root_j2` [Pa] and `gap` [-] broadcast (see `mpm.drucker_prager`)."""
    start_warp()
    inputs = np.broadcast_arrays(sigma_m, gap, root_j2)
    shape = inputs[0].shape
    inputs = [wp.array(a.astype(float).ravel(), dtype=wp.float64, device="cpu") for a in inputs]
    law, out = law_of(constants), wp.zeros(inputs[0].shape, dtype=VEC5, device="cpu")
    wp.launch(returned, out.shape, inputs=[*inputs, *law, out], device="cpu")
    return out.numpy().T.reshape(5, *shape)


class Point:
    """One point under a solver's law. `strain(g)`: one step with F = I + g, `g` (3, 3) [-]."""

    def strain(self, g):
        raise NotImplementedError

    def follow(self, before, after):
        """The step between two points of a path of displacement gradients: F = F_after F_before^-1."""
        self.strain((after - before) @ np.linalg.inv(IDENTITY + before))

    @staticmethod
    def volume_of(gradient) -> float:
        """ln det F of a displacement gradient."""
        return math.log(np.linalg.det(IDENTITY + gradient))


class RatePoint(Point):
    """One point under the explicit solver's law."""

    solver = "explicit"

    def __init__(self, material: Material, pressure=0.0):
        from explicit.solver import ExplicitSolver

        start_warp()
        scene = load_scene("self_weight", ["grid.cell=1.0", "geometry={shape='box', size=[0.5, 0.5, 0.5]}"])
        scene = scene.model_copy(update={"material": material})
        seeds = Seeds(np.array([[0.5, 0.5, 0.5]]), 1.0, 1.0)
        self.point = point = ExplicitSolver(build(scene, seeds))
        constants = point.body.constants
        self.bulk, self.opens_at = constants.bulk, constants.opens_at
        point.tau.assign(np.array([[-pressure] * 3 + [0.0] * 3]))
        point.theta.assign(np.array([-pressure / self.bulk]))
        point.theta_start = np.array([-pressure / self.bulk])
        point.clock.assign(np.ones(len(point.clock)))  # a step of 1 s
        pencil, base = point.grid.pencil_of.numpy(), point.grid.base.numpy()
        i, j = np.divmod(pencil, base.shape[1])
        k = np.arange(len(pencil)) - base[i, j]
        self.nodes = np.stack([i + point.grid.i0, j + point.grid.j0, k], axis=1) - 0.5
        self.velocity = np.zeros((len(pencil), 4))

    def strain(self, g):
        """The linear velocity field of gradient `g` for a second; the point stays where it is."""
        self.velocity[:, :3] = self.nodes @ np.asarray(g, float).T
        _begin, clear, p2g, *_grid, strain, node_law, stress = self.point.phases
        clear.launch()
        p2g.launch()
        self.point.node_mapped.assign(self.velocity)
        for phase in (strain, node_law, stress):
            phase.launch()

    @property
    def sigma(self) -> np.ndarray:
        """Cauchy stress (6,) [Pa]."""
        return self.point.sigma[0]

    @property
    def opening(self) -> float:
        """Volume strain opened beyond the apex [-]."""
        return max(float(self.point.theta.numpy()[0]) - self.opens_at, 0.0)

    @property
    def volume(self) -> float:
        """ln(V/V0) [-]."""
        return math.log(self.point.volume_ratio[0])

    @property
    def elastic_volume(self) -> float:
        """Elastic volume strain [-]."""
        return float(self.point.tau.numpy()[0, :3].mean()) / self.bulk


class FinitePoint(Point):
    """One point under the implicit solver's law, in the middle of a cell of unit size whose eight nodes see it alone.

    `state` and `volume` are as in `implicit.system`, `u` (8,) vec3 the nodes' displacement at `corners` (8, 3) [m].
    """

    solver = "implicit"

    def __init__(self, constants: Material | Constants, pressure=0.0):
        """At rest under `pressure` [Pa], in a scene's material or with its constants."""
        from implicit._dolfinx import MPI
        from implicit.kernels import points
        from implicit.kernels.layout import OUTSIDE, STENCIL, mat33, real, vec3, vec6
        from implicit.volume import Volume

        start_warp()
        constants = constants.constants() if isinstance(constants, Material) else constants
        self.kernels, self.vec6, self.real = points, vec6, real
        self.bulk, self.opens_at, self.material = constants.bulk, constants.opens_at, LAW.pack(constants)
        nodes = np.full((1, STENCIL), OUTSIDE, np.int32)
        corners = np.argwhere(np.ones((2, 2, 2)))
        nodes[0, corners @ [9, 3, 1]] = np.arange(8)
        self.corners = corners - 0.5

        def array(value, dtype):
            return wp.array(value, dtype=dtype, device="cpu")

        nodes, self.u, held = array(nodes, wp.int32), array(np.zeros((8, 3)), vec3), array(np.zeros((8, 3)), vec3)
        weights = SimpleNamespace(
            reach=array([[2, 2, 2]], wp.vec3i),
            weight=array(np.tile([0.5, 0.5, 0.0], (1, 3, 1)), mat33),
            slope=array(np.tile([-1.0, 1.0, 0.0], (1, 3, 1)), mat33),
        )
        state = {"theta": [-pressure / self.bulk], "jacobian": [1.0], "mean": [-pressure]}
        self.state = SimpleNamespace(count=1, volume=1.0, **{name: array(v, real) for name, v in state.items()})
        self.b_e, self.law_state = array([IDENTITY], mat33), array(first_law_state(constants, 1), LAW.LawState)
        alone = Halo([], 8, MPI.COMM_SELF)
        self.volume_law = Volume(self.state, weights, nodes, alone, nodes, held, self.material)
        moves = [array(np.zeros((1, 3)), vec3) for _ in range(2)]
        self.stencils = [nodes, weights.reach, weights.weight]
        self.changed = [moves[0], self.state.mean, self.state.theta, moves[1]]

    def deform(self, g) -> list:
        """Give the nodes u = `g` x; what kernels need for the stress then."""
        self.u.numpy()[:] = self.corners @ np.asarray(g, float).T
        v = self.volume_law
        if not v.deform(self.u):
            raise NumericalError(f"F = I + {g} collapses the point")
        return [v.deformation, self.b_e, v.nodal, v.gap, self.law_state, self.material, self.real(0.0)]

    def strain(self, g):
        """One step with F = I + `g`."""
        strained = self.deform(g)
        self.volume_law.commit()
        wp.launch(self.kernels.commit, 1, inputs=[self.u, *self.stencils, *strained, *self.changed], device="cpu")

    @property
    def sigma(self) -> np.ndarray:
        """Cauchy stress (6,) [Pa]."""
        sigma = wp.zeros(1, dtype=self.vec6, device="cpu")
        fields = [self.b_e, self.state.mean, self.state.jacobian, self.material, sigma]
        wp.launch(self.kernels.cauchy, 1, inputs=fields, device="cpu")
        return sigma.numpy()[0]

    @property
    def opening(self) -> float:
        """Volume strain opened beyond the apex [-]."""
        return max(float(self.state.theta.numpy()[0]) - self.opens_at, 0.0)

    @property
    def volume(self) -> float:
        """ln(V/V0) [-]."""
        return math.log(self.state.jacobian.numpy()[0])

    @property
    def elastic_volume(self) -> float:
        """Elastic volume strain [-]."""
        return float(self.state.mean.numpy()[0]) / self.bulk


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
    point = law(Material(**SAND), PRESSURE)
    start, ends, peaks, left = point.elastic_volume, [], [], []
    for _ in range(LOOPS):
        peak = 0.0
        for before, after in pairwise(path):
            point.follow(before, after)
            peak = max(peak, point.opening)
        ends.append(abs(point.elastic_volume + point.opening - start))
        peaks.append(peak)
        left.append(point.opening)
    growth = np.abs(np.array(peaks) - peaks[0]).max()
    if peaks[0] < 1e-3:
        ends[0] = growth = left[0] = math.nan  # loops that never open say nothing
    note = f"{LOOPS} loops of {STEPS} steps, open by {max(peaks):.3f}"
    rounding = LOOPS * STEPS * ROUNDING
    yield Finding(
        "volume strain that the law gains in loops",
        law.solver,
        float(np.max(ends)),
        rounding,
        "psi = 0: all plastic volume strain is opening, so a closed path recovers it; round-off",
        note,
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
    volume = abs(point.volume)
    yield Finding("ln(V/V0) of the point after the loops", law.solver, volume, rounding, "round-off", note)


def _no_deviator(law):
    """Paths whose trial stress is isotropic, zero or at the apex, for every kind of material."""
    tension, still = 1e-3 * IDENTITY, 0.0 * IDENTITY
    paths = {
        "nothing": [still, still],
        "tension, then nothing, then back": [tension, still, -tension, -tension],
        "pressure, then just to zero": [-tension, tension, still],
        "tension, shear, tension": [tension, 1e-3 * np.diag([1.0, -1.0, 0.0]), tension],
    }
    kinds = [{"dilatancy_angle": psi, "cohesion": cohesion} for psi in (0.0, 10.0) for cohesion in (0.0, 1e3)]
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
        f"of {runs}: psi 0 and 10 degrees, c 0 and 1 kPa, phi = 0, elastic{last}",
    )


def _below_normal_numbers():
    """Isotropic tension down to the smallest number there is, where products underflow."""
    trial = np.array([1e-300, 1e-310, 1e-316, 1e-317, 1e-318, 1e-320, 5e-324])
    bad = np.zeros(len(trial), bool)
    for kind in ({}, {"dilatancy_angle": 10.0}):
        bad |= ~np.isfinite(return_map(trial, 0.0, 0.0, Material(**(SAND | kind)).constants())).all(axis=0)
    return Finding(
        "isotropic tensions of 1e-300 Pa and less that return NaN",
        "law",
        float(bad.sum()),
        0.0,
        "a stress that underflows is zero stress",
        f"of {len(trial)}" + (f"; up to {trial[bad].max():.0e} Pa" if bad.any() else ""),
    )
