"""The coordinates of the search: parameters scaled, and an amplitude with its angle as two linear components."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from rotorsim.diagram.diagram import Free
from rotorsim.settled.equations import Equations, instants

ANGLE_UNIT = "rad"
PROBES = (0.4, 1.9)
TURN_INSTANTS = 64  # of a turn, at which the forcing is compared
RIGID_FROM = 1e6  # times its usual size, a part in series is rigid: it shows a millionth of what it then shows


@dataclass(frozen=True, eq=False)
class Coordinates:
    """theta (m,) <-> q (m,): q = theta / scale, but (a cos phi, a sin phi) / scale for pairs (amplitude, angle).

    Of what is in series (m,), q = theta / (theta + scale): the response to a stiffness k of a support is
    (a + b k) / (c + d k), nearly linear in the compliance 1 / k where that is small, so that no step in k leads from a
    rigid support back to a soft one.
    """

    scale: np.ndarray
    pairs: tuple[tuple[int, int], ...]
    low: np.ndarray
    high: np.ndarray
    series: tuple[int, ...] = ()

    def inside(self, theta: np.ndarray) -> np.ndarray:
        """Return q of theta."""
        q = theta / self.scale
        for j in self.series:
            q[j] = self._of_series(j, theta[j])
        for a, b in self.pairs:
            q[a], q[b] = (theta[a] / self.scale[a]) * np.array([np.cos(theta[b]), np.sin(theta[b])])
        return np.asarray(q)

    def outside(self, q: np.ndarray, near: np.ndarray | None = None) -> np.ndarray:
        """Return theta of q; angles within half a turn of ``near``, else of zero."""
        theta = q * self.scale
        for j in self.series:
            theta[j] /= 1 - q[j]
        for a, b in self.pairs:
            theta[a] = min(np.hypot(q[a], q[b]) * self.scale[a], self.high[a])
            theta[b] = np.arctan2(q[b], q[a])
            if near is not None:
                theta[b] = near[b] + np.angle(np.exp(1j * (theta[b] - near[b])))
        return np.asarray(theta)

    def jacobian(self, theta: np.ndarray) -> np.ndarray:
        """Return dtheta/dq (m, m)."""
        J = np.diag(self.scale.copy())
        for j in self.series:
            J[j, j] = (theta[j] + self.scale[j]) ** 2 / self.scale[j]
        for a, b in self.pairs:
            c, s = np.cos(theta[b]), np.sin(theta[b])
            amplitude = max(abs(theta[a]), 1e-12 * self.scale[a])
            J[a, a], J[a, b] = c * self.scale[a], s * self.scale[a]
            J[b, a], J[b, b] = -s * self.scale[a] / amplitude, c * self.scale[a] / amplitude
        return J

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of q; those of a pair hold its largest amplitude, which cannot be negative."""
        low, high = self.low / self.scale, self.high / self.scale
        for j in self.series:
            stiffest = min(self.high[j], RIGID_FROM * self.scale[j])
            low[j], high[j] = self._of_series(j, self.low[j]), self._of_series(j, stiffest)
        for a, b in self.pairs:
            low[[a, b]], high[[a, b]] = -high[a], high[a]
        return low, high

    def moved(self, value: float, j: int, step: float) -> float:
        """Return a value of parameter j after a step in q; of a part in series 0 to infinity, where it is rigid."""
        size = float(self.scale[j])
        return _moved_in_series(value, size, step) if j in self.series else value + step * size

    def _of_series(self, j: int, value: float) -> float:
        return _in_series(value, float(self.scale[j]))

    def at_bound(self, q: np.ndarray, near: float) -> np.ndarray:
        """Return which parameters (m,) are at a bound, or as near as that in q."""
        low, high = self.bounds
        found = (q <= low + near) | (q >= high - near)
        for a, b in self.pairs:
            found[a], found[b] = np.hypot(q[a], q[b]) >= high[a] - near, False
        return np.asarray(found)


def stretched(item: Free, value: float, end: float, by: float) -> float:
    """Return the end of an interval about the value of a parameter, so many times as far away in q."""
    if not (item.series and item.low >= 0):
        return value + by * (end - value)
    size = _scale(item)
    return _moved_in_series(value, size, by * (_in_series(end, size) - _in_series(value, size)))


