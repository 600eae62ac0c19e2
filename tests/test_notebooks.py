"""Every notebook runs in a new kernel, and is stored without outputs."""

from __future__ import annotations

from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

NOTEBOOKS = sorted((Path(__file__).parents[1] / "notebooks").glob("*.ipynb"))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs_and_is_stored_without_outputs(path, tmp_path):
    notebook = nbformat.read(path, as_version=4)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert all(not cell.outputs and cell.execution_count is None for cell in code)
    NotebookClient(
        notebook, timeout=600, kernel_name="python3", resources={"metadata": {"path": tmp_path}}
    ).execute()
    assert all(cell.execution_count for cell in code)
    kinds = {kind for cell in code for output in cell.outputs for kind in output.get("data", {})}
    assert {"text/html", "image/png"} <= kinds


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_figures_do_not_call_simulated_vessels_3d(path):
    """The notebooks name the truth, because the default name is that of the paper's 3D data."""
    cells = [cell.source for cell in nbformat.read(path, as_version=4).cells]
    named = ("smoothness(", "time_and_space(", "noise(", "results(", "fourier_effect(")
    drawn = [line for cell in cells for line in cell.splitlines() if line.startswith(named)]
    assert all("truth_label=" in line for line in drawn)


def test_there_are_notebooks():
    assert NOTEBOOKS
