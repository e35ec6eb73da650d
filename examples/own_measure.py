"""Measures of your own: how much of a column takes part in its collapse, and what gravity's work is by another way."""

import numpy as np
from matplotlib.figure import Figure

import repose

scene = repose.load_scene("column_small", grid={"cell": 1 / 6}, explicit={"damping": 0.05}, output={"every": 0.05})
run = repose.run(scene)

r0, spacing = scene.geometry.radius, scene.grid.cell / 2
mass = scene.material.density * spacing**3 * len(run.points)  # of the quarter that is computed [kg]
snapshots = [run.snapshot(index) for index in range(len(run.times))]

# A grain has moved when it is 2 % of r0 from where it was.
moved = np.array([np.mean(np.linalg.norm(one["displacement"], axis=1) > 0.02 * r0) for one in snapshots])
print(f"{1 - moved[-1]:.0%} of the column never moves")

# Gravity works M g on the fall of the centre of mass: the run's own ledger sums forces times velocities over its steps.
fall = np.array([-one["displacement"][:, 2].mean() for one in snapshots])
work = mass * scene.loads.gravity * fall
ledger = np.interp(run.times, run.history["time"], run.history["W_ext"])
print(f"work of gravity: {work[-1]:.1f} J from the centre of mass, {ledger[-1]:.1f} J in the ledger")

figure = Figure(figsize=(5, 4), layout="constrained")
axes = figure.subplots()
axes.plot(run.times, moved, label="share of the mass that has moved")
axes.plot(run.times, fall / fall[-1], label="fall of the centre of mass, over its end")
axes.set(xlabel="time [s]", ylabel="[-]")
axes.legend()
figure.savefig("moved.png")
