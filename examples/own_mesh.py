"""A body of your own: a stockpile with sides too steep to stand (63 degrees, phi = 35), as STL, slides to its angle."""

from pathlib import Path

import meshio
import numpy as np

import repose

FOOT, TOP, HEIGHT = 1.0, 0.5, 1.0  # half the edge of the square foot and of the flat top, height [m]

corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
points = np.vstack([np.insert(FOOT * corners, 2, 0.0, axis=1), np.insert(TOP * corners, 2, HEIGHT, axis=1)])
sides = [[a, b, b + 4] for a, b in ((0, 1), (1, 2), (2, 3), (3, 0))]
sides += [[a, b + 4, a + 4] for a, b in ((0, 1), (1, 2), (2, 3), (3, 0))]
faces = [[0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7], *sides]  # wound outwards
meshio.Mesh(points, {"triangle": np.array(faces)}).write("stockpile.stl")

Path("stockpile.toml").write_text("""
name = "stockpile"
geometry = { shape = "mesh", file = "stockpile.stl", symmetry = "quarter" }
grid = { cell = 0.2 }
material = { young = 5e6, poisson = 0.3, density = 1600.0, friction_angle = 35.0 }
explicit = { damping = 0.2 }
""")
result = repose.run("stockpile.toml")

height = result.points[:, 2].max()
print(f"height {HEIGHT:.2f} m before, {height:.2f} m after {result.summary['sim_time']:.2f} s")
print(f"99.5 % of the mass lies within {FOOT * 2**0.5 * (1 + result.summary['R_995']):.2f} m of the axis")
result.plot_morphology().savefig("stockpile.png")
