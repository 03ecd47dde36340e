"""Critical speeds of a run-up or coast-down, corrected for its sweep rate, with intervals.

A rotor that passes a critical speed rings on: the peak comes late, low and broad, and beats behind it are no critical
speeds. What is fitted to order vectors is therefore the motion of a few modes along the speed as it was, of order k

x'' + 2 z w x' + w^2 x = Re g e^{i k theta},   g = W^2 - i W' for 1X (unbalance), 1 for the others

x = Re X e^{i k theta},  X = (a - b) / (s - conj s),  a' = (s - i k W) a + g,  b' = (conj s - i k W) b + g,

s = -z w + i w sqrt(1 - z^2), in steps that are exact for constant W, and X averaged over the turns of each row, as it
was of the machine. Each channel is a sum of all modes with complex factors of its own, of g (modes far above), of a
constant (slow roll) and of the mains' pick-up, which the shaft overtakes; these enter linearly and are projected out
(variable projection). As many modes are taken as the Bayesian information criterion asks for. Critical speed and
amplification factor are then those of the settled response of each mode by itself
(`rotorsim.signals.orders.resonance`). One that has no half-power speeds is no critical speed. Natural frequencies may
follow the speed along straight lines, as gyroscopic moments make them, where that is very strong evidence, too.

Source: API RP 684 (2005), SP6.8.2; `rotorsim.signals.orders.modal_fit`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from rotorsim.criteria import Z90
from rotorsim.errors import Problem, RotorsimError
from rotorsim.recordings.orders import OrderChannel, OrderRun
from rotorsim.signals.orders.modal_fit import ModalFit, PassedRun, covariance_of, searched, with_one_more
from rotorsim.signals.orders.resonance import Margin, Peak, peak_of, separation_margin, settled_response
from rotorsim.signals.orders.rows import slowness

MOST_MODES = 4
MUCH = 2.0  # times the variance of the noise: beyond, a fit has something left to explain
VERY_STRONG = 10.0  # by which the criterion must fall for one more mode: very strong evidence; Kass & Raftery (1995)


@dataclass(frozen=True, eq=False)
class CriticalSpeed:
    """One mode whose critical speed a run has passed.

    frequency [rad/s] and damping: w, z. peak: of its settled response. std: standard deviations of "frequency",
    "damping", "speed" and "amplification". vectors: channel -> settled response of this mode alone at its critical
    speed, complex, SI, 0-peak. whirl: 1 for a circle forward, 0 for a line, -1 for a circle backward; NaN without two
    axes.
    """

    frequency: float
    damping: float
    peak: Peak
    std: Mapping[str, float]
    vectors: Mapping[str, complex]
    whirl: float

    def interval90(self, name: str) -> tuple[float, float]:
        """Return the 90 % interval of "frequency", "damping", "speed" or "amplification"."""
        values = {"speed": self.peak.speed, "amplification": self.peak.amplification}
        value, std = values[name] if name in values else getattr(self, name), self.std[name]
        return value - Z90 * std, value + Z90 * std

    def separation(self, lowest: float, highest: float) -> tuple[Margin, str]:
        """Return the margin from operating speeds [rad/s], and "met", "not met", or "unsure" within both intervals."""
        margin = separation_margin(self.peak.speed, self.peak.amplification, lowest, highest)
        low, high = self.interval90("speed")
        speeds = [low, self.peak.speed, high, *(end for end in (lowest, highest) if low <= end <= high)]
        corners = [
            separation_margin(speed, amplification, lowest, highest).met
            for speed in speeds
            for amplification in self.interval90("amplification")
        ]
        return margin, "met" if all(corners) else "not met" if not any(corners) else "unsure"


@dataclass(frozen=True, eq=False)
class CriticalSpeeds:
    """What the vectors of one order of a run say: critical speeds, rising; fitted and settled: channel -> (n,), SI.

    settled: the response that the same modes have at constant speeds, without slow roll. excess: variance of what is
    left over that of noise between rows, by whose root intervals are wider or narrower.
    """

    run: str
    order: int
    speed: np.ndarray
    found: tuple[CriticalSpeed, ...]
    fitted: Mapping[str, np.ndarray] = field(default_factory=dict)
    settled: Mapping[str, np.ndarray] = field(default_factory=dict)
    slow_roll: Mapping[str, complex] = field(default_factory=dict)
    excess: float = 1.0

    @property
    def explained(self) -> bool:
        """Whether the modes leave little more than noise, so that none that was found means that none was passed."""
        return self.excess <= MUCH


def critical_speeds(run: OrderRun, channels: Mapping[str, OrderChannel], order: int = 1) -> CriticalSpeeds:
    """Return the critical speeds that a run has passed, from all of its channels of one order.

    Channels with so many gaps that their noise is not seen are left out. Raises RotorsimError where none is left, or
    no channel has that order.
    """
    own = [run.vectors[name] for name, one in channels.items() if one.order == order and name in run.vectors]
    if not any(np.isfinite(vectors).any() for vectors in own):
        raise RotorsimError(Problem(f"no channel of {order}X was measured", f"run {run.id}"))
    if not np.ptp(run.speed) > 0:
        hint = "rotorsim spectrum shows harmonics of runs at one speed"
        raise RotorsimError(Problem("its speed does not change", f"run {run.id}", run.place, hint), exit_code=1)
    data = PassedRun.of(run, channels, order)
    return _said(run, channels, order, data, _chosen(data))


def _chosen(data: PassedRun) -> ModalFit:
    """Return the fit with as many modes as there is very strong evidence for, two at once where one explains nothing.

    A fit that lacks a mode leaves what is slow from row to row, so that few rows count, and says little for itself.
    """
    fits = [ModalFit(data, np.zeros((0, 3)))]
    while len(fits) <= MOST_MODES and float((fits[-1].residual ** 2).mean()) > data.least:
        more = with_one_more(data, fits[-1])
        if more.has_twins:
            break
        fits.append(more)
    best = 0
    while True:
        better = [k for k in range(best + 1, len(fits)) if fits[k].gain(fits[best]) >= VERY_STRONG * (k - best)]
        if not better:
            break
        best = better[0]
    found = fits[best]
    if best:
        sloped = searched(data, found.modes, slopes=True)
        if sloped.gain(found) >= VERY_STRONG * best and not sloped.has_twins:
            return sloped
    return found


def _said(
    run: OrderRun, channels: Mapping[str, OrderChannel], order: int, data: PassedRun, fit: ModalFit
) -> CriticalSpeeds:
    """Return what a fit says, intervals by its Jacobian and what it leaves."""
    counted = slowness(fit.left) if fit.excess <= MUCH else sum(int(np.isfinite(e).sum()) for e in fit.left)
    variance = max(fit.excess, data.least) * counted
    low, high = float(data.rows.min()), float(data.rows.max())
    covariance = covariance_of(data, fit) * variance if len(fit.modes) else np.zeros((0, 0))
    found: list[CriticalSpeed] = []
    for j, (w, z, slope) in enumerate(fit.modes.tolist()):
        peak = peak_of(w, z, order, slope)
        if not low <= peak.speed <= high or not np.isfinite(peak.amplification):
            continue
        C = covariance[3 * j : 3 * j + 3, 3 * j : 3 * j + 3]
        std = {name: float(np.sqrt(max(g @ C @ g, 0.0))) for name, g in _gradients(w, z, order, slope).items()}
        if std["amplification"] * Z90 > peak.amplification:
            continue
        own = settled_response(np.array([peak.speed]), w, z, order, slope)[0] * fit.factors[j] * data.noise
        vectors = dict(zip(data.names, own.tolist(), strict=True))
        whirl = run.sense * _whirl(vectors, channels)
        found.append(CriticalSpeed(w, z, peak, std, vectors, whirl))
    whole = data.far(data.rows) @ fit.factors[-2:]
    for mode, factors in zip(fit.modes.tolist(), fit.factors, strict=False):
        whole = whole + np.outer(data.settled_mode(*mode), factors)
    place = len(fit.modes)
    return CriticalSpeeds(
        run.id,
        order,
        data.rows,
        tuple(sorted(found, key=lambda one: one.peak.speed)),
        dict(zip(data.names, (fit.columns @ fit.factors * data.noise).T, strict=True)),
        dict(zip(data.names, (whole * data.noise).T, strict=True)),
        {name: complex(fit.factors[place, c] * data.noise[c]) for c, name in enumerate(data.names)},
        fit.excess,
    )


def _whirl(vectors: Mapping[str, complex], channels: Mapping[str, OrderChannel]) -> float:
    """Return the mean of 2 Im(X conj Y) / (|X|^2 + |Y|^2) over the places with two axes."""
    pairs: dict[tuple[str, int | None, float | None], dict[str, complex]] = {}
    for name, value in vectors.items():
        channel = channels[name]
        if channel.axis is not None:
            pairs.setdefault((channel.signal, channel.node, channel.position), {})[channel.axis] = value
    whole = [(one["x"], one["y"]) for one in pairs.values() if len(one) == 2]
    parts = [2 * (x * y.conjugate()).imag / max(abs(x) ** 2 + abs(y) ** 2, 1e-300) for x, y in whole]
    return float(np.mean(parts)) if parts else float("nan")


def _gradients(w: float, z: float, order: int, slope: float) -> dict[str, np.ndarray]:
    """Return the derivatives of what is said of a mode by w, z and slope."""

    def told(at: np.ndarray) -> np.ndarray:
        peak = peak_of(at[0], at[1], order, at[2] if slope else 0.0)
        return np.array([at[0], at[1], peak.speed, peak.amplification])

    here = np.array([w, z, slope])
    columns = [
        (told(here + step * unit) - told(here - step * unit)) / (2 * step)
        for step, unit in zip((1e-4 * w * z, 1e-4 * z, 1e-4), np.eye(3), strict=True)
    ]
    return dict(zip(("frequency", "damping", "speed", "amplification"), np.stack(columns, axis=1), strict=True))
