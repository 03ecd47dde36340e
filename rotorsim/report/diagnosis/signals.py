"""The missing signals in the report of a diagnosis: estimated without a law, and the places that they may act at."""

from __future__ import annotations

from collections.abc import Iterator

from rotorsim.diagnosis.conclude.result import Diagnosis
from rotorsim.diagnosis.evidence.missing_signal import MissingSignal
from rotorsim.report.diagnosis.compared import Drawn
from rotorsim.report.diagnosis.page import Page, paragraph, table
from rotorsim.report.figures.missing_signal import missing_signal_figure

LISTED = 0.005  # probability from which a class of places is listed
CAPTION = (
    "What must be added there to explain all recorded outputs, by a Kalman smoother that knows no law; in SI where "
    "neither diagram nor recording states a unit."
)
BESIDE = " The other parameters are those of the repaired diagram."
CLASSES = (
    "Places where such a signal may act: those of one class no data tell apart, since their signals change all "
    "recorded outputs alike."
)


def missing_signals(diagnosis: Diagnosis, page: Page) -> Iterator[str]:
    """Yield each missing signal with its places."""
    for number, signal in enumerate(diagnosis.signals):
        if not number:
            yield "<h3>What is missing as a signal</h3>"
        name = "missing_signal" + (f"_{number + 1}" if number else "")
        yield page.figure(Drawn(name, missing_signal_figure(signal), CAPTION + BESIDE * bool(signal.physics)))
        yield _classes(signal)


def _classes(signal: MissingSignal) -> str:
    rows = [
        [", ".join(spot.words for spot in one.places), f"{one.probability:.2f}"]
        for one in signal.classes
        if one.probability >= LISTED
    ]
    return "\n".join([paragraph(CLASSES), table(["places", "probability"], rows, right=[1])]) if rows else ""
