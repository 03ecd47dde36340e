"""What a report was made from and with: hashes, command, versions."""

from __future__ import annotations

import hashlib
import json
import platform
import shlex
import sys
from collections.abc import Iterable, Iterator, Mapping
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from rotorsim.errors import escape
from rotorsim.recordings.orders import OrderRecording
from rotorsim.recordings.recording import Recording

LIBRARIES = ("casadi", "numpy", "scipy", "matplotlib")
Row = tuple[str, str]


def provenance_table(rows: Iterable[Row], command: str) -> str:
    """Return the table: when, by which command, what ``rows`` say, and the versions; empty ones are left out."""
    made = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
    libraries = ", ".join(f"{name} {version(name)}" for name in LIBRARIES)
    versions = f"rotorsim {version('rotorsim')}, Python {platform.python_version()}, {libraries}"
    every = [("made", made), ("command", command), *rows, ("versions", versions)]
    lines = [f"<tr><th>{escape(name)}</th><td><code>{escape(text)}</code></td></tr>" for name, text in every if text]
    return f'<h2>Provenance</h2>\n<table class="small">{"".join(lines)}</table>'


def own_command() -> str:
    """Return the command line of rotorsim, if this is one."""
    name = Path(sys.argv[0]).stem
    return shlex.join(["rotorsim", *sys.argv[1:]]) if name in ("rotorsim", "__main__") else ""


def document_hash(document: Mapping[str, Any]) -> str:
    """Return the SHA-256 of a document, whatever the order of its keys."""
    return hashlib.sha256(json.dumps(document, sort_keys=True, default=str).encode()).hexdigest()


def recording_rows(recording: Recording | OrderRecording, what: str) -> Iterator[Row]:
    """Yield the SHA-256 of all samples, or of all order vectors and their speeds, and the source."""
    digest = hashlib.sha256()
    if isinstance(recording, OrderRecording):
        columns = [{"": run.speed, **run.vectors} for run in recording.runs]
    else:
        columns = [dict(run.values) for run in recording.runs]
    for values in columns:
        for name in sorted(values):
            digest.update(name.encode())
            digest.update(np.ascontiguousarray(values[name]).tobytes())
    yield f"{what}, sha256 of the samples", f"{recording.name}, {len(recording.runs)} runs: {digest.hexdigest()}"
    yield "source of the recording", str(recording.source)
