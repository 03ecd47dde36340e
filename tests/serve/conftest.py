"""A diagram of one's own in an empty folder."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from rotorsim.diagram.parse.fmt import format_document
from rotorsim.diagram.resolve.resolution import shipped_diagrams
from rotorsim.serve.store import DiagramFile


@pytest.fixture
def mine(tmp_path: Path) -> Path:
    """Return the file of a copy of `jeffcott`."""
    document = json.loads(shipped_diagrams()["jeffcott"].read_text()) | {"name": "mine"}
    document.pop("$schema")
    path = tmp_path / "mine.json"
    path.write_text(format_document(document))
    return path


@pytest.fixture
def opened(mine: Path) -> DiagramFile:
    """Return it, opened."""
    return DiagramFile(mine)
