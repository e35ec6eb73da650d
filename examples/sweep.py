"""A sweep: how the run-out of a column falls as friction grows, beside the quasistatic theory (Eq. 4)."""

from matplotlib.figure import Figure

import repose

angles = [25.0, 34.0, 43.0]  # friction phi [degrees]
runs = [
    repose.run(repose.load_scene("column_small", grid={"cell": 1 / 6}, material={"friction_angle": phi}))
    for phi in angles
]

computed = [run.summary["R_995"] for run in runs]
theory = [run.summary["eq4"] for run in runs]
for phi, mine, eq4 in zip(angles, computed, theory, strict=True):
    print(f"phi = {phi:g} degrees: R = {mine:.3f}, Eq. 4: {eq4:.3f}, {mine / eq4 - 1:+.0%}")

figure = Figure(figsize=(5, 4), layout="constrained")
axes = figure.subplots()
axes.plot(angles, theory, "k-", label="Eq. 4")
axes.plot(angles, computed, "o", label="computed, 6 cells per r0")
axes.set(xlabel="friction angle [degrees]", ylabel="run-out R_995 [-]", ylim=(0, None))
axes.legend()
figure.savefig("sweep.png")
