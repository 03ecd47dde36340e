"""Bars of figures reach 1.644854 standard deviations to either side: 90 %."""

from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure

from rotorsim.report.diagnosis import figures as diagnosis_figures
from rotorsim.report.identification import figures as identification_figures
from tests.report.test_identification_figures import bars

SIGNAL = SimpleNamespace(unit="m", title="rotor.displacement", y="")
STD, PHASE_STD = np.array([1e-7, 2e-7]), np.array([0.1, 0.05])
MEASURED = SimpleNamespace(
    orders=np.array([1, 2]),
    value=np.array([3e-6, 2e-6j]),
    amplitude_std=STD,
    phase_std=PHASE_STD,
    noise=np.full(2, 1e-7),
)


class Run:
    """What a diagram says of one run at 100 rad/s, and what was measured."""

    groups = {"": [0]}
    experiment = SimpleNamespace(fits=[SimpleNamespace(speed=100.0)])

    def measured(self, r: int, signal: object) -> SimpleNamespace:
        return MEASURED

    def model(self, r: int, signal: object) -> np.ndarray:
        return MEASURED.value

    def orders(self, signal: object) -> np.ndarray:
        return MEASURED.orders

    def lines(self, r: int, signal: object) -> tuple[SimpleNamespace, np.ndarray]:
        return MEASURED, MEASURED.value

    def curve(self, group: str, signal: object, orders: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.array([90.0, 110.0]), np.array([MEASURED.value[:1]] * 2)


def halves(made: Figure) -> list[list[float]]:
    """Return the half widths of all bars, axes by axes."""
    return [bars(container)[1].tolist() for axes in made.axes for container in axes.containers]


def test_bars_of_spectra_of_an_identification():
    made = Figure()
    identification_figures._draw_spectrum(made.subplots(), Run(), 0, SIGNAL)
    assert halves(made) == [pytest.approx([0.1644854, 0.3289708], rel=1e-6)]  # um


def test_bars_over_speed_of_an_identification():
    made = Figure()
    style = ("k", "o", "-")
    identification_figures._draw_group(
        made.subplots(2, 1, squeeze=False), Run(), SIGNAL, np.array([1]), "", style, np.full(1, np.nan)
    )
    assert halves(made) == [[pytest.approx(0.1644854, rel=1e-6)], [pytest.approx(np.degrees(0.1644854), rel=1e-6)]]


def test_bars_of_spectra_of_a_diagnosis():
    """Of the harmonics, then of the lines beside them."""
    run, made = Run(), Figure()
    pair = SimpleNamespace(any=run, models=[("after", run)], labels={"after": "repaired diagram"})
    diagnosis_figures._draw_spectrum(made.subplots(), pair, 0, SIGNAL)
    assert halves(made) == 2 * [pytest.approx([0.1644854, 0.3289708], rel=1e-6)]


def test_bars_over_speed_of_a_diagnosis():
    made = Figure()
    curve = np.array([90.0, 110.0]), np.zeros(2)
    diagnosis_figures._points(*made.subplots(2), Run(), [0], SIGNAL, 0, np.array([100.0]), curve, 0.0, "measured")
    assert halves(made) == [[pytest.approx(0.1644854, rel=1e-6)], [pytest.approx(np.degrees(0.1644854), rel=1e-6)]]
