"""Execute the notebooks, and store their outputs and a checksum of their code.

Run ``python notebooks/execute.py [NAME ...]`` after a change; a test compares the checksums.
"""

from __future__ import annotations

import base64
import hashlib
import io
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import nbformat
from nbclient import NotebookClient
from PIL import Image

FOLDER = Path(__file__).parent
_COLORS = 40  # of a stored picture


def code_checksum(notebook: Any) -> str:
    """Return the SHA-256 checksum of the code cells."""
    code = [cell.source for cell in notebook.cells if cell.cell_type == "code"]
    return hashlib.sha256("\n\n".join(code).encode()).hexdigest()


@contextmanager
def kernel(folder: Path) -> Iterator[NotebookClient]:
    """Start a kernel in a folder; notebooks in turn share what it has compiled."""
    where = {"metadata": {"path": folder}}
    first = NotebookClient(nbformat.v4.new_notebook(), timeout=600, resources=where)
    with first.setup_kernel():
        yield first


def execute(notebook: Any, kernel: NotebookClient) -> None:
    """Execute a notebook without the variables of those before."""
    client = NotebookClient(notebook, timeout=600, km=kernel.km, resources=kernel.resources)
    client.kc = kernel.kc
    notebook.cells.insert(0, nbformat.v4.new_code_cell("%reset -f"))
    client.execute(reset_kc=False, cleanup_kc=False)
    notebook.cells.pop(0)


def shrink(notebook: Any) -> None:
    """Store pictures with few colors, and nothing that differs from run to run."""
    for number, cell in enumerate(c for c in notebook.cells if c.cell_type == "code"):
        cell.metadata.pop("execution", None)
        cell.execution_count = number + 1
        for output in cell.outputs:
            if "execution_count" in output:
                output.execution_count = number + 1
            if picture := output.get("data", {}).get("image/png"):
                shown = Image.open(io.BytesIO(base64.b64decode(picture))).convert("RGB")
                small = io.BytesIO()
                shown.quantize(_COLORS).save(small, "PNG", optimize=True)
                output["data"]["image/png"] = base64.b64encode(small.getvalue()).decode()


def main(names: list[str]) -> None:
    """Execute the notebooks of these names, by default all, in place."""
    paths = [path for path in sorted(FOLDER.glob("*.ipynb")) if not names or path.stem in names]
    with tempfile.TemporaryDirectory() as folder, kernel(Path(folder)) as running:
        for path in paths:
            notebook = nbformat.read(path, as_version=4)
            execute(notebook, running)
            shrink(notebook)
            notebook.metadata["code_checksum"] = code_checksum(notebook)
            nbformat.write(notebook, path)
            print(f"{path.name}: {path.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main(sys.argv[1:])
