"""The notebook is executed, and its results are those that are kept in it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

NOTEBOOKS = Path(__file__).resolve().parents[2] / "notebooks"


def results(notebook: object) -> list[tuple[int, list[str]]]:
    """The numbers and hashes in the text outputs of each cell: their layout differs between versions of pandas."""
    found = []
    for i, cell in enumerate(notebook.cells):  # type: ignore[attr-defined]
        for output in cell.get("outputs", []):
            text = output.get("text") or output.get("data", {}).get("text/plain", "")
            if output.get("name") != "stderr" and "Figure" not in text:
                found.append((i, re.findall(r"[0-9a-f]{16}|\d+(?:\.\d+)?|built", text)))
    return found


def test_the_notebook_gives_the_results_that_it_keeps() -> None:
    nbclient = pytest.importorskip("nbclient")
    nbformat = pytest.importorskip("nbformat")
    pytest.importorskip("matplotlib")
    kept = nbformat.read(NOTEBOOKS / "runs.ipynb", as_version=4)
    nbformat.validate(kept)
    expected = results(kept)
    assert len(expected) >= 4, "the notebook keeps no outputs"
    client = nbclient.NotebookClient(kept, resources={"metadata": {"path": str(NOTEBOOKS)}}, timeout=1800)
    client.execute()
    assert results(kept) == expected
