"""Table 1 of Wyser et al. 2023: the paper's twelve counts, and what the sparse grid stores in their place."""

import functools
import sys

import numpy as np
import pytest

from compare.cli import main as cli
from explicit.solver import ExplicitSolver
from mpm.body import build
from mpm.devices import find_device
from mpm.load import load_scene
from mpm.walls import paper_grid

# lambda0: elements, nodes, material points
TABLE1 = {
    0.5: (27104, 30375, 25120),
    1: (169344, 180625, 50240),
    2: (1183424, 1225125, 100480),
    4: (8817984, 8978125, 200960),
}
ROWS = [(lambda0, *counts) for lambda0, counts in TABLE1.items()]


@functools.cache
def body(lambda0):
    """The paper's column, built once."""
    return build(load_scene(f"column_{lambda0:g}"))


@pytest.mark.parametrize(("lambda0", "n_el", "n_no", "n_mp"), ROWS)
def test_counts_are_the_papers(lambda0, n_el, n_no, n_mp):
    assert paper_grid(20, lambda0) == (n_el, n_no)
    assert len(body(lambda0).x) == n_mp


@pytest.mark.parametrize("lambda0", TABLE1)
def test_points_hold_the_columns_mass(lambda0):
    column = body(lambda0)
    assert column.point_volume == pytest.approx(0.025**3)
    assert len(column.x) * column.point_mass == pytest.approx(2000.0 * np.pi / 4 * lambda0, rel=1e-3)


@pytest.mark.parametrize(("lambda0", "n_el", "n_no", "n_mp"), [ROWS[0], ROWS[-1]])
def test_validate_prints_the_row(monkeypatch, capsys, tmp_path, lambda0, n_el, n_no, n_mp):
    monkeypatch.chdir(tmp_path)  # away from any runs/
    monkeypatch.setattr(sys, "argv", ["repose", "validate", f"column_{lambda0:g}", "--table1"])
    with pytest.raises(SystemExit) as end:
        cli.main()
    printed = capsys.readouterr()
    assert (end.value.code or 0, printed.err) == (0, "")
    header, values = [line for line in printed.out.splitlines() if "lambda0 " in line or f" {n_el} " in line]
    assert header.split()[:4] == ["lambda0", "n_el", "n_no", "n_mp"]
    assert values.split()[:4] == [f"{lambda0:g}", str(n_el), str(n_no), str(n_mp)]
    assert "Warp" not in printed.out


def nodes_with_mass(x, cell):
    """Nodes within a cell and a half-length of some point, per axis: the support of the uGIMP weights."""
    first = np.floor((x - cell / 4) / cell + 1e-9).astype(int)
    last = np.ceil((x + cell / 4) / cell - 1e-9).astype(int)
    box = np.unique(np.hstack([first, last]), axis=0)
    low = box[:, :3].min(axis=0)
    carries = np.zeros(box[:, 3:].max(axis=0) - low + 1, bool)
    for i, j, k, i_end, j_end, k_end in box - np.tile(low, 2):
        carries[i : i_end + 1, j : j_end + 1, k : k_end + 1] = True
    return int(carries.sum())


@pytest.mark.parametrize("lambda0", TABLE1)
def test_stored_nodes_follow_the_material(lambda0):
    column = body(lambda0)
    stored = ExplicitSolver(column, find_device("cpu")).nodes_stored_start
    with_mass = nodes_with_mass(column.x, column.scene.grid.cell)
    assert with_mass < stored <= 3 * with_mass
    if lambda0 == 4:
        assert stored < 0.01 * TABLE1[4][1]
