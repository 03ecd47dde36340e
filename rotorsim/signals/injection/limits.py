"""Gain, phase and delay margins of an open loop as it was measured, with intervals."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.special import stdtrit

from rotorsim.linear.control.margins import Axis
from rotorsim.linear.loop import open_loop_of
from rotorsim.signals.injection.columns import Column

CLEAR_OF_ZERO = 4.0  # standard deviations on both sides of a crossing: of thousands of frequencies noise makes three


def with_limits(
    best: Axis, hz: np.ndarray, S: np.ndarray, column: Column, i: int, measured: np.ndarray
) -> tuple[Axis, dict[str, tuple[float, float]]]:
    """Return gain, phase and delay margins where G_o, between frequencies measured, is -1 / gain or of size 1."""
    with np.errstate(invalid="ignore", divide="ignore"):
        G = np.asarray(open_loop_of(np.where(measured, S, np.nan)))
        std = column.std[:, i] / np.abs(S) ** 2 / np.sqrt(2)  # of G_o, along any direction
        quantile = stdtrit(2 * column.freedom, 0.95)
        relative = quantile * std / np.abs(G)
        size = np.log(np.abs(G))
    best = replace(best, gain_up=np.inf, gain_down=0.0)
    interval: dict[str, tuple[float, float]] = {}
    for f, value, half in _crossings(hz, G.imag, std, G, relative):
        gain = -1 / value.real
        ends = gain * (1 - half), gain * (1 + half)
        if 1 < gain < best.gain_up:
            best, interval["gain_up"] = replace(best, gain_up=gain, gain_up_frequency=f), ends
        elif best.gain_down < gain < 1:
            best, interval["gain_down"] = replace(best, gain_down=gain, gain_down_frequency=f), ends
    for f, value, half in _crossings(hz, size, std / np.abs(G), G, relative):
        lag, spread = float(np.degrees(np.angle(-value))), float(np.degrees(half))
        if not abs(lag) >= best.phase:  # which is nan before the first
            best = replace(best, phase=abs(lag), phase_frequency=f)
            interval["phase"] = abs(lag) - spread, abs(lag) + spread
        delay = lag % 360 / 360 / f
        if not delay >= best.delay:
            best = replace(best, delay=delay, delay_frequency=f)
            interval["delay"] = delay - spread / 360 / f, delay + spread / 360 / f
    return best, interval


def _crossings(
    hz: np.ndarray, values: np.ndarray, std: np.ndarray, G: np.ndarray, relative: np.ndarray
) -> Iterator[tuple[float, complex, float]]:
    """Yield frequency [Hz], G_o and its relative half width where values pass zero, clear of it on both sides."""
    with np.errstate(invalid="ignore"):
        clear = np.flatnonzero(np.abs(values) > CLEAR_OF_ZERO * std)
    for a, b in pairwise(clear.tolist()):
        between = values[a : b + 1]
        if values[a] * values[b] > 0 or not np.isfinite(between).all():
            continue
        changes = a + np.flatnonzero(between[:-1] * between[1:] <= 0)
        k = int(changes[len(changes) // 2])
        part = float(values[k] / (values[k] - values[k + 1]))
        yield float(hz[k] + part * (hz[k + 1] - hz[k])), complex(G[k] + part * (G[k + 1] - G[k])), float(relative[k])
