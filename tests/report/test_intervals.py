"""Bars of figures reach 1.644854 standard deviations to either side: 90 %."""

from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure

from rotorsim.report.comparison.harmonics import Harmonics, Signal
from rotorsim.report.figures import speed_curves
from rotorsim.report.figures.spectra import spectra_figure
from rotorsim.report.figures.speed_curves import speed_curves_figure
from rotorsim.report.style import BLUE, Look
from tests.report.test_identification_figures import bars

SIGNAL = Signal("rotor.displacement", "rotor.displacement[1]", "rotor.displacement[2]", "m")
STD, PHASE_STD = np.array([1e-7, 2e-7]), np.array([0.1, 0.05])
MEASURED = Harmonics(np.array([1, 2]), np.array([3e-6, 2e-6j]), STD, PHASE_STD, np.full(2, 1e-7))


class Runs:
    """What a diagram says of two runs, and what was measured."""

    groups = {"": [0, 1]}
    speeds = np.array([100.0, 110.0])

    def measured(self, r: int, signal: Signal) -> Harmonics:
        return MEASURED

    def prediction(self, r: int, signal: Signal) -> np.ndarray:
        return MEASURED.value

    def orders(self, signal: Signal) -> np.ndarray:
        return MEASURED.orders

    def lines(self, r: int, signal: Signal) -> tuple[Harmonics, np.ndarray]:
        return MEASURED, MEASURED.value

    def spread(self, count: int) -> list[int]:
        return [0]

    def title(self, r: int) -> str:
        return "955 rpm"


RUNS = Runs()
ONE = SimpleNamespace(
    runs=RUNS,
    diagrams=((Look("model", BLUE), RUNS),),
    signals=[SIGNAL],
    of="runs",
    largest=lambda r, signal: MEASURED.size,
)


def halves(made: Figure) -> list[list[float]]:
    """Return the half widths of all bars, axes by axes."""
    return [bars(container)[1].tolist() for axes in made.axes for container in axes.containers]


def test_bars_of_spectra():
    """Of the harmonics, then of the lines beside them."""
    assert halves(spectra_figure(ONE)) == 2 * [pytest.approx([0.1644854, 0.3289708], rel=1e-6)]  # um


def test_bars_over_speed(monkeypatch):
    monkeypatch.setattr(speed_curves, "speed_curve", lambda runs, group, signal, orders, reach: None)
    um, degrees = (0.1644854, 0.3289708), np.degrees((0.1644854, 0.0822427))
    expected = [2 * [pytest.approx(half, rel=1e-6)] for half in (*um, *degrees)]
    assert halves(speed_curves_figure(ONE)) == expected
