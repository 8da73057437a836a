"""The example notebook runs from top to bottom, with its figures, and is stored without outputs."""

import re
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

pytestmark = pytest.mark.slow

NOTEBOOK = Path(__file__).resolve().parents[2] / "examples" / "notebooks" / "first-look.ipynb"
FIGURES = 3
HIDDEN_MS = 50.0
"""The steering delay that the notebook adds to its car."""
SD_MOST = 10.0
"""A larger standard error [ms] would say nothing of such a delay."""


def test_the_notebook_runs_and_shows_its_figures(tmp_path, monkeypatch):
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path))
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    NotebookClient(
        notebook, timeout=500, kernel_name="python3", resources={"metadata": {"path": tmp_path}}
    ).execute()
    outputs = [out for cell in notebook.cells for out in cell.get("outputs", ())]
    images = [out for out in outputs if "image/png" in out.get("data", {})]
    printed = "".join(out.get("text", "") for out in outputs)
    assert len(images) == FIGURES
    found = re.search(r"steer_delay: delay = ([\d.]+) ± ([\d.]+) ms", printed)
    assert found is not None, printed
    value, sd = map(float, found.groups())
    assert sd < SD_MOST
    assert abs(value - HIDDEN_MS) < 2.0 * sd
    assert "EXPLAINED" in printed
    assert not [out for out in outputs if out.get("name") == "stderr"]


def test_the_notebook_is_stored_without_outputs():
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    nbformat.validate(notebook)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert len(code) >= 6
    assert all(not cell.outputs and cell.execution_count is None for cell in code)
