"""What a diagnosis was made from and with: hashes, command, versions."""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Mapping
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any

import numpy as np

from rotorsim.diagnosis.conclude.result import Diagnosis
from rotorsim.diagnosis.files import repaired_document
from rotorsim.errors import escape
from rotorsim.recordings.orders import OrderRecording
from rotorsim.recordings.recording import Recording

LIBRARIES = ("casadi", "numpy", "scipy", "matplotlib")


def provenance(diagnosis: Diagnosis, command: str) -> str:
    """Return the table of what a diagnosis was made from and with."""
    made = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
    rows = [("made", made), ("command", command), ("diagram as given, sha256", _of_document(diagnosis.before.document))]
    rows.append(("repaired diagram, sha256", _of_document(repaired_document(diagnosis))))
    for k, item in enumerate(diagnosis.recordings):
        what = "held-out recording" if k else "recording"
        text = f"{item.name}, {len(item.runs)} runs: {_of_samples(item)}"
        rows += [(f"{what}, sha256 of the samples", text), ("source of the recording", str(item.source))]
    libraries = ", ".join(f"{name} {version(name)}" for name in LIBRARIES)
    rows.append(("work", ", ".join(f"{value} {name}" for name, value in diagnosis.selection.counts.items())))
    rows.append(("versions", f"rotorsim {version('rotorsim')}, Python {platform.python_version()}, {libraries}"))
    lines = [f"<tr><th>{escape(name)}</th><td><code>{escape(text)}</code></td></tr>" for name, text in rows if text]
    return f'<h2>Provenance</h2>\n<table class="small">{"".join(lines)}</table>'


def _of_document(document: Mapping[str, Any]) -> str:
    """Return the SHA-256 of a document, whatever the order of its keys."""
    return hashlib.sha256(json.dumps(document, sort_keys=True, default=str).encode()).hexdigest()


def _of_samples(recording: Recording | OrderRecording) -> str:
    """Return the SHA-256 of all samples of a recording, or of all its order vectors and their speeds."""
    digest = hashlib.sha256()
    if isinstance(recording, OrderRecording):
        columns = [{"": run.speed, **run.vectors} for run in recording.runs]
    else:
        columns = [dict(run.values) for run in recording.runs]
    for values in columns:
        for name in sorted(values):
            digest.update(name.encode())
            digest.update(np.ascontiguousarray(values[name]).tobytes())
    return digest.hexdigest()
