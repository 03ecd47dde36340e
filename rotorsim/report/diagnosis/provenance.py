"""What a diagnosis was made from and with."""

from __future__ import annotations

from rotorsim.diagnosis.conclude.result import Diagnosis
from rotorsim.diagnosis.files import repaired_document
from rotorsim.report.provenance import document_hash, provenance_table, recording_rows


def provenance(diagnosis: Diagnosis, command: str) -> str:
    """Return the table of what a diagnosis was made from and with."""
    rows = [("diagram as given, sha256", document_hash(diagnosis.before.document))]
    rows.append(("repaired diagram, sha256", document_hash(repaired_document(diagnosis))))
    for k, item in enumerate(diagnosis.recordings):
        rows += recording_rows(item, "held-out recording" if k else "recording")
    rows.append(("work", ", ".join(f"{value} {name}" for name, value in diagnosis.selection.counts.items())))
    return provenance_table(rows, command)
