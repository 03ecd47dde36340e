"""What is kept of every run of an ensemble, and how it follows from sums over its rows."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from rotorsim.errors import Problem, RotorsimError, near_miss
from rotorsim.model.lanes import Reduced, Reduction

LEAST, LARGEST, SUM, SQUARES = range(4)  # of `Reduced.moments`
KINDS: Mapping[str, str] = {
    "peak": "largest magnitude in the window, 0-peak, (n, *shape)",
    "peak_to_peak": "largest less least value in the window, (n, *shape)",
    "mean": "mean over the window, (n, *shape)",
    "rms": "root mean square over the window, (n, *shape)",
    "radius": "largest distance of a two-axis signal from [0, 0] in the window, (n, *shape without the axes)",
    "last": "last recorded value, (n, *shape)",
    "harmonics": "complex Y_k, k = 0..K, of y = Re sum Y_k exp(i k theta) in the window, 0-peak, (n, *shape, K + 1)",
    "poincare": "values where the shaft angle passes whole turns in the window, (n, turns, *shape), NaN behind",
    "envelope": "least and largest value in each of B equal parts of the run, (n, B, *shape, 2)",
    "history": "all recorded rows of the window, (n, rows, *shape)",
}
NUMBERS: Mapping[str, int] = {"harmonics": 3, "envelope": 200}  # what may follow '=', where it does not
DEFAULT = ("peak", "rms")
OF_TURNS = ("harmonics", "poincare")
ROWS_A_TURN = 8  # in a turn, for what lies between rows: the cubic through four is off by 1e-3 of 1X then
TOO_STEEP = f"a turn of the shaft has fewer than {ROWS_A_TURN} recorded rows somewhere: no Poincare points are kept"
GROWTH_PARTS = 8  # of a run, the last four of which tell whether it still grows


def chosen_reductions(names: Iterable[str]) -> dict[str, int]:
    """Return kinds of reductions, with their numbers, of texts like "peak" and "harmonics=3". Raises RotorsimError."""
    chosen: dict[str, int] = {}
    problems = []
    for text in names:
        kind, equals, number = text.strip().partition("=")
        if kind not in KINDS:
            problems.append(Problem(f"no reduction '{kind}'", "reduce", hint=near_miss(kind, KINDS, most=1)))
        elif equals and kind not in NUMBERS:
            problems.append(Problem(f"'{text}': {kind} takes no number", "reduce", hint=kind))
        elif equals and not (number.isdecimal() and 1 <= int(number) <= 10_000):
            hint = f"{kind}={NUMBERS[kind]}"
            problems.append(Problem(f"'{text}': not a whole number from 1 to 10000", "reduce", hint=hint))
        elif kind in chosen:
            problems.append(Problem(f"'{kind}' is named twice", "reduce", hint="name it once"))
        else:
            chosen[kind] = int(number) if equals else NUMBERS.get(kind, 0)
    if problems:
        raise RotorsimError(*problems)
    return chosen


@dataclass(frozen=True)
class Rows:
    """The recorded rows of every run: how many, and the window, from a first one to the one behind the last."""

    n: int
    window: tuple[int, int]

    @property
    def growth_ends(self) -> list[int]:
        """The rows between the last four eighths, as `rotorsim.simulation.validity.growth_rate` has them."""
        m = self.n // GROWTH_PARTS
        return [self.n - k * m for k in range(4, -1, -1)]

    def envelope_ends(self, parts: int) -> list[int]:
        """The rows between equal parts."""
        return [round(self.n * k / parts) for k in range(parts + 1)]


@dataclass(frozen=True)
class Columns:
    """Where things lie in a row: signals (those that are watched, too), radii, cosine, sine, angle, residuals."""

    signals: Mapping[str, tuple[slice, tuple[int, ...]]]
    radii: Mapping[str, tuple[slice, tuple[int, ...]]]
    angle: tuple[int, int, int]
    residuals: slice
    n: int


@dataclass(frozen=True)
class Wanted:
    """Reductions of the rows of every run: kinds and their numbers; points: most turns in a window."""

    kinds: Mapping[str, int]
    rows: Rows
    columns: Columns
    names: tuple[str, ...]
    points: int = 0

    @property
    def reduction(self) -> Reduction:
        """What the loop over the rows has to keep."""
        ends = {*self.rows.window, *self.rows.growth_ends, self.rows.n}
        if "envelope" in self.kinds:
            ends |= set(self.rows.envelope_ends(self.kinds["envelope"]))
        return Reduction(
            self.columns.n,
            np.array(sorted(end for end in ends if 0 < end <= self.rows.n)),
            self.rows.window,
            self.kinds.get("harmonics", -1),
            self.columns.angle,
            self.points if "poincare" in self.kinds else 0,
            "history" in self.kinds,
        )

    def values(self, kept: Reduced) -> dict[str, dict[str, np.ndarray]]:
        """Return kind -> signal -> values (n, ...)."""
        moments = Moments(kept.moments, self.reduction.ends)
        window = moments.between(*self.rows.window)
        peak = np.maximum(np.abs(window[LEAST]), np.abs(window[LARGEST]))
        n = max(self.rows.window[1] - self.rows.window[0], 1)
        found: dict[str, Callable[[], np.ndarray]] = {
            "peak": lambda: peak,
            "peak_to_peak": lambda: window[LARGEST] - window[LEAST],
            "mean": lambda: window[SUM] / n,
            "rms": lambda: np.sqrt(window[SQUARES] / n),
            "radius": lambda: window[LARGEST],
            "last": lambda: kept.last,
            "harmonics": lambda: harmonics_of(kept),
            "poincare": lambda: np.moveaxis(kept.points, 0, -1),
            "envelope": lambda: self._envelope(moments),
            "history": lambda: np.asarray(kept.history),
        }
        values = {}
        for kind in self.kinds:
            signals = self.columns.radii if kind == "radius" else self.columns.signals
            signals = {name: signals[name] for name in self.names if name in signals}
            values[kind] = {name: _shaped(found[kind](), *at) for name, at in signals.items()}
        if "poincare" in values:
            beyond = np.arange(kept.points.shape[1]) >= kept.found[:, None]
            beyond |= self.too_steep(kept)[:, None]
            for array in values["poincare"].values():
                array[beyond] = np.nan
        return values

    def too_steep(self, kept: Reduced) -> np.ndarray:
        """Return which runs (n,) turn too fast, or too often, for their Poincare points."""
        if "poincare" not in self.kinds:
            return np.zeros(len(kept.found), bool)
        fast = kept.steepest * ROWS_A_TURN > 2 * np.pi * (1 + 1e-9)
        return np.asarray(fast | (kept.found > self.points))

    def _envelope(self, moments: Moments) -> np.ndarray:
        parts = [moments.between(*ends) for ends in pairwise(self.rows.envelope_ends(self.kinds["envelope"]))]
        return np.array([[part[LEAST], part[LARGEST]] for part in parts])


def _shaped(values: np.ndarray, part: slice, shape: tuple[int, ...]) -> np.ndarray:
    """Return (..., columns, n) as (n, ..., *shape); extra axes of (B, 2, columns, n) and harmonics come last."""
    chosen = values[..., part, :]
    whole = np.moveaxis(chosen, -1, 0)
    if whole.ndim == 2:  # (n, columns)
        return np.array(whole.reshape(len(whole), *shape))
    if whole.ndim == 4:  # envelope: (n, B, 2, columns)
        whole = np.moveaxis(whole, 2, -1)
        return np.array(whole.reshape(*whole.shape[:2], *shape, 2))
    if np.iscomplexobj(whole):  # harmonics: (n, K + 1, columns)
        whole = np.moveaxis(whole, 1, -1)
        return np.array(whole.reshape(len(whole), *shape, whole.shape[-1]))
    return np.array(whole.reshape(*whole.shape[:2], *shape))


class Moments:
    """Least, largest, sum and sum of squares of the rows between ends of segments: (4, n_y, n)."""

    def __init__(self, moments: np.ndarray, ends: np.ndarray) -> None:
        self._moments = moments
        self._at = {0: 0, **{int(end): k + 1 for k, end in enumerate(ends)}}

    def between(self, first: int, last: int) -> np.ndarray:
        """Return the moments of the rows first..last-1, both of which are ends of segments."""
        part = self._moments[self._at[first] : self._at[last]]
        with np.errstate(all="ignore"):
            found = np.array(
                [
                    part[:, LEAST].min(axis=0, initial=np.inf),
                    part[:, LARGEST].max(axis=0, initial=-np.inf),
                    part[:, SUM].sum(axis=0),
                    part[:, SQUARES].sum(axis=0),
                ]
            )
        found[:, np.isnan(found[SUM])] = np.nan  # comparisons lose it
        return found


def harmonics_of(kept: Reduced) -> np.ndarray:
    """Return Y_0..Y_K (K + 1, n_y, n), complex, of y = Re sum Y_k exp(i k theta), by least squares over the rows.

    The normal equations of the columns 1, cos k theta, sin k theta need the sums of cosines and sines up to 2K alone,
    cos a cos b = (cos(a - b) + cos(a + b)) / 2 and so on.
    """
    cosines, sines = kept.sums  # (2K + 1, n)
    by_cosine, by_sine = kept.products  # (K + 1, n_y, n)
    orders = len(by_cosine) - 1
    k = np.arange(orders + 1)
    plus, minus = k[:, None] + k, k[:, None] - k
    cc = (cosines[np.abs(minus)] + cosines[plus]) / 2
    ss = (cosines[np.abs(minus)] - cosines[plus]) / 2
    cs = (sines[plus] - np.sign(minus)[..., None] * sines[np.abs(minus)]) / 2  # cos(i) sin(j)
    top = np.concatenate([cc, cs[:, 1:]], axis=1)
    bottom = np.concatenate([np.swapaxes(cs, 0, 1)[1:], ss[1:, 1:]], axis=1)
    normal = np.moveaxis(np.concatenate([top, bottom]), -1, 0)  # (n, 2K + 1, 2K + 1)
    right = np.moveaxis(np.concatenate([by_cosine, by_sine[1:]]), -1, 0)  # (n, 2K + 1, n_y)
    solved = np.full(right.shape, np.nan)
    for i, (matrix, side) in enumerate(zip(normal, right, strict=True)):
        if np.isfinite(matrix).all() and np.isfinite(side).all() and np.linalg.cond(matrix) < 1e12:
            solved[i] = np.linalg.solve(matrix, side)
    found = solved[:, : orders + 1].astype(complex)
    found[:, 1:] -= 1j * solved[:, orders + 1 :]
    return np.moveaxis(found, 0, -1)


def reduce_rows(wanted: Wanted, rows: np.ndarray) -> Reduced:
    """Return what lanes.c keeps, of the rows (n, n_y) of one run that went by other ways."""
    plan = wanted.reduction
    moments = np.empty((len(plan.ends), 4, plan.n_y, 1))
    for k, (first, last) in enumerate(pairwise([0, *plan.ends.tolist()])):
        part = rows[first:last]
        moments[k, :, :, 0] = part.min(axis=0), part.max(axis=0), part.sum(axis=0), (part**2).sum(axis=0)
    first, last = plan.window
    window = rows[first:last]
    turning = window[:, plan.angle[0]] + 1j * window[:, plan.angle[1]]
    powers = turning[None] ** np.arange(2 * max(plan.orders, 0) + 1)[:, None]
    sums, products = powers.sum(axis=1), powers[: plan.orders + 1] @ window
    points = np.zeros((1, plan.n_points, plan.n_y))
    crossed = crossings(window, plan.angle[2]) if plan.n_points else points[0]
    points[0, : len(crossed)] = crossed[: plan.n_points]
    return Reduced(
        moments,
        np.array([sums.real, sums.imag])[..., None],
        np.array([products.real, products.imag])[..., None],
        points,
        np.array([len(crossed)]),
        window[..., None] if plan.history else None,
        rows[-1][:, None],
        np.abs(np.diff(window[:, plan.angle[2]])).max(initial=0.0, keepdims=True) if plan.n_points else np.zeros(1),
    )


def crossings(rows: np.ndarray, angle: int) -> np.ndarray:
    """Return the rows (turns, n_y) where the angle [rad] passes whole turns, by the cubic through the four around."""
    turns = np.floor(rows[:, angle] / (2 * np.pi))
    found = []
    for k in np.flatnonzero(turns[1:] != turns[:-1]).tolist():  # between rows k and k + 1
        begin = min(max(k - 1, 0), len(rows) - 4)
        near, at = rows[begin : begin + 4], 2 * np.pi * max(turns[k], turns[k + 1])
        here = near[:, angle]
        apart = here[:, None] - here
        np.fill_diagonal(apart, 1.0)
        away = at - here
        weights = [np.prod(np.delete(away, i)) / np.prod(apart[i]) for i in range(4)]
        found.append(np.array(weights) @ near)
    return np.array(found).reshape(-1, rows.shape[1])
