"""Linear solvers on tangents of a collapse: iterations, set-up and solve seconds, true residual; one row each.

    python benchmarks/implicit_linear.py SCENE [--set KEY=VALUE ...] [--steps N] [--table FILE]

Marches N steps, takes the tangent at the last increment, and solves for it with each solver in turn: GMRES(150),
right preconditioning, relative tolerance 1e-3, at most 600 iterations. The operator is the exact tangent; the
preconditioners are made of its block rows.
"""

import argparse
import csv
import time
from pathlib import Path

from implicit._dolfinx import PETSc
from implicit.newton import Tangent
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


def tangent_of(solver):
    """Block rows (3x3) and right-hand side of the last step at half its increment, where Newton is at work."""
    system = solver.system
    u = 0.5 * system.u.numpy().copy()
    values, size = system.tangent(u), 3 * system.count
    pattern = (system.indptr, system.indices, values.reshape(-1).copy())
    matrix = PETSc.Mat().createBAIJ(((size, size), (size, size)), bsize=3, csr=pattern, comm=PETSc.COMM_SELF)
    right = matrix.createVecLeft()
    right.array[:] = -system.residual(u).ravel()
    return matrix, right


def solve(system, matrix, right, kind, preconditioner, options, number):
    """Set-up seconds, solve seconds, iterations and the true relative residual."""
    if kind != "baij":
        matrix = matrix.convert(kind, PETSc.Mat())
        matrix.setBlockSize(3)
    prefix = f"linear{number}_"
    for key, value in options.items():
        PETSc.Options()[prefix + key] = value
    krylov = PETSc.KSP().create(PETSc.COMM_SELF)
    krylov.setOptionsPrefix(prefix)
    operator = PETSc.Mat().createPython(matrix.getSizes(), Tangent(system, matrix), comm=PETSc.COMM_SELF)
    operator.setUp()
    krylov.setOperators(operator, matrix)
    krylov.setType("gmres")
    krylov.setGMRESRestart(150)
    krylov.setPCSide(PETSc.PC.Side.RIGHT)
    krylov.getPC().setType(preconditioner)
    krylov.setTolerances(rtol=1e-3, max_it=600)
    krylov.setFromOptions()
    x = matrix.createVecRight()
    start = time.perf_counter()
    krylov.setUp()
    ready = time.perf_counter()
    krylov.solve(right, x)
    done = time.perf_counter()
    true = (right - operator * x).norm() / right.norm()
    result = ready - start, done - ready, krylov.getIterationNumber(), true
    krylov.destroy()
    operator.destroy()
    return result


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--steps", type=int, default=12)
    parser.add_argument("--table", type=Path, default=Path("benchmarks/results/implicit_linear_cpu.csv"))
    options = parser.parse_args()
    start_warp()
    solver = ImplicitSolver(build(load_scene(options.scene, options.set)))
    for _ in range(options.steps):
        solver.advance()
    matrix, right = tangent_of(solver)
    described = provenance("cpu", "float64")
    rows = []
    for number, (name, (kind, preconditioner, more)) in enumerate(SOLVERS.items()):
        setup, spent, iterations, true = solve(solver.system, matrix, right, kind, preconditioner, more, number)
        rows.append(
            {
                "scene": options.scene,
                "set": " ".join(options.set),
                "unknowns": matrix.getSize()[0],
                "blocks": len(solver.system.indices),
                "solver": name,
                "setup_s": f"{setup:.3f}",
                "solve_s": f"{spent:.3f}",
                "iterations": iterations,
                "true_residual": f"{true:.1e}",
                "device": described["device_name"],
                "commit": described["commit"],
            }
        )
        print(rows[-1], flush=True)
    fresh = not options.table.exists()
    options.table.parent.mkdir(parents=True, exist_ok=True)
    with open(options.table, "a", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        if fresh:
            writer.writeheader()
        writer.writerows(rows)


if __name__ == "__main__":
    main()
