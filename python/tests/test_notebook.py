"""The notebook runs from its first cell to its last, and shows its pictures."""

from __future__ import annotations

from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def test_the_notebook_runs() -> None:
    nbformat, nbclient = pytest.importorskip("nbformat"), pytest.importorskip("nbclient")
    for needed in ("ipykernel", "matplotlib", "pandas", "pyarrow"):
        pytest.importorskip(needed)
    notebook = nbformat.read(ROOT / "examples/tango.ipynb", as_version=4)
    client = nbclient.NotebookClient(notebook, timeout=300, kernel_name="python3")
    done = client.execute(cwd=str(ROOT / "examples"))
    outputs = [output for cell in done.cells if cell.cell_type == "code" for output in cell.outputs]
    pictures = [output for output in outputs if "image/png" in output.get("data", {})]
    assert len(pictures) >= 4 and all(len(picture["data"]["image/png"]) > 10_000 for picture in pictures)
    assert not [output for output in outputs if output.get("name") == "stderr"]
