"""Lines that do not follow the shaft: a second frequency whose combinations with the speed explain them in all runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar
from threadpoolctl import threadpool_limits

from rotorsim.recordings.harmonic_fit import fit_harmonics, harmonic_basis
from rotorsim.recordings.harmonics import RunHarmonics
from rotorsim.recordings.recording import Recording

__all__ = ["Second", "find_second", "with_second"]

TURN = 2 * np.pi
ORDERS = 5  # combinations k W + nu with |k| up to this
CLOSE = 0.4  # of the resolution of a run, by which a line may miss its place
SHARE = 0.7  # of the strongest lines that one frequency must explain
STRONG = 6  # lines of a run that are looked at


@dataclass(frozen=True)
class Second:
    """A second frequency [rad/s], or its ratio to the speed where it follows that; std: of either.

    orders: k of the combinations k W + nu that two runs show.
    """

    value: float
    std: float
    follows: bool
    orders: tuple[int, ...]

    def at(self, speed: float) -> float:
        """Return the frequency [rad/s] at a speed [rad/s]."""
        return self.value * abs(speed) if self.follows else self.value


def find_second(recording: Recording, runs: Sequence[RunHarmonics]) -> Second | None:
    """Return the second frequency of lines that at least two runs show, None if there is none.

    nu is taken as constant, or as a part of the speed: whichever explains more of the lines as |k W +- nu|, with the
    smaller orders k.
    """
    found = [(r, line.frequency) for r, item in enumerate(runs) for line in item.fit.lines[:STRONG]]
    if len({r for r, _ in found}) < 2:
        return None
    where = np.array([r for r, _ in found])
    at = np.array([frequency for _, frequency in found])
    speeds = np.abs([item.fit.speed for item in runs])[where] / TURN
    close = CLOSE / np.array([item.run.time[-1] - item.run.time[0] for item in runs])[where]
    best: tuple[float, float, Second] | None = None
    k = np.arange(-ORDERS, ORDERS + 1)
    for follows in (False, True):
        unit = speeds if follows else np.ones(len(at))
        tried = np.unique(np.abs(at[:, None] - k * speeds[:, None]).ravel() / np.repeat(unit, len(k)))
        for value in tried[tried > 0]:
            places = np.abs(k * speeds[:, None] + (value * unit)[:, None])
            miss = np.abs(places - at[:, None])
            nearest = miss.argmin(axis=1)
            good = miss.min(axis=1) < close
            if good.sum() < SHARE * len(at) or len(set(where[good])) < 2:
                continue
            order = np.abs(k[nearest])[good].mean()
            rank = (good.sum() - 0.2 * order * len(at), -float((miss.min(axis=1)[good] / close[good]).mean()))
            if best is None or rank > best[:2]:
                sign = np.sign(k[nearest] * speeds + value * unit)
                own = (at * sign - k[nearest] * speeds)[good] / unit[good]
                shown = {order: set(where[good & (k[nearest] == order)]) for order in k.tolist()}
                orders = tuple(order for order, seen in shown.items() if len(seen) > 1)
                factor = 1.0 if follows else TURN
                best = (*rank, Second(factor * float(np.median(own)), 0.0, follows, orders or (0,)))
    return None if best is None else _refined(best[2], recording, runs)


def _refined(second: Second, recording: Recording, runs: Sequence[RunHarmonics]) -> Second:
    """Return a second frequency where its combinations hold most power in all runs, with its standard deviation."""
    found = []
    for even in (False, True):
        power, rest = _power(second, recording, runs, even)
        scale = float(np.median([abs(item.fit.speed) for item in runs])) if second.follows else 1.0
        width = 0.5 * TURN / max(float(item.run.time[-1] - item.run.time[0]) for item in runs) / scale
        at = minimize_scalar(
            lambda value, power=power: -power(value), bounds=(second.value - width, second.value + width),
            method="bounded", options={"xatol": 1e-6 * width},
        )  # fmt: skip
        step = 0.05 * width
        bend = -(power(at.x + step) - 2 * power(at.x) + power(at.x - step)) / step**2
        found.append((rest(at.x), float(at.x), float(np.sqrt(2 / max(bend, 1e-300)))))
    _, value, std = min(found)
    return replace(second, value=value, std=std)


def _power(
    second: Second, recording: Recording, runs: Sequence[RunHarmonics], even: bool
) -> tuple[Callable[[float], float], Callable[[float], float]]:
    """Return the power at all combinations, and that of all the rest, as functions of the second frequency.

    even: the angle is taken to rise evenly.
    """
    parts = []
    for item in runs:
        time, theta = item.run.time, _even(item, second.at(item.fit.speed)) if even else item.angle.theta
        basis = harmonic_basis(item.fit.run, time, theta, orders=int(item.fit.orders[-1]))
        left = basis.solve(np.column_stack(list(_signals(recording, item).values())))[1]
        scale = abs(item.fit.speed) if second.follows else 1.0
        parts.append((time - time.mean(), theta, scale, basis, left / np.maximum(item.fit.residual, 1e-300)))

    def power(value: float) -> float:
        total = 0.0
        for time, theta, scale, basis, left in parts:
            phase = np.multiply.outer(theta, second.orders) + (value * scale * time)[:, None]
            columns = basis.solve(np.hstack([np.cos(phase), np.sin(phase)]))[1]
            onto = columns.T @ left
            total += float((onto * np.linalg.lstsq(columns.T @ columns, onto, rcond=1e-9)[0]).sum())
        return total

    every = sum(float((part[4] ** 2).sum()) for part in parts)
    return power, lambda value: every - power(value)


def _even(item: RunHarmonics, second: float) -> np.ndarray:
    """Return the angle of a shaft that turns evenly but for a swing at a second frequency, without the swing."""
    time, theta = item.run.time, item.angle.theta
    at, turned = time, theta
    pulses = item.run.tacho
    if pulses is not None and len(pulses) > 6:  # they are right where an angle between them is a guess
        at = np.asarray(pulses)
        turned = np.sign(item.fit.speed) * TURN * np.arange(len(at))
    middle = at.mean()
    columns = np.column_stack([np.ones(len(at)), at - middle, np.cos(second * at), np.sin(second * at)])
    best = np.linalg.lstsq(columns, turned, rcond=1e-9)[0]
    return np.asarray(best[0] + best[1] * (time - middle))


def with_second(
    recording: Recording, runs: Sequence[RunHarmonics], second: Second
) -> tuple[tuple[RunHarmonics, ...], list[str]]:
    """Return runs with the combinations of a second frequency fitted, and ids of those it cannot be told apart in.

    Where an angle that turns evenly leaves less over than the measured one, it is used: pulses of a shaft whose speed
    swings are too few to follow it.
    """
    kept, lost = [], []
    orders = np.array(second.orders)
    with threadpool_limits(1, "blas"):
        for item in runs:
            signals = _signals(recording, item)
            time, theta = item.run.time, item.angle.theta
            at = second.at(item.fit.speed)
            fits = [
                fit_harmonics(
                    item.fit.run, time, angle, signals, dict(zip(item.fit.names, item.fit.units, strict=True)),
                    orders=int(item.fit.orders[-1]), angle_std=item.angle.std, second=(at, orders),
                )
                for angle in (theta, _even(item, at))
            ]  # fmt: skip
            left = [float(np.log(np.maximum(fit.residual, 1e-300)).sum()) for fit in fits]
            fit = fits[int(left[1] < left[0] - 1e-3)]
            assert fit.beside is not None
            if not fit.beside.told.all():
                lost.append(item.fit.run)
                continue
            kept.append(replace(item, fit=fit))
    return tuple(kept), lost


def _signals(recording: Recording, item: RunHarmonics) -> dict[str, np.ndarray]:
    """Return the samples of the channels that were fitted."""
    columns = {channel.name: c for c, channel in recording.channels.items() if c in item.run.values}
    return {name: np.asarray(item.run.values[columns[name]]) for name in item.fit.names}
