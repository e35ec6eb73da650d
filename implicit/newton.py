"""Newton's method for one step: PETSc SNES with a backtracking line search and a Krylov solver."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import bsr_matrix

from implicit._dolfinx import PETSc
from implicit.system import System

MOST_ITERATIONS = 25
MOST_LINEAR_ITERATIONS = 300  # of one linear solve; beyond, the next preconditioner is tried
# A line search that must shorten a step below this has no descent: at a kink (a point that just closes, or just
# yields) the tangent of one side points uphill.
SHORTEST = 0.03
DECREASE = 1e-4  # share of its first-order decrease that the residual's norm must fall by
# Shares of the elastic in the plastic modulus with which Newton goes on from such a kink. They fall tenfold with each
# iteration, so that the last ones are exact Newton; the solution is the same.
RESCUES = (0.0, 0.01, 0.1)
# Preconditioners from the assembled rows, in the order in which they are tried: symmetric sweeps, then ILU(1) and
# complete factors. Sweeps need no set-up and win as long as they converge.
PRECONDITIONERS = ("sor", "ilu", "lu")


@dataclass
class NewtonResult:
    """What a Newton solve gave: the increment `u` (count, 3) [m] if `converged`, and what it took.

    `residuals`: norm of the residual [N] before the first and after each iteration. `preconditioner`: the last tried.
    """

    u: np.ndarray
    converged: bool
    iterations: int
    linear_iterations: int
    residuals: list[float]
    preconditioner: str = PRECONDITIONERS[0]


class Tangent:
    """The tangent as PETSc sees a matrix without entries: the assembled rows and the nodes' coupling of pressures."""

    def __init__(self, system: System, assembled):
        self.system, self.assembled = system, assembled

    def mult(self, _matrix, x, y):
        self.assembled.mult(x, y)
        y.array[:] += self.system.coupling(x.array_r)


def matrix_of(system: System):
    """The assembled rows as PETSc's matrix, on the ranks of the system, and a function that refills it with blocks."""
    sizes = (3 * system.owned, 3 * system.total)
    if system.comm.size > 1:
        pattern = (system.indptr, system.indices)
        matrix = PETSc.Mat().createBAIJ((sizes, sizes), bsize=3, csr=pattern, comm=system.comm)
        matrix.setOption(PETSc.Mat.Option.ROW_ORIENTED, False)  # blocks one by one, each by columns

        def refill(blocks):
            matrix.setValuesBlockedCSR(*pattern, blocks.transpose(0, 2, 1).ravel())
            matrix.assemble()
            # PETSc 3.22 to 3.25 keep the diagonal blocks' inverses of the values before, with which sweeps take a third
            # more iterations. To clear rows, even none, makes them forget those.
            matrix.zeroRows([])

        return matrix, refill
    places = np.arange(9 * len(system.indices)).reshape(-1, 3, 3)
    csr = bsr_matrix((places, system.indices, system.indptr), shape=sizes).tocsr()
    order, values = csr.data, np.zeros(csr.nnz)
    matrix = PETSc.Mat().createAIJWithArrays((sizes, sizes), csr=(csr.indptr, csr.indices, values), comm=system.comm)

    def refill_own(blocks):
        np.take(blocks.reshape(-1), order, out=values)  # the matrix' own memory
        matrix.assemble()

    return matrix, refill_own


class _Context:
    """A system as SNES sees it."""

    def __init__(self, system: System, refill):
        self.system, self.refill, self.blend = system, refill, 0.0

    def residual(self, _snes, x, f):
        f.array[:] = self._at(x.array_r).ravel()

    def _at(self, u):
        return self.system.residual(self.system.kept(u))

    def _norm(self, u):
        return self.system.norm(self._at(u))

    def shorten(self, x, y):
        """Halve the step `y` (x_new = x - y) until the residual falls; SNES' own search then takes it whole.

        That search fits a cubic to the norm, which has kinks: it cuts to a tenth where a half would do.
        """
        start, u, step = self._norm(x.array_r), x.array_r.copy(), y.array_r.copy()
        length = 1.0
        while length > SHORTEST:
            if self._norm(u - length * step) < (1.0 - DECREASE * length) * start:
                break
            length *= 0.5
        y.scale(length)
        return length < 1.0

    def tangent(self, _snes, x, operator, _matrix):
        s = self.system
        self.refill(s.tangent(s.kept(x.array_r), self.blend))
        self.blend = 0.1 * self.blend if self.blend > RESCUES[1] / 100 else 0.0
        operator.assemble()


