"""Pages of comparisons in a browser, wide and narrow: nothing is cut, no label lies over another."""

import json

import pytest
from browser import measure
from legible import CASES, CELL, assert_legible, write_off_centre

from compare import comparison
from compare.batch import Outcome
from compare.plots import reports
from compare.report.page import write_report
from compare.solvers import runs_of
from mpm.devices import start_warp
from mpm.errors import SceneError

pytest.importorskip("implicit._dolfinx", reason="dolfinx or petsc4py is not installed", exc_type=SceneError)


def run_here(jobs, directory, _workers, _force, _monitor):
    """The jobs one after another in this process."""
    start_warp()
    return [
        Outcome(job, folder, runs_of(job.mode).run(job.scene, folder), None)
        for job in jobs
        for folder in [directory / job.name]
    ]


@pytest.fixture(scope="module", params=CASES)
def compared(request, tmp_path_factory):
    """A short comparison: its page and its figures by file name."""
    folder = tmp_path_factory.mktemp("page")
    write_off_centre(folder)
    scene, sections = CASES[request.param]
    settings = [f"grid.cell={CELL}", "explicit.max_time=0.2", "implicit.max_steps=2", "output.vtk=false"]
    settings += [f"{name}.{key}={json.dumps(value)}" for name, keys in sections.items() for key, value in keys.items()]
    figures = {}

    def kept(figure, path):
        figures[path.name] = figure
        figure.savefig(path)
        return path

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(comparison, "run_all", run_here)
        patch.setattr(reports, "save", kept)
        reference = str(folder / scene) if scene.endswith(".toml") else scene
        asked = (folder, False, None, f"./repose compare {scene}", reference, settings, "cpu")
        page = write_report(comparison.compare_solvers(*asked), folder)
    return page, figures


def test_no_words_of_a_figure_are_cut_or_overlap(compared):
    _, figures = compared
    assert len(figures) >= 3
    for name, figure in figures.items():
        assert_legible(figure, name)


@pytest.mark.parametrize("width", [1280, 420])
def test_nothing_on_the_page_is_cut_or_lies_over_another(compared, tmp_path, width):
    page, figures = compared
    seen = measure(page, width, tmp_path)
    assert len(seen["images"]) == len(figures) and all(image["natural_width"] > 0 for image in seen["images"])
    assert seen["trouble"] == []
    assert seen["scroll_width"] <= seen["client_width"]


def test_the_browser_tells_what_is_cut_and_what_overlaps(tmp_path):
    place = '<p style="position: absolute; margin: 0; white-space: nowrap; left: {}px; top: {}px">{}</p>'
    words = [(10, 10, "first"), (15, 12, "second"), (400, 100, "beyond the edge"), (10, 200, "alone")]
    page = tmp_path / "page.html"
    page.write_text("<!DOCTYPE html><body>" + "".join(place.format(*word) for word in words), encoding="utf-8")
    assert measure(page, 420, tmp_path)["trouble"] == ["first overlaps second", "beyond the edge is cut"]
