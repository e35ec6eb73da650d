"""What the implicit solver knows of the material points, and how they see the lattice at the start of a step."""

import numpy as np
import warp as wp

from implicit.kernels import basis
from implicit.kernels.layout import LawState, mat33, real, vec3, vec6
from implicit.kernels.points import cauchy
from mpm.body import Body
from mpm.law_state import by_name, by_point, first_law_state


class Points:
    """State of the material points, float64 on the CPU.

    `x` (n, 3) [m]; `v` (n, 3) [m/s], velocity in pseudo-time; `b_e` (n, 3, 3) elastic left Cauchy-Green tensor [-],
    isochoric; `mean` (n,) mean Kirchhoff stress [Pa]; `theta` (n,) volume strain [-] that the pressure law sees (see
    `mpm.drucker_prager`); `jacobian` (n,) volume over initial volume [-]; `law_state` (n, variables) what the law
    remembers, empty where the material is elastic; `load` (n, 3) [N] external force; `moved` (n, 3) [m] in the last
    step. `mass` [kg] and initial `volume` [m3] are those of one point.
    """

    SAVED = ("x", "v", "b_e", "mean", "theta", "jacobian", "law_state", "moved")

    def __init__(self, body: Body):
        constants, n = body.constants, len(body.x)
        self.count, self.mass, self.volume = n, body.point_mass, body.point_volume
        self.x = wp.array(body.x, dtype=vec3, device="cpu")
        self.v = wp.zeros(n, dtype=vec3, device="cpu")
        self.b_e = wp.array(np.tile(np.eye(3), (n, 1, 1)), dtype=mat33, device="cpu")
        self.jacobian = wp.full(n, real(1.0), dtype=real, device="cpu")
        self.mean = wp.zeros(n, dtype=real, device="cpu")
        self.theta = wp.zeros(n, dtype=real, device="cpu")
        self.law_state = wp.array(first_law_state(constants, n), dtype=LawState, device="cpu")
        self.load = wp.zeros(n, dtype=vec3, device="cpu")
        self.moved = wp.zeros(n, dtype=vec3, device="cpu")

    def sigma(self, material) -> np.ndarray:
        """Cauchy stress (n, 6) [Pa]: xx, yy, zz, yz, xz, xy."""
        sigma = wp.zeros(self.count, dtype=vec6, device="cpu")
        wp.launch(cauchy, self.count, inputs=[self.b_e, self.mean, self.jacobian, material, sigma], device="cpu")
        return sigma.numpy()

    def strain(self, principal: np.ndarray, bulk: float):
        """Start from elastic Hencky strains `principal` (n, 3) along x, y, z, with the mean stress K tr(strain)."""
        volumetric = principal.sum(axis=1)
        deviator = principal - volumetric[:, None] / 3.0
        self.b_e.numpy()[:] = np.exp(2.0 * deviator)[:, :, None] * np.eye(3)
        self.theta.numpy()[:] = volumetric
        self.mean.numpy()[:] = bulk * volumetric

    def take(self, rows: dict[str, np.ndarray]):
        """Hold the points of `rows`, an array for each of SAVED that the material has, in place of those so far."""
        for name in self.SAVED:
            if name in rows:
                setattr(self, name, wp.array(rows[name], dtype=getattr(self, name).dtype, device="cpu"))
        self.count = len(self.x)
        self.load = wp.zeros(self.count, dtype=vec3, device="cpu")

    def state(self) -> dict[str, np.ndarray]:
        """What a restart needs, as copies."""
        return by_name({name: getattr(self, name).numpy().copy() for name in self.SAVED})

    def restore(self, state: dict[str, np.ndarray]):
        """Take over what `state` gave."""
        state = by_point(state)
        for name in self.SAVED:
            if getattr(self, name).size:
                getattr(self, name).assign(state[name])


class Basis:
    """First nodes, reach, weights and slopes of the points' stencils (see `implicit.kernels.basis.evaluate_basis`)."""

    def __init__(self, count: int):
        self.base = wp.zeros(count, dtype=wp.vec3i, device="cpu")
        self.reach = wp.zeros(count, dtype=wp.vec3i, device="cpu")
        self.weight = wp.zeros(count, dtype=mat33, device="cpu")
        self.slope = wp.zeros(count, dtype=mat33, device="cpu")

    def evaluate(self, x: wp.array, cell: float):
        """uGIMP at points `x` (n,) vec3 [m]."""
        outputs = [self.base, self.reach, self.weight, self.slope]
        wp.launch(basis.evaluate_basis, len(x), inputs=[x, real(1.0 / cell), *outputs], device="cpu")
