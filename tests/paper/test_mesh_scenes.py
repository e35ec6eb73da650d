"""Scenes seeded from the mesh files: the cylinder runs out like the analytic column, the cone at repose stays."""

from pathlib import Path

import pytest

from mpm.runout import run_out

MESHES = Path(__file__).parents[2] / "meshes"


@pytest.fixture
def runouts_at(solver_of, run_to):
    """`runouts_at(time, scene, *overrides)` -> all measures at the start and at `time` [s]."""

    def measure(time, scene, *overrides):
        solver = solver_of(scene, *overrides)
        start = run_out(solver.x.numpy(), solver.body.measure)
        list(run_to(solver, time))
        return start, run_out(solver.x.numpy(), solver.body.measure)

    return measure


def test_cylinder_from_a_mesh_runs_out_like_the_column(runouts_at):
    _, column = runouts_at(1.5, "column_small")
    for file in ("cylinder.stl", "cylinder_volume.vtu"):
        _, mesh = runouts_at(1.5, str(MESHES / "cylinder.toml"), f"geometry.file={MESHES / file}")
        assert mesh["R_995"] == pytest.approx(column["R_995"], rel=0.02), file
        assert mesh["R_max"] == pytest.approx(column["R_max"], rel=0.02), file


def test_cone_at_repose_hardly_spreads(runouts_at):
    """The same volume as a column moves its front ten times as far."""
    cone = [end["R_995"] for end in runouts_at(1.0, str(MESHES / "cone.toml"))]
    column = [end["R_995"] for end in runouts_at(1.0, "column_small")]
    assert abs(cone[1] - cone[0]) < 0.02
    assert column[1] - column[0] > 10 * abs(cone[1] - cone[0])
