"""The notebooks run, and are stored with the outputs of their code."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import nbformat
import pytest

FOLDER = Path(__file__).parents[1] / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
_spec = importlib.util.spec_from_file_location("execute_notebooks", FOLDER / "execute.py")
execute_notebooks = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(execute_notebooks)
code_checksum = execute_notebooks.code_checksum


def code_cells(notebook):
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def outputs(notebook):
    return [output for cell in code_cells(notebook) for output in cell.outputs]


@pytest.fixture(scope="module")
def kernel(tmp_path_factory):
    """One kernel for all notebooks, which compiles what they share once."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PCNDE_DATA", str(FOLDER / "none"))  # small vessels in place of 3D data
        with execute_notebooks.kernel(tmp_path_factory.mktemp("notebooks")) as kernel:
            yield kernel


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs(path, kernel):
    notebook = nbformat.read(path, as_version=4)
    for cell in code_cells(notebook):
        cell.outputs, cell.execution_count = [], None
    execute_notebooks.execute(notebook, kernel)
    assert all(cell.execution_count for cell in code_cells(notebook))
    kinds = {kind for output in outputs(notebook) for kind in output.get("data", {})}
    assert {"text/html", "image/png"} <= kinds
    assert not [output for output in outputs(notebook) if output.get("name") == "stderr"]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_is_stored_with_the_outputs_of_its_code(path):
    notebook = nbformat.read(path, as_version=4)
    advice = f"run python notebooks/execute.py {path.stem}"
    assert notebook.metadata.get("code_checksum") == execute_notebooks.code_checksum(notebook), (
        advice
    )
    kinds = {kind for output in outputs(notebook) for kind in output.get("data", {})}
    assert {"text/html", "image/png"} <= kinds
    assert not [o for o in outputs(notebook) if o.output_type in ("stream", "error")]
    assert path.stat().st_size <= 200_000


def test_a_change_of_the_code_is_noticed():
    notebook = nbformat.read(NOTEBOOKS[0], as_version=4)
    code_cells(notebook)[-1].source += "  "
    assert notebook.metadata["code_checksum"] != code_checksum(notebook)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_figures_do_not_call_simulated_vessels_3d(path):
    """The notebooks name the truth, because the default name is that of the paper's 3D data."""
    cells = [cell.source for cell in nbformat.read(path, as_version=4).cells]
    named = ("smoothness(", "time_and_space(", "noise(", "results(", "fourier_effect(")
    drawn = [line for cell in cells for line in cell.splitlines() if line.startswith(named)]
    assert all("truth_label=" in line for line in drawn)


def test_there_are_notebooks():
    assert NOTEBOOKS
