"""Each script of `examples/` runs in a folder of its own, leaves its pictures, and its numbers are physics."""

import runpy
from pathlib import Path

import numpy as np
import pytest
from installed import needs_implicit

EXAMPLES = Path(__file__).parents[1] / "examples"
MOST_LINES = 40


@pytest.fixture
def example(tmp_path, monkeypatch):
    """`example(name, *pictures)`: the names that the script has at its end, once its pictures are seen to be there."""

    def run(name, *pictures):
        monkeypatch.chdir(tmp_path)
        its = runpy.run_path(str(EXAMPLES / f"{name}.py"))
        for picture in pictures:
            assert (tmp_path / picture).read_bytes().startswith(b"\x89PNG")
        return its

    return run


def test_every_example_is_run_here_and_is_short():
    scripts = sorted(path.name for path in EXAMPLES.glob("*.py"))
    assert scripts == ["column.py", "implicit_against_explicit.py", "own_measure.py", "own_mesh.py", "sweep.py"]
    for name in scripts:
        assert len((EXAMPLES / name).read_text(encoding="utf-8").splitlines()) <= MOST_LINES, name


def test_column(example, capsys):
    its = example("column", "profile.png", "morphology.png", "history.png")
    assert its["found"]["stop_reason"] == "rest"
    assert its["found"]["eq4"] == pytest.approx(0.307, abs=5e-4)  # lambda0 = 0.5, tan(phi) = 0.769
    assert "Eq. 4: 1.307 m" in capsys.readouterr().out
    energy = its["energy"]
    spent = sum(energy[name][-1] for name in ("W_plastic", "W_damping", "W_decay", "E_elastic", "KE_points"))
    assert spent == pytest.approx(energy["W_ext"][-1], rel=0.05)  # what is bought is paid for


def test_own_mesh(example):
    its = example("own_mesh", "stockpile.png")
    x = its["result"].points
    # A quarter of the frustum h/3 (A + a + sqrt(A a)), filled with points half a cell apart, within 5 %.
    volume = (4 * its["FOOT"] ** 2 + 4 * its["TOP"] ** 2 + 4 * its["FOOT"] * its["TOP"]) * its["HEIGHT"] / 3 / 4
    assert len(x) * 0.1**3 == pytest.approx(volume, rel=0.05)
    # What has come to rest is no steeper, from its top to its foot, than the angle of friction.
    foot = np.quantile(np.hypot(x[:, 0], x[:, 1]), 0.995)
    assert its["height"] < 0.9 * its["HEIGHT"]
    assert its["height"] / foot < np.tan(np.radians(35.0))


@needs_implicit
def test_implicit_against_explicit(example):
    its = example("implicit_against_explicit", "mass_within.png")
    assert {run.summary["stop_reason"] for run in its["runs"].values()} == {"rest"}
    assert its["runs"]["implicit"].summary["unbalanced_ratio"] <= 5e-3
    assert its["implicit"] < its["explicit"]  # no momentum carries it on


def test_sweep(example):
    its = example("sweep", "sweep.png")
    a = 0.5 / np.tan(np.radians(its["angles"]))  # lambda0/tan(phi): Eq. 4's cone, its volume set to the column's
    np.testing.assert_allclose(its["theory"], 0.5 * (a + np.sqrt(4 - a**2 / 3)) - 1, rtol=1e-12)
    assert np.all(np.diff(its["computed"]) < 0)


def test_own_measure(example):
    its = example("own_measure", "moved.png")
    # To single precision, in which snapshots are kept, and the step in which the ledger lags behind positions.
    np.testing.assert_allclose(its["work"], its["ledger"], atol=2e-3 * its["ledger"].max())
    assert np.all(np.diff(its["fall"]) > -1e-4)
    assert 0.2 < 1 - its["moved"][-1] < 0.6
