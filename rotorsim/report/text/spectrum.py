"""Full spectra and harmonics of two-axis signals as text and as data."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from rotorsim.report.amplitudes import from_peak, of_amplitude
from rotorsim.report.text.table import degrees, display_unit, percent, table

if TYPE_CHECKING:
    from rotorsim.signals.spectrum import FullSpectrum, Harmonics
    from rotorsim.signals.two_axis import TwoAxis


METHOD_WORDS = {"fft": "FFT", "regression": "regression", "least-squares": "least squares"}


def spectrum_text(spectrum: FullSpectrum, running: float | None, threshold: float) -> str:
    """Return the lines of a spectrum: what exceeds both neighbours and the threshold; running: frequency [Hz]."""
    size = np.abs(spectrum.amplitude)
    padded = np.concatenate(([0.0], size, [0.0]))
    peaks = np.flatnonzero((size > padded[:-2]) & (size >= padded[2:]) & (size >= threshold * size.max()))
    unit, scale = display_unit(spectrum.unit)
    shown = from_peak(size, spectrum.frequency)
    rows = [
        (
            f"{spectrum.frequency[k]:.4f}",
            f"{spectrum.frequency[k] / running:.4g}" if running else "-",
            f"{shown[k] * scale:.6g}",
            f"{degrees(spectrum.amplitude[k]):.2f}",
        )
        for k in peaks
    ]
    header = ("frequency [Hz]", "order", f"amplitude [{of_amplitude(unit)}]", "phase [deg]")
    return f"{spectrum.signal}\n{table(header, rows)}"


def spectrum_data(spectrum: FullSpectrum) -> dict[str, Any]:
    """Return a spectrum as data."""
    amplitude = spectrum.amplitude
    return {"frequency_hz": spectrum.frequency, "real": amplitude.real, "imag": amplitude.imag}


def harmonics_data(harmonics: Harmonics) -> dict[str, Any]:
    """Return harmonics without statistics as data."""
    values = harmonics.values
    return {"orders": harmonics.orders, "real": values.real, "imag": values.imag, "residual": harmonics.residual}


def harmonics_text(fit: TwoAxis, threshold: float) -> str:
    """Return harmonics as text: those above the threshold and above what noise makes."""
    item = fit.harmonics
    unit, scale = display_unit(item.unit)
    size = np.abs(item.values)
    shown = size >= threshold * size.max(initial=0.0)
    if fit.significant is not None:
        shown &= fit.significant
    columns = {
        "order": [f"{order:g}" for order in item.orders],
        f"amplitude [{of_amplitude(unit)}]": [f"{one * scale:.6g}" for one in from_peak(size, item.orders)],
        "+- 90 %": None
        if fit.amplitude90 is None
        else [f"{half * scale:.2g}" for half in from_peak(fit.amplitude90, item.orders)],
        "phase [deg]": [f"{degrees(value):.2f}" for value in item.values],
        " +- 90 %": None if fit.phase90 is None else [f"{half:.2g}" for half in np.degrees(fit.phase90)],
    }
    known = {name: cells for name, cells in columns.items() if cells is not None}
    rows = [row for row, wanted in zip(zip(*known.values(), strict=True), shown, strict=True) if wanted]
    first, last = fit.window
    lines = [
        f"{item.signal}, {METHOD_WORDS[fit.method]} over {fit.turns:.4g} turns, {first:.4g}..{last:.4g} s",
        table([name.strip() for name in known], rows) if rows else "nothing but noise",
        *(
            f"asynchronous line: {line.frequency:.6g} Hz, order {line.order:.4f}, "
            f"forward {from_peak(line.forward) * scale:.4g} {unit}, "
            f"backward {from_peak(line.backward) * scale:.4g} {unit}"
            for line in fit.lines
        ),
    ]
    x, y = map(percent, fit.error)
    return "\n".join([*lines, f"reconstruction error: x {x}, y {y} of the rms"])


def two_axis_data(fit: TwoAxis) -> dict[str, Any]:
    """Return harmonics with their statistics as data."""
    item = fit.harmonics
    return {
        "method": fit.method,
        "window": fit.window,
        "turns": fit.turns,
        "orders": item.orders,
        "real": item.values.real,
        "imag": item.values.imag,
        "amplitude_90": fit.amplitude90,
        "phase_90": fit.phase90,
        "residual": item.residual,
        "reconstruction_error": fit.error,
        "lines": [
            {"frequency_hz": line.frequency, "order": line.order, "forward": line.forward, "backward": line.backward}
            for line in fit.lines
        ],
    }
