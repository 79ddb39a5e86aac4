"""Every notebook runs from top to bottom beside the data and finds the truth."""

import json
import re
from pathlib import Path

import pytest

from rotcal_ros.foundation.machine_load import load_scaled_timeout

EXAMPLES = Path(__file__).parents[2] / "examples"
KEY_FIGURES = {
    "07_what_limits_my_uncertainty": (r"trials / solver: (\S+)", 0.9, 1.1),
    "10_own_solver_on_raw_streams": (r"against the truth: (\S+) arcsec", 0.0, 0.15),
    "14_from_numbers_to_a_certificate": (r"against the truth: (\S+) arcsec", 0.0, 1.0),
}
"""Notebook -> its key figure, with the bounds that truth and uncertainty set."""
DEADLINE_S = 120
LINK = re.compile(r"\]\(([^)#]+)\)")


def cells_of(name):
    return json.loads((EXAMPLES / f"{name}.ipynb").read_text())["cells"]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Return a folder with the data, and let kernels keep their files there."""
    (tmp_path / "data").symlink_to(EXAMPLES / "data")
    for name in ("IPYTHONDIR", "JUPYTER_CONFIG_DIR", "JUPYTER_DATA_DIR", "JUPYTER_RUNTIME_DIR"):
        monkeypatch.setenv(name, str(tmp_path / "jupyter"))
    monkeypatch.setenv("PYTHONPATH", str(EXAMPLES.parent))
    return tmp_path


def ran(name, folder):
    """Return the outputs of a notebook."""
    extra = "needs what the notebook names in its first lines"
    nbclient, nbformat, *_ = (
        pytest.importorskip(module, reason=extra)
        for module in ("nbclient", "nbformat", "ipykernel", "pandas", "lxml", "signxml")
    )
    notebook = nbformat.read(EXAMPLES / f"{name}.ipynb", as_version=4)
    nbformat.validate(notebook)
    where = {"metadata": {"path": str(folder)}}
    nbclient.NotebookClient(
        notebook, timeout=int(load_scaled_timeout(DEADLINE_S)), resources=where
    ).execute()
    return [output for cell in notebook.cells for output in cell.get("outputs", ())]


@pytest.mark.slow
@pytest.mark.parametrize("name", KEY_FIGURES)
def test_a_notebook_finds_the_truth_and_shows_it(name, folder):
    outputs = ran(name, folder)
    pattern, low, high = KEY_FIGURES[name]
    printed = "".join(output.text for output in outputs if output.get("name") == "stdout")
    (found,) = re.findall(pattern, printed)
    assert low <= float(found) <= high
    assert [output.text for output in outputs if output.get("name") == "stderr"] == []
    assert sum("image/png" in output.get("data", {}) for output in outputs) == 1
    made = {path.name for path in folder.glob("out/*")}
    assert made == ({"certificate.xml", "report.html"} if "certificate" in name else set())


def test_every_notebook_is_run_and_listed():
    assert {path.stem for path in EXAMPLES.glob("*.ipynb")} == set(KEY_FIGURES)
    listed = (EXAMPLES / "README.md").read_text()
    assert all(f"| [{name}]({name}.ipynb) | " in listed for name in KEY_FIGURES)


@pytest.mark.parametrize("name", KEY_FIGURES)
def test_a_notebook_is_short_and_kept_without_outputs(name):
    code = [cell for cell in cells_of(name) if cell["cell_type"] == "code"]
    assert len(code) <= 10
    assert all(len(cell["source"]) <= 30 for cell in code)
    assert all(cell["outputs"] == [] and cell["execution_count"] is None for cell in code)


@pytest.mark.parametrize("name", KEY_FIGURES)
def test_the_links_of_a_notebook_lead_somewhere(name):
    texts = ["".join(c["source"]) for c in cells_of(name) if c["cell_type"] == "markdown"]
    links = [link for text in texts for link in LINK.findall(text)]
    assert [link for link in links if not (EXAMPLES / link).is_file()] == []
