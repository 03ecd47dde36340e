"""Figures of samples in time: what is drawn are the numbers, with names, units, and the white band."""

import numpy as np
import pytest

from rotorsim.identification.identification import identify
from rotorsim.model.load import load
from rotorsim.report.comparison.samples import SampleComparison, Trace
from rotorsim.report.figures.samples import (
    SIMULATED_LOOK,
    autocorrelation,
    beside_figure,
    residuals_in_time_figure,
    stretch,
    worst_stretch,
)
from rotorsim.report.identification.figures import identification_figures, save_figures
from rotorsim.report.style import BLUE, RED, Look
from tests.identification.waveform.in_time import OSCILLATOR, even, measured, recording


@pytest.fixture(scope="module")
def found():
    runs = [measured(f"run{k}", k, even(600), 0.02, use) for k, use in enumerate(["identify", "identify", "hold_out"])]
    made = recording(*runs)
    return identify(load(OSCILLATOR), made), made


@pytest.mark.slow
def test_an_identification_in_time_has_its_figures(found, tmp_path):
    names = [file.stem for file in save_figures(*found, tmp_path)]
    assert names == ["parameters", "correlation", "simulated", "hold_out", "residual"]


@pytest.mark.slow
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
    trace = Trace("r", "a.output", "V", time, np.sin(time), (np.sin(time) + (np.abs(time - 13) < 0.1),))
    part = worst_stretch(trace)
    assert time[part.start] < 12.9 < 13.1 < time[part.stop - 1]
    axes = beside_figure(SampleComparison((SIMULATED_LOOK,), (trace,), "long")).axes[0]
    assert len(axes.lines[0].get_xdata()) <= 4000
    assert axes.lines[1].get_ydata().max() == pytest.approx((np.sin(time) + (np.abs(time - 13) < 0.1)).max())


# -- before and after --------------------------------------------------------------------------------------------------

TIME = np.arange(400) / 100
LOOKS = (Look("diagram as given", RED, line="--"), Look("repaired diagram", BLUE))


def two(given: np.ndarray | None, repaired: np.ndarray) -> SampleComparison:
    """Two runs of a signal of 2 V 0-peak beside two diagrams."""
    y = 2 * np.sin(5 * TIME)
    traces = [Trace(run, "drive.output", "V", TIME, y, (given, repaired + off)) for run, off in (("a", 0), ("b", 0.1))]
    return SampleComparison(LOOKS, tuple(traces), "Signals in time, hold-out runs")


def texts(legend) -> list[str]:
    return [text.get_text() for text in legend.get_texts()]


def test_before_and_after_of_the_worst_run_with_errors_in_its_unit():
    y = 2 * np.sin(5 * TIME)
    both = two(y + 0.5, y + 0.01 * (-1) ** np.arange(400))
    [worst] = both.worst_runs().traces
    assert worst.run == "a"
    whole, zoom = (made := beside_figure(both.worst_runs())).axes
    assert made.get_suptitle() == "Signals in time, hold-out runs"
    assert whole.get_title("left") == ("drive.output, run a: rms error 0.5 V as given, rms error 0.01 V repaired")
    assert (zoom.get_title("left"), zoom.get_xlabel(), zoom.get_ylabel()) == ("worst stretch", "time [s]", "[V]")
    assert texts(made.legends[0]) == ["measured", "diagram as given", "repaired diagram"]


def test_residuals_before_and_after_have_one_legend_and_the_white_band_of_all_samples():
    y, random = 2 * np.sin(5 * TIME), np.random.default_rng(0)
    both = two(y + 0.5 * np.sin(TIME), y + 0.01 * random.normal(size=400))
    left, right = (made := residuals_in_time_figure(both)).axes
    assert texts(made.legends[0]) == ["diagram as given", "repaired diagram", "next run"]
    assert texts(made.legends[1]) == ["white noise (95 %)"]
    assert right.patches[0].get_height() == pytest.approx(2 * 1.96 / np.sqrt(800))
    assert right.get_title("left").startswith("autocorrelation: ")
    np.testing.assert_allclose(left.lines[0].get_ydata(), y - both.traces[0].simulated[0])


def test_nothing_is_lost_where_a_simulation_diverges():
    y = 2 * np.sin(5 * TIME)
    both = two(None, y + 0.01)
    made = beside_figure(both)
    assert made.axes[0].get_title("left") == ("drive.output, run a: as given diverges, rms error 0.01 V repaired")
    assert texts(made.legends[0]) == ["measured", "repaired diagram"]
    residual = residuals_in_time_figure(both)
    assert texts(residual.legends[0]) == ["repaired diagram", "next run"]


def test_the_stretch_that_varies_most_is_not_the_largest_one():
    values = np.concatenate([np.full(1000, 3.0), np.sin(np.arange(1000) / 9)])
    assert stretch(values, values).stop <= 1000
    assert stretch(values, values, about_mean=True).start >= 900
    fast = np.sin(2 * np.pi * np.arange(20_000) / 20)
    part = stretch(fast, fast)
    assert part.stop - part.start == 300  # fifteen periods, for 6 % are too many to be seen