def _in_series(value: float, size: float) -> float:
    return float(value / (value + size)) if value < np.inf else 1.0


def _moved_in_series(value: float, size: float, step: float) -> float:
    at = max(_in_series(value, size) + step, 0.0)
    return float(at * size / (1 - at)) if at < 1 else np.inf


def coordinates_of(
    free: tuple[Free, ...], equations: Equations, p: np.ndarray, speeds: np.ndarray, *, bounded: bool = True
) -> Coordinates:
    """Return the coordinates of a search over the free parameters, within their bounds or not."""
    theta = np.array([item.value for item in free])
    scale = np.array([_scale(item) for item in free])
    pairs = amplitude_pairs(free, equations, p, speeds, theta)
    low, high = np.array([(item.low, item.high) for item in free], float).T
    if not bounded:
        low, high = np.full(len(free), -np.inf), np.full(len(free), np.inf)
    for _, b in pairs:
        scale[b] = 1.0
    for a, b in pairs:
        scale[b] = scale[a]
    series = tuple(j for j, item in enumerate(free) if item.series and low[j] >= 0)
    return Coordinates(scale, pairs, low, high, series)


def _scale(free: Free) -> float:
    """Return the size of a step that means something: never that of a value which a fit has brought to nothing."""
    if free.unit == ANGLE_UNIT:
        return 1.0
    size = free.scale or abs(free.value) or free.prior_std
    if size:
        return size
    return abs(free.high) if np.isfinite(free.high) and free.high else 1.0


def amplitude_pairs(
    free: tuple[Free, ...], equations: Equations, p: np.ndarray, speeds: np.ndarray, theta: np.ndarray
) -> tuple[tuple[int, int], ...]:
    """Return the pairs (amplitude, angle) that enter as a cos phi and a sin phi, as an unbalance does.

    Found from the traced forcing: with amplitude one, the force at every angle is made up of those at 0 and pi / 2.
    Lower bounds other than zero, or priors, leave a pair as it is.
    """
    plain = [item.prior_std is None for item in free]
    angles = [
        j
        for j, item in enumerate(free)
        if item.unit == ANGLE_UNIT and plain[j] and item.low == -np.inf and item.high == np.inf
    ]
    amplitudes = [j for j, item in enumerate(free) if plain[j] and item.low in (0.0, -np.inf) and item.high > 0]
    amplitudes = [j for j in amplitudes if free[j].unit != ANGLE_UNIT]
    if not angles or not amplitudes:
        return ()
    row, speed = p[:1], np.abs(speeds[:1])
    moved = equations.moved_by(row, theta)
    angles, amplitudes = ([j for j in some if not moved[j]] for some in (angles, amplitudes))

    def forces(*points: Mapping[int, float]) -> np.ndarray:
        changed = np.repeat(theta[None], len(points), axis=0)
        for k, point in enumerate(points):
            changed[k, list(point)] = list(point.values())
        many = len(points)
        return equations.whole.at_rest(
            np.repeat(row, many, 0), changed, instants(np.repeat(speed, many), TURN_INSTANTS)
        )

    rows = equations.whole.moved_at_rest()
    pairs: list[tuple[int, int]] = []
    for b in angles:
        for a in amplitudes:
            if any(a in pair for pair in pairs) or not rows[:, b].any() or (rows[:, b] & ~rows[:, a]).any():
                continue
            unit = 3.0 * _scale(free[a])
            none, turned, cosine, sine, *probes = forces(
                {a: 0.0},
                {a: 0.0, b: 1.0},
                {a: unit, b: 0.0},
                {a: unit, b: np.pi / 2},
                *({a: unit / 3, b: at} for at in PROBES),
            )
            cosine, sine = cosine - none, sine - none
            size = np.abs(cosine).max()
            if not size > 0 or np.abs(turned - none).max() > 1e-9 * size:
                continue
            wrong = [
                probe - none - (np.cos(at) * cosine + np.sin(at) * sine) / 3
                for probe, at in zip(probes, PROBES, strict=True)
            ]
            if np.abs(wrong).max() < 1e-9 * size:
                pairs.append((a, b))
                break
    return tuple(pairs)
