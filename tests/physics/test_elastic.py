"""Elastic verification: self-weight compaction, the vibrating bar, objective stress rotation."""

import numpy as np
import pytest

HEIGHT, RHO_G, MODULUS = 2.0, 2000.0 * 9.81, 7.86154e6


def settled(solver_of, run_to, cells):
    cell = HEIGHT / cells
    solver = solver_of(
        "self_weight", f"grid.cell={cell}", f"geometry.size=[{cell},{cell},{HEIGHT}]", "explicit.damping=0.4"
    )
    list(run_to(solver, 3.0))
    return solver


def test_self_weight_column_settles_to_the_elastic_value_at_first_order(solver_of, run_to):
    """sigma_zz = -rho g (h - Z) at the material height Z; error norm as in physics: mean |difference| / (rho g h).

    The settlement of the hypoelastic law under finite strain: ln(stretch) = sigma_zz / M along Z.
    """
    errors = []
    for cells in (8, 16, 32):
        solver = settled(solver_of, run_to, cells)
        z = solver.body.x[:, 2]
        exact = -RHO_G * (HEIGHT - z)
        errors.append(np.abs(solver.sigma[:, 2] - exact).mean() / (RHO_G * HEIGHT))
    rates = np.log2(np.array(errors[:-1]) / errors[1:])
    assert errors[-1] < 0.01
    assert np.all(rates > 1.0), f"errors {errors}, rates {rates}"

    top = z.argmax()
    stretch = RHO_G / MODULUS
    sunk = z[top] - (np.exp(-stretch * (HEIGHT - z[top])) - np.exp(-stretch * HEIGHT)) / stretch
    assert solver.body.constants.p_wave_modulus == pytest.approx(MODULUS, rel=1e-6)
    assert (solver.body.x - solver.x.numpy())[top, 2] == pytest.approx(sunk, rel=2e-3)


def test_axial_bar_vibrates_with_its_period(solver_of, run_to):
    """Period 4L/c, c = sqrt(E/rho) at nu = 0: 0.08 s, from the crossings of the mean height."""
    solver = solver_of("elastic_bar")
    history = [(t, solver.x.numpy()[:, 2].mean()) for t in run_to(solver, 0.4, 2 * solver.time_step)]
    t, z = np.array(history).T
    level = 0.5 * (z.max() + z.min())
    down = np.where((z[:-1] > level) & (z[1:] <= level))[0]
    crossings = t[down] + (z[down] - level) / (z[down] - z[down + 1]) * (t[down + 1] - t[down])
    assert len(crossings) == 5
    period = (crossings[-1] - crossings[0]) / 4
    assert period == pytest.approx(4 * 2.0 / np.sqrt(2e7 / 2000.0), rel=0.01)


def test_rigid_rotation_turns_the_stress_and_changes_nothing_else(solver_of):
    """A quarter turn in 500 steps of a rigid velocity field on the nodes: the deviator s -> Q s Q^T.

    Only the stress phases run, with the points held in place, so that the closed form holds exactly. A step x += dt w x
    along the tangent stretches by det F = 1 + a^2 for the angle a, and the mean stress is that of one step, K ln det F.
    """
    solver = solver_of("self_weight", "geometry.walls={z_min='free'}", "loads.gravity=0.0", "explicit.until=1.0",
                       "output.history_every=1.0")  # fmt: skip
    solver.set_target(1.0)
    solver.step()  # fills clock and grid
    steps, angle = 500, np.pi / 2
    dt = float(solver.clock.numpy()[1])
    axis = np.array([1.0, 2.0, -2.0]) / 3.0
    spin = axis * angle / (steps * dt)
    base = solver.grid.base.numpy()
    nodes = np.zeros((solver.grid.capacity, 4))
    pencil = solver.grid.pencil_of.numpy()
    i, j = np.divmod(pencil, base.shape[1])
    k = np.arange(len(pencil)) - base[i, j]
    position = 0.125 * np.stack([i + solver.grid.i0, j + solver.grid.j0, k], axis=1)
    nodes[:, :3] = np.cross(spin, position)
    solver.node_mapped.assign(nodes)
    solver.carry.zero_()
    start = np.tile([-3e3, 1e3, 2e3, 5e2, -7e2, 9e2], (solver.points, 1))
    solver.tau.assign(start)
    for _ in range(steps):
        solver.node_dilation.zero_()
        solver.node_force.zero_()
        for phase in solver.phases[-3:]:
            phase.launch()

    def full(s):
        return np.array([[s[0], s[5], s[4]], [s[5], s[1], s[3]], [s[4], s[3], s[2]]])

    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    turn = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    expected = turn @ full(start[0]) @ turn.T
    tau = solver.tau.numpy()
    mean = tau[:, :3].mean(axis=1)
    assert mean == pytest.approx(solver.body.constants.bulk * np.log1p((angle / steps) ** 2), rel=1e-6)
    tau[:, :3] -= mean[:, None]
    for s in tau:
        assert full(s) == pytest.approx(expected, abs=0.05)  # 2 atan(a/2) against a: 1e-5 of 3 kPa
        assert np.linalg.norm(full(s)) == pytest.approx(np.linalg.norm(full(start[0])), rel=1e-9)
