"""An identified model beside what was measured: harmonics of both with their uncertainty, run by run and over speed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rotorsim.identification.experiment import Experiment, open_experiment
from rotorsim.identification.identification import Identification
from rotorsim.identification.likelihood import Likelihood
from rotorsim.identification.whitening import harmonics_of_time
from rotorsim.jobs.threads import one_thread
from rotorsim.recordings.recording import Recording
from rotorsim.report.style import ROUNDING, rpm
from rotorsim.signals.harmonic_fit import HarmonicFit
from rotorsim.units import format_quantity

__all__ = ["Comparison", "Harmonics", "Signal", "compare"]

EXCEEDED = 0.05  # share of harmonics of noise alone that are above the noise level
SPEEDS, STEP, REFINEMENTS = 121, 0.2, 4  # of a curve over speed: first points; change between two that is refined
UNSEEN = 0.1  # of the noise of the best run: a line at its tenth adds 0.5 % to what is measured
AGREES = 0.05  # of the largest order: how far a curve over speed may be from the motion in a run
BATCH = 64  # speeds solved at a time


@dataclass(frozen=True)
class Signal:
    """A measured signal: two axes x + i y, or one (``y`` is None); x and y are flat names."""

    title: str
    x: str
    y: str | None
    unit: str

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


@dataclass(frozen=True, eq=False)
class Comparison:
    """Runs of a recording beside the identified model.

    theta (m,): the identified values of experiment.free. predicted (R, K+1, c): harmonics of the model about the
    shaft angle; what the model leaves open (means of slow states, true values of measured inputs) is at its best.
    """

    found: Identification
    recording: Recording
    experiment: Experiment
    theta: np.ndarray
    predicted: np.ndarray

    @cached_property
    def every(self) -> list[Signal]:
        """Every predicted signal: two axes together where both were measured, nodes one by one."""
        names, found = self.experiment.predicted, []
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
            found.append(Signal(title, name, partner, signal.unit or ""))
        return found

    @cached_property
    def signals(self) -> list[Signal]:
        """One signal of each predicted port: of several nodes the one that moves most."""
        by_port: dict[str, list[Signal]] = {}
        for signal in self.every:
            by_port.setdefault(signal.x.partition("[")[0], []).append(signal)
        return [max(some, key=self._motion) for some in by_port.values()]

    def _motion(self, signal: Signal) -> float:
        """Return the mean square of a signal about its mean, over all runs."""
        columns = [name for name in (signal.x, signal.y) if name is not None]
        return float(sum(fit.rms[fit.names.index(name)] ** 2 for fit in self.experiment.fits for name in columns))

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

    def model(self, r: int, signal: Signal) -> np.ndarray:
        """Return what the model says at the orders of `measured`, complex (n,)."""
        return signal.combined(self.predicted[r], self.experiment.predicted, self.orders(signal))

    def lines(self, r: int, signal: Signal) -> tuple[Harmonics, np.ndarray] | None:
        """Return lines at k W + nu beside the harmonics of run r, and what the model says; None where none were fitted.

        Their places among the orders, k + nu / W: negative ones run backward.
        """
        fit, K = self.experiment.fits[r], self.experiment.motion.K
        if fit.beside is None or self.predicted.shape[1] == K + 1:
            return None
        names = [name for name in (signal.x, signal.y) if name is not None]
        columns = np.array([fit.names.index(name) for name in names])
        predicted = self.predicted[r][K + 1 :]
        predicted = predicted if fit.speed > 0 else predicted.conj()
        predicted = predicted[:, [self.experiment.predicted.index(name) for name in names]]
        covariance = fit.covariance_beside(columns, 0.0)
        variance = np.diag(covariance).reshape(len(fit.beside.orders), -1).sum(axis=1)
        at = fit.beside.orders + fit.beside.second / fit.speed
        if signal.y is None:
            places, values, model = np.abs(at), 2 * fit.beside.values[:, columns[0]], 2 * predicted[:, 0]
            variance = 4 * variance
        else:
            places = np.concatenate([at, -at])
            values, model = (
                np.concatenate([v[:, 0] + 1j * v[:, 1], v[:, 0].conj() + 1j * v[:, 1].conj()])
                for v in (fit.beside.values[:, columns], predicted)
            )
            variance = np.tile(variance, 2)
        size = np.maximum(np.abs(values), 1e-300)
        std, noise = np.sqrt(variance / 2), np.sqrt(-np.log(EXCEEDED) * variance)
        return Harmonics(places, values, std, np.minimum(std / size, np.pi), noise), model

    def orbit(self, r: int, signal: Signal, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return measured and predicted motion x + i y that is synchronous to the shaft, at angles (n,)."""
        wave = np.exp(1j * np.outer(theta, self.orders(signal)))
        return wave @ self.measured(r, signal).value, wave @ self.model(r, signal)

    def raw(self, r: int, signal: Signal) -> np.ndarray:
        """Return the samples x + i y of run r, (n,); about their mean where that means nothing."""
        x, y = (self.recording.signal(self.experiment.runs[r].run, name) for name in (signal.x, signal.y or ""))
        values = x + 1j * y
        return np.asarray(values if 0 in self.orders(signal) else values - values.mean())

    @cached_property
    def _follows_speed(self) -> np.ndarray:
        model = self.experiment.model
        return np.asarray(model.parameter_vector({"speed": 1.0}) != model.parameter_vector({"speed": 2.0}))

    @cached_property
    def groups(self) -> dict[str, list[int]]:
        """Runs that differ only in speed, by what is set in them and not in all: 'KP = 12200 A/m, KD = 3 A s/m'."""
        found: dict[bytes, list[int]] = {}
        for r, p in enumerate(self.experiment.p):
            found.setdefault(np.where(self._follows_speed, 0.0, p).tobytes(), []).append(r)
        named = {self._settings(runs[0]): runs for runs in found.values()}
        if len(named) == len(found):
            return named
        return {f"settings {k + 1}": runs for k, runs in enumerate(found.values())}

    def _settings(self, r: int) -> str:
        model, p = self.experiment.model, self.experiment.p
        texts = {}
        for name in dict.fromkeys(name for item in self.experiment.runs for name in item.run.settings):
            parts = model.references.get(name) if name in model.diagram.parameters else [model.parameters[name]]
            if not parts or (p[:, parts[0]] == p[0, parts[0]]).all():
                continue
            block, _, key = name.rpartition(".")
            unit = (
                model.diagram.nodes[block].block.parameters[key].unit if block else model.diagram.parameter_units[name]
            )
            values = p[r, parts[0]]
            given = _quantity(float(values[0]), unit) if len(values) == 1 else str(values.tolist())
            texts[name] = (key, given)
        keys = [key for key, _ in texts.values()]
        return ", ".join(f"{key if keys.count(key) == 1 else name} = {v}" for name, (key, v) in texts.items())

    def group_of(self, r: int) -> str:
        """Return the label of the group of run r."""
        return next(label for label, runs in self.groups.items() if r in runs)

    def title(self, r: int) -> str:
        """Return the speed of run r and what was set."""
        label = self.group_of(r)
        return f"{float(rpm(self.experiment.fits[r].speed)):.0f} rpm" + (f", {label}" if label else "")

    def chosen(self, count: int = 4) -> list[int]:
        """Return runs spread over speed and settings, in the order of settings and speed."""
        speeds = np.array([fit.speed for fit in self.experiment.fits])
        labels = list(self.groups)
        group = np.array([labels.index(self.group_of(r)) for r in range(len(speeds))])
        span = float(np.ptp(speeds)) or 1.0
        taken = [int(np.argmax([self._motion_of(r) for r in range(len(speeds))]))]
        while len(taken) < min(count, len(speeds)):
            apart = np.abs(speeds[:, None] - speeds[taken]) / span + 0.5 * (group[:, None] != group[taken])
            nearest = apart.min(axis=1)
            nearest[taken] = -1.0
            taken.append(int(np.argmax(nearest)))
        return sorted(taken, key=lambda r: (group[r], speeds[r]))

    def _motion_of(self, r: int) -> float:
        fit, signal = self.experiment.fits[r], self.signals[0]
        return float(sum(fit.rms[fit.names.index(name)] ** 2 for name in (signal.x, signal.y) if name is not None))

    def curve(self, group: str, signal: Signal, orders: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return ascending speeds (n,) [rad/s] over the range of all runs, and the model's harmonics (n, orders) there.

        nan where the model is not stable and so never settles, and where it is rounding or far below the noise. Empty
        when the model needs measured inputs: between the runs nobody knows them; and where the motion that it settles
        to over speed is not the one that it has in the runs (a nonlinear model may have several).
        """
        runs = self.groups[group]
        all_speeds = np.array([fit.speed for fit in self.experiment.fits])
        side = all_speeds[np.sign(all_speeds) == np.sign(all_speeds[runs[0]])]
        if self.experiment.given or np.ptp(side) == 0:
            return np.zeros(0), np.zeros((0, len(orders)), complex)
        margin = 0.03 * np.ptp(side)
        low, high = np.abs(side).min() - margin, np.abs(side).max() + margin
        grid = np.linspace(max(low, 0.5 * np.abs(side).min()), high, SPEEDS) * np.sign(side[0])
        own = [r for r in runs if all_speeds[r] in side]
        speeds = np.unique(np.concatenate([grid, all_speeds[own]]))
        with one_thread():  # many small matrices
            values = self._at(runs[0], speeds, signal, orders)
            for _ in range(REFINEMENTS):
                size = np.maximum(np.abs(values), 1e-3 * np.nan_to_num(np.abs(values)).max(axis=0) + 1e-300)
                change = (np.abs(np.diff(values, axis=0)) / np.minimum(size[1:], size[:-1])).max(axis=1)
                where = np.flatnonzero(change > STEP)
                if not len(where):
                    break
                between = (speeds[where] + speeds[where + 1]) / 2
                values = np.insert(values, where + 1, self._at(runs[0], between, signal, orders), axis=0)
                speeds = np.insert(speeds, where + 1, between)
        if not self._passes(own, signal, orders, speeds, values):
            return np.zeros(0), np.zeros((0, len(orders)), complex)
        return speeds, np.where(np.abs(values) > self._least(signal, values), values, np.nan)

    def _least(self, signal: Signal, values: np.ndarray) -> float:
        """Return the amplitude below which a curve says nothing: of rounding, or far below the noise of every run."""
        noise = min(float(self.measured(r, signal).noise.min()) for r in range(len(self.experiment.runs)))
        return max(ROUNDING * float(np.nanmax(np.abs(values), initial=0.0)), UNSEEN * noise)

    def _passes(
        self, runs: Sequence[int], signal: Signal, orders: np.ndarray, speeds: np.ndarray, values: np.ndarray
    ) -> bool:
        """Return whether a curve over speed goes through the motion that the model has in some runs."""
        every = self.orders(signal).tolist()
        for r in runs:
            there = np.array([self.model(r, signal)[every.index(int(k))] for k in orders])
            curve = values[int(np.argmin(np.abs(speeds - self.experiment.fits[r].speed)))]
            apart = np.abs(curve - there)[orders != 0]  # means may not have settled
            if np.isfinite(apart).all() and (apart > AGREES * np.abs(there[orders != 0]).max(initial=0.0)).any():
                return False
        return True

    def _at(self, r: int, speeds: np.ndarray, signal: Signal, orders: np.ndarray) -> np.ndarray:
        experiment, K = self.experiment, int(np.abs(orders).max())
        found = []
        for some in np.array_split(speeds, -(-len(speeds) // BATCH)):
            p = np.repeat(experiment.p[r][None], len(some), axis=0)
            for k, speed in enumerate(some):
                moved = experiment.model.parameter_vector({"speed": speed})
                p[k, self._follows_speed] = moved[self._follows_speed]
            base = experiment.motion
            beside = None if base.beside is None else base.beside.at(some)
            motion = replace(
                base,
                p=p,
                speeds=some,
                K=K if beside is None else beside.K,  # of forces that do not follow the shaft alone, all at once
                windows=np.full(len(some), base.windows[r]),
                phase=np.full(len(some), base.phase[r]),
                beside=beside,
            )
            group = np.array(self.groups[self.group_of(r)])
            own = np.array([experiment.fits[k].speed for k in group])
            motion.begin_from(base, group[np.argmin(np.abs(own[:, None] - some), axis=0)], self.theta)
            Y = harmonics_of_time(motion.predict(self.theta).Y[:, : K + 1], some[0])
            linear = motion.linear()
            if linear is not None:
                A = linear.response(self.theta, 0, forced=False).A
                Y[np.linalg.eigvals(A).real.max(axis=1) > 1e-6 * np.abs(A).max() ** 0.5] = np.nan
            found.append(signal.combined(Y, experiment.predicted, orders))
        return np.concatenate(found)

    @property
    def has_slow_states(self) -> bool:
        """Whether a mean of some run is free, because a mode had no time to settle."""
        return any(len(slow) for slow in self.experiment.linear.slow or [])


def compare(found: Identification, recording: Recording) -> Comparison:
    """Return an identification beside the recording that it was made from."""
    experiment = open_experiment(
        found.diagram,
        recording,
        runs=[item.run for item in found.runs],
        given=found.settings.get("given", ()),
        free=found.free,
        harmonics=found.runs,
    )
    theta = np.array([found.parameters[item.name].value for item in experiment.free])
    with one_thread():
        Y = Likelihood(experiment).evaluate(theta).Y
    predicted = np.array([harmonics_of_time(y, fit.speed) for y, fit in zip(Y, experiment.fits, strict=True)])
    return Comparison(found, recording, experiment, theta, predicted)


def _quantity(value: float, unit: str | None) -> str:
    """Return a setting as it is usually written: 12200 A/m, but 400 um."""
    if unit in (None, "", "1"):
        return f"{value:.6g}"
    return f"{value:.6g} {unit}" if 0.1 <= abs(value) < 1e5 or not value else format_quantity(value, unit, 5)


def _covariance(fit: HarmonicFit, covariance: np.ndarray, signal: Signal, k: int) -> np.ndarray:
    """Return the covariance (2, 2) of real and imaginary part of one harmonic of `Signal.combined`."""
    total = len(fit.names)
    columns = [fit.names.index(name) for name in (signal.x, signal.y) if name is not None]
    rows = [0] if k == 0 else [2 * abs(k) - 1, 2 * abs(k)]
    places = [row * total + column for column in columns for row in rows]
    change = np.zeros((2, len(places)))
    if k == 0:
        change[: len(columns), : len(columns)] = np.eye(len(columns))
    elif signal.y is None:
        change = 2 * np.eye(2)
    else:  # (a_re, a_im, b_re, b_im) -> a + i b, or conj(a) + i conj(b)
        sign = np.sign(k)
        change = np.array([[1.0, 0.0, 0.0, -sign], [0.0, sign, 1.0, 0.0]])
    return np.asarray(change @ covariance[np.ix_(places, places)] @ change.T)
