"""Runs of a turning shaft: measured harmonics with their uncertainty, beside those of one or more diagrams."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rotorsim.identification.harmonic.experiment import Experiment
from rotorsim.identification.harmonic.whitening import harmonics_of_time
from rotorsim.report.style import Look
from rotorsim.report.text.table import rpm
from rotorsim.signals.harmonic_fit import HarmonicFit
from rotorsim.units import format_quantity

EXCEEDED = 0.05  # share of harmonics of noise alone that are above the noise level


@dataclass(frozen=True)
class Signal:
    """A measured signal: two axes x + i y, or one (``y`` is None); x and y are flat names."""

    title: str
    x: str
    y: str | None
    unit: str

    @property
    def names(self) -> list[str]:
        """The flat names of its axes."""
        return [self.x] if self.y is None else [self.x, self.y]

    def combined(self, values: np.ndarray, names: Sequence[str], orders: np.ndarray) -> np.ndarray:
        """Return the harmonics at signed orders (n,) whose absolute value is the amplitude, 0-peak.

        values: (..., K+1, c) of the channels ``names``. Two axes: R_k = a_k + i b_k, R_-k = a_k* + i b_k*, forward
        for k > 0. One axis: 2 c_k.
        """
        a = values[..., np.abs(orders), list(names).index(self.x)]
        if self.y is None:
            return np.asarray(np.where(orders == 0, 1, 2) * a)
        b = values[..., np.abs(orders), list(names).index(self.y)]
        return np.asarray(np.where(orders < 0, a.conj() + 1j * b.conj(), a + 1j * b))


@dataclass(frozen=True, eq=False)
class Harmonics:
    """Measured harmonics of one signal in one run, at signed orders (n,).

    value (n,) complex [SI]: amplitude 0-peak, phase against shaft angle zero; amplitude_std [SI], phase_std [rad].
    noise (n,): amplitude that noise alone exceeds in one case of twenty.
    """

    orders: np.ndarray
    value: np.ndarray
    amplitude_std: np.ndarray
    phase_std: np.ndarray
    noise: np.ndarray

    @property
    def size(self) -> np.ndarray:
        """Amplitudes, (n,)."""
        return np.asarray(np.abs(self.value))

    @property
    def std(self) -> np.ndarray:
        """Square root of the trace of the covariance of each harmonic, (n,)."""
        alone = self.noise**2 / -np.log(EXCEEDED)
        across = self.size * np.minimum(self.phase_std, 1.0)
        return np.asarray(np.sqrt(np.maximum(alone, self.amplitude_std**2 + across**2)) + 1e-300)


@dataclass(frozen=True, eq=False)
class PredictedRuns:
    """Runs of a recording beside what one diagram predicts of them.

    theta (m,): values of experiment.free. predicted (R, K+1, c): harmonics of the diagram about the shaft angle; what
    it leaves open (means of slow states, true values of measured inputs) is at its best.
    """

    experiment: Experiment
    theta: np.ndarray
    predicted: np.ndarray

    @property
    def speeds(self) -> np.ndarray:
        """The speeds of the runs (R,) [rad/s]."""
        return np.array([fit.speed for fit in self.experiment.fits])

    @cached_property
    def signals(self) -> list[Signal]:
        """Every predicted signal: two axes together where both were measured, nodes one by one."""
        names, signals = self.experiment.predicted, []
        for name in names:
            port, _, inside = name.partition("[")
            index = inside.rstrip("]").split(",") if inside else []
            signal, partner, title = self.experiment.model.signals[port], None, name
            if signal.shape[-1:] == (2,):
                x, y = (f"{name[:-2]}{axis}]" for axis in "12")
                if name == y and x in names:
                    continue
                partner = y if name == x and y in names else None
                title = port + (f", node {index[0]}" if len(index) == 2 else "")
                title += "" if partner else f", {'x' if name == x else 'y'}"
            signals.append(Signal(title, name, partner, signal.unit or ""))
        return signals

    def orders(self, signal: Signal) -> np.ndarray:
        """Return the signed orders of a signal; 0 only where the mean means something."""
        K = self.experiment.motion.K
        mean = self.experiment.use_mean[self.experiment.predicted.index(signal.x)]
        return np.array([k for k in range(-K if signal.y else 0, K + 1) if k or mean])

    def measured(self, r: int, signal: Signal) -> Harmonics:
        """Return what was measured in run r."""
        fit, orders = self.experiment.fits[r], self.orders(signal)
        value = signal.combined(fit.values, fit.names, orders)
        own = fit.covariance - fit.turned @ fit.turned.T
        alone = np.array([_covariance(fit, own, signal, int(k)) for k in orders])
        size = np.abs(value)
        along = np.where(size > 0, value / np.where(size > 0, size, 1.0), 1.0)
        radial, across = np.stack([along.real, along.imag], 1), np.stack([-along.imag, along.real], 1)
        amplitude_std, across_std = (
            np.sqrt(np.maximum(np.einsum("ni,nij,nj->n", u, alone, u), 0)) for u in (radial, across)
        )
        with np.errstate(divide="ignore", invalid="ignore"):  # an error of the angle turns harmonics and no more
            phase_std = np.hypot(across_std / size, orders * fit.angle_std)
        phase_std = np.minimum(np.nan_to_num(phase_std, nan=np.pi, posinf=np.pi), np.pi)
        noise = np.sqrt(-np.log(EXCEEDED) * np.maximum(np.trace(alone, axis1=1, axis2=2), 0))
        return Harmonics(orders, value, amplitude_std, phase_std, noise)

    def prediction(self, r: int, signal: Signal) -> np.ndarray:
        """Return what the diagram says at the orders of `measured`, complex (n,)."""
        return signal.combined(self.predicted[r], self.experiment.predicted, self.orders(signal))

    def residual(self, r: int, signal: Signal) -> np.ndarray:
        """Return the residual of each harmonic of run r in standard deviations of the noise, (n,).

        |R - R_model| / sqrt(trace of the covariance of R); noise alone has a root mean square of 1.
        """
        measured = self.measured(r, signal)
        return np.asarray(np.abs(measured.value - self.prediction(r, signal)) / measured.std)

    def lines(self, r: int, signal: Signal) -> tuple[Harmonics, np.ndarray] | None:
        """Return asynchronous lines at k W + nu of run r, and what the diagram says; None where none were fitted.

        Their places among the orders, k + nu / W: negative ones run backward.
        """
        fit, K = self.experiment.fits[r], self.experiment.motion.K
        if fit.beside is None or self.predicted.shape[1] == K + 1:
            return None
        columns = np.array([fit.names.index(name) for name in signal.names])
        predicted = harmonics_of_time(self.predicted[r][K + 1 :], fit.speed)
        predicted = predicted[:, [self.experiment.predicted.index(name) for name in signal.names]]
        value, model = (_both_whirls(values) for values in (fit.beside.values[:, columns], predicted))
        variance = np.diag(fit.covariance_beside(columns, 0.0)).reshape(len(fit.beside.orders), -1).sum(axis=1)
        at = fit.beside.orders + fit.beside.second / fit.speed
        places, variance = (
            (np.abs(at), 4 * variance) if signal.y is None else (np.append(at, -at), np.tile(variance, 2))
        )
        std, noise = np.sqrt(variance / 2), np.sqrt(-np.log(EXCEEDED) * variance)
        return Harmonics(places, value, std, np.minimum(std / np.maximum(np.abs(value), 1e-300), np.pi), noise), model

    def orbit(self, r: int, signal: Signal, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return measured and predicted motion x + i y that is synchronous to the shaft, at angles (n,)."""
        wave = np.exp(1j * np.outer(theta, self.orders(signal)))
        return wave @ self.measured(r, signal).value, wave @ self.prediction(r, signal)

    def samples(self, r: int, signal: Signal) -> np.ndarray:
        """Return the samples x + i y of run r, (n,); about their mean where that means nothing."""
        x, y = (self.experiment.recording.signal(self.experiment.runs[r].run, name) for name in signal.names)
        values = x + 1j * y
        return np.asarray(values if 0 in self.orders(signal) else values - values.mean())

    @cached_property
    def follows_speed(self) -> np.ndarray:
        """Whether each parameter of the model is given by the speed, (n_p,)."""
        model = self.experiment.model
        return np.asarray(model.parameter_vector({"speed": 1.0}) != model.parameter_vector({"speed": 2.0}))

    @cached_property
    def groups(self) -> dict[str, list[int]]:
        """Runs that differ only in speed, by what is set in them and not in all: 'KP = 12200 A/m, KD = 3 A s/m'."""
        alike: dict[bytes, list[int]] = {}
        for r, p in enumerate(self.experiment.p):
            alike.setdefault(np.where(self.follows_speed, 0.0, p).tobytes(), []).append(r)
        named = {self._settings(runs[0]): runs for runs in alike.values()}
        if len(named) == len(alike):
            return named
        return {f"settings {k + 1}": runs for k, runs in enumerate(alike.values())}

    def _settings(self, r: int) -> str:
        model, p = self.experiment.model, self.experiment.p
        texts = {}
        for name in dict.fromkeys(name for item in self.experiment.runs for name in item.run.settings):
            parts = model.references.get(name) if name in model.diagram.parameters else [model.parameters[name]]
            if not parts or (p[:, parts[0]] == p[0, parts[0]]).all():
                continue
            key = name.rpartition(".")[2]
            values = p[r, parts[0]]
            unit = model.diagram.unit_of_parameter(name)
            texts[name] = key, _quantity(float(values[0]), unit) if len(values) == 1 else str(values.tolist())
        keys = [key for key, _ in texts.values()]
        return ", ".join(f"{key if keys.count(key) == 1 else name} = {v}" for name, (key, v) in texts.items())

    def group_of(self, r: int) -> str:
        """Return the label of the group of run r."""
        return next(label for label, runs in self.groups.items() if r in runs)

    def group_numbers(self) -> np.ndarray:
        """Return the place of the group of each run among the groups, (R,)."""
        labels = list(self.groups)
        return np.array([labels.index(self.group_of(r)) for r in range(len(self.speeds))])

    def title(self, r: int) -> str:
        """Return the speed of run r and what was set."""
        label = self.group_of(r)
        return f"{float(rpm(self.speeds[r])):.0f} rpm" + (f", {label}" if label else "")

    def spread(self, count: int) -> list[int]:
        """Return runs spread over speed and settings, in the order of settings and speed; first the largest motion."""
        speeds, group = self.speeds, self.group_numbers()
        motion = [
            sum(fit.rms[fit.names.index(name)] ** 2 for name in self.signals[0].names) for fit in self.experiment.fits
        ]
        taken = [int(np.argmax(motion))]
        while len(taken) < min(count, len(speeds)):
            apart = np.abs(speeds[:, None] - speeds[taken]) / (float(np.ptp(speeds)) or 1.0)
            nearest = (apart + 0.5 * (group[:, None] != group[taken])).min(axis=1)
            nearest[taken] = -1.0
            taken.append(int(np.argmax(nearest)))
        return sorted(taken, key=lambda r: (group[r], speeds[r]))


