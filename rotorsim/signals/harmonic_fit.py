"""Harmonics of measured signals about the measured shaft angle, with their covariance.

For windows that are not whole turns and speeds that drift: least squares on cosines and sines of multiples of
the angle, beside a slow drift of the mean. What is left over says how uncertain the harmonics are.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from rotorsim.errors import Problem, RotorsimError
from rotorsim.signals.noise import Line, Noise, find_lines, noise_of

__all__ = [
    "Basis",
    "Beside",
    "HarmonicFit",
    "check_samples",
    "complex_values",
    "fit_harmonics",
    "harmonic_basis",
    "line_columns",
    "real_columns",
    "real_vector",
    "scaled_cholesky",
    "with_lines",
]

TURN = 2 * np.pi
MOST_ORDERS = 16
DRIFT = 2  # degree of the drift of the mean
APART = 0.5  # of the resolution, from which on a steady line has columns of its own: its variance doubles there
NEAR, NEAR_JITTER = 1.5, 4.0  # lines of the spectrum within which something beside a harmonic is not told from it
LOUD = 2.5  # times the noise, for lines of samples that differ in what they tell: those may follow the motion a little
LEAST_TOLD = 1e-6  # of the best known combination of coefficients: information of one that samples tell nothing of
SLACK = 3.0  # times the rms of the curvature of a turn: what it says of the angle is then a quarter of what is known
TURNS = 1e-3  # probability of a harmonic as large by noise alone, below which it is turned by an error of the angle
ROUNDING = 1e-10  # of a signal's rms: what numbers of seven to sixteen digits and the fit itself leave over


@dataclass(frozen=True, eq=False)
class Beside:
    """Lines y = sum over l of 2 Re values[l] e^{i (k_l theta + second t)} beside the harmonics of one run.

    second [rad/s]. orders (L,): k, of either sign. values (L, C). gram (L,): variance of the real and of the imaginary
    part for noise of variance one. told (L,): False where the line is too near to a harmonic or to another one.
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
    rms, residual: (C,) of the signal about its mean, and of what the fit leaves over. noise: cross-spectrum of the
    latter. gram: (2K+1, 2K+1), covariance of the real coefficients for noise of variance one, drift marginalised.
    angle_std: standard deviation of angle zero [rad]: it turns harmonic k by k times that. stamp: of the part of it
    that is late by the same time in all runs [s].
    lines: lines that do not follow the shaft. drift: (degree, C) Legendre coefficients of the slow drift.
    beside: what was fitted at combinations k theta + second t of the shaft with a second frequency. own: place of a
    channel -> (2K+1, 2K+1), covariance of its coefficients where its samples differ in what they tell.
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
        root = (vectors * np.sqrt(np.maximum(values, 0))) @ vectors.T
        m = len(root) * channels
        middle = np.zeros((m, m))
        for k in range(len(self.orders)):
            block = self.noise.at_order(k)
            if k == 0:
                middle[:channels, :channels] = block.real
                continue
            at = (2 * k - 1) * channels
            real, imag = slice(at, at + channels), slice(at + channels, at + 2 * channels)
            middle[real, real] = middle[imag, imag] = block.real
            middle[imag, real], middle[real, imag] = block.imag, -block.imag
        spread = np.kron(root, np.eye(channels))
        scatter = spread @ middle @ spread.T
        for c, own in self.own.items():
            scatter[c::channels] = scatter[:, c::channels] = 0.0
            scatter[c::channels, c::channels] = own
            if self.residual[c] > 0:  # noise that is not white: by order
                powers = [float(self.noise.at_order(k)[c, c].real) for k in range(len(self.orders))]
                louder = np.sqrt(np.repeat(powers, [1, *[2] * (len(powers) - 1)])) / self.residual[c]
                scatter[c::channels, c::channels] *= np.outer(louder, louder)
        for k, variance in self.hum.items():
            rows = np.arange(max(2 * k - 1, 0) * channels, (2 * k + 1) * channels)
            scatter[rows, rows] += np.tile(variance, len(rows) // channels)
        turned = self.turned
        return np.asarray(scatter + turned @ turned.T)

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
        power = [
            2 * self.gram[max(2 * k - 1, 0), max(2 * k - 1, 0)] * np.diag(self.noise.at_order(k)).real
            for k in range(len(self.orders))
        ]
        return np.where(np.abs(self.values) ** 2 > -math.log(TURNS) * np.array(power), self.values, 0.0)

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
        found = self.covariance[np.ix_(places, places)] + np.diag(floor)
        if not stamp and self.stamp:
            together = real_vector(self.stamped)[places]
            found = found - np.outer(together, together)
        return np.asarray(found)

    def covariance_beside(self, columns: np.ndarray, resolution: float) -> np.ndarray:
        """Return the covariance (2 L c, 2 L c) of real and imaginary parts of the lines `beside`, each on its own."""
        beside = self.beside
        assert beside is not None
        width = len(columns)
        out = np.zeros((2 * len(beside.orders) * width,) * 2)
        for k, (order, gram) in enumerate(zip(beside.orders, beside.gram, strict=True)):
            nearest = min(round(abs(order + beside.second / self.speed)), int(self.orders[-1]))
            block = gram * self.noise.at_order(nearest)[np.ix_(columns, columns)]
            block = block + np.diag((resolution * np.maximum(self.rms[columns], 1e-300)) ** 2)
            at = 2 * k * width
            real, imag = slice(at, at + width), slice(at + width, at + 2 * width)
            out[real, real] = out[imag, imag] = block.real
            out[imag, real], out[real, imag] = block.imag, -block.imag
        return out

    def real_vector(self, values: np.ndarray | None = None) -> np.ndarray:
        """Return harmonics (..., K+1, C) as real numbers (..., m): order 0, then real and imaginary part per order."""
        c = self.values if values is None else values
        return real_vector(c)

    @cached_property
    def std(self) -> np.ndarray:
        """Standard deviation of the real and imaginary part of each harmonic, complex (K+1, C)."""
        return complex_values(np.sqrt(np.maximum(np.diag(self.covariance), 0)), len(self.names))

    def two_axis(self, x: str, y: str) -> dict[int, complex]:
        """Return the harmonics R_k of x + i y, k = -K..K: forward for k > 0, backward for k < 0."""
        a, b = (self.values[:, self.names.index(name)] for name in (x, y))
        forward = {int(k): complex(a[k] + 1j * b[k]) for k in self.orders}
        return {**{-k: complex(a[k].conj() + 1j * b[k].conj()) for k in forward if k}, **forward}

    def at(self, theta: np.ndarray) -> np.ndarray:
        """Return what the harmonics make up at shaft angles (n,), shape (n, C), without the drift."""
        wave = np.exp(1j * np.outer(theta, self.orders))
        return np.asarray(self.values[0].real + 2 * (wave[:, 1:] @ self.values[1:]).real)


def real_vector(values: np.ndarray) -> np.ndarray:
    """Return harmonics (..., K+1, C) as real numbers (..., (2K+1) C): order 0, then real, imaginary per order."""
    return real_columns(values[..., None])[..., 0]


def real_columns(values: np.ndarray) -> np.ndarray:
    """Return harmonics (..., K+1, C, j) as real columns (..., (2K+1) C, j); see `real_vector`."""
    *lead, orders, channels, count = values.shape
    out = np.empty((*lead, 2 * orders - 1, channels, count))
    out[..., 0, :, :] = values[..., 0, :, :].real
    out[..., 1::2, :, :] = values[..., 1:, :, :].real
    out[..., 2::2, :, :] = values[..., 1:, :, :].imag
    return out.reshape(*lead, -1, count)


def complex_values(vector: np.ndarray, channels: int) -> np.ndarray:
    """Return the harmonics (K+1, C) that a real vector holds."""
    rows = vector.reshape(-1, channels)
    return np.concatenate([rows[:1] + 0j, rows[1::2] + 1j * rows[2::2]])


def scaled_cholesky(covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return standard deviations s (m,) and the lower factor L (m, m) of a covariance diag(s) L L^T diag(s)."""
    scale = np.sqrt(np.diag(covariance))
    return scale, np.linalg.cholesky(covariance / np.outer(scale, scale))


class Basis:
    """Columns (n, m) of a harmonic fit with the factor of their normal matrix: the same for all signals of a run.

    orders: K. drift: degree of the drift. Raises RotorsimError when the columns cannot be told apart.
    """

    def __init__(self, run: str, columns: np.ndarray, orders: int, drift: int, turns: float) -> None:
        self.columns, self.orders, self.drift, self.turns = columns, orders, drift, turns
        self._size = np.sqrt(np.einsum("ij,ij->j", columns, columns))
        self._scaled = columns / self._size
        try:
            self._factor = cho_factor(self._scaled.T @ self._scaled, lower=True)
            if np.diag(self._factor[0]).min() < 1e-5:
                raise np.linalg.LinAlgError
        except np.linalg.LinAlgError:
            what = f"{columns.shape[1]} harmonics and drifts cannot be told apart in {turns:.3g} turns"
            raise RotorsimError(Problem(what, f"run {run}", hint="a longer run, or fewer orders")) from None

    def solve(self, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the least-squares coefficients (m, C) of signals (n, C), and what is left over (n, C)."""
        coefficients = cho_solve(self._factor, self._scaled.T @ y)
        coefficients += cho_solve(self._factor, self._scaled.T @ (y - self._scaled @ coefficients))  # to rounding
        coefficients /= self._size[:, None]
        return coefficients, y - self.columns @ coefficients

    @cached_property
    def inverse(self) -> np.ndarray:
        """Inverse of the normal matrix (m, m) (of scaled columns: well conditioned)."""
        root = solve_triangular(self._factor[0], np.diag(1 / self._size), lower=True)
        return np.asarray(root.T @ root)

    @cached_property
    def kept(self) -> np.ndarray:
        """Share of white noise that the fit leaves of each line of the spectrum, (n // 2 + 1,)."""
        base = solve_triangular(self._factor[0], self._scaled.T, lower=True)
        taken = (np.abs(np.fft.rfft(base, axis=1)) ** 2).sum(axis=0) / base.shape[1]
        return np.asarray(np.maximum(1 - taken, 0.0))

    def covariance(self, weights: np.ndarray) -> np.ndarray:
        """Return the covariance (m, m) of the coefficients where each sample (n,) has an information of its own."""
        normal = self._scaled.T @ (self._scaled * weights[:, None])
        values, vectors = np.linalg.eigh(normal)
        kept = np.maximum(values, LEAST_TOLD * values[-1])
        return np.asarray((vectors / kept) @ vectors.T / np.outer(self._size, self._size))


def harmonic_basis(run: str, time: np.ndarray, theta: np.ndarray, *, orders: int | None = None) -> Basis:
    """Return the columns of a harmonic fit at times and shaft angles (n,), for `fit_harmonics`.

    orders: highest order K; default as many as the window and the sampling can tell apart, at most 16.
    """
    n = len(theta)
    turns = float(abs(theta[-1] - theta[0]) / TURN) * n / max(n - 1, 1)
    K = _orders(run, orders, n, turns)
    drift = DRIFT if turns >= 1.5 else 0
    return Basis(run, _columns(theta, time, K, drift), K, drift, turns)


def fit_harmonics(
    run: str,
    time: np.ndarray,
    theta: np.ndarray,
    signals: Mapping[str, np.ndarray],
    units: Mapping[str, str] | None = None,
    *,
    orders: int | None = None,
    angle_std: float = 0.0,
    stamp: float = 0.0,
    basis: Basis | None = None,
    second: tuple[float, np.ndarray] | None = None,
    weights: Mapping[str, np.ndarray] | None = None,
    lost: float = 0.0,
    pickups: Sequence[float] = (),
    hum: Mapping[int, np.ndarray] | None = None,
) -> HarmonicFit:
    """Fit y = drift(t) + sum over |k| <= K of c_k e^{i k theta} to every channel by least squares.

    time, theta: (n,), samples at any instants. orders: K; default as many as the window and the sampling can tell
    apart, at most 16. angle_std: of angle zero [rad]; stamp: see `HarmonicFit`. basis: of an earlier fit at the same
    times and angles, which saves most of the work. Noise is taken as stationary; whether it is white is tested, and
    coloured noise is described by its cross-spectrum. Lines beside the multiples of the speed are found, reported
    and fitted along. second: a frequency [rad/s] and orders k whose combinations with the shaft are fitted, too.
    weights: of signals whose samples (n,) differ in what they tell, the information of each. lost: share of the
    samples that were put in for lost ones, and tell nothing. pickups: frequencies [Hz] of lines that are fitted along,
    but for those too near to an order; hum: what those add to the variance of the harmonics, by order, (C,).

    Raises RotorsimError for less than a turn, signals that are not finite, or no room for one harmonic.
    """
    names = tuple(signals)
    y = np.column_stack([signals[name] for name in names])
    n = len(y)
    check_samples(run, names, y, theta)
    if basis is None:
        basis = harmonic_basis(run, time, theta, orders=orders)
    turns, K, drift = basis.turns, basis.orders, basis.drift
    speed = float((theta[-1] - theta[0]) / (time[-1] - time[0]))
    told = np.zeros(0, bool)
    if second is not None:
        told = _told_apart(second, speed, K, float(time[-1] - time[0]), pickups)
        beside = [_combination(theta, time, int(k), second[0]) for k in second[1][told]]
        basis = Basis(run, np.column_stack([basis.columns, *beside]), K, drift, turns) if beside else basis
    steady = [at for at in pickups if _is_apart(at, speed, K, float(time[-1] - time[0]))]
    if steady:
        basis = with_lines(basis, run, time, steady)
    coefficients, left = basis.solve(y)
    rms = np.sqrt(np.mean((y - y.mean(axis=0)) ** 2, axis=0))
    reach = NEAR_JITTER if angle_std > 0 else NEAR  # an error of the speed spreads a harmonic to its sides
    least = ROUNDING * (rms + np.abs(y.mean(axis=0)))
    for c in (names.index(name) for name in weights or {}):
        least[c] = LOUD * np.sqrt(np.mean(left[:, c] ** 2))
    lines = find_lines(time, left, speed, K, least, reach, basis.kept)
    if lines:
        basis = with_lines(basis, run, time, [line.frequency for line in lines])
        coefficients, left = basis.solve(y)
    m = 2 * K + 1
    scale = np.sqrt(np.mean(y**2, axis=0))
    floor = ROUNDING * np.where(scale > 0, scale, 1.0)
    noise = noise_of(left, time, speed, K, n - basis.columns.shape[1], floor, lines, basis.kept)
    known = units or {}
    first = m + drift
    at = first + 2 * int(told.sum())
    picked = {
        frequency: (
            coefficients[at + 2 * k] - 1j * coefficients[at + 2 * k + 1],
            float(np.diag(basis.inverse)[at + 2 * k : at + 2 * k + 2].sum()),
        )
        for k, frequency in enumerate(steady)
    }
    combined = None if second is None else _beside(second, told, coefficients[first:], basis.inverse[first:, first:])
    return HarmonicFit(
        run=run,
        speed=speed,
        names=names,
        units=tuple(known.get(name, "") for name in names),
        orders=np.arange(K + 1),
        values=complex_values(coefficients[:m].ravel(), len(names)),
        rms=rms,
        residual=np.sqrt(np.mean(left**2, axis=0)),
        noise=noise,
        gram=basis.inverse[:m, :m] / (1 - lost),
        angle_std=angle_std,
        turns=turns,
        samples=n,
        lines=tuple(lines),
        drift=coefficients[m : m + drift],
        beside=combined,
        own={names.index(name): basis.covariance(w)[:m, :m] for name, w in (weights or {}).items()},
        pickups=picked,
        hum=hum or {},
        stamp=stamp,
    )


def check_samples(run: str, names: Sequence[str], y: np.ndarray, theta: np.ndarray) -> None:
    """Raise RotorsimError for samples (n, C) that are too few, or not finite, or less than a turn of the shaft."""
    if len(theta) < 4:
        raise RotorsimError(
            Problem(f"only {len(theta)} samples", f"run {run}", hint="harmonics need a turn of the shaft")
        )
    problems = []
    for k, name in enumerate(names):
        bad = np.flatnonzero(~np.isfinite(y[:, k]))
        if len(bad):
            count = "1 sample is" if len(bad) == 1 else f"{len(bad)} samples are"
            what = f"{count} not finite, first at sample {bad[0] + 1}"
            problems.append(Problem(what, f"run {run}: {name}"))
    turned = abs(float(theta[-1] - theta[0])) / TURN if len(theta) > 1 else 0.0
    if not turned >= 1 - 1e-6 * max(turned, 1) - 2 / len(theta):
        what = f"only {turned:.3g} turns of the shaft were recorded"
        problems.append(Problem(what, f"run {run}", hint="harmonics need at least one turn"))
    if problems:
        raise RotorsimError(*problems)


def _orders(run: str, wanted: int | None, n: int, turns: float) -> int:
    """Return the highest order that n samples over these turns can carry, at most what is wanted."""
    room = min(int(0.45 * n / turns), (n - DRIFT - 8) // 4)
    if room < 1:
        what = f"{n} samples over {turns:.3g} turns cannot carry a harmonic"
        raise RotorsimError(Problem(what, f"run {run}", hint="sample more often"))
    if wanted is not None and wanted > room:
        what = f"order {wanted} cannot be told from {n} samples over {turns:.3g} turns; at most {room}"
        raise RotorsimError(Problem(what, f"run {run}", hint="fewer orders, or sample more often"))
    return min(room, MOST_ORDERS) if wanted is None else wanted


def _columns(theta: np.ndarray, time: np.ndarray, K: int, drift: int) -> np.ndarray:
    """Return the columns 1, 2 cos k theta, -2 sin k theta, and Legendre polynomials of time, (n, 2K+1+drift)."""
    columns = np.empty((len(theta), 2 * K + 1 + drift))
    columns[:, 0] = 1.0
    first = np.exp(1j * theta)
    power = np.ones_like(first)
    for k in range(1, K + 1):
        power = power * first
        columns[:, 2 * k - 1], columns[:, 2 * k] = 2 * power.real, -2 * power.imag
    u = 2 * (time - time[0]) / (time[-1] - time[0]) - 1
    for degree in range(1, drift + 1):
        columns[:, 2 * K + degree] = u if degree == 1 else 1.5 * u**2 - 0.5
    return columns


def _told_apart(
    second: tuple[float, np.ndarray], speed: float, K: int, duration: float, pickups: Sequence[float]
) -> np.ndarray:
    """Return which combinations of a second frequency are apart from harmonics, zero, each other, and pick-up [Hz]."""
    at = np.abs(second[1] * speed + second[0]) / TURN
    others = np.concatenate([np.abs(speed) / TURN * np.arange(K + 1), pickups])
    away = np.abs(at[:, None] - others).min(axis=1)
    pairs = np.abs(at[:, None] - at) + 1e9 * np.eye(len(at))
    return np.asarray((away > NEAR / duration) & (pairs.min(axis=1, initial=np.inf) > NEAR / duration))


def _combination(theta: np.ndarray, time: np.ndarray, k: int, second: float) -> np.ndarray:
    phase = k * theta + second * time
    return np.column_stack([2 * np.cos(phase), -2 * np.sin(phase)])


def _beside(
    second: tuple[float, np.ndarray], told: np.ndarray, coefficients: np.ndarray, inverse: np.ndarray
) -> Beside:
    count = int(told.sum())
    values = np.zeros((len(told), coefficients.shape[1]), complex)
    values[told] = coefficients[0 : 2 * count : 2] + 1j * coefficients[1 : 2 * count : 2]
    gram = np.ones(len(told))
    gram[told] = np.diag(inverse)[: 2 * count].reshape(-1, 2).mean(axis=1)
    return Beside(second[0], second[1], values, gram, told)


def _is_apart(frequency: float, speed: float, K: int, duration: float) -> bool:
    """Return whether a line [Hz] has a place of its own beside the mean and the harmonics up to order K."""
    away = np.abs(frequency - np.abs(speed) / TURN * np.arange(K + 1)).min()
    return bool(away * duration >= APART)


def with_lines(basis: Basis, run: str, time: np.ndarray, frequencies: Sequence[float]) -> Basis:
    """Return a basis with columns of lines [Hz] at times (n,)."""
    columns = [basis.columns, *(line_columns(time, frequency) for frequency in frequencies)]
    return Basis(run, np.column_stack(columns), basis.orders, basis.drift, basis.turns)


def line_columns(time: np.ndarray, frequency: float) -> np.ndarray:
    """Return the columns (n, 2) of a line [Hz] at times (n,)."""
    phase = TURN * frequency * time
    return np.column_stack([np.cos(phase), np.sin(phase)])
