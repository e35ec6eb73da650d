"""`repose` in a Jupyter notebook that is executed without a browser."""

import pytest
from installed import needs_ranks

nbformat = pytest.importorskip("nbformat", reason="nbformat is not installed: pip install -e '.[test]'")
nbclient = pytest.importorskip("nbclient", reason="nbclient is not installed: pip install -e '.[test]'")
pytest.importorskip("ipykernel", reason="ipykernel is not installed: pip install -e '.[test]'")

CELLS = (
    """
import repose
scene = repose.load_scene("column_small", grid={"cell": 0.25}, explicit={"until": 0.1})
""",
    "result = repose.run(scene)",
    "result.plot_profile()",
    "print(result)",
)


@pytest.fixture
def run_notebook(tmp_path, monkeypatch):
    """`run_notebook(*cells)`: the executed notebook; and the empty folder that it is run in."""
    for name in ("IPYTHONDIR", "JUPYTER_RUNTIME_DIR"):
        monkeypatch.setenv(name, str(tmp_path / name))
    beside = tmp_path / "notebook"
    beside.mkdir()

    def run(*cells):
        notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell.strip()) for cell in cells])
        nbclient.NotebookClient(
            notebook, timeout=300, kernel_name="python3", resources={"metadata": {"path": beside}}
        ).execute()
        return notebook, beside

    return run


def test_a_notebook_runs_draws_and_runs_again(run_notebook):
    """The cell of the run a second time, as a reader does who has changed nothing."""
    notebook, beside = run_notebook(*(CELLS[number] for number in (0, 1, 2, 3, 1, 2)))
    ran, drawn, said = (notebook.cells[number].outputs for number in (1, 2, 3))
    assert not any("points" in output.get("text", "") for output in ran)  # no banner
    for outputs in (drawn, notebook.cells[5].outputs):
        assert "image/png" in outputs[-1].data
    assert said[0].text.startswith("<column_small, explicit: R_995 = ")
    assert said[0].text.strip().endswith("end_time at t = 0.1 s>")
    assert list(beside.iterdir()) == []


@needs_ranks
def test_a_cell_computes_on_two_ranks_and_shows_how_far_they_are(run_notebook):
    ranks = 'result = repose.run(scene, ranks=2)\nprint(result.summary["ranks"], "ranks")'
    notebook, _ = run_notebook(CELLS[0], ranks)
    said = "".join(output.get("text", "") for output in notebook.cells[1].outputs)
    assert "s of at most 0.1 s, step" in said and "2 ranks" in said
