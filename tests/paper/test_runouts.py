"""The paper's claims about run-out: quasistatic theory at D = 0.4, experiments at D = 0.05, monotone in D.

The full-resolution runs take minutes each on one core and are marked slow; their figures are in benchmarks/results/.
"""

import pytest

from compare.experiments import measured_runout
from explicit.run import run
from mpm.load import load_scene


def finish(tmp_path, preset, *settings):
    scene = load_scene(preset, [*settings, "output.every=100.0", "output.vtk=false"])
    return run(scene, tmp_path / "-".join([preset, *settings]).replace("=", "_"))


def test_run_out_falls_with_damping(tmp_path):
    """lambda0 = 1 at 10 cells per r0, 2 s."""
    coarse = ("grid.cell=0.1", "explicit.until=2.0")
    ends = [finish(tmp_path, "column_1", *coarse, f"explicit.damping={d}") for d in (0.0, 0.05, 0.1, 0.2, 0.4)]
    runouts = [end["R_995"] for end in ends]
    assert runouts == sorted(runouts, reverse=True) and runouts[-1] < 0.6 * runouts[0]
    farthest = [end["R_max"] for end in ends]
    assert farthest == sorted(farthest, reverse=True)


ABOVE = {"0.5": 0.076, "1": 0.162}  # of Eq. 4, at 20 cells per r0; the limits with the grid are 8 and 15 %


@pytest.mark.slow
@pytest.mark.xfail(strict=True, reason="7.6 and 16.2 % above Eq. 4: the fall's momentum at D = 0.4, and slow creep")
@pytest.mark.parametrize("aspect", ABOVE)
def test_heavy_damping_meets_the_quasistatic_theory(tmp_path, aspect):
    end = finish(tmp_path, f"column_{aspect}", "explicit.damping=0.4")
    assert end["R_995"] == pytest.approx(end["eq4"], rel=0.06)


@pytest.mark.slow
@pytest.mark.parametrize("aspect", ABOVE)
def test_heavy_damping_ends_above_the_quasistatic_theory_by_what_is_known(tmp_path, aspect):
    end = finish(tmp_path, f"column_{aspect}", "explicit.damping=0.4")
    assert end["R_995"] / end["eq4"] - 1.0 == pytest.approx(ABOVE[aspect], abs=0.02)
    assert end["volume_ratio"] == pytest.approx(1.0, abs=0.01)


@pytest.mark.slow
@pytest.mark.parametrize(("aspect", "cells"), [("0.5", 20), ("1", 20), ("2", 10), ("4", 10)])
def test_light_damping_meets_the_experiments(tmp_path, aspect, cells):
    """The measured run-out lies between R_995 and R_max, or within 5 % of one of them."""
    end = finish(tmp_path, f"column_{aspect}", f"grid.cell={1 / cells!r}", "explicit.damping=0.05")
    measured = measured_runout(float(aspect))
    assert 0.95 * end["R_995"] < measured < 1.05 * end["R_max"]


@pytest.mark.slow
def test_run_out_falls_with_damping_at_full_resolution(tmp_path):
    ends = [finish(tmp_path, "column_1", f"explicit.damping={d}") for d in (0.0, 0.05, 0.1, 0.2, 0.4)]
    runouts = [end["R_995"] for end in ends]
    assert runouts == sorted(runouts, reverse=True)
