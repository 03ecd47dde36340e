"""Frequency responses from one record of any excitation, by local polynomials, with covariances and coherence.

Near a frequency the DFTs of outputs and inputs obey Y = S U + T + noise: the response S and the transient T of the ends
of the record (leakage) are smooth and the excitation is not, so that polynomials of both are fitted to the lines of the
spectrum around it by least squares. What they leave is the noise.

Source: Pintelon and Schoukens, System Identification (2nd ed., 2012), sec. 7.2; bandwidth as of Goldenshluger and
Nemirovski, Math. Methods Stat. 6 (1997) 135-170, the comparison as of Hausman, Econometrica 46 (1978) 1251-1271.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.ndimage import uniform_filter1d

POLYNOMIAL_DEGREE = 2  # of the polynomials: the centre of a window then errs by the fourth power of its width
WIDER = 1.5  # from one window to the next
MOST_LINES_OF_WINDOW = 400
CHANCE = 1e-3  # of a window that is taken for too wide though it is not
CENTRAL, CENTRAL_SHARE = 1 / 3, 0.1  # of a window, and of its mean power: less, and S is extrapolated from its sides
INDEPENDENT = 1e-9  # of a column, beside the others, at least: less is rounding
INFLATION = 100.0  # of a variance by the transient: more, and what the transient lacks is as large as the response
FLOOR, FALLS, FAINTEST = 10.0, 1000.0, 1e-4  # times a power
SMOOTHED = 51  # lines of the spectrum, over which the power of an input is a mean
BELOW_NYQUIST = 0.95  # of half of the sample rate: filters of converters fall beyond
LARGEST_BATCH = 2_000_000  # complex numbers at a time
ESTIMATED = ("S", "noise", "gain", "coherence", "freedom", "smooth", "alone")  # of a `Response`


@dataclass(frozen=True, eq=False)
class Spectra:
    """DFTs of inputs U (K, m) and outputs Y (K, q) of a record at frequencies k step [Hz], k = 0..K-1; n samples."""

    U: np.ndarray
    Y: np.ndarray
    step: float
    n: int

    @classmethod
    def of(cls, inputs: np.ndarray, outputs: np.ndarray, rate: float) -> Spectra:
        """Return those of samples (n, m) and (n, q) at a rate [Hz], without their parabolas: drift leaks far."""
        n = len(inputs)
        trend, _ = np.linalg.qr(np.vander(np.linspace(-1, 1, n), 3))
        U, Y = (np.fft.rfft(x - trend @ (trend.T @ x), axis=0) / np.sqrt(n) for x in (inputs, outputs))
        return cls(U, Y, rate / n, n)

    @cached_property
    def excited(self) -> np.ndarray:
        """Return which lines (K, m) the inputs excite: by FLOOR times their least power, noise of converters, and more.

        An input that is nowhere less than FALLS below its largest has no floor to be seen. It is also FAINTEST of the
        largest power, in a hertz or in an octave: what leaks beyond the ends of a sweep tells next to nothing.
        """
        power = np.stack([uniform_filter1d(np.abs(u) ** 2, SMOOTHED, mode="reflect") for u in self.U.T], axis=1)
        inner = power[1 : max(int(BELOW_NYQUIST * len(power)), 2)]
        low, high = inner.min(axis=0), inner.max(axis=0)
        in_octave = power * np.arange(len(power))[:, None]
        injected = (power > FAINTEST * high) | (in_octave > FAINTEST * in_octave.max(axis=0))
        return np.asarray(((power > FLOOR * low) | (high < FALLS * low)) & injected)


@dataclass(frozen=True, eq=False)
class Response:
    """A response S (n, q, m) at frequencies (n,) [Hz].

    noise (n, q, q): of the outputs, circular complex, E[e e^H]; gain (n, m): by which it enters S[:, :, j], see
    `covariance`. coherence (n, q, m): share of the power of an output that an input explains. freedom (n,): complex
    degrees of freedom of the noise. smooth (n, q, m): the same S with a wider window, less noise, and a bias that may
    be as large; it says where a peak is. alone (n,): narrower windows tell nothing, and this wider one contradicts: S
    may be wrong by as much as they differ. NaN: not excited.
    """

    frequencies: np.ndarray
    S: np.ndarray
    noise: np.ndarray
    gain: np.ndarray
    coherence: np.ndarray
    freedom: np.ndarray
    smooth: np.ndarray
    alone: np.ndarray

    @property
    def covariance(self) -> np.ndarray:
        """Covariance (n, m, q, q) of S[:, :, j], E[dS dS^H]."""
        return np.asarray(self.gain[..., None, None] * self.noise[:, None])


def least_half(m: int) -> int:
    """Return the half-width, in lines, of the narrowest window for m inputs: as many lines are left as are fitted."""
    return (POLYNOMIAL_DEGREE + 1) * (m + 1)


def window_halves(m: int, K: int) -> list[int]:
    """Return the half-widths of the windows that are tried, narrowest first."""
    halves, most = [least_half(m)], min(MOST_LINES_OF_WINDOW, K - 2) // 2
    while (wider := int(np.ceil(halves[-1] * WIDER))) <= most:
        halves.append(wider)
    return halves


def response(spectra: Spectra, frequencies: np.ndarray) -> Response:
    """Return the response at frequencies [Hz], each with the widest window that narrower ones do not contradict.

    A wider window has less noise, and a bias where S is not a polynomial within it. One window less than the widest
    that the narrower ones allow is taken, so that what they cannot see is small beside the noise.
    """
    halves = window_halves(spectra.U.shape[1], len(spectra.U))
    every = [_at_width(spectra, frequencies, half) for half in halves]
    chosen = np.full(len(frequencies), -1)
    going = np.ones(len(frequencies), bool)
    for k, wide in enumerate(every):
        for narrow in every[:k]:
            going &= ~_contradicts(narrow, wide)
        there = np.isfinite(wide.freedom) & (wide.freedom > 0)
        chosen = np.where(going & there, k, chosen)
    first = np.argmax([np.isfinite(one.freedom) for one in every], axis=0)
    alone = (first > 0) & (chosen <= first)
    S = np.stack([*(one.S for one in every), np.full_like(every[0].S, np.nan)])  # none is wider than the widest
    wider = np.where(alone, first + 1, np.maximum(chosen, first))
    smooth = np.take_along_axis(S, wider[None, :, None, None], axis=0)[0]
    return replace(_picked(every, np.maximum(chosen - 1, first)), smooth=smooth, alone=alone)


def _contradicts(narrow: Response, wide: Response) -> np.ndarray:
    """Return where an entry of two responses differs by more than the noise that they do not share.

    The noise is that which the narrow one leaves: in the wide one's may be what it cannot follow.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        variance = np.einsum("nii->ni", narrow.noise).real
        spread = variance[:, :, None] * (narrow.gain - wide.gain)[:, None]
        ratio = np.abs(wide.S - narrow.S) ** 2 / spread
        entries = ratio[0].size if len(ratio) else 1
        n = np.maximum(narrow.freedom, 1)
        limit = n * np.expm1(-np.log(CHANCE / entries) / n)  # F of 2 and 2 n is above with (1 + F / n)^-n
        found = (ratio > limit[:, None, None]) & (spread > 0)
    return np.asarray(found.any(axis=(1, 2)))