@dataclass(frozen=True, eq=False)
class Comparison:
    """Diagrams, the one as given first, beside the same runs.

    of: what the runs are called in titles, "held-out runs"; a second line of it says what to bear in mind.
    """

    diagrams: tuple[tuple[Look, PredictedRuns], ...]
    of: str

    @property
    def runs(self) -> PredictedRuns:
        """The runs beside the last diagram, for what was measured."""
        return self.diagrams[-1][1]

    @cached_property
    def signals(self) -> list[Signal]:
        """One signal of each port: of several nodes the one that the first diagram explains least."""
        by_port: dict[str, list[Signal]] = {}
        for signal in self.runs.signals:
            by_port.setdefault(signal.x.partition("[")[0], []).append(signal)
        return [max(some, key=self._worst) if len(some) > 1 else some[0] for some in by_port.values()]

    def _worst(self, signal: Signal) -> float:
        first = self.diagrams[0][1]
        return max(float(np.nan_to_num(first.residual(r, signal)).max()) for r in range(len(first.speeds)))

    def largest(self, r: int, signal: Signal) -> np.ndarray:
        """Return the largest amplitude at each order that was measured or is predicted in run r, (n,)."""
        every = [self.runs.measured(r, signal).value, *(runs.prediction(r, signal) for _, runs in self.diagrams)]
        return np.asarray(np.nan_to_num(np.abs(every)).max(axis=0))