def solve(system: System, tolerance: float, linear_tolerance: float, start: np.ndarray | None = None) -> NewtonResult:
    """Find the increment at which the residual's norm is below `tolerance` [N], from `start` (count, 3) [m] or u = 0.

    `linear_tolerance` [-]: relative residual of the linear solves. Not converged where the line search finds no
    descent, or not within 25 iterations.
    """
    matrix, refill = matrix_of(system)
    context = _Context(system, refill)
    operator = PETSc.Mat().createPython(matrix.getSizes(), Tangent(system, matrix), comm=system.comm)
    operator.setUp()
    x, f = matrix.createVecs()
    snes = PETSc.SNES().create(system.comm)
    try:
        snes.setFunction(context.residual, f)
        snes.setJacobian(context.tangent, operator, matrix)
        snes.setLineSearchPreCheck(context.shorten)
        _configure(snes, linear_tolerance)
        x.array[:] = 0.0 if start is None else start[: system.owned].ravel()
        return _solve(snes, context, x, tolerance)
    finally:
        for thing in (snes, operator, matrix, x, f):  # petsc4py would keep them: a gigabyte in a few hundred steps
            thing.destroy()


def _configure(snes, linear_tolerance):
    snes.setType("newtonls")
    options = PETSc.Options()
    snes.setOptionsPrefix("repose_")
    options["repose_snes_linesearch_type"] = "bt"
    options["repose_snes_linesearch_minlambda"] = SHORTEST
    options["repose_sub_pc_type"] = "ilu"  # of each rank's rows, where there are several
    options["repose_sub_pc_factor_levels"] = 1
    ksp = snes.getKSP()
    ksp.setType("gmres")
    ksp.setGMRESRestart(150)
    # From the left, factors can leave a small residual where the true one is not.
    ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
    ksp.setPCSide(PETSc.PC.Side.RIGHT)
    ksp.setTolerances(rtol=linear_tolerance, atol=0.0, max_it=MOST_LINEAR_ITERATIONS)
    snes.setFromOptions()


def _precondition(pc, kind):
    """Set one of PRECONDITIONERS. On several ranks sweeps go over the rows of each, and ILU(1) is made of them."""
    if pc.comm.size == 1:
        pc.setType(kind)
        if kind == "ilu":
            pc.setFactorLevels(1)  # ILU(0) diverges on these matrices
    elif kind == "ilu":
        pc.setType("asm")
        pc.setASMOverlap(1)
    else:
        pc.setType(kind)
        if kind == "lu":
            pc.setFactorSolverType("mumps")


def _solve(snes, context, x, tolerance) -> NewtonResult:
    reasons = PETSc.SNES.ConvergedReason
    iterations = linear_iterations = 0
    residuals = []
    stages = [(blend, PRECONDITIONERS[0]) for blend in RESCUES]
    while stages:
        context.blend, preconditioner = stages.pop(0)
        _precondition(snes.getKSP().getPC(), preconditioner)
        snes.setTolerances(rtol=0.0, atol=tolerance, stol=0.0, max_it=MOST_ITERATIONS - iterations)
        snes.setConvergenceHistory(MOST_ITERATIONS + 1, reset=True)
        snes.solve(None, x)
        iterations += snes.getIterationNumber()
        linear_iterations += snes.getLinearSolveIterations()
        residuals += list(snes.getConvergenceHistory()[0])[1 if residuals else 0 :]
        reason = snes.getConvergedReason()
        if reason > 0:
            break
        if reason == reasons.DIVERGED_LINEAR_SOLVE:
            later = PRECONDITIONERS[PRECONDITIONERS.index(preconditioner) + 1 :]
            stages = [(context.blend, later[0]), *((b, later[0]) for b, _ in stages)] if later else []
        elif reason != reasons.DIVERGED_LINE_SEARCH:
            break
        if iterations >= MOST_ITERATIONS:
            break
    u = context.system.kept(x.array).copy()
    return NewtonResult(u, reason > 0, iterations, linear_iterations, residuals, preconditioner)