def _picked(every: Sequence[Response], chosen: np.ndarray) -> Response:
    """Return at each frequency the values of one of several responses."""
    at = np.arange(len(chosen))

    def of(name: str) -> np.ndarray:
        return np.asarray(np.stack([getattr(one, name) for one in every])[chosen, at])

    return Response(every[0].frequencies, *(of(name) for name in ESTIMATED))


def _at_width(spectra: Spectra, frequencies: np.ndarray, half: int) -> Response:
    """Return the response with windows of 2 half + 1 lines."""
    columns = (2 * half + 1) * ((POLYNOMIAL_DEGREE + 1) * (spectra.U.shape[1] + 1) + spectra.Y.shape[1])
    parts = np.array_split(frequencies, 1 + len(frequencies) * columns // LARGEST_BATCH)
    found = [_fitted(spectra, part, half) for part in parts]
    return Response(frequencies, *(np.concatenate([getattr(one, name) for one in found]) for name in ESTIMATED))


def design(U: np.ndarray, places: np.ndarray, extra: np.ndarray | None = None) -> np.ndarray:
    """Return the columns (b, w, p) of windows: r^d U_j, j by j, r^d, then others; r (b, w) from -1 to 1."""
    powers = places[..., None] ** np.arange(POLYNOMIAL_DEGREE + 1)
    of_inputs = [powers * U[..., j, None] for j in range(U.shape[-1])]
    return np.concatenate([*of_inputs, powers.astype(complex), *([] if extra is None else [extra])], axis=-1)


def windows(spectra: Spectra, frequencies: np.ndarray, half: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the lines (b, w) of windows around frequencies, and their places r in them; the mean is in none."""
    at = frequencies / spectra.step
    first = np.clip(np.round(at).astype(int) - half, 1, max(len(spectra.U) - 2 * half - 1, 1))
    lines = first[:, None] + np.arange(2 * half + 1)
    return lines, (lines - at[:, None]) / half


def _mean(values: np.ndarray, there: np.ndarray) -> np.ndarray:
    """Return the mean of values (b, w, m) where there (b, w) says so, (b, m)."""
    return np.asarray(np.einsum("bwm,bw->bm", values, there) / np.maximum(there.sum(axis=1), 1)[:, None])


def _fitted(spectra: Spectra, frequencies: np.ndarray, half: int) -> Response:
    m = spectra.U.shape[1]
    lines, places = windows(spectra, frequencies, half)
    U, Y = spectra.U[lines], spectra.Y[lines]
    A = design(U, places)
    size = np.linalg.norm(A, axis=1)
    size[size == 0] = 1.0
    Q, R = np.linalg.qr(A / size[:, None])
    told = np.abs(np.einsum("bii->bi", R)).min(axis=1) > INDEPENDENT
    R[~told] = np.eye(R.shape[-1])
    inverse = np.linalg.inv(R)
    projected = Q.conj().swapaxes(1, 2) @ Y
    left = Y - Q @ projected
    freedom = Y.shape[1] - A.shape[2]
    noise = left.swapaxes(1, 2) @ left.conj() / freedom
    constants = np.arange(m) * (POLYNOMIAL_DEGREE + 1)
    S = (inverse @ projected)[:, constants] / size[:, constants, None]  # (b, m, q)
    gain = np.linalg.norm(inverse[:, constants], axis=2) ** 2 / size[:, constants] ** 2
    explained = np.abs(S) ** 2 * np.mean(np.abs(U) ** 2, axis=1)[..., None]
    total = explained.sum(axis=1, keepdims=True) + np.einsum("bii->bi", noise).real[:, None]
    with np.errstate(invalid="ignore", divide="ignore"):
        coherence = (explained / total).swapaxes(1, 2)
    S = S.swapaxes(1, 2)
    power = np.abs(U) ** 2
    total, central = power.sum(axis=1), _mean(power, np.abs(places) < CENTRAL)
    told &= ((gain * total < INFLATION) & (total > 0) & (central > CENTRAL_SHARE * power.mean(axis=1))).all(axis=1)
    for values in (S, noise, gain, coherence):
        values[~told] = np.nan
    return Response(frequencies, S, noise, gain, coherence, np.where(told, float(freedom), np.nan), S, ~told)
