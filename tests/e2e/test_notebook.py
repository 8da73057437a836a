"""The example notebook runs from top to bottom, with its figures, and is stored without outputs."""

import re
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

from steerd.daemon.loop.transitions import SupervisorState

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOK = ROOT / "examples" / "notebooks" / "first-look.ipynb"
FIGURES = 3
LINES_MOST = 60  # lines of text below a cell: more than a screen nobody reads
HIDDEN_MS = 50.0  # the steering delay that the notebook adds to its car
SD_MOST = 10.0  # a larger standard error [ms] would say nothing of such a delay


def test_the_notebook_runs_and_shows_its_figures(tmp_path, monkeypatch):
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path))
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    place = {"metadata": {"path": tmp_path}}
    NotebookClient(notebook, timeout=500, kernel_name="python3", resources=place).execute()
    outputs = [out for cell in notebook.cells for out in cell.get("outputs", ())]
    images = [out for out in outputs if "image/png" in out.get("data", {})]
    printed = "".join(out.get("text", "") for out in outputs)
    assert len(images) == FIGURES
    for cell in (cell for cell in notebook.cells if cell.cell_type == "code"):
        texts = [o.get("text", o.get("data", {}).get("text/plain", "")) for o in cell["outputs"]]
        assert sum(text.count("\n") + 1 for text in texts) <= LINES_MOST, texts
    found = re.search(r"steer_delay: delay = ([\d.]+) ± ([\d.]+) ms", printed)
    assert found is not None, printed
    value, sd = map(float, found.groups())
    assert sd < SD_MOST
    assert abs(value - HIDDEN_MS) < 2.0 * sd
    assert "EXPLAINED" in printed
    assert not [out for out in outputs if out.get("name") == "stderr"]


def test_the_programs_of_a_page_run(monkeypatch):
    monkeypatch.setattr("matplotlib.pyplot.show", lambda: None)
    text = (ROOT / "docs" / "how-to" / "your-own-controller.md").read_text(encoding="utf-8")
    names = {}
    for program in re.findall(r"```python\n(.*?)```", text, re.DOTALL):
        if "steerd.serve(" not in program:  # which needs a car
            exec(program, names)
    assert names["truncated"]
    assert not names["terminated"]
    state = names["drive"]["state"]
    driven = state[state["mode"] == SupervisorState.RUNNING]
    assert driven["e1"].abs().max() < 0.1, "the MPC keeps its lane"
    assert state.attrs["units"]["e1"] == "m"
