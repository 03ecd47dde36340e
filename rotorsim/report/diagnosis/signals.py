"""The missing signals in the report of a diagnosis: estimated without a law, and the places that they may act at."""

from __future__ import annotations

from collections.abc import Iterator

from rotorsim.diagnosis.conclude.result import Diagnosis
from rotorsim.report.diagnosis.places import place_classes
from rotorsim.report.figures.missing_signal import missing_signal_figure
from rotorsim.report.page import Drawn, Page, paragraph, table

CAPTION = (
    "What must be added there to explain all recorded outputs, by a Kalman smoother that knows no law; in SI where "
    "neither diagram nor recording states a unit."
)
BESIDE = " The other parameters are those of the repaired diagram."
CLASSES = (
    "Classes of places where such a signal may act, by its likelihood alone: the places of one class no data "
    "separate, since signals there change all recorded outputs alike."
)


def missing_signals(diagnosis: Diagnosis, page: Page) -> Iterator[str]:
    """Yield each missing signal, and the places where they may act."""
    for number, signal in enumerate(diagnosis.signals):
        if not number:
            yield "<h3>What is missing as a signal</h3>"
        name = "missing_signal" + (f"_{number + 1}" if number else "")
        yield page.figure(Drawn(name, missing_signal_figure(signal), CAPTION + BESIDE * bool(signal.physics)))
    rows = [
        [letter, ", ".join(spot.words for spot in spots), f"{probability:.2f}"]
        for letter, spots, probability in place_classes(diagnosis.signals)
    ]
    if rows:
        yield paragraph(CLASSES)
        yield table(["class", "places", "probability"], rows, right=[2])
