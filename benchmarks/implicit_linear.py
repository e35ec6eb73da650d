"""Linear solvers on tangents of a collapse: iterations, set-up and solve seconds, true residual; one row each.

    [mpiexec -n N] python benchmarks/implicit_linear.py SCENE [--set KEY=VALUE ...] [--steps N] [--table FILE]

Marches N steps, takes the tangent at the last increment, and solves for it with each solver in turn: GMRES(150),
right preconditioning, relative tolerance 1e-3, at most 600 iterations. The operator is the exact tangent; the
preconditioners are made of its block rows. Seconds are CPU time, of the rank that took longest.
"""

import argparse
import time
from pathlib import Path

import numpy as np

from compare.report.page import add_rows
from implicit._dolfinx import MPI, PETSc
from implicit.newton import Tangent
from implicit.pseudo_time import Regularisation
from implicit.ranks import Domain
from implicit.solver import ImplicitSolver
from mpm.body import build
from mpm.devices import start_warp
from mpm.load import load_scene
from mpm.provenance import provenance

# matrix format, PC type, PC options
SOLVERS = {
    "SOR, 3x3 blocks": ("baij", "sor", {}),
    "block Jacobi of points": ("baij", "pbjacobi", {}),
    "ILU(0), 3x3 blocks": ("baij", "ilu", {"pc_factor_levels": 0}),
    "ILU(0)": ("aij", "ilu", {"pc_factor_levels": 0}),
    "ILU(1)": ("aij", "ilu", {"pc_factor_levels": 1}),
    "GAMG, block size 3": ("aij", "gamg", {}),
    "ML, block size 3": ("aij", "ml", {}),
    "BoomerAMG": ("aij", "hypre", {"pc_hypre_type": "boomeramg"}),
    "MUMPS": ("aij", "lu", {"pc_factor_mat_solver_type": "mumps"}),
}
SWEEPS, ILU1 = {"sub_pc_type": "sor"}, {"sub_pc_type": "ilu", "sub_pc_factor_levels": 1}
RIGID = "GAMG, rigid-body modes"  # as its near-nullspace
SOLVERS_ON_RANKS = {
    "SOR in each rank's rows": ("baij", "sor", {}),
    "additive Schwarz, SOR": ("baij", "asm", SWEEPS),
    "block Jacobi, ILU(1)": ("baij", "bjacobi", ILU1),
    "additive Schwarz, ILU(1)": ("baij", "asm", ILU1),
    "GAMG, block size 3": ("aij", "gamg", {}),
    RIGID: ("aij", "gamg", {}),
    "BoomerAMG": ("aij", "hypre", {"pc_hypre_type": "boomeramg"}),
    "MUMPS": ("aij", "lu", {"pc_factor_mat_solver_type": "mumps"}),
}


def tangent_of(solver):
    """Block rows (3x3) and right-hand side of the last step at half its increment, where Newton is at work."""
    system = solver.system
    u = 0.5 * system.u.numpy().copy()
    values, sizes = system.tangent(u), (3 * system.owned, 3 * system.total)
    pattern = (system.indptr, system.indices, values.reshape(-1).copy())
    matrix = PETSc.Mat().createBAIJ((sizes, sizes), bsize=3, csr=pattern, comm=system.comm)
    right = matrix.createVecLeft()
    right.array[:] = -system.residual(u).ravel()
    return matrix, right


def rigid_body_modes(system, matrix):
    """Translations and rotations of the nodes."""
    places = matrix.createVecRight()
    places.setBlockSize(3)
    places.array[:] = system.place_in_lattice[: system.owned].ravel()
    return PETSc.NullSpace().createRigidBody(places)


def solve(system, matrix, right, name, kind, preconditioner, options, number):
    """Set-up seconds, solve seconds, iterations and the true relative residual."""
    if kind != "baij":
        matrix = matrix.convert(kind, PETSc.Mat())
        matrix.setBlockSize(3)
    if name == RIGID:
        matrix.setNearNullSpace(rigid_body_modes(system, matrix))
    prefix = f"linear{number}_"
    for key, value in options.items():
        PETSc.Options()[prefix + key] = value
    krylov = PETSc.KSP().create(system.comm)
    krylov.setOptionsPrefix(prefix)
    operator = PETSc.Mat().createPython(matrix.getSizes(), Tangent(system, matrix), comm=system.comm)
    operator.setUp()
    krylov.setOperators(operator, matrix)
    krylov.setType("gmres")
    krylov.setGMRESRestart(150)
    krylov.setPCSide(PETSc.PC.Side.RIGHT)
    krylov.getPC().setType(preconditioner)
    krylov.setTolerances(rtol=1e-3, max_it=600)
    krylov.setFromOptions()
    x = matrix.createVecRight()
    start = time.process_time()
    krylov.setUp()
    ready = time.process_time()
    krylov.solve(right, x)
    done = time.process_time()
    true = (right - operator * x).norm() / right.norm()
    setup, spent = np.max(system.comm.allgather((ready - start, done - ready)), axis=0)
    result = setup, spent, krylov.getIterationNumber(), true
    krylov.destroy()
    operator.destroy()
    return result


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--steps", type=int, default=12)
    parser.add_argument("--table", type=Path, default=Path("benchmarks/results/implicit_linear_ranks_cpu.csv"))
    options = parser.parse_args()
    start_warp()
    comm, body = MPI.COMM_WORLD, build(load_scene(options.scene, options.set))
    several = comm.size > 1
    solver = Domain(body, Regularisation(), comm) if several else ImplicitSolver(body)
    for _ in range(options.steps):
        solver.advance()
    matrix, right = tangent_of(solver)
    described = provenance("cpu", "float64")
    rows = []
    for number, (name, kind) in enumerate((SOLVERS_ON_RANKS if several else SOLVERS).items()):
        setup, spent, iterations, true = solve(solver.system, matrix, right, name, *kind, number)
        rows.append(
            {
                "scene": options.scene,
                "set": " ".join(options.set),
                "ranks": comm.size,
                "unknowns": matrix.getSize()[0],
                "blocks": comm.allreduce(len(solver.system.indices)),
                "solver": name,
                "setup_s": f"{setup:.3f}",
                "solve_s": f"{spent:.3f}",
                "iterations": iterations,
                "true_residual": f"{true:.1e}",
                "device": described["device_name"],
                "commit": described["commit"],
            }
        )
        if comm.rank == 0:
            print(rows[-1], flush=True)
    if comm.rank:
        return
    add_rows(options.table, rows)


if __name__ == "__main__":
    main()
