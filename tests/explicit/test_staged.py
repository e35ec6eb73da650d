"""The step of a rank on a GPU, run on the CPU: sums that are packed, carried by the host and added are the halo's."""

import subprocess

import numpy as np
import pytest
from installed import HAS_RANKS, NO_RANKS

from compare import launch
from mpm.results import Results

if not HAS_RANKS:
    pytest.skip(NO_RANKS, allow_module_level=True)

LONGEST = 120  # seconds: nothing hangs
SHORT = ("explicit.until=0.3", "output.every=0.1", "output.vtk=false")
# The same program with the sums of either; what the other one would use is not there.
HOST = "from explicit import staged; staged.exchange = None"
STAGED = "from explicit.ranks import Domain; from mpm.domains import Halo; Domain.staged, Halo.add = True, None"
PROGRAM = "\nfrom compare.cli.main import main\nmain()"


def state(folder, ranks, sums, scene, *settings):
    """What a run on so many ranks ends with, its sums by HOST or STAGED."""
    words = [word for setting in settings for word in ("--set", setting)]
    words = ["-c", sums + PROGRAM, "run", scene, *words, "--out", str(folder)]
    process = launch.start(ranks, words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    try:
        said = process.communicate(timeout=LONGEST)[1]
    finally:
        process.kill()
    assert process.returncode == 0, said
    return Results.open(folder).read_checkpoint(), Results.open(folder).history()


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("ranks", [2, 3])
def test_sums_by_way_of_a_buffer_are_those_of_the_halo_to_the_last_bit(tmp_path, ranks, precision):
    """A column whose points cross the cuts, some hundred steps on grids that are fitted anew."""
    settings = (*SHORT, f"explicit.precision={precision}")
    halo, staged = (
        state(tmp_path / name, ranks, sums, "column_small", *settings)
        for name, sums in (("halo", HOST), ("staged", STAGED))
    )
    assert halo[0]["clock"][5] > 100
    for name in halo[0].keys() - {"wall_before"}:
        np.testing.assert_array_equal(staged[0][name], halo[0][name], err_msg=name)
    for name, column in halo[1].items():
        np.testing.assert_array_equal(staged[1][name], column, err_msg=name)


def test_ranks_without_points_take_part(tmp_path):
    """A bar two cells wide has fewer pencils than four ranks can share; it hangs from a wall as on one rank."""
    settings = ("explicit.until=0.05", "grid.cell=0.1", "output.vtk=false")
    one, four = (state(tmp_path / str(ranks), ranks, STAGED, "elastic_bar", *settings)[0] for ranks in (1, 4))
    np.testing.assert_allclose(four["x"], one["x"], rtol=0, atol=1e-12)


@pytest.mark.parametrize("sums", [HOST, STAGED], ids=["halo", "buffer"])
def test_smoothed_volume_strains_are_those_of_one_rank(tmp_path, sums):
    """K is 500 G, so that ripples of the volume strain are smoothed, in two exchanges more."""
    settings = ("explicit.until=0.02", "material.cohesion=2000.0", "material.poisson=0.499", "output.vtk=false")
    one, three = (state(tmp_path / str(ranks), ranks, sums, "column_small", *settings)[0] for ranks in (1, 3))
    assert one["clock"][5] > 200
    np.testing.assert_allclose(three["x"], one["x"], rtol=0, atol=1e-12)
    np.testing.assert_allclose(three["theta"], one["theta"], rtol=0, atol=1e-9 * np.abs(one["theta"]).max())


def test_a_point_at_fault_ends_all_ranks(tmp_path):
    """A velocity that is no number on one rank, seen with the last exchange of the step."""
    fault = """
take = Domain._take
def spoiling(domain, steps):
    if domain.comm.rank == 1 and domain.steps > 30:
        domain.v.numpy()[7] = float("nan")
    take(domain, steps)
Domain._take = spoiling
"""
    with pytest.raises(AssertionError, match=r"numerical failure: diverged at .*is not finite"):
        state(tmp_path / "run", 2, STAGED + fault, "column_small", *SHORT)
    assert np.isfinite(Results.open(tmp_path / "run").read_checkpoint()["x"]).all()
