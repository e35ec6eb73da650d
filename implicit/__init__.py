"""Implicit quasistatic MPM on dolfinx and PETSc: assembly over points, Newton, relaxation in pseudo-time."""
