"""The paper's claims about run-out: quasistatic theory at D = 0.4, experiments at D = 0.05, monotone in D.

The full-resolution runs take minutes each on one core and are marked slow; their figures over both cones and
both pressure treatments are in benchmarks/results/.
"""

import pytest

from compare.experiments import measured_runout
from explicit.run import run
from mpm.config import load_scene
from mpm.scene import theory


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


# The collapse is chaotic: four runs of the low column that differ in round-off, or by up to 4 % in the time step, end
# 4.9 to 7.9 % below Eq. 4 (benchmarks/results/paper_checks_cpu.csv).
LOW_COLUMN = pytest.mark.xfail(strict=False, reason="ends 4.9 to 7.9 % below Eq. 4, depending on round-off")


@pytest.mark.slow
@pytest.mark.parametrize("aspect", [pytest.param("0.5", marks=LOW_COLUMN), "1"])
def test_heavy_damping_meets_the_quasistatic_theory(tmp_path, aspect):
    end = finish(tmp_path, f"column_{aspect}", "explicit.damping=0.4")
    assert end["R_995"] == pytest.approx(theory(load_scene(f"column_{aspect}"))["eq4"], rel=0.06)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("aspect", "memory", "low", "high"),
    [("0.5", "false", 0.70, 0.95), ("1", "false", 1.25, 1.70), ("1", "true", 1.25, 1.70)],
)
def test_light_damping_meets_the_experiments(tmp_path, aspect, memory, low, high):
    """Bounds round Eq. 6 with prefactor and exponent exchanged: 0.84 and 1.30 for the farthest point."""
    settings = ("explicit.damping=0.05", f"material.apex_memory={memory}")
    end = finish(tmp_path, f"column_{aspect}", *settings)
    assert low < end["R_max"] < high


@pytest.mark.slow
def test_light_damping_meets_the_neighbouring_experiments_of_a_low_column(tmp_path):
    """With apex memory the lambda0 = 0.5 column ends below Eq. 6, which overshoots the low columns themselves:
    measured 0.495 at 0.285 and 0.845 at 0.751, so 0.656 between them, where the power law gives 0.840."""
    end = finish(tmp_path, "column_0.5", "explicit.damping=0.05")
    assert end["R_max"] == pytest.approx(measured_runout(0.5), rel=0.06)


@pytest.mark.slow
def test_run_out_falls_with_damping_at_full_resolution(tmp_path):
    ends = [finish(tmp_path, "column_1", f"explicit.damping={d}") for d in (0.0, 0.05, 0.1, 0.2, 0.4)]
    runouts = [end["R_995"] for end in ends]
    assert runouts == sorted(runouts, reverse=True)