def predicted_runs(experiment: Experiment, theta: np.ndarray, Y: np.ndarray) -> PredictedRuns:
    """Return runs beside harmonics of time Y (R, K+1, c) that a diagram has in them with parameters theta (m,)."""
    pairs = zip(Y, experiment.fits, strict=True)
    return PredictedRuns(experiment, theta, np.array([harmonics_of_time(y, fit.speed) for y, fit in pairs]))


def _both_whirls(values: np.ndarray) -> np.ndarray:
    """Return amplitudes of lines (L, axes), forward and then backward; of one axis 2 c_k."""
    a, b = values[:, 0], values[:, -1]
    return 2 * a if values.shape[1] == 1 else np.append(a + 1j * b, a.conj() + 1j * b.conj())


def _quantity(value: float, unit: str | None) -> str:
    """Return a setting as it is usually written: 12200 A/m, but 400 um."""
    if unit in (None, "", "1"):
        return f"{value:.6g}"
    return f"{value:.6g} {unit}" if 0.1 <= abs(value) < 1e5 or not value else format_quantity(value, unit, 5)


def _covariance(fit: HarmonicFit, covariance: np.ndarray, signal: Signal, k: int) -> np.ndarray:
    """Return the covariance (2, 2) of real and imaginary part of one harmonic of `Signal.combined`."""
    columns = [fit.names.index(name) for name in signal.names]
    rows = [0] if k == 0 else [2 * abs(k) - 1, 2 * abs(k)]
    places = [row * len(fit.names) + column for column in columns for row in rows]
    change = np.eye(2, len(places))
    if k and signal.y is None:
        change *= 2
    elif k:  # (a_re, a_im, b_re, b_im) -> a + i b, or conj(a) + i conj(b)
        sign = np.sign(k)
        change = np.array([[1.0, 0.0, 0.0, -sign], [0.0, sign, 1.0, 0.0]])
    return np.asarray(change @ covariance[np.ix_(places, places)] @ change.T)
