"""What a harmonic fit leaves over: lines that do not follow the shaft, and noise with its cross-spectrum."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from rotorsim.signals.colour import Bands, bands_of, colour_of, density, of_mean

__all__ = ["Line", "Noise", "find_lines", "noise_of"]

TURN = 2 * np.pi
FALSE_ALARM = 1e-3  # chance that noise alone shows a line somewhere in one run
MOST_LINES = 20
GAP, NEIGHBOURS = 3, 24  # the level of the noise at a line: the mean of so many others, these next to it left out
BANDS = 16
LEAST_BAND = 7  # lines of the narrowest
NOT_WHITE = 1e-4  # probability below which noise is not called white
MOST_LAGS = 8  # of an autoregression
SMOOTHING = 12  # lines on each side over which a coloured spectrum is averaged, at least
LEAST_KEPT = 0.3  # of the noise that a fit leaves of a line: below, the line says little of the noise


@dataclass(frozen=True)
class Line:
    """A spectral line beside the fitted harmonics: frequency [Hz], in orders of the speed, amplitude (C,) 0-peak."""

    frequency: float
    order: float
    amplitude: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Noise:
    """Cross-spectrum of the noise at the harmonics: spectrum (K+1, C, C), or (1, C, C) where it is white.

    Scaled so that white noise of covariance S has spectrum S. freedom: degrees of freedom it was estimated with.
    colour: (C, 3) of the density that grows towards low frequencies (see `rotorsim.signals.colour.density`), of
    noise that is not white. bands: where noise is white or so coloured, what that was found from, else None.
    """

    spectrum: np.ndarray
    white: bool
    freedom: float
    colour: np.ndarray | None = None
    bands: Bands | None = None

    def at_order(self, k: int) -> np.ndarray:
        """Return the cross-spectrum (C, C), Hermitian, at order k."""
        return np.asarray(self.spectrum[0 if self.white else k])

    def of_drift(self, degree: int) -> np.ndarray:
        """Return n times the variance (C,) of a Legendre coefficient of n samples; degree 0: of their mean."""
        white = np.diag(self.at_order(0)).real
        if self.colour is not None:
            mean = of_mean(self.colour)
            white = white * np.divide(of_mean(self.colour, degree), mean, out=np.ones(len(white)), where=mean > 0)
        return np.asarray((2 * degree + 1) * white)

    def recoloured(self, colour: np.ndarray, turns: float, K: int) -> Noise:
        """Return noise of other densities a + b j^-c (C, 3), of a run of so many turns, that is correlated alike."""
        old = np.diag(self.spectrum[0].real)[None] if self.colour is None else _at_orders(self.colour, turns, K)
        scale = np.sqrt(np.divide(_at_orders(colour, turns, K), old, out=np.ones((K + 1, len(colour))), where=old > 0))
        spectrum = self.spectrum * scale[:, :, None] * scale[:, None, :]
        return replace(self, spectrum=spectrum, white=False, colour=colour)


def _at_orders(colour: np.ndarray, turns: float, K: int) -> np.ndarray:
    """Return the density (K+1, C) at orders 0..K of a run of so many turns."""
    return np.vstack([of_mean(colour), density(colour, turns * np.arange(1, K + 1))])


def find_lines(
    time: np.ndarray,
    left: np.ndarray,
    speed: float,
    K: int,
    floor: np.ndarray,
    near: float = 1.5,
    kept: np.ndarray | None = None,
) -> list[Line]:
    """Return the lines that stand out of the residual (n, C) of a harmonic fit, largest first (of the residual's rms).

    Noise alone shows one in a thousand runs. floor: (C,) amplitudes below which nothing counts. near: so many lines of
    the spectrum beside a fitted harmonic belong to it and are not reported. kept: see `noise_of`.
    """
    n = len(left)
    if n < 64:
        return []
    step = (time[-1] - time[0]) / (n - 1)
    power = np.abs(np.fft.rfft(left, axis=0)[1:-1]) ** 2 / n
    mean = power.mean(axis=0)
    threshold = np.log(power.size / FALSE_ALARM)
    left_of = np.ones(len(power)) if kept is None else kept[1 : len(power) + 1]
    usable = left_of > LEAST_KEPT
    if not (power > threshold * mean).any() and _is_white(power[usable] / left_of[usable, None]):
        return []
    at_line = np.arange(1, len(power) + 1)
    shape = density(colour_of(power[usable] / left_of[usable, None], at_line[usable]), at_line)
    shape = np.where(shape > 0, shape, 1.0)  # a level that falls within the neighbours is no line of its upper end
    level = np.maximum(_beside(power / shape) * shape, floor**2)
    # power over the mean of its neighbours has an F distribution with 2 and 2 NEIGHBOURS degrees of freedom
    threshold = NEIGHBOURS * np.expm1(threshold / NEIGHBOURS)
    ratio = np.divide(power, level, out=np.zeros_like(power), where=level > 0)
    lines: list[Line] = []
    running = abs(speed) / TURN
    resolution = 1 / (n * step)
    skipped = 0
    while len(lines) + skipped < MOST_LINES:
        at, channel = np.unravel_index(int(np.argmax(ratio)), ratio.shape)
        if ratio[at, channel] <= threshold:
            break
        frequency = _refined(left[:, channel], time, (at + 1) * resolution, resolution)
        columns = np.exp(-1j * TURN * frequency * time)
        amplitude = 2 * np.abs(columns @ left) / n
        order = frequency / running if running else np.inf
        nearest = round(order)
        if nearest > K or abs(order - nearest) * running > near * resolution:
            lines.append(Line(float(frequency), float(order), tuple(float(a) for a in amplitude)))
        else:
            skipped += 1
        reach = 4 if ratio[at, channel] < 1e4 else 40  # skirts of a strong line
        ratio[max(0, at - reach) : at + reach + 1] = 0.0
    rms = np.maximum(np.sqrt(np.mean(left**2, axis=0)), np.maximum(floor, 1e-300))
    return sorted(lines, key=lambda line: -float((np.array(line.amplitude) / rms).max()))


def _beside(power: np.ndarray) -> np.ndarray:
    """Return the mean of the NEIGHBOURS on both sides of every line, those within GAP left out, (n, C)."""
    half = NEIGHBOURS // 2
    padded = np.pad(power, ((half + GAP, half + GAP), (0, 0)), mode="reflect")
    total = np.vstack([np.zeros((1, power.shape[1])), np.cumsum(padded, axis=0)])
    at = np.arange(len(power))
    left = total[at + half] - total[at]
    right = total[at + 2 * (half + GAP) + 1] - total[at + half + 2 * GAP + 1]
    return np.asarray((left + right) / NEIGHBOURS)


def _refined(signal: np.ndarray, time: np.ndarray, frequency: float, resolution: float) -> float:
    """Return the frequency at which the signal's Fourier integral is largest, near a line of its FFT."""
    offsets = np.linspace(-0.75, 0.75, 13)
    for scale in (1.0, 0.15):
        trial = frequency + offsets * scale * resolution
        size = np.abs(np.exp(-1j * TURN * np.outer(trial, time)) @ signal)
        frequency = float(trial[int(np.argmax(size))])
    return frequency


def _bands(n: int) -> np.ndarray:
    """Return where bands of n lines start: BANDS of one width, of which the lowest is divided into octaves.

    Flicker noise that fills a few lines only moves the harmonics of a slow shaft all the same.
    """
    width = n / BANDS
    octaves = [width / 2**k for k in range(1, 32) if width / 2**k >= LEAST_BAND]
    return np.unique([0, *np.array(octaves[::-1], int), *np.linspace(0, n, BANDS, endpoint=False).astype(int)])


def _is_white(power: np.ndarray) -> bool:
    """Return whether the power of every channel is the same in all bands of frequency (chi-squared test)."""
    if len(power) < 4 * BANDS:
        return True
    starts = _bands(len(power))
    sizes = np.diff(np.append(starts, len(power)))
    sums = np.add.reduceat(power, starts, axis=0)
    means, overall = sums / sizes[:, None], sums.sum(axis=0) / len(power)
    with np.errstate(invalid="ignore", divide="ignore"):
        statistic = np.nansum(sizes[:, None] * (means / overall - 1) ** 2, axis=0)
    return bool((statistic < chi2.isf(NOT_WHITE / power.shape[1], len(starts) - 1)).all())


def _autoregressive(left: np.ndarray, omega: np.ndarray, freedom: int) -> tuple[np.ndarray, float] | None:
    """Return the cross-spectrum (K+1, C, C) at angles per sample omega of an autoregression of the residual.

    e_n = A_1 e_(n-1) + ... + A_p e_(n-p) + w_n by least squares, the order p up to 8 by the Bayesian information
    criterion; None where w is not white or there are too few samples. With minus twice the logarithm of Whittle's
    likelihood, its constant left out, and what its parameters cost. Source: Lutkepohl, New Introduction to Multiple
    Time Series Analysis (2005), ch. 3-4.
    """
    size = np.sqrt(np.mean(left**2, axis=0))
    used = np.flatnonzero(size > 0)
    n, C = len(left), len(used)
    most = min(MOST_LAGS, (n // 20) // max(C, 1))
    if most < 1:
        return None
    e = left[:, used] / size[used]
    lagged = np.hstack([e[most - k : n - k] for k in range(1, most + 1)])
    target = e[most:]
    normal, right = lagged.T @ lagged, lagged.T @ target
    best: tuple[float, int, np.ndarray, np.ndarray] | None = None
    for p in range(1, most + 1):
        coefficients = np.linalg.lstsq(normal[: p * C, : p * C], right[: p * C], rcond=None)[0]
        rest = target - lagged[:, : p * C] @ coefficients
        sign, logarithm = np.linalg.slogdet(rest.T @ rest / len(rest))
        if sign <= 0:
            return None
        criterion = len(rest) * logarithm + p * C * C * np.log(len(rest))
        if best is None or criterion < best[0]:
            best = (criterion, p, coefficients, rest)
    assert best is not None
    _, p, coefficients, rest = best
    transform = np.fft.rfft(rest, axis=0)[1:-1]
    if not (_is_white(np.abs(transform) ** 2) and _is_together(transform)):
        return None
    covariance = rest.T @ rest / max(freedom - most - p * C, 1)
    spectrum = np.zeros((len(omega), left.shape[1], left.shape[1]), complex)
    for k, angle in enumerate(omega):
        steps = np.exp(-1j * angle * np.arange(1, p + 1))
        through = np.eye(C) - np.einsum("p,pij->ji", steps, coefficients.reshape(p, C, C))
        if np.linalg.cond(through) > 1 / np.finfo(float).eps:  # a pole on the unit circle: no noise
            return None
        transfer = np.linalg.inv(through)
        inner = transfer @ covariance @ transfer.conj().T
        spectrum[k][np.ix_(used, used)] = inner * np.outer(size[used], size[used])
    spectrum[0] = spectrum[0].real
    level = float(
        np.linalg.slogdet(covariance)[1] + 2 * np.log(size[used]).sum()
    )  # log det of the density, in the mean
    return spectrum, n * level + p * C * C * np.log(n)


def _is_together(transform: np.ndarray) -> bool:
    """Return whether channels that are white are so together: the same cross-spectrum in all bands.

    Noise that comes later in one channel, as behind a sampled controller, has a phase that turns with frequency.
    """
    C = transform.shape[1]
    size = np.sqrt(np.mean(np.abs(transform) ** 2, axis=0))
    used = np.flatnonzero(size > 0)
    starts = np.linspace(0, len(transform), BANDS, endpoint=False).astype(int)
    counts = np.diff(np.append(starts, len(transform)))
    if len(used) < 2 or counts[0] < 4:
        return True
    scaled = transform[:, used] / size[used]
    covariance = (scaled.T @ scaled.conj()).real / len(scaled)
    values, vectors = np.linalg.eigh(covariance)
    if values[0] < 1e-9:  # two channels carry the same noise: nothing is left to be tested
        return True
    independent = scaled @ (vectors / np.sqrt(values))
    pairs = np.triu_indices(len(used), 1)
    products = independent[:, pairs[0]] * independent[:, pairs[1]].conj()
    bands = np.add.reduceat(products, starts, axis=0) / counts[:, None]
    statistic = 2 * (counts[:, None] * np.abs(bands) ** 2).sum(axis=0)
    return bool((statistic < chi2.isf(NOT_WHITE / (C * C), 2 * BANDS)).all())


def noise_of(
    left: np.ndarray,
    time: np.ndarray,
    speed: float,
    K: int,
    freedom: int,
    floor: np.ndarray,
    lines: Sequence[Line],
    kept: np.ndarray | None = None,
) -> Noise:
    """Return the noise in a residual (n, C) with the given degrees of freedom, at orders 0..K of the speed.

    White noise is one covariance. Coloured noise is white and flicker noise in each channel, or an autoregression of
    low order, whichever is more likely of those that leave white noise over; else its spectrum is averaged over lines
    about each order, lines found left out. floor: (C,) standard deviation never undercut (rounding of the data).
    kept: share of white noise that the fit leaves of each line of the spectrum, (n // 2 + 1,).
    """
    n, channels = left.shape
    at_least = np.diag(floor**2)
    kept = np.full(n // 2 + 1, max(freedom, 1) / n) if kept is None else kept
    transform = np.fft.rfft(left, axis=0) / np.sqrt(n * np.maximum(kept, LEAST_KEPT))[:, None]
    step = (time[-1] - time[0]) / (n - 1)
    usable = kept > LEAST_KEPT
    usable[[0, -1]] = False
    for line in lines:
        at = round(line.frequency * n * step)
        usable[max(0, at - 2) : at + 3] = False
    inner = transform[usable]
    at_line = np.arange(len(transform))
    bands = None if len(inner) < 8 else bands_of(np.abs(inner) ** 2, at_line[usable], n * step)
    if len(inner) < 8 or (_is_white(np.abs(inner) ** 2) and _is_together(inner)):
        return Noise((left.T @ left / max(freedom, 1) + at_least)[None], True, float(max(freedom, 1)), bands=bands)
    colour = colour_of(np.abs(inner) ** 2, at_line[usable])
    spacing = abs(speed) / TURN * n * step
    orders = np.sqrt(_at_orders(colour, spacing, K))
    shape = np.sqrt(density(colour, at_line))
    dead = shape[-1] == 0
    orders[:, dead], shape[:, dead] = 1.0, 1.0
    transform = transform / shape
    inner = transform[usable]
    scale = orders[:, :, None] * orders[:, None, :]
    found: list[tuple[float, np.ndarray, Bands | None]] = []
    if _is_white(np.abs(inner) ** 2) and _is_together(inner):
        together = (inner.T @ inner.conj()).real / len(inner)
        level = 2 * float(np.log(shape[usable]).sum()) / len(inner) + float(
            np.linalg.slogdet(together[~dead][:, ~dead])[1]
        )
        found.append((n * level + 3 * channels * np.log(n), scale * together, bands))
    modelled = _autoregressive(left, np.arange(K + 1) * speed * step, freedom)
    if modelled is not None:
        found.append((modelled[1], modelled[0], None))
    if found:
        _, likely, bands = min(found, key=lambda item: item[0])
        return Noise(likely + at_least, False, float(max(freedom, 1)), colour, bands)
    width = max(SMOOTHING, 2 * channels, round(spacing / 2))
    spectrum = np.empty((K + 1, channels, channels), complex)
    for k in range(K + 1):
        reach = width
        while True:
            low, high = max(0, round(k * spacing - reach)), min(len(transform), round(k * spacing + reach) + 1)
            part = transform[low:high][usable[low:high]]
            if len(part) >= min(max(2 * SMOOTHING, 4 * channels), usable.sum()) or reach > len(transform):
                break
            reach *= 2
        # the inverse of a cross-spectrum estimated from N lines is too large by N / (N - channels) in the mean
        unbiased = max(len(part) - channels, 1)
        spectrum[k] = scale[k] * np.einsum("ni,nj->ij", part, part.conj()) / unbiased + at_least
    spectrum[0] = spectrum[0].real
    return Noise(spectrum, False, float(4 * width), colour)
