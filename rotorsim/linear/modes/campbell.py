"""Campbell diagram: modes over speed, followed by their shape, and where they cross multiples of the speed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from scipy.optimize import brentq, linear_sum_assignment

from rotorsim._shown import Shown, xarray_module
from rotorsim.diagram.diagram import Diagram
from rotorsim.linear.eigen import Eigen, eigen
from rotorsim.linear.linearisation import as_model
from rotorsim.linear.loop import growing_poles, systems_at
from rotorsim.linear.modes.eigenmodes import RESONANT, checked_speeds, require_speed, shape_names, whirl
from rotorsim.linear.sampled_data import SampledData
from rotorsim.linear.state_space import StateSpace
from rotorsim.model.compiled import Model

UNMATCHED = 0.98  # cost from which two modes are not the same one
SPEED_FOUND = 1e-9, 1e-12  # absolute [rad/s] and relative, to which the speed of a crossing is found
MOST_CHORDS = 5


@dataclass(frozen=True)
class Crossing:
    """Where the damped frequency of ``mode`` (from 1) equals ``order`` times the speed: a critical speed (order 1).

    stable: whether no pole of the machine grows at this speed; a settled motion is never reached where one does. modulo
    [Hz]: with samplers, the rate modulo which the frequency is known, so that the crossing may be another image's; NaN
    where it is sure.
    """

    order: int
    speed: float
    frequency_hz: float
    mode: int
    whirl: str
    damping_ratio: float
    stable: bool = True
    modulo: float = np.nan

    @property
    def modulo_text(self) -> str:
        """Say what the frequency is known modulo: " modulo 250 Hz"; nothing where it is sure."""
        return "" if np.isnan(self.modulo) else f" modulo {self.modulo:.6g} Hz"


@dataclass(frozen=True, repr=False)
class Campbell(Shown):
    """Modes over speed: one column per mode, followed by shape; NaN where a mode does not oscillate.

    speeds (n,) [rad/s]; frequency_hz, damping_ratio (n, modes); whirl (n, modes) text, "" where NaN.
    stable (n,): whether no pole of the machine grows there, also none that does not oscillate. modulo (n, modes) [Hz]:
    with samplers, the rate modulo which a frequency is known, NaN where it is sure, see `rotorsim.linear.eigen.Eigen`.
    """

    speeds: np.ndarray
    frequency_hz: np.ndarray
    damping_ratio: np.ndarray
    whirl: np.ndarray
    crossings: tuple[Crossing, ...]
    stable: np.ndarray = field(default_factory=lambda: np.zeros(0, bool))
    provenance: Mapping[str, Any] = field(default_factory=dict)
    modulo: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))

    _figure = "rotorsim.report.figures.linear:campbell_figure"

    def __repr__(self) -> str:
        low, high = (end * 30 / np.pi for end in (self.speeds.min(), self.speeds.max()))
        critical = [f"{item.speed * 30 / np.pi:.6g}" for item in self.crossings if item.order == 1]
        found = f"critical speeds {', '.join(critical)} rpm" if critical else "no critical speed"
        name = self.provenance.get("diagram", "")
        return f"Campbell({name}: {self.frequency_hz.shape[1]} modes, {low:.6g}..{high:.6g} rpm, {found})"

    def to_xarray(self) -> Any:
        """Return an xarray.Dataset over speed [rad/s] and mode; needs the optional package xarray."""
        dims = ("speed", "mode")
        variables = {
            "frequency_hz": (dims, self.frequency_hz, {"units": "Hz"}),
            "damping_ratio": (dims, self.damping_ratio, {"units": "1"}),
            "whirl": (dims, self.whirl, {}),
        }
        coordinates = {
            "speed": ("speed", self.speeds, {"units": "rad/s"}),
            "mode": np.arange(self.frequency_hz.shape[1]) + 1,
        }
        return xarray_module().Dataset(variables, coordinates, {k: str(v) for k, v in self.provenance.items()})

    @property
    def resonant(self) -> np.ndarray:
        """Which modes have a damping ratio below 1/sqrt(2) at some speed, (modes,)."""
        return np.asarray(np.nanmin(self.damping_ratio, axis=0, initial=np.inf) < RESONANT)

    def to_table(self) -> list[dict[str, Any]]:
        """Return one row per speed and mode."""
        return [
            {
                "speed": float(speed),
                "mode": k + 1,
                "frequency_hz": float(self.frequency_hz[j, k]),
                "damping_ratio": float(self.damping_ratio[j, k]),
                "whirl": str(self.whirl[j, k]),
                "stable": bool(self.stable[j]),
            }
            for j, speed in enumerate(self.speeds)
            for k in range(self.frequency_hz.shape[1])
            if np.isfinite(self.frequency_hz[j, k])
        ]


@dataclass(frozen=True, eq=False)
class _Point:
    eigen: Eigen
    system: StateSpace | SampledData
    names: tuple[str, ...]

    @cached_property
    def whirl(self) -> list[str]:
        return whirl(self.eigen, self.names)

    @cached_property
    def stable(self) -> bool:
        values = np.concatenate([self.eigen.values, self.eigen.real])
        return bool((values.real <= 0).all()) or not len(growing_poles(self.system))


def campbell(
    diagram: Diagram | Model,
    *,
    speeds: Sequence[float | str] | np.ndarray,
    parameters: Mapping[str, Any] | None = None,
    orders: Sequence[int] = (1, 2),
    progress: Callable[[float], None] | None = None,
) -> Campbell:
    """Return the modes at many speeds [rad/s], each followed through crossings, and the critical speeds.

    Modes at neighbouring speeds belong together where |l1^H r2| |l2^H r1| (left and right eigenvectors: a
    modal assurance criterion that no scaling of the states changes) is near 1 and the frequencies are near;
    the assignment is optimal (Hungarian method). Crossings with order times speed are refined by root finding.

    progress: is told the share of the speeds that is done. Raises RotorsimError as `modes`, and without a diagram
    parameter ``speed``.
    Source: Allemang, Sound and Vibration 37 (2003) 14-23 (MAC).
    """
    model = as_model(diagram)
    require_speed(model, "campbell")
    values = np.unique(checked_speeds(speeds, zero=True))
    names = shape_names(model)
    system_at = systems_at(model, (), names, parameters, values)

    def point(speed: float) -> _Point:
        system = system_at(speed, False)[0]
        return _Point(eigen(system), system, names)

    points = []
    for speed in values:
        points.append(point(float(speed)))
        if progress is not None:
            progress(len(points) / len(values))
    columns = _follow(points)
    n_modes = columns.shape[1]
    frequency = np.full((len(values), n_modes), np.nan)
    damping = np.full((len(values), n_modes), np.nan)
    direction = np.full((len(values), n_modes), "", dtype="<U8")
    modulo = np.full((len(values), n_modes), np.nan)
    for j, at in enumerate(points):
        there = np.flatnonzero(columns[j] >= 0)
        found = at.eigen.values[columns[j, there]]
        frequency[j, there] = found.imag / (2 * np.pi)
        damping[j, there] = -found.real / np.abs(found)
        modulo[j, there] = at.eigen.modulo[columns[j, there]]
        direction[j, there] = [at.whirl[k] for k in columns[j, there]]
    crossings = [
        crossing
        for order in orders
        for k in range(n_modes)
        for crossing in _crossings(point, values, points, columns[:, k], k, order)
    ]
    return Campbell(
        speeds=values,
        frequency_hz=frequency,
        damping_ratio=damping,
        whirl=direction,
        crossings=tuple(sorted(crossings, key=lambda c: (c.order, c.speed, c.mode))),
        stable=np.array([at.stable for at in points], bool),
        provenance={"diagram": model.diagram.name, "set": dict(parameters or {}), "analysis": "campbell"},
        modulo=modulo,
    )


def _cost(a: Eigen, b: Eigen) -> np.ndarray:
    """Return how little two sets of modes resemble one another, in [0, 1] plus a small term for continuity."""
    assurance = np.abs(a.left.conj().T @ b.right) * np.abs(b.left.conj().T @ a.right).T
    scale = np.maximum(np.abs(a.values)[:, None], np.abs(b.values)[None])
    distance = np.abs(a.values[:, None] - b.values[None]) / scale
    cost: np.ndarray = 1 - np.minimum(assurance, 1.0) + distance
    return cost


def _follow(points: list[_Point]) -> np.ndarray:
    """Return for every speed and mode the number of the eigenvalue there, -1 where it is missing.

    From the highest speed down: there the modes are most distinct; at rest pairs may be arbitrary.
    """
    last = len(points) - 1
    columns = [[k] for k in range(len(points[last].eigen.values))]  # from high to low speed
    seen = [(last, k) for k in range(len(columns))]  # where each mode was seen last
    for j in range(last - 1, -1, -1):
        here = points[j].eigen
        cost = np.ones((len(columns), len(here.values)))
        for source in {at for at, _ in seen}:
            rows = [row for row, (at, _) in enumerate(seen) if at == source]
            numbers = [seen[row][1] for row in rows]
            cost[rows] = _cost(points[source].eigen, here)[numbers]
        rows, found = linear_sum_assignment(cost)
        match = {int(r): int(c) for r, c in zip(rows, found, strict=True) if cost[r, c] < UNMATCHED}
        for row, column in enumerate(columns):
            column.append(match.get(row, -1))
            if row in match:
                seen[row] = (j, match[row])
        for new in sorted(set(range(len(here.values))) - set(match.values())):
            columns.append([-1] * (last - j) + [new])
            seen.append((j, new))
    table = np.array(columns, int).reshape(len(columns), len(points)).T[::-1]
    frequencies = [
        np.nanmin([points[j].eigen.values[k].imag for j, k in enumerate(column) if k >= 0]) for column in table.T
    ]
    return table[:, np.argsort(frequencies, kind="stable")] if frequencies else table


def _near(column: np.ndarray, j: int) -> list[int]:
    """Return the speeds at which a mode is there, from up to two below an interval to as many above it."""
    return [i for i in range(max(j - 2, 0), min(j + 4, len(column))) if column[i] >= 0]


def _root(gap: Callable[[float], float], known: Sequence[tuple[float, float]], ends: tuple[float, float]) -> float:
    """Return where a gap vanishes between two ends at which it has different signs.

    An evaluation solves for all modes. From where the polynomial through the known (speed, gap) vanishes, off by some
    1e-8, chords to the end that is further away: two evaluations. By Brent's method where that does not converge.
    """
    x, y = np.array(known).T
    with np.errstate(all="ignore"):
        others = ~np.eye(len(y), dtype=bool)
        weights = [np.prod(-y[row] / (y[k] - y[row])) for k, row in enumerate(others)]
        speed = float(x @ weights)  # Lagrange's polynomial of the speed over the gap, at a gap of zero
    for _ in range(MOST_CHORDS):
        if not ends[0] <= speed <= ends[1]:
            break
        here, far = gap(speed), max(ends, key=lambda end: abs(end - speed))
        change = here * (speed - far) / (here - gap(far)) if here else 0.0
        if abs(change) <= SPEED_FOUND[0] + SPEED_FOUND[1] * speed:
            return speed
        speed -= change
    return float(brentq(gap, *ends, xtol=SPEED_FOUND[0], rtol=SPEED_FOUND[1]))


def _crossings(
    point: Any, speeds: np.ndarray, points: list[_Point], column: np.ndarray, mode: int, order: int
) -> list[Crossing]:
    found = []
    for j in range(len(speeds) - 1):
        if column[j] < 0 or column[j + 1] < 0:
            continue
        ends = [points[i].eigen.values[column[i]].imag - order * speeds[i] for i in (j, j + 1)]
        if ends[0] * ends[1] > 0 or (ends[1] == 0.0 < abs(ends[0]) and j + 2 < len(speeds)):
            continue  # no crossing, or one that the next interval reports
        seen = {float(speeds[i]): (points[i], int(column[i])) for i in (j, j + 1)}
        between = list(seen.values())

        def nearest(
            speed: float, seen: dict[float, tuple[_Point, int]] = seen, ends: list[tuple[_Point, int]] = between
        ) -> tuple[_Point, int]:
            if speed not in seen:
                at = point(speed)
                cost = sum(_cost(end.eigen, at.eigen)[number] for end, number in ends)
                seen[speed] = at, int(np.argmin(cost))
            return seen[speed]

        def gap(speed: float) -> float:
            at, number = nearest(speed)
            return float(at.eigen.values[number].imag - order * speed)

        known = [(speeds[i], points[i].eigen.values[column[i]].imag - order * speeds[i]) for i in _near(column, j)]
        speed = _root(gap, known, (float(speeds[j]), float(speeds[j + 1])))
        at, number = nearest(speed)
        value = at.eigen.values[number]
        found.append(
            Crossing(
                order=order,
                speed=speed,
                frequency_hz=float(value.imag / (2 * np.pi)),
                mode=mode + 1,
                whirl=at.whirl[number],
                damping_ratio=float(-value.real / abs(value)),
                stable=at.stable,
                modulo=float(at.eigen.modulo[number]),
            )
        )
    return found
