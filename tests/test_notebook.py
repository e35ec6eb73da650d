"""`repose` in a Jupyter notebook that is executed without a browser."""

import pytest

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


def test_a_notebook_runs_draws_and_runs_again(tmp_path, monkeypatch):
    """The cell of the run a second time, as a reader does who has changed nothing."""
    for name in ("IPYTHONDIR", "JUPYTER_RUNTIME_DIR"):
        monkeypatch.setenv(name, str(tmp_path / name))
    beside = tmp_path / "notebook"
    beside.mkdir()
    order = (0, 1, 2, 3, 1, 2)
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(CELLS[number].strip()) for number in order])
    nbclient.NotebookClient(
        notebook, timeout=300, kernel_name="python3", resources={"metadata": {"path": beside}}
    ).execute()
    ran, drawn, said = (notebook.cells[number].outputs for number in (1, 2, 3))
    assert not any("points" in output.get("text", "") for output in ran)  # no banner
    for outputs in (drawn, notebook.cells[5].outputs):
        assert "image/png" in outputs[-1].data
    assert said[0].text.startswith("<column_small, explicit: R_995 = ")
    assert said[0].text.strip().endswith("end_time at t = 0.1 s>")
    assert list(beside.iterdir()) == []
