"""What both solvers share: scene files, points, the background lattice, uGIMP, Drucker-Prager, results."""
