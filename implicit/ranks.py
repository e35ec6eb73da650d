"""The implicit solver on several MPI ranks: points with the rank that owns their cell, one system on all ranks.

Every rank takes the same steps of Newton on its own rows. Points change ranks at the start of a step. `mpm.parts` says
how the first rank runs the program, `implicit.system` what ranks exchange.
"""

from dataclasses import replace

import numpy as np

from implicit.points import Basis, Points
from implicit.pseudo_time import Regularisation
from implicit.solver import ImplicitSolver
from mpm.body import Body
from mpm.devices import start_warp
from mpm.geostatic import geostatic_strain
from mpm.law_state import by_name, by_point
from mpm.parts import Gathered, Part, Whole
from mpm.watch import Look, look


class Domain(Part, ImplicitSolver):
    """The points of one rank, and its share of the nodes."""

    def __init__(self, body: Body, regularisation: Regularisation, comm):
        self.comm = comm
        self.whole = regularisation.limit_stiffness(body)
        self.ids = self.cut_anew(body.x)
        super().__init__(replace(body, x=body.x[self.ids]), regularisation, comm)

    @property
    def held(self) -> list[str]:
        """Names of the arrays that the material has, whether there are points here or not."""
        spare = {"law_state": self.whole.constants.plastic}
        return [name for name in Points.SAVED if spare.get(name, True)]

    def field(self, name: str) -> np.ndarray:
        """One of the point arrays (n, ...), or their Cauchy stress "sigma"."""
        points = self.material_points
        return points.sigma(self.material) if name == "sigma" else getattr(points, name).numpy()

    def take(self, rows: dict[str, np.ndarray]):
        """Hold the points of `rows` in place of those so far (see `Part.take`)."""
        self.ids = rows["id"]
        self.material_points.take(rows)
        self.points = self.material_points.count
        self.weights = Basis(self.points)
        self._pull()

    def _geostatic_strain(self) -> np.ndarray:
        return geostatic_strain(self.whole)[self.ids]

    def _new_system(self):
        self.hand_on(self.x)
        return super()._new_system()

    def look(self) -> Look:
        """What a history row says of the whole body's shape and volume; no rank has all of its points."""
        return look(self.x, self.material_points.jacobian.numpy(), self.whole, self.ids, self.comm)

    def find_invalid(self, farthest: float) -> str:
        """What is invalid on the first rank that has anything of that kind (see `mpm.run.find_invalid`)."""
        return next(filter(None, self.comm.allgather(super().find_invalid(farthest))), "")

    def shared_state(self) -> dict:
        """What `state` holds that is the same on all ranks: all but points and nodes."""
        own = (*self.material_points.state(), *self.NODAL)
        return {name: value for name, value in self.state().items() if name not in own}

    def nodes_of_all(self) -> dict[str, np.ndarray] | None:
        """`node_place` and `node_velocity` of all ranks, on the first one; what ranks have in common is there once."""
        parts = self.comm.gather((self.node_place, self.node_velocity))
        if parts is None:
            return None
        places, velocities = map(np.concatenate, zip(*parts, strict=True))
        places, first = np.unique(places, axis=0, return_index=True)
        return dict(zip(self.NODAL, (places, velocities[first]), strict=True))

    def restore(self, state: dict):
        """Take this rank's part of a state of the whole body."""
        mine, state = self.cut_anew(state["x"]), by_point(state)
        rows = {name: state[name][mine] for name in self.held}
        self.take(rows | {"id": mine})
        super().restore(by_name(state | rows))


def domain(body: Body, regularisation: Regularisation, comm) -> Domain:
    """This rank's domain."""
    start_warp()
    return Domain(body, regularisation, comm)


class GatheredPoints:
    """The points of all ranks, with the arrays of `implicit.points.Points`."""

    x: Gathered

    def __init__(self, whole: Whole):
        for name in Points.SAVED:
            setattr(self, name, Gathered(whole, name))
        self.stress = Gathered(whole, "sigma")

    def sigma(self, _material) -> np.ndarray:
        """Cauchy stress (n, 6) [Pa]: xx, yy, zz, yz, xz, xy."""
        return self.stress.numpy()


class RankedSolver(Whole):
    """The interface of `ImplicitSolver` for a body that is spread over the ranks of `comm`, on its first rank.

    Arrays and counts are of the whole body.
    """

    SAME = (
        *ImplicitSolver.COUNTERS,
        "unbalanced_ratio",
        "nodes_solved_start",
        "nodes_solved_max",
        "regularisation",
        "time_step",
        "material",
    )

    def __init__(self, body: Body, regularisation: Regularisation, comm):
        super().__init__(domain, body, regularisation, comm)
        self.body = self.part.whole
        self.material_points = GatheredPoints(self)

    advance_to = ImplicitSolver.advance_to

    @property
    def x(self) -> np.ndarray:
        """Positions (n, 3) [m] of the points."""
        return self.material_points.x.numpy()

    def advance(self):
        """One step (see `ImplicitSolver.advance`)."""
        self.ask("advance")

    def look(self) -> Look:
        """What a history row says of the body's shape and volume."""
        return self.ask("look")

    def grid_mass(self) -> float:
        """Mass [kg] that the points have put on the grid in the last step."""
        return sum(self.ask("each", "grid_mass"))

    def find_invalid(self, farthest: float) -> str:
        """What of the body's state is invalid (see `mpm.run.find_invalid`)."""
        return self.ask("find_invalid", farthest)

    def state(self) -> dict:
        """Everything a restart needs, of the whole body; `restore` takes it back on any number of ranks."""
        points = {name: getattr(self.material_points, name).numpy() for name in Points.SAVED}
        return by_name(points) | self.ask("nodes_of_all") | self.part.shared_state()

    def restore(self, state: dict):
        """Take over a state made by `state`, on this or another number of ranks."""
        self.ask("restore", state)

    def write_grid(self, path):
        """Write the background mesh (see `ImplicitSolver.write_grid`)."""
        self.ask("write_grid", path)
