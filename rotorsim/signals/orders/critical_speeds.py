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
(`rotorsim.signals.orders.resonance`). One that has no half-power speeds is no critical speed.

Source: API RP 684 (2005), SP6.8.2; `rotorsim.signals.orders.modal_fit`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from rotorsim.criteria import Z90
from rotorsim.errors import Problem, RotorsimError
from rotorsim.recordings.orders import OrderChannel, OrderRun
from rotorsim.signals.orders.modal_fit import ModalFit, PassedRun, covariance_of, with_one_more
from rotorsim.signals.orders.resonance import Peak, peak_of
from rotorsim.signals.orders.rows import slowness

MOST_MODES = 4
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


@dataclass(frozen=True, eq=False)
class CriticalSpeeds:
    """What the vectors of one order of a run say: critical speeds, rising; fitted and settled: channel -> (n,), SI.

    settled: the response that the same modes have at constant speeds, without slow roll. excess: variance of what is
    left over that of noise between rows; above one, intervals are wider by its root.
    """

    run: str
    order: int
    speed: np.ndarray
    found: tuple[CriticalSpeed, ...]
    fitted: Mapping[str, np.ndarray] = field(default_factory=dict)
    settled: Mapping[str, np.ndarray] = field(default_factory=dict)
    slow_roll: Mapping[str, complex] = field(default_factory=dict)
    excess: float = 1.0


def critical_speeds(run: OrderRun, channels: Mapping[str, OrderChannel], order: int = 1) -> CriticalSpeeds:
    """Return the critical speeds that a run has passed, from all of its channels of one order.

    Raises RotorsimError where no channel has that order, or rows are missing so often that noise is not seen.
    """
    if not any(one.order == order and np.isfinite(run.vectors[name]).any() for name, one in channels.items()):
        raise RotorsimError(Problem(f"no channel of {order}X was measured", f"run {run.id}"))
    data = PassedRun.of(run, channels, order)
    fit = ModalFit(data, np.zeros((0, 2)))
    while len(fit.modes) < MOST_MODES:
        trial = with_one_more(data, fit)
        if trial.gain(fit) < VERY_STRONG or trial.has_twins:
            break
        fit = trial
    return _said(run, channels, order, data, fit)


def _said(
    run: OrderRun, channels: Mapping[str, OrderChannel], order: int, data: PassedRun, fit: ModalFit
) -> CriticalSpeeds:
    """Return what a fit says, intervals by its Jacobian and what it leaves."""
    excess = float(fit.residual @ fit.residual) / max(len(fit.residual) - fit.unknowns, 1)
    variance = max(excess, 1.0) * slowness(fit.left)
    low, high = float(data.rows.min()), float(data.rows.max())
    covariance = covariance_of(data, fit) * variance if len(fit.modes) else np.zeros((0, 0))
    found: list[CriticalSpeed] = []
    for j, (w, z) in enumerate(fit.modes):
        peak = peak_of(w, z, order)
        if not low <= peak.speed <= high or not np.isfinite(peak.amplification):
            continue
        C = covariance[2 * j : 2 * j + 2, 2 * j : 2 * j + 2]
        std = {name: float(np.sqrt(max(g @ C @ g, 0.0))) for name, g in _gradients(w, z, order).items()}
        if std["amplification"] * Z90 > peak.amplification:
            continue
        own = replace(data, rows=np.array([peak.speed])).settled_mode(w, z)[0] * fit.factors[j] * data.noise
        vectors = dict(zip(data.names, own.tolist(), strict=True))
        found.append(CriticalSpeed(float(w), float(z), peak, std, vectors, _whirl(vectors, channels)))
    whole = np.zeros((len(data.rows), len(data.names)), complex)
    for (w, z), factors in zip(fit.modes, fit.factors, strict=False):
        whole += np.outer(data.settled_mode(w, z), factors)
    whole += data.far(data.rows) @ fit.factors[-2:]
    place = len(fit.modes)
    return CriticalSpeeds(
        run.id,
        order,
        data.rows,
        tuple(sorted(found, key=lambda one: one.peak.speed)),
        dict(zip(data.names, (fit.columns @ fit.factors * data.noise).T, strict=True)),
        dict(zip(data.names, (whole * data.noise).T, strict=True)),
        {name: complex(fit.factors[place, c] * data.noise[c]) for c, name in enumerate(data.names)},
        excess,
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


def _gradients(w: float, z: float, order: int) -> dict[str, np.ndarray]:
    """Return the derivatives of what is said of a mode by w and z."""

    def told(w: float, z: float) -> np.ndarray:
        peak = peak_of(w, z, order)
        return np.array([peak.speed, peak.amplification])

    by_w = np.array([1 / w, 0.0])
    step = 1e-5 * z
    by_z = (told(w, z + step) - told(w, z - step)) / (2 * step)
    here = told(w, z)
    return {
        "frequency": np.array([1.0, 0.0]),
        "damping": np.array([0.0, 1.0]),
        "speed": np.array([here[0] * by_w[0], by_z[0]]),
        "amplification": np.array([0.0, by_z[1]]),
    }
