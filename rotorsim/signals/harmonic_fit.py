"""Harmonics of measured signals about the measured shaft angle, with their covariance.

For windows that are not whole turns and speeds that drift: least squares on cosines and sines of multiples of
the angle, beside a slow drift of the mean. The residual says how uncertain the harmonics are.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import tau

import numpy as np
from scipy.linalg import block_diag

from rotorsim.signals.covariance import complex_values, real_form, real_vector
from rotorsim.signals.harmonic_basis import Basis, check_samples, harmonic_basis
from rotorsim.signals.noise.lines import Line, find_lines
from rotorsim.signals.noise.noise import Noise, noise_of
from rotorsim.signals.noise.whitening import FALSE_ALARM

OWN_PLACE = 0.5  # of the resolution, from which on a steady line has columns of its own: its variance doubles there
NEAR, NEAR_JITTER = 1.5, 4.0  # lines of the spectrum within which something beside a harmonic is not told from it
LOUD = 2.5  # times the noise, for lines of samples that differ in what they tell: those may follow the motion a little
SLACK = 3.0  # times the rms of the curvature of a turn: what it says of the angle is then a quarter of what is known
RESOLUTION = 1e-6  # of a signal's rms: no measuring chain is better, and no settled model either
FIT_ROUNDING = 1e-10  # of a signal's rms: residual of numbers of seven to sixteen digits and of the fit itself


@dataclass(frozen=True, eq=False)
class Samples:
    """The channels of one run beside the shaft angle.

    time [s], theta [rad]: (n,), samples at any instants. signals, units: by name of the channel. weights: of signals
    whose samples (n,) differ in what they tell, the information of each. angle_std: of angle zero [rad]; stamp: of
    the part of it that is late by the same time in all runs [s]. lost: share of the samples that were filled in for
    dropped ones, and tell nothing.
    """

    run: str
    time: np.ndarray
    theta: np.ndarray
    signals: Mapping[str, np.ndarray]
    units: Mapping[str, str] = field(default_factory=dict)
    weights: Mapping[str, np.ndarray] = field(default_factory=dict)
    angle_std: float = 0.0
    stamp: float = 0.0
    lost: float = 0.0


@dataclass(frozen=True, eq=False)
class Beside:
    """Asynchronous lines y = sum over l of 2 Re values[l] e^{i (k_l theta + second t)} of one run.

    second: the asynchronous frequency [rad/s]. orders (L,): k, of either sign. values (L, C). gram (L,): variance of
    the real and of the imaginary part for noise of variance one. told (L,): False where the line is too near to a
    harmonic or to another one.
    """

    second: float
    orders: np.ndarray
    values: np.ndarray
    gram: np.ndarray
    told: np.ndarray


@dataclass(frozen=True, eq=False)
class HarmonicFit:
    """Harmonics of the channels of one run: y_c(t) = sum over k = -K..K of values[|k|, c] e^{i k theta}.

    The coefficient at -k is the conjugate. speed: mean [rad/s]. names: flat names of the channels, (C,).
    orders: 0..K. values: (K+1, C) complex, SI, phase against shaft angle zero; order 0 is the mean over the window.
    rms, residual: (C,), rms of the signal about its mean and of the residual. noise: cross-spectrum of the latter.
    gram: (2K+1, 2K+1), covariance of the real coefficients for noise of variance one, drift marginalised.
    angle_std: standard deviation of angle zero [rad]: it turns harmonic k by k times that. stamp: of the part of it
    that is late by the same time in all runs [s]. lines: asynchronous lines that stand out. drift: (degree, C),
    Legendre coefficients of the slow drift.
    beside: what was fitted at combinations k theta + second t of the shaft with an asynchronous frequency. own: place
    of a channel -> (2K+1, 2K+1), covariance of its coefficients where its samples differ in what they tell.
    pickups: frequency [Hz] -> complex amplitude (C,), 0-peak, of a line that was fitted along, and its variance for
    noise of variance one. hum: order -> (C,) variance of the real and of the imaginary part by a line that is too near.
    """

    run: str
    speed: float
    names: tuple[str, ...]
    units: tuple[str, ...]
    orders: np.ndarray
    values: np.ndarray
    rms: np.ndarray
    residual: np.ndarray
    noise: Noise
    gram: np.ndarray
    angle_std: float
    turns: float
    samples: int
    lines: tuple[Line, ...] = ()
    drift: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    beside: Beside | None = None
    own: Mapping[int, np.ndarray] = field(default_factory=dict)
    pickups: Mapping[float, tuple[np.ndarray, float]] = field(default_factory=dict)
    hum: Mapping[int, np.ndarray] = field(default_factory=dict)
    stamp: float = 0.0

    @cached_property
    def covariance(self) -> np.ndarray:
        """Covariance of `real_vector`, shape (m, m) with m = (2K+1) C: residual scatter and angle spacing."""
        channels = len(self.names)
        values, vectors = np.linalg.eigh(self.gram)
        spread = np.kron((vectors * np.sqrt(np.maximum(values, 0))) @ vectors.T, np.eye(channels))
        blocks = [self.noise.at_order(k) for k in range(len(self.orders))]
        scatter = spread @ block_diag(blocks[0].real, *map(real_form, blocks[1:])) @ spread.T
        for c, own in self.own.items():
            scatter[c::channels] = scatter[:, c::channels] = 0.0
            scatter[c::channels, c::channels] = own
            if self.residual[c] > 0:  # noise that is not white: by order
                powers = [float(block[c, c].real) for block in blocks]
                louder = np.sqrt(np.repeat(powers, [1, *[2] * (len(powers) - 1)])) / self.residual[c]
                scatter[c::channels, c::channels] *= np.outer(louder, louder)
        for k, variance in self.hum.items():
            rows = np.arange(max(2 * k - 1, 0) * channels, (2 * k + 1) * channels)
            scatter[rows, rows] += np.tile(variance, len(rows) // channels)
        return np.asarray(scatter + self.turned @ self.turned.T)

    @cached_property
    def turned(self) -> np.ndarray:
        """What the uncertain angle zero adds to the covariance of `real_vector`: it is turned @ turned.T, (m, 4).

        An error d of the angle turns harmonic k of all channels: c_k (1 - e^{-i k d}) = - sum of (-i k d)^n / n! c_k.
        Columns: the first four terms at the rms of d^n, d uniform with standard deviation s = `angle_std`:
        (sqrt(3) s)^n / sqrt(2 n + 1). The second and the third are above the noise of a good sensor from a degree on.
        Those after the first are taken as independent and SLACK times as large: d alone makes them, so that knowing
        them would make it seem better known than it is, d^2 by (20 / 9) / SLACK^2 of 1 / s^2 at d = s. Harmonics that
        noise makes are not turned: what depends on their noise would be taken off it.
        """
        size = 3**0.5 * self.angle_std * -1j * self.orders[:, None]
        terms = [size**n / math.factorial(n) / (2 * n + 1) ** 0.5 * (SLACK if n > 1 else 1.0) for n in (1, 2, 3, 4)]
        return np.column_stack([real_vector(term * self._told) for term in terms])

    @cached_property
    def _told(self) -> np.ndarray:
        """The harmonics (K+1, C) that noise alone does not make; zero for others."""
        gram = np.diag(self.gram)[np.maximum(2 * self.orders - 1, 0)]
        power = 2 * gram[:, None] * [np.diag(self.noise.at_order(k)).real for k in self.orders]
        return np.where(np.abs(self.values) ** 2 > -math.log(FALSE_ALARM) * power, self.values, 0.0)

    @cached_property
    def stamped(self) -> np.ndarray:
        """What a common delay of all pulses by ``stamp`` changes in the harmonics, (K+1, C): i k W stamp c_k."""
        return np.asarray(1j * self.orders[:, None] * self.speed * self.stamp * self._told)

    def covariance_at(
        self, columns: np.ndarray, orders: Sequence[int], resolution: float, *, stamp: bool = True
    ) -> np.ndarray:
        """Return the covariance (m, m) of the real harmonics of some channels and orders, as `real_vector` has them.

        columns: places of the channels in ``names``. resolution: of the measuring chain, as a share of the rms or the
        mean of a channel, the larger one; it is added to every harmonic as noise of that standard deviation. stamp:
        with what `stamped` adds.
        """
        rows = [row for k in orders for row in ((2 * k - 1, 2 * k) if k else (0,))]
        places = (np.array(rows)[:, None] * len(self.names) + columns).ravel()
        size = np.tile(np.maximum(self.rms[columns], np.abs(self.values[0, columns])), len(rows))
        floor = (resolution * np.where(size > 0, size, 1.0)) ** 2
        covariance = self.covariance[np.ix_(places, places)] + np.diag(floor)
        if not stamp and self.stamp:
            together = real_vector(self.stamped)[places]
            covariance -= np.outer(together, together)
        return np.asarray(covariance)

    def covariance_beside(self, columns: np.ndarray, resolution: float) -> np.ndarray:
        """Return the covariance (2 L c, 2 L c) of real and imaginary parts of the lines `beside`, each on its own."""
        assert self.beside is not None
        floor = np.diag((resolution * np.maximum(self.rms[columns], 1e-300)) ** 2)
        blocks = []
        for order, gram in zip(self.beside.orders, self.beside.gram, strict=True):
            nearest = min(round(abs(order + self.beside.second / self.speed)), int(self.orders[-1]))
            blocks.append(real_form(gram * self.noise.at_order(nearest)[np.ix_(columns, columns)] + floor))
        return np.asarray(block_diag(*blocks))

    def recoloured(self, colour: np.ndarray) -> HarmonicFit:
        """Return the fit with noise of other densities (C, 3), see `rotorsim.signals.noise.colour.density`."""
        return replace(self, noise=self.noise.recoloured(colour, self.turns, int(self.orders[-1])))

    def two_axis(self, x: str, y: str) -> dict[int, complex]:
        """Return the harmonics R_k of x + i y, k = -K..K: forward for k > 0, backward for k < 0."""
        a, b = (self.values[:, self.names.index(name)] for name in (x, y))
        forward = {int(k): complex(a[k] + 1j * b[k]) for k in self.orders}
        return {**{-k: complex(a[k].conj() + 1j * b[k].conj()) for k in forward if k}, **forward}

    def at(self, theta: np.ndarray) -> np.ndarray:
        """Return what the harmonics make up at shaft angles (n,), shape (n, C), without the drift."""
        wave = np.exp(1j * np.outer(theta, self.orders))
        return np.asarray(self.values[0].real + 2 * (wave[:, 1:] @ self.values[1:]).real)


def fit_harmonics(
    samples: Samples,
    *,
    orders: int | None = None,
    basis: Basis | None = None,
    second: tuple[float, np.ndarray] | None = None,
    pickups: Sequence[float] = (),
    hum: Mapping[int, np.ndarray] | None = None,
) -> HarmonicFit:
    """Fit y = drift(t) + sum over |k| <= K of c_k e^{i k theta} to every channel by least squares.

    orders: K; default as many as the window and the sampling carry, at most 16. basis: of an earlier fit at the same
    times and angles, which saves most of the work. Noise is taken as stationary; whether it is white is tested, and
    coloured noise is described by its cross-spectrum. Lines beside the multiples of the speed are found, reported
    and fitted along. second: an asynchronous frequency [rad/s] and orders k whose combinations with the shaft are
    fitted, too. pickups: frequencies [Hz] of lines that are fitted along, but for those too near to an order; hum:
    what those add to the variance of the harmonics, by order, (C,).

    Raises RotorsimError for less than a turn, signals that are not finite, or no room for one harmonic.
    """
    run, time, theta, names = samples.run, samples.time, samples.theta, tuple(samples.signals)
    y = np.column_stack(list(samples.signals.values()))
    check_samples(run, names, y, theta)
    if basis is None:
        basis = harmonic_basis(run, time, theta, orders=orders)
    K, turns, duration = basis.orders, basis.turns, float(time[-1] - time[0])
    speed = float(theta[-1] - theta[0]) / duration
    m = 2 * K + 1
    first = m + basis.drift
    told = np.zeros(0, bool)
    if second is not None:
        told = _resolved(second, speed, K, duration, pickups)
        basis = basis.with_waves(int(k) * theta + second[0] * time for k in second[1][told])
    harmonics = np.abs(speed) / tau * np.arange(K + 1)
    steady = [at for at in pickups if np.abs(at - harmonics).min() * duration >= OWN_PLACE]
    basis = basis.with_lines(time, steady)
    coefficients, left = basis.solve(y)
    mean, rms, scale = y.mean(axis=0), y.std(axis=0), np.sqrt(np.mean(y**2, axis=0))
    reach = NEAR_JITTER if samples.angle_std > 0 else NEAR  # an error of the speed spreads a harmonic to its sides
    least = FIT_ROUNDING * (rms + np.abs(mean))
    for c in map(names.index, samples.weights):
        least[c] = LOUD * np.sqrt(np.mean(left[:, c] ** 2))
    lines = find_lines(time, left, speed, K, least, reach, basis.kept)
    if lines:
        basis = basis.with_lines(time, (line.frequency for line in lines))
        coefficients, left = basis.solve(y)
    floor = FIT_ROUNDING * np.where(scale > 0, scale, 1.0)
    noise = noise_of(left, time, speed, K, len(y) - basis.columns.shape[1], floor, lines, basis.kept)
    waves = coefficients[first::2] + 1j * coefficients[first + 1 :: 2]
    variances = np.diag(basis.inverse)[first:].reshape(-1, 2)
    count = int(told.sum())
    beside = None
    if second is not None:
        values, gram = np.zeros((len(told), len(names)), complex), np.ones(len(told))
        values[told], gram[told] = waves[:count], variances[:count].mean(axis=1)
        beside = Beside(*second, values, gram, told)
    return HarmonicFit(
        run=run,
        speed=speed,
        names=names,
        units=tuple(samples.units.get(name, "") for name in names),
        orders=np.arange(K + 1),
        values=complex_values(coefficients[:m].ravel(), len(names)),
        rms=rms,
        residual=np.sqrt(np.mean(left**2, axis=0)),
        noise=noise,
        gram=basis.inverse[:m, :m] / (1 - samples.lost),
        angle_std=samples.angle_std,
        turns=turns,
        samples=len(y),
        lines=tuple(lines),
        drift=coefficients[m:first],
        beside=beside,
        own={names.index(name): basis.covariance(w)[:m, :m] for name, w in samples.weights.items()},
        pickups={at: (2 * waves[k], 4 * float(variances[k].sum())) for k, at in enumerate(steady, count)},
        hum=hum or {},
        stamp=samples.stamp,
    )


def _resolved(
    second: tuple[float, np.ndarray], speed: float, K: int, duration: float, pickups: Sequence[float]
) -> np.ndarray:
    """Return which combinations of an asynchronous frequency are apart from harmonics, zero, each other, pick-up."""
    at = np.abs(second[1] * speed + second[0]) / tau
    others = np.concatenate([np.abs(speed) / tau * np.arange(K + 1), pickups])
    away = np.abs(at[:, None] - others).min(axis=1)
    pairs = np.abs(at[:, None] - at) + 1e9 * np.eye(len(at))
    return np.asarray((away > NEAR / duration) & (pairs.min(axis=1, initial=np.inf) > NEAR / duration))
