"""The host looks at the device at the end of a batch and where the stored nodes follow, and is never behind it."""

import numpy as np
import pytest
import warp as wp

from explicit.dials import Dials, Seen
from explicit.kernels.sparse_grid import NODES
from explicit.run import run
from explicit.solver import ExplicitSolver
from mpm.body import build
from mpm.devices import start_warp
from mpm.load import load_scene
from mpm.results import Results

start_warp()


def started(until=0.3) -> ExplicitSolver:
    solver = ExplicitSolver(build(load_scene("column_small", ["explicit.damping=0.05"])))
    solver.advance_to(until)
    return solver


def test_looks_per_thousand_steps(monkeypatch):
    """One a batch of steps, and two more where the stored nodes follow the points."""
    solver, looks, fits = started(), [], []
    as_numpy, fit_grid = wp.array.numpy, ExplicitSolver.fit_grid
    monkeypatch.setattr(wp.array, "numpy", lambda array: looks.append(array) or as_numpy(array))
    monkeypatch.setattr(ExplicitSolver, "fit_grid", lambda solver: fits.append(solver) or fit_grid(solver))
    solver.set_target(10.0)
    first, batches = solver.steps, 0
    while solver.steps < first + 1000:
        solver.advance(10.0)
        batches += 1
    assert 0 < len(fits) < batches < 100
    assert len(looks) == batches + 2 * len(fits)


def test_looks_of_a_fused_run(monkeypatch):
    """Two a history row, at the dials and at the row, and none where the stored nodes follow the points; where there is
    no room for these, two more and another batch."""
    monkeypatch.setattr(wp.config, "enable_cpu_blocks", True)
    settings = ["explicit.damping=0.05", "grid.cell=0.125"]
    solver = ExplicitSolver(build(load_scene("column_small", settings)), fused=True)
    solver.advance_to(0.3)
    looks, rooms, nodes = [], [], set()
    as_numpy, fit_grid = wp.array.numpy, ExplicitSolver.fit_grid
    monkeypatch.setattr(wp.array, "numpy", lambda array: looks.append(array) or as_numpy(array))
    monkeypatch.setattr(ExplicitSolver, "fit_grid", lambda solver: rooms.append(solver) or fit_grid(solver))
    solver.set_target(10.0)
    rows = batches = 0
    every, until = solver.body.time_scale / 20, solver.time
    while rows < 20:
        batches += 1
        if solver.advance(until) >= until:
            solver.observe()
            rows, until = rows + 1, until + every
            nodes.add(int(as_numpy(solver.grid.found)[NODES]))
    assert len(nodes) > 2 + len(rooms)
    assert len(looks) == batches + rows + 2 * len(rooms)
    assert batches == rows + len(rooms)


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_what_was_seen_is_what_is_there(monkeypatch, tmp_path, precision):
    """A run to whose host each look is a copy, as on a GPU, is the run that sees all as it changes."""
    settings = ["grid.cell=0.2", "explicit.until=0.3", f"explicit.precision={precision}"]
    scene = load_scene("column_small", settings)
    ends = [run(scene, tmp_path / "live")]
    live = Dials.read

    def copied(dials):
        seen = live(dials)
        return Seen(seen.clock.copy(), seen.speed.copy(), seen.fault.copy())

    monkeypatch.setattr(Dials, "read", copied)
    ends.append(run(scene, tmp_path / "copied"))
    assert ends[0]["steps"] == ends[1]["steps"] > 50
    one, other = (Results.open(tmp_path / name) for name in ("live", "copied"))
    for name, values in one.history().items():
        np.testing.assert_array_equal(other.history()[name], values, err_msg=name)
    np.testing.assert_array_equal(other.read_checkpoint()["x"], one.read_checkpoint()["x"])
