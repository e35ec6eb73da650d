"""A column of sand, lambda0 = h0/r0 = 0.5, collapses: how far it runs out, and where the energy of its fall goes."""

import repose

scene = repose.load_scene("column_small", grid={"cell": 1 / 6}, explicit={"damping": 0.4})
result = repose.run(scene)

r0, h0 = scene.geometry.radius, scene.geometry.height
found = result.summary
print(f"{found['points']} points came to rest after {found['sim_time']:.2f} s")
print(f"99.5 % of the mass lies within r = {r0 * (1 + found['R_995']):.3f} m; Eq. 4: {r0 * (1 + found['eq4']):.3f} m")
print(f"height: {found['h_inf']:.3f} m, of {h0:.3f} m at the start")

# The ledger of energies [J]: friction takes most of what gravity gives, damping the rest.
energy = result.history
for name, column in {"plastic work": "W_plastic", "damping": "W_damping", "still elastic": "E_elastic"}.items():
    print(f"{name}: {energy[column][-1] / energy['W_ext'][-1]:.1%} of the work of gravity")

result.plot_profile().savefig("profile.png")
result.plot_morphology().savefig("morphology.png")
result.plot_history().savefig("history.png")
