"""Amplitudes 0-peak, peak-peak or rms, by choice, in every figure and table."""

from __future__ import annotations

import re

import numpy as np
import pytest

from rotorsim import RotorsimError, amplitudes, load, periodic, run_up, simulate_many
from rotorsim.report.amplitudes import from_peak, of_amplitude, shown_amplitudes
from rotorsim.report.figures.bode import Curve, bode_figure
from rotorsim.report.figures.ensemble import curve_figure
from rotorsim.report.figures.linear import periodic_figure
from rotorsim.report.figures.run import spectrum_figure
from rotorsim.report.text.ensemble import ensemble_table
from rotorsim.report.text.spectrum import harmonics_text, spectrum_text
from rotorsim.signals.spectrum import full_spectrum
from rotorsim.signals.two_axis import two_axis_harmonics
from rotorsim.simulation.result import Result

FACTORS = {"0-peak": 1.0, "peak-peak": 2.0, "rms": 0.70710678}


@pytest.mark.parametrize("word", FACTORS)
def test_what_is_shown_is_the_amplitude_of_a_sine_taken_that_way(word: str) -> None:
    sine = 3.0 * np.sin(2 * np.pi * np.arange(1000) / 1000)
    truth = {"0-peak": sine.max(), "peak-peak": np.ptp(sine), "rms": np.sqrt(np.mean(sine**2))}
    with amplitudes(word):
        assert from_peak(3.0) == pytest.approx(truth[word], rel=1e-12)
        assert from_peak([3.0, 5.0], [1, 0]) == pytest.approx([3.0 * FACTORS[word], 5.0])  # a mean is no amplitude
        assert of_amplitude("um") == f"um, {word}"
    assert shown_amplitudes() == "0-peak"


def test_another_word_is_refused() -> None:
    with pytest.raises(RotorsimError) as refused, amplitudes("peak"):
        pass
    [problem] = refused.value.problems
    assert problem.what == "'peak' is no way to show amplitudes"
    assert problem.hint == "did you mean '0-peak' or 'peak-peak'?"


def turning() -> Result:
    """Return 20 turns of r = 2 + 3 e^{i theta} + e^{-3 i theta} [um]."""
    theta = 2 * np.pi * np.arange(20 * 64) / 64
    r = (2.0 + 3.0 * np.exp(1j * theta) + np.exp(-3j * theta)) * 1e-6
    signals = {"rotor.displacement": np.stack([r.real, r.imag], axis=1), "clock.theta": theta}
    return Result(theta / 100.0, signals, {"rotor.displacement": "m", "clock.theta": "rad"})


@pytest.mark.parametrize("word", FACTORS)
def test_spectra_are_shown_as_chosen(word: str) -> None:
    result, factor = turning(), FACTORS[word]
    with amplitudes(word):
        listed = spectrum_text(full_spectrum(result, "rotor.displacement", angle="clock.theta"), 100 / 2 / np.pi, 1e-3)
        fitted = harmonics_text(two_axis_harmonics(result, "rotor.displacement", "fft", angle="clock.theta"), 1e-3)
        axes = spectrum_figure(result, "rotor.displacement").axes[0]
    for text in (listed, fitted):
        assert f"[um, {word}]" in text
    rows = {line.split()[1]: float(line.split()[2]) for line in listed.splitlines()[2:]}
    assert rows == pytest.approx({"-3": factor, "0": 2.0, "1": 3 * factor}, rel=1e-4)
    rows = {line.split()[0]: float(line.split()[1]) for line in fitted.splitlines()[2:5]}
    assert rows == pytest.approx({"-3": factor, "0": 2.0, "1": 3 * factor}, rel=1e-4)
    assert axes.get_ylabel() == f"[um, {word}]"
    heights = {round(float(line[0][0])): float(line[1][1]) for c in axes.collections for line in c.get_segments()}
    assert heights == pytest.approx({-3: factor, 0: 2.0, 1: 3 * factor}, rel=1e-4)


def test_the_size_of_a_turn_is_that_of_its_samples() -> None:
    """x = sin + 0.5 cos 2: max |x| = 1.5, max - min = 2.25 (at sin = -1 and at sin = 1/2), mean square = 0.625."""
    time = np.linspace(0.0, 6.0, 60_001)
    theta, speed = 2 * np.pi * (10.0 * time + 0.05 * time**2), 2 * np.pi * (10.0 + 0.1 * time)
    signals = {"x": np.sin(theta) + 0.5 * np.cos(2 * theta), "clock.speed": speed, "clock.theta": theta}
    found = run_up(Result(time, signals, dict.fromkeys(signals, "1")), "x")
    for word, size in {"0-peak": 1.5, "peak-peak": 2.25, "rms": np.sqrt(0.625)}.items():
        assert found.sizes(word)[2:-2] == pytest.approx(size, rel=1e-3)


@pytest.mark.parametrize("word", FACTORS)
def test_other_figures_are_shown_as_chosen(word: str) -> None:
    factor = FACTORS[word]
    diagram = load("jeffcott")
    settled = periodic(diagram, speeds=["1400 rpm", "1500 rpm"])
    swept = simulate_many(diagram, {"speed": np.array([150.0, 160.0])}, stop=1.0, reduce=["harmonics", "peak"])
    curve = Curve("measured", np.array([100.0, 200.0]), np.array([1e-6, 2e-6 + 0j]))
    with amplitudes(word):
        drawn = periodic_figure(settled, "rotor.displacement").axes[0]
        over = curve_figure(swept, "rotor.displacement[1]", "harmonics").axes[0]
        bode = bode_figure(curve, [], "", "um", 1e-8).axes[0]
        table = ensemble_table(swept)
    one = np.abs(settled.harmonic("rotor.displacement", 1)) * 1e6
    assert drawn.get_ylabel() == bode.get_ylabel() == f"amplitude [um, {word}]"
    assert np.asarray(drawn.lines[0].get_ydata()) == pytest.approx(factor * one)
    assert over.get_ylabel() == f"amplitude of 1X, {word} [um]"
    size = np.abs(swept["harmonics", "rotor.displacement"][:, 0, 1]) * 1e6
    assert np.asarray(over.lines[0].get_ydata()) == pytest.approx(factor * size)
    assert np.asarray(bode.lines[0].get_ydata()) == pytest.approx([factor, 2 * factor])
    [row] = re.findall(rf"1X, {word} .*\nrotor\.displacement\[1\] +(\S+)", table)
    assert float(row) == pytest.approx(factor * size.min(), rel=1e-4)
