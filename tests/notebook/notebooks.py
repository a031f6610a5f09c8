"""Notebooks run in a kernel of their own, and the pictures that they show."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]


def executed(cells: Sequence[str], folder: Path, monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    """What each cell shows, by MIME type; skipped where no notebook can be run."""
    nbclient = pytest.importorskip("nbclient")
    nbformat = pytest.importorskip("nbformat")
    pytest.importorskip("ipykernel")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]))
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell) for cell in cells])
    client = nbclient.NotebookClient(
        notebook, timeout=280, kernel_name="python3", resources={"metadata": {"path": str(folder)}}
    )
    client.execute()
    return [
        {kind: text for out in cell.outputs for kind, text in (out.get("data") or {}).items()}
        for cell in notebook.cells
    ]


def pictures(shown: dict[str, Any]) -> int:
    """Pictures in what a cell shows, in the form that JupyterLab and nbconvert take: HTML before PNG."""
    if "text/html" in shown:
        return str(shown["text/html"]).count('src="data:image/png;base64,')
    return int("image/png" in shown)
