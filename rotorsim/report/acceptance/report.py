"""The report of an acceptance: one HTML file that prints as PDF, its figures as PNG, and its data as JSON."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from rotorsim.acceptance.acceptance import Acceptance, AnyRecording
from rotorsim.acceptance.criterion import MET, NOT_MET, Part
from rotorsim.acceptance.damping import DampedModes
from rotorsim.errors import escape
from rotorsim.files import write_atomically
from rotorsim.report.acceptance.figures import Shown, figures_of
from rotorsim.report.page import Page, paragraph, table
from rotorsim.report.provenance import document_hash, own_command, provenance_table, recording_rows
from rotorsim.report.text.acceptance import CRITERION_COLUMNS, acceptance_data, cells, conditions_text

LONGEST_NAME = 60  # of a file
REPORT, DATA = "report.html", "acceptance.json"
VERDICT_COLOURS = {MET: "#0b6b4f", NOT_MET: "#b33c00"}
OTHER_COLOUR = "#7a5c00"
ADVICE = "Verdicts in brackets are advice: the verdict of the machine does not rest on them."


def save_acceptance(
    result: Acceptance, folder: str | Path, recordings: Sequence[AnyRecording] = (), *, command: str | None = None
) -> list[Path]:
    """Write report.html, its figures as PNG and acceptance.json into a folder; return the files.

    recordings: those that were judged, for their hashes. command: default the command line of rotorsim, if this is one.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    page = Page(folder)
    title = f"Acceptance of {result.name}"
    rows = [] if result.diagram is None else [("diagram, sha256", document_hash(result.diagram.document))]
    for recording in recordings:
        rows += recording_rows(recording, "recording")
    sections = [
        _head(result, title),
        *(section for k, part in enumerate(result.parts, 1) for section in _part(result, part, k, page)),
        provenance_table(rows, own_command() if command is None else command),
    ]
    write_atomically(folder / REPORT, page.html(title, sections))
    page.write(DATA, json.dumps(acceptance_data(result), indent=2, allow_nan=False) + "\n")
    return [folder / REPORT, *page.files]


def _head(result: Acceptance, title: str) -> str:
    colour = VERDICT_COLOURS.get(result.verdict, OTHER_COLOUR)
    given = result.conditions
    judged = [*([f"diagram {result.diagram.name}"] if result.diagram else []), *result.recordings]
    wrong = [(part.title, one) for part in result.parts for one in part.criteria if one.required and one.verdict != MET]
    listed = table(
        ("verdict", "part", "quantity", "where", "value", "limit"),
        [(cells(one)[0], name, *cells(one)[1:5]) for name, one in wrong],
    )
    return "\n".join(
        [
            f"<h1>{escape(title)}</h1>",
            f'<div class="verdict" style="border-color:{colour}"><b style="color:{colour}">{escape(result.verdict)}</b>'
            f"{escape(result.statement)}</div>",
            paragraph(f"Judged at {conditions_text(given)}, by {', '.join(judged)}."),
            paragraph(". ".join(given.notes), small=True),
            f"<h2>What is not met, not sure or not judged</h2>\n{listed}" if wrong else "",
            paragraph(ADVICE, small=True),
        ]
    )


def _part(result: Acceptance, part: Part, number: int, page: Page) -> Iterator[str]:
    """Yield the section of a part: its criteria, its figures, its tables, and its notes."""
    yield f"<h2>{number} {escape(part.title)}</h2>"
    if part.criteria:
        yield table(CRITERION_COLUMNS, [cells(one) for one in part.criteria], right=(3, 4))
    for one in part.results:
        for drawn in figures_of(one, Shown(result, part)):
            yield page.figure(drawn._replace(name=f"{number}_{_file_name(drawn.name)}"))
        if isinstance(one, DampedModes):
            rows = [(f"{mode.frequency:.5g}", f"{mode.decrement:.3g}", mode.whirl or "-") for mode in one.modes]
            yield table(("damped frequency [Hz]", "log decrement", "whirl"), rows, right=(0, 1))
    for note in part.notes:
        yield paragraph(note, small=True)


def _file_name(name: str) -> str:
    """Return a name that any folder takes."""
    return re.sub(r"[^\w-]", "_", name)[:LONGEST_NAME]
