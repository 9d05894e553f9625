"""The example notebook runs, from its first cell to its last."""

import os
from pathlib import Path

import pytest

NOTEBOOK = Path(__file__).parents[1] / "examples" / "shadows.ipynb"


def test_the_example_notebook_runs(tmp_path):
    nbformat = pytest.importorskip("nbformat")
    nbclient = pytest.importorskip("nbclient")
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    nbclient.NotebookClient(notebook, timeout=120, resources={"metadata": {"path": str(tmp_path)}}).execute()
    said = "".join(output.get("text", "") for cell in notebook.cells for output in cell.get("outputs", []))
    assert "of the street is in shadow in winter" in said


def test_the_notebook_from_images_to_a_figure_runs(tmp_path):
    nbformat = pytest.importorskip("nbformat")
    nbclient = pytest.importorskip("nbclient")
    if not os.environ.get("HELIOSPLAT"):
        pytest.skip("HELIOSPLAT names no program")
    notebook = nbformat.read(NOTEBOOK.with_name("surface.ipynb"), as_version=4)
    nbclient.NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(tmp_path)}}).execute()
    figures = [data for cell in notebook.cells for output in cell.get("outputs", []) if "image/png" in (data := output.get("data", {}))]
    assert len(figures) == 2 and (tmp_path / "street_shadows.tif").is_file()
