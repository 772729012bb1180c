"""docs/notebook.ipynb, cell by cell in a kernel of its own."""

import nbclient
import nbformat
import pytest

from tests.support.paths import ROOT

NOTEBOOK = ROOT / "docs" / "notebook.ipynb"


@pytest.mark.slow
def test_the_notebook_runs_and_shows_tables_and_figures() -> None:
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    nbformat.validate(notebook)
    assert all(not cell.outputs for cell in notebook.cells if cell.cell_type == "code"), "strip the outputs"
    nbclient.NotebookClient(notebook, timeout=120, kernel_name="python3").execute()
    shown = [output.data for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs
             if "data" in output]
    assert sum("image/png" in data for data in shown) == 5
    assert sum("<table" in data.get("text/html", "") for data in shown) == 2  # those of pandas
    assert sum("<pre>" in data.get("text/html", "") for data in shown) == 4  # results, as they are printed
    fitted = next(data["text/html"] for data in shown if "beta9" in data.get("text/html", ""))
    assert fitted.startswith("<pre>") and "95 % interval" in fitted and "NOT TO BE USED" not in fitted
