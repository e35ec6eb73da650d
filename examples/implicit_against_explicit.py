"""One column by both solvers: stepped in time with heavy damping, and as a quasistatic collapse. Do the heaps agree?"""

import numpy as np
from matplotlib.figure import Figure

import repose

scene = repose.load_scene("column_small", grid={"cell": 1 / 6}, explicit={"damping": 0.4})
runs = {mode: repose.run(scene, mode=mode) for mode in ("explicit", "implicit")}

figure = Figure(figsize=(6, 4), layout="constrained")
axes = figure.subplots()
for mode, run in runs.items():
    radius = np.sort(np.hypot(*run.points[:, :2].T))  # all points have the same mass
    axes.plot(radius, np.arange(1, len(radius) + 1) / len(radius), label=mode)
    found = run.summary
    print(f"{mode}: R = {found['R_995']:.3f}, height {found['h_inf']:.3f} m, {found['steps']} steps")
axes.set(xlabel="radius r [m]", ylabel="share of the mass within r [-]")
axes.legend()
figure.savefig("mass_within.png")

explicit, implicit = (run.summary["R_995"] for run in runs.values())
print(f"the implicit run-out is {implicit / explicit - 1:+.1%} off the explicit one; Eq. 4: {found['eq4']:.3f}")
print(f"at rest, forces on the nodes balance within {runs['implicit'].summary['unbalanced_ratio']:.2%}")
