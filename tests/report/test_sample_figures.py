"""Figures of samples in time: what is drawn are the numbers, with names, units, and the white band."""

import numpy as np
import pytest

from rotorsim.identification.identification import identify
from rotorsim.model.load import load
from rotorsim.report.figures.samples import Beside, autocorrelation, beside_figure, worst_stretch
from rotorsim.report.identification.figures import identification_figures, save_figures
from tests.identification.in_time import OSCILLATOR, even, measured, recording


@pytest.fixture(scope="module")
def found():
    runs = [measured(f"run{k}", k, even(600), 0.02, use) for k, use in enumerate(["identify", "identify", "hold_out"])]
    made = recording(*runs)
    return identify(load(OSCILLATOR), made), made


def test_an_identification_in_time_has_its_figures(found, tmp_path):
    names = [file.stem for file in save_figures(*found, tmp_path)]
    assert names == ["parameters", "correlation", "simulated", "hold_out", "residual"]


def test_titles_and_legends(found):
    figures = identification_figures(*found)
    assert figures["simulated"].get_suptitle() == "Fitted runs, oscillator identified from bench"
    assert figures["hold_out"].get_suptitle() == "Hold-out runs, oscillator identified from bench"
    residual = figures["residual"]
    left, right = residual.axes
    assert residual.get_suptitle() == "Residuals, oscillator identified from bench"
    assert left.get_xlabel() == "time [s], runs one after another"
    assert right.get_xlabel() == "lag [s]"
    assert [[text.get_text() for text in legend.get_texts()] for legend in residual.legends] == [
        ["residual", "next run"],
        ["white noise (95 %)", "autocorrelation"],
    ]
    bottom, top = np.sort(right.patches[0].get_y() + np.array([0, right.patches[0].get_height()]))
    assert (bottom, top) == pytest.approx((-1.96 / np.sqrt(1200), 1.96 / np.sqrt(1200)))


def test_the_residual_is_measured_less_simulated(found):
    identification, made = found
    (left, _) = identification_figures(identification, made)["residual"].axes
    lines = [line for line in left.lines if line.get_label() == "residual"]
    for line, run, item in zip(lines, made.runs, identification.runs, strict=False):
        expected = run.values["q"] - item.simulated["position.output"]
        factor = {"[um]": 1e6, "[mm]": 1e3, "[m]": 1.0}[left.get_ylabel()]
        np.testing.assert_allclose(line.get_ydata(), factor * expected, rtol=1e-9)


def test_autocorrelation_of_white_and_of_first_order_noise():
    """r_k = a^k; the standard deviation of an estimate is about 1 / sqrt(N)."""
    rng, a = np.random.default_rng(0), 0.8
    white = [rng.normal(size=4000), rng.normal(size=3000)]
    values, count = autocorrelation(white, 50)
    assert count == 7000
    assert values[0] == pytest.approx(1.0)
    assert np.mean(np.abs(values[1:]) > 1.96 / np.sqrt(count)) < 0.2
    e = np.zeros(60_000)
    for k, drawn in enumerate(rng.normal(size=len(e) - 1)):
        e[k + 1] = a * e[k] + drawn
    e[rng.integers(0, len(e), 5000)] = np.nan  # missing samples change nothing but the number of pairs
    values, _ = autocorrelation([e], 10)
    np.testing.assert_allclose(values, a ** np.arange(11), atol=0.05)


def test_the_worst_stretch_and_long_signals():
    time = np.arange(20_000) / 1000
    trace = Beside("r", "a.output", "V", time, np.sin(time), np.sin(time) + (np.abs(time - 13) < 0.1))
    part = worst_stretch(trace)
    assert time[part.start] < 12.9 < 13.1 < time[part.stop - 1]
    axes = beside_figure([trace], "long").axes[0]
    assert len(axes.lines[0].get_xdata()) <= 4000
    assert axes.lines[1].get_ydata().max() == pytest.approx((np.sin(time) + (np.abs(time - 13) < 0.1)).max())
