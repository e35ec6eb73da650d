"""Scenes seeded from the mesh files: the cylinder runs out like the analytic column, the cone at repose stays."""

from pathlib import Path

import pytest

from explicit.solver import ExplicitSolver
from mpm.config import load_scene
from mpm.devices import start_warp
from mpm.runout import run_out
from mpm.scene import build

MESHES = Path(__file__).parents[2] / "meshes"


def runouts_at(scene, time):
    start_warp()
    solver = ExplicitSolver(build(scene))
    start = run_out(solver.x.numpy(), solver.body.measure)
    solver.aim(time)
    while solver.time < time:
        solver.advance(time)
    return start, run_out(solver.x.numpy(), solver.body.measure)


def test_cylinder_from_a_mesh_runs_out_like_the_column():
    _, column = runouts_at(load_scene("column_small"), 1.5)
    for file in ("cylinder.stl", "cylinder_volume.vtu"):
        scene = load_scene(str(MESHES / "cylinder.toml"), [f"geometry.file={MESHES / file}"])
        _, mesh = runouts_at(scene, 1.5)
        assert mesh["R_995"] == pytest.approx(column["R_995"], rel=0.02), file
        assert mesh["R_max"] == pytest.approx(column["R_max"], rel=0.02), file


def test_cone_at_repose_hardly_spreads():
    """The same volume as a column moves its front ten times as far."""
    cone = [end["R_995"] for end in runouts_at(load_scene(str(MESHES / "cone.toml")), 1.0)]
    column = [end["R_995"] for end in runouts_at(load_scene("column_small"), 1.0)]
    assert abs(cone[1] - cone[0]) < 0.02
    assert column[1] - column[0] > 10 * abs(cone[1] - cone[0])
