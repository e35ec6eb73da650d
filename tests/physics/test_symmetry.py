"""Parts of a column stand for the whole; a slice between rollers stays plane."""

import numpy as np
import pytest

from mpm.runout import run_out


def test_quarter_and_half_columns_stand_for_the_full_one(solver_of, run_to):
    """Same run-out and height; the full column keeps its horizontal momentum at zero."""
    ends = {}
    for symmetry in ("quarter", "half", "full"):
        solver = solver_of("column_1", "grid.cell=0.2", f"geometry.symmetry='{symmetry}'", "explicit.damping=0.4")
        list(run_to(solver, 0.8))
        ends[symmetry] = run_out(solver.x.numpy(), solver.body.measure)
    assert ends["full"]["R_995"] > 0.2
    for measure in ("R_max", "R_995", "h_inf"):
        assert ends["quarter"][measure] == pytest.approx(ends["full"][measure], rel=0.02), measure
        assert ends["half"][measure] == pytest.approx(ends["full"][measure], rel=0.02), measure
    drift = solver.v.numpy()[:, :2].sum(axis=0)
    assert np.abs(drift).max() < 1e-9 * np.abs(solver.v.numpy()).sum()


def test_plane_strain_column_between_rollers_stays_plane(solver_of, run_to):
    solver = solver_of(
        "column_1",
        "geometry={shape='box', size=[1.0, 0.2, 0.5], "
        "walls={x_min='roller', y_min='roller', y_max='roller', z_min='fixed'}}",
        "grid.cell=0.1",
        "explicit.damping=0.4",
    )
    start = solver.body.x
    list(run_to(solver, 1.5))
    x = solver.x.numpy()
    assert np.abs(x[:, 1] - start[:, 1]).max() < 1e-9
    slices = [x[start[:, 1] == y][:, ::2] for y in np.unique(start[:, 1])]
    assert len(slices) == 4
    for other in slices[1:]:
        assert other == pytest.approx(slices[0], abs=1e-9)
    assert 0.1 < run_out(x, solver.body.measure)["R_995"] < 0.5  # plane-strain quasistatic theory: 0.325
