"""Residual and tangent of one state, and solutions, on the ranks that this is started on, by node, into a file.

mpiexec -n N python tests/implicit/system_on_ranks.py FILE.npz quarter|full|settled
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from implicit import newton
from implicit._dolfinx import MPI, PETSc
from implicit.kernels.layout import LAW
from implicit.mesh import BackgroundMesh
from implicit.newton import Tangent, matrix_of
from implicit.points import Basis, Points
from implicit.pseudo_time import Regularisation
from implicit.ranks import Domain
from implicit.run import run
from implicit.system import System
from mpm.body import build
from mpm.devices import start_warp
from mpm.domains import cut_plan, owner_of
from mpm.load import load_scene

WAVES = np.array([[1.3, 0.7, 2.1], [0.4, 1.9, 0.3], [2.2, 0.1, 1.1]])  # of fields over the lattice


def collapses(folder: str, starts: int) -> list[dict]:
    """Collapses on 6 cells per r0 to rest, from so many random starts; the summary of each."""
    settings = [f"grid.cell={1 / 6}", "grid.scatter=0.5", "output.vtk=false"]
    scenes = [load_scene("column_small", [*settings, f"grid.realisation={start}"]) for start in range(starts)]
    return [run(scene, Path(folder) / f"run{start}") for start, scene in enumerate(scenes)]


def fields(comm, symmetry) -> dict[str, np.ndarray]:
    """By node, in the order of the lattice: place, mass, momentum, out-of-balance force, residual, tangent product, and
    a preconditioner's sweep of a matrix that is filled a second time and of a new one.

    A column whose nodes are open and closed, points elastic, yielding and open, with drag, ghost springs, viscosity and
    momentum; one point flies. A full column is cut through its axis, and its K so large that ripples are smoothed.
    """
    start_warp()
    rng = np.random.default_rng(1)
    poisson = {"quarter": 0.3, "full": 0.48}[symmetry]
    settings = ["grid.cell=0.2", f"geometry.symmetry={symmetry}", f"material.poisson={poisson}"]
    body = build(load_scene("column_small", settings))
    cell = body.scene.grid.cell
    x = body.x + 0.1 * cell * rng.uniform(-1.0, 1.0, body.x.shape)
    x[-1] += 6 * cell
    theta = -1e-3 + 3e-3 * rng.normal(size=len(x))
    velocity = rng.normal(size=x.shape)
    weights = Basis(len(x))
    weights.evaluate(Points(replace(body, x=x)).x, cell)
    columns = weights.base.numpy()[:, :2]
    held, points = np.unique(columns, axis=0, return_counts=True)
    cut = cut_plan(held, points, comm.size)
    mine = owner_of(columns, cut) == comm.rank

    state = Points(replace(body, x=x[mine]))
    state.theta.numpy()[:], state.v.numpy()[:] = theta[mine], velocity[mine]
    state.load.numpy()[:, 2] = -9.81 * state.mass
    weights = Basis(state.count)
    weights.evaluate(state.x, cell)
    background = BackgroundMesh(cell, body.walls, comm)
    background.follow(weights.base.numpy(), cut)
    system = System(state, weights, background, LAW.pack(body.constants))
    system.set_regularisation(drag=1.0, ghost=2e4, viscous=0.05, dt=0.03, momentum=0.7)

    place = system.place_in_lattice + background.corner
    u, direction = 2e-3 * cell * np.sin(place @ WAVES), np.cos(place @ WAVES)
    u[system.held] = direction[system.held] = 0.0
    residual = system.residual(u)
    matrix, refill = matrix_of(system)
    refill(system.tangent(0.0 * u))
    sweep(matrix)
    refill(system.tangent(u))
    new, fill = matrix_of(system)
    fill(system.tangent(u))
    given, product = matrix.createVecs()
    given.array[:] = direction[: system.owned].ravel()
    Tangent(system, matrix).mult(None, given, product)
    own = slice(system.owned)
    found = {
        "mass": system.node_mass[own],
        "momentum": system.node_mass[own, None] * system.velocity[own],
        "unbalanced": system.unbalanced[own],
        "residual": residual,
        "product": product.array.reshape(-1, 3).copy(),
        "sweep": sweep(matrix),
        "sweep_of_new": sweep(new),
        "owner": np.full(system.owned, comm.rank),
    }
    return together(comm, place[own], found)


def sweep(matrix) -> np.ndarray:
    """What Newton's first preconditioner makes of ones (owned, 3)."""
    ones, swept = matrix.createVecs()
    ones.set(1.0)
    preconditioner = PETSc.PC().create(matrix.comm)
    preconditioner.setOperators(matrix)
    preconditioner.setType(newton.PRECONDITIONERS[0])
    preconditioner.apply(ones, swept)
    return swept.array.reshape(-1, 3).copy()


def settled(comm) -> dict[str, np.ndarray]:
    """By node, in the order of the lattice: increment of an elastic column under its weight, by each preconditioner."""
    start_warp()
    changes = ["material.model=elastic", "material.young=3e5", "loads.initial_stress=none", "grid.cell=0.25"]
    solver = Domain(build(load_scene("column_small", changes)), Regularisation(), comm)
    solver.load_share = 1.0
    solver._pull()
    system = solver._new_system()
    system.set_regularisation(ghost=1e3)
    weight, kinds, found = system.norm(system.load), newton.PRECONDITIONERS, {}
    for kind in kinds:
        newton.PRECONDITIONERS = (kind,)
        outcome = newton.solve(system, 1e-11 * weight, 1e-8)
        assert outcome.converged and outcome.iterations <= 6, (kind, outcome.residuals)
        found[kind] = outcome.u[: system.owned]
    newton.PRECONDITIONERS = kinds
    return together(comm, (system.place_in_lattice + solver.background.corner)[: system.owned], found)


def together(comm, place, found):
    """What the ranks have `found`, by node in the order of `place`."""
    parts = comm.allgather(found | {"place": place})
    whole = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    order = np.lexsort(whole["place"].T)
    return {name: values[order] for name, values in whole.items()}


if __name__ == "__main__":
    comm, (_, file, what) = MPI.COMM_WORLD, sys.argv
    found = settled(comm) if what == "settled" else fields(comm, what)
    if comm.rank == 0:
        np.savez(file, **found)
