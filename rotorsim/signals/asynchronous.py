"""Lines that do not follow the shaft: a second frequency whose combinations with the speed explain them in all runs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.stats import binom, chi2

from rotorsim.jobs.threads import one_thread
from rotorsim.recordings.recording import Recording
from rotorsim.signals.faint_lines import Spectrum, faint_line, spectrum_of
from rotorsim.signals.harmonic_fit import NEAR, Basis, HarmonicFit, fit_harmonics, harmonic_basis, with_lines
from rotorsim.signals.harmonics import RunHarmonics, with_one_noise

__all__ = ["Second", "find_second", "signals_of", "spectra_of", "strongest", "with_second"]

TURN = 2 * np.pi
ORDERS = 5  # combinations k W + nu with |k| up to this
MULTIPLES = (1, 2, 3)  # of the frequency, that a strong swing of the angle has
CLOSE = 0.4  # of the resolution of a run, by which a line may miss its place
SHARE = 0.7  # of the strongest lines, by their sizes, that one frequency must explain
STRONG = 6  # lines of a run that are looked at
ROUNDS = 4
EVEN = 10.0  # variances of the noise by which what one angle leaves over says nothing against another
PULSES = 8  # of a run, at least, to see its speed swing
DRIFT = 2  # degree of slow changes of the speed
ROUNDING = 1e-12  # of the length of a run, or of a radian
MOVED = 2000  # times that spectra of pulses are moved against each other to see what coincides by chance
LONGEST = 2.5  # periods of a swing in the longest run
FALSE_ALARM = 1e-3
LESS = 0.98  # of what a fit left over: then what the lines weigh against the noise is worth finding again


@dataclass(frozen=True)
class Second:
    """A second frequency [rad/s], or its ratio to the speed where it follows that; std: of either.

    orders: k of the combinations k W + nu that two runs show. even: the shaft turns evenly but for a swing at nu, and
    harmonics are counted by its angle without the swing.
    """

    value: float
    std: float
    follows: bool
    orders: tuple[int, ...]
    even: bool = False

    @property
    def swings(self) -> bool:
        """Whether the angle may be what swings: it does so on both sides of an order, at a frequency of its own."""
        return self.even and not self.follows and any(-k in self.orders for k in self.orders if k > 0)

    def at(self, speed: float) -> float:
        """Return the frequency [rad/s] at a speed [rad/s]."""
        return self.value * abs(speed) if self.follows else self.value


def find_second(recording: Recording, runs: Sequence[RunHarmonics]) -> Second | None:
    """Return the second frequency of lines that at least two runs show, or of a swing of their pulses; None without.

    nu is taken as constant, or as a part of the speed: whichever explains more of the lines as |k W + nu|, with the
    smaller orders k. Lines too faint for one run are looked for in all runs together.
    """
    seen = _guessed(runs)
    swing = None if seen else _swinging(runs)
    seen = seen or (None if swing else _faint(recording, runs))
    second = seen or swing
    if second is None:
        return None
    with one_thread():
        for _ in range(ROUNDS):
            second = _refined(second, recording, runs)
            fitted = {item.run.id: item for item in with_second(recording, runs, second)[0]}
            hidden = _shown(second, list(fitted.values()))
            again = [fitted.get(item.run.id, item) for item in runs]
            less = [(new.fit.residual < LESS * old.fit.residual).any() for new, old in zip(again, runs, strict=True)]
            if not (set(hidden) - set(second.orders) or any(less)):
                break
            second, runs = replace(second, orders=tuple(sorted({*second.orders, *hidden}))), again
    if seen is None and not second.even:  # no swing of one frequency: the measured angle follows it better
        return None
    return _centred(second, np.sign([item.fit.speed for item in runs]))


def _guessed(runs: Sequence[RunHarmonics]) -> Second | None:
    """Return the second frequency that explains most of the strongest lines, to their resolution."""
    found = [(r, *line) for r, item in enumerate(runs) for line in _beside_harmonics(item)[:STRONG]]
    if len({r for r, _, _ in found}) < 2:
        return None
    where = np.array([r for r, _, _ in found])
    at = np.array([frequency for _, frequency, _ in found])
    weight = np.array([size for _, _, size in found])
    speeds = np.array([item.fit.speed for item in runs])[where] / TURN
    close = CLOSE / np.array([item.run.time[-1] - item.run.time[0] for item in runs])[where]
    best: tuple[float, float, Second] | None = None
    k = np.arange(-ORDERS, ORDERS + 1)
    for follows in (False, True):
        unit = np.abs(speeds) if follows else np.ones(len(at))
        tried = np.unique(np.abs(at[:, None] - k * speeds[:, None]).ravel() / np.repeat(unit, len(k)))
        for value in tried[tried > 0]:
            places = np.abs(k * speeds[:, None] + (value * unit)[:, None])
            miss = np.abs(places - at[:, None])
            nearest = miss.argmin(axis=1)
            good = miss.min(axis=1) < close
            explained, every = float(weight[good].sum()), float(weight.sum())
            if explained < SHARE * every or len(set(where[good])) < 2:
                continue
            order = float(np.average(np.abs(k[nearest])[good], weights=weight[good]))
            rank = (explained - 0.2 * order * every, -float((miss.min(axis=1)[good] / close[good]).mean()))
            if best is None or rank > best[:2]:
                sign = np.sign(k[nearest] * speeds + value * unit)
                own = (at * sign - k[nearest] * speeds)[good] / unit[good]
                shown = {order: set(where[good & (k[nearest] == order)]) for order in k.tolist()}
                twice = tuple(order for order, seen in shown.items() if len(seen) > 1)
                once = tuple(order for order, seen in shown.items() if seen)
                factor = 1.0 if follows else TURN
                best = (*rank, Second(factor * float(np.median(own)), 0.0, follows, twice or once))
    return None if best is None else best[2]


def _faint(recording: Recording, runs: Sequence[RunHarmonics]) -> Second | None:
    """Return the frequency of a line that all runs show together, though none by itself."""
    with one_thread():
        made = spectra_of(recording, runs)
        found = faint_line([item for item in made if item is not None], _all_orders(runs)[-1])
    if found is None:
        return None
    value, follows, shown = found
    return Second(value if follows else TURN * value, 0.0, follows, shown)


def spectra_of(recording: Recording, runs: Sequence[RunHarmonics]) -> list[Spectrum | None]:
    """Return the spectrum of what harmonics leave over of every run, by the colour of its noise."""
    return [
        spectrum_of(
            item.run.time,
            _left(recording, item, item.angle.theta)[1],
            item.fit.speed,
            int(item.fit.orders[-1]),
            item.fit.noise.colour,
        )
        for item in runs
    ]


def _left(recording: Recording, item: RunHarmonics, theta: np.ndarray) -> tuple[Basis, np.ndarray]:
    """Return harmonics of an angle (n,), and what they leave over of the signals, (n, C)."""
    basis = harmonic_basis(item.fit.run, item.run.time, theta, orders=int(item.fit.orders[-1]))
    if item.fit.pickups:
        basis = with_lines(basis, item.fit.run, item.run.time, list(item.fit.pickups))
    return basis, basis.solve(np.column_stack(list(signals_of(recording, item).values())))[1]


def _swinging(runs: Sequence[RunHarmonics]) -> Second | None:
    """Return the frequency at which pulses of most runs swing about an even speed, by more than they jitter.

    An angle that follows the pulses takes lines of a slow swing away.
    """
    swings = []
    for item in runs:
        pulses = None if item.run.tacho is None else np.asarray(item.run.tacho)
        if pulses is not None and len(pulses) >= PULSES:
            k = np.arange(len(pulses))
            early = pulses - np.polyval(np.polyfit(k, pulses, DRIFT), k)
            size = float(np.sqrt(np.mean(early**2)))
            if size > ROUNDING * float(np.ptp(pulses)):
                swings.append((pulses - pulses.mean(), early / size))
    if len(swings) < 2:
        return None
    longest = max(float(np.ptp(t)) for t, _ in swings)
    rates = [len(t) / float(np.ptp(t)) for t, _ in swings]
    grid = np.arange(LONGEST / longest, 0.5 * min(rates), 0.2 / longest)
    if not len(grid):
        return None
    power = []
    for rate, (t, early) in zip(rates, swings, strict=True):  # over the whole rate, above which it repeats
        at = grid[0] + np.arange(0.0, rate, 0.2 / longest)
        power.append(np.abs(np.exp(-1j * TURN * np.outer(at, t)) @ early) ** 2 * 2 / len(t))
    shared = int(np.ceil(SHARE * len(swings)))

    def shown(moved: Sequence[int]) -> np.ndarray:
        parts = [np.roll(p, by)[: len(grid)] for p, by in zip(power, moved, strict=True)]
        return np.asarray(np.sort(parts, axis=0)[-shared])

    both = shown([0] * len(power))
    best = int(np.argmax(both))
    if binom.sf(shared - 1, len(swings), chi2.sf(both[best], 2)) > FALSE_ALARM / len(grid):
        return None
    random = np.random.default_rng(0)  # pulses of a coarse timer have strong lines, but others in every run
    moved = random.integers(0, [len(p) for p in power], (MOVED, len(power)))
    if sum(float(shown(by).max()) >= both[best] for by in moved) > FALSE_ALARM * MOVED:
        return None
    return Second(TURN * float(grid[best]), 0.0, False, (-1, 1))


def _beside_harmonics(item: RunHarmonics) -> list[tuple[float, float]]:
    """Return lines that are no harmonics of higher orders than were fitted: frequency [Hz] and size.

    The size counts in what a channel leaves over, and as a share of that of the strongest.
    """
    speed = abs(item.fit.speed) / TURN
    close = CLOSE / (item.run.time[-1] - item.run.time[0])
    scale = np.where(item.fit.residual > 0, item.fit.residual, np.inf)
    sizes = [(line.frequency, float(np.max(np.asarray(line.amplitude) / scale))) for line in item.fit.lines]
    kept = [(at, size) for at, size in sizes if abs(at - speed * round(at / speed)) >= close]
    largest = max((size for _, size in kept), default=1.0)
    return [(at, size / largest) for at, size in kept]


def _centred(second: Second, direction: np.ndarray) -> Second:
    """Return a frequency that follows the speed, known but for whole orders, so that its orders lie about zero."""
    if not second.follows or len(set(direction.tolist())) > 1:
        return second
    found = []
    for j in range(-ORDERS, ORDERS + 1):
        sign = 1 if second.value + j > 0 else -1
        orders = tuple(sorted(int(sign * (k - j * direction[0])) for k in second.orders))
        found.append((sum(map(abs, orders)), sign * (second.value + j), orders))
    _, value, orders = min(found)
    return replace(second, value=value, orders=orders)


def _shown(second: Second, runs: Sequence[RunHarmonics]) -> tuple[int, ...]:
    """Return further orders that lines of at least two runs are at: stronger lines near them hid them before."""
    k = np.array(_all_orders(runs))
    seen: dict[int, set[str]] = {}
    for item in runs:
        close = CLOSE / (item.run.time[-1] - item.run.time[0])
        places = np.abs(k * item.fit.speed + second.at(item.fit.speed)) / TURN
        for frequency, _ in _beside_harmonics(item):
            miss = np.abs(places - frequency)
            if miss.min() < close:
                seen.setdefault(int(k[miss.argmin()]), set()).add(item.run.id)
    return tuple(order for order, ids in seen.items() if len(ids) > 1)


def _all_orders(runs: Sequence[RunHarmonics]) -> range:
    """Return the orders of either sign that all runs have."""
    highest = min(int(item.fit.orders[-1]) for item in runs)
    return range(-highest, highest + 1)


def _refined(second: Second, recording: Recording, runs: Sequence[RunHarmonics]) -> Second:
    """Return a second frequency where its combinations hold most power in all runs, with its standard deviation."""
    measured = strongest(replace(second, even=False), recording, runs)
    even = strongest(replace(second, even=True), recording, runs)
    if abs(even[1].value - second.value) > even[1].std:  # the swing that was taken out was one at the first value
        even = strongest(even[1], recording, runs)
    by_pulses = _by_pulses(even[1], runs)
    if by_pulses is not None:  # pulses that do not swing have a frequency of their own
        left = _rest(by_pulses, recording, runs)(by_pulses.value, _all_orders(runs), MULTIPLES)
        even = (left, by_pulses) if left < even[0] - EVEN else even
    return even[1] if even[0] < measured[0] + EVEN else measured[1]


def _by_pulses(second: Second, runs: Sequence[RunHarmonics]) -> Second | None:
    """Return the frequency near a first value at which the pulses of all runs swing, by maximum likelihood.

    None where they swing by no more than noise makes them.
    """
    having = [item for item in runs if item.run.tacho is not None and len(item.run.tacho) >= PULSES]
    if not having:
        return None

    def unlikely(rests: Iterable[np.ndarray]) -> float:
        return float(sum(len(rest) * np.log(np.mean(rest**2) + ROUNDING**2) for rest in rests))

    def left(value: float) -> float:
        return unlikely(_swing(item, replace(second, value=value).at(item.fit.speed))[2] for item in having)

    at, bend = _least(left, second, having)
    if unlikely(_swing(item, None)[2] for item in having) - left(at) < chi2.isf(FALSE_ALARM, 2 * len(having)):
        return None
    return replace(second, value=at, std=float(np.sqrt(2 / max(bend, 1e-300))))


def _least(left: Callable[[float], float], second: Second, runs: Sequence[RunHarmonics]) -> tuple[float, float]:
    """Return where a function of the frequency is least, within the resolution of a first value, and its bend there."""
    scale = float(np.median([abs(item.fit.speed) for item in runs])) if second.follows else 1.0
    width = 0.5 * TURN / max(float(item.run.time[-1] - item.run.time[0]) for item in runs) / scale
    bounds = (second.value - width, second.value + width)
    at = float(minimize_scalar(left, bounds=bounds, method="bounded", options={"xatol": 1e-6 * width}).x)
    step = 0.05 * width
    return at, float((left(at + step) - 2 * left(at) + left(at - step)) / step**2)


def strongest(second: Second, recording: Recording, runs: Sequence[RunHarmonics]) -> tuple[float, Second]:
    """Return the frequency near a first value that leaves least over, and what that leaves, in variances of the noise.

    The latter with all combinations and multiples: a measured angle that follows a swing takes them all away.
    """
    rest = _rest(second, recording, runs)
    at, bend = _least(rest, second, runs)
    std = float(np.sqrt(2 / max(bend, 1e-300)))
    return rest(at, _all_orders(runs), MULTIPLES), replace(second, value=at, std=std)


def _rest(second: Second, recording: Recording, runs: Sequence[RunHarmonics]) -> Callable[..., float]:
    """Return what harmonics and combinations leave over, in variances of the noise, as a function of the frequency."""
    parts = []
    for item in runs:
        time = item.run.time
        theta = _even(item, second.at(item.fit.speed))[0] if second.even else item.angle.theta
        basis, left = _left(recording, item, theta)
        scale = abs(item.fit.speed) if second.follows else 1.0
        parts.append((time - time.mean(), theta, scale, basis, left / np.maximum(item.fit.residual, 1e-300)))
    every = sum(float((part[4] ** 2).sum()) for part in parts)

    def rest(value: float, orders: Sequence[int] = second.orders, multiples: Sequence[int] = (1,)) -> float:
        total = every
        for time, theta, scale, basis, left in parts:
            turned, swung = np.multiply.outer(theta, orders), np.multiply.outer(value * scale * time, multiples)
            phase = (turned[:, :, None] + swung[:, None, :]).reshape(len(time), -1)
            columns = basis.solve(np.hstack([np.cos(phase), np.sin(phase)]))[1]
            onto = columns.T @ left
            total -= float((onto * np.linalg.lstsq(columns.T @ columns, onto, rcond=1e-9)[0]).sum())
        return total

    return rest


def _even(item: RunHarmonics, second: float) -> tuple[np.ndarray, float]:
    """Return the angle of a shaft that turns evenly but for a swing at a second frequency, without the swing.

    With the standard deviation of angle zero, from what the pulses leave over.
    """
    best, middle, rest = _swing(item, second)
    variance = float(rest @ rest) / max(len(rest) - len(best), 1)
    return np.asarray(best[0] + best[1] * (item.run.time - middle)), float(np.sqrt(variance / len(rest)))


def _swing(item: RunHarmonics, second: float | None) -> tuple[np.ndarray, float, np.ndarray]:
    """Return angle, speed and swing (4,) that fit the pulses of a run, the time they count from, and what is left.

    second: frequency of the swing [rad/s]; None: there is none.
    """
    at, turned = item.run.time, item.angle.theta
    pulses = item.run.tacho
    if pulses is not None and len(pulses) > 6:  # they are right where an angle between them is a guess
        at = np.asarray(pulses)
        turned = np.sign(item.fit.speed) * TURN * np.arange(len(at))
    middle = float(at.mean())
    columns = np.column_stack([np.ones(len(at)), at - middle])
    if second is not None:
        columns = np.column_stack([columns, np.cos(second * at), np.sin(second * at)])
    best = np.linalg.lstsq(columns, turned, rcond=1e-9)[0]
    return best, middle, turned - columns @ best


def with_second(
    recording: Recording, runs: Sequence[RunHarmonics], second: Second
) -> tuple[tuple[RunHarmonics, ...], list[str]]:
    """Return runs with the combinations of a second frequency fitted, and ids of those it cannot be told apart in.

    Pulses of a shaft whose speed swings are too few to follow it at some speeds, and follow it at others: all runs are
    taken alike.
    """
    kept, lost = [], []
    orders = np.array(second.orders)
    with one_thread():
        for item in runs:
            signals = signals_of(recording, item)
            at = second.at(item.fit.speed)
            theta, std = _even(item, at) if second.even else (item.angle.theta, item.angle.std)
            fit = fit_harmonics(
                item.fit.run,
                item.run.time,
                theta,
                signals,
                dict(zip(item.fit.names, item.fit.units, strict=True)),
                orders=int(item.fit.orders[-1]),
                angle_std=std,
                stamp=item.fit.stamp,
                second=(at, orders),
                weights={recording.channels[c].name: np.asarray(w) for c, w in item.run.weights.items()},
                lost=item.lost / len(item.run.time),
                pickups=list(item.fit.pickups),
                hum=item.fit.hum,
            )
            assert fit.beside is not None
            if not fit.beside.told.all() or (second.swings and _twice(fit, float(np.ptp(item.run.time)))):
                lost.append(item.fit.run)
                continue
            kept.append(replace(item, fit=fit))
    return tuple(with_one_noise(kept)), lost


def _twice(fit: HarmonicFit, duration: float) -> bool:
    """Return whether twice or three times a swing's frequency adds to harmonics or combinations more than noise does.

    A swing m of the angle makes J_1(k m) = k m / 2 of order k at nu, and J_2(k m) = J_1^2 / 2 at 2 nu.
    """
    assert fit.beside is not None
    speed = abs(fit.speed) / TURN
    multiples = np.array(MULTIPLES[1:]) * fit.beside.second / TURN
    if (np.abs(multiples - speed * np.round(multiples / speed)) > NEAR / duration).all():
        return False
    own, beside = (np.abs(values).max(axis=0) for values in (fit.values[1:], fit.beside.values))
    return bool((beside**2 > 2 * own * fit.residual * np.sqrt(fit.beside.gram.max())).any())


def signals_of(recording: Recording, item: RunHarmonics) -> dict[str, np.ndarray]:
    """Return the samples of the channels that were fitted."""
    columns = {channel.name: c for c, channel in recording.channels.items() if c in item.run.values}
    return {name: np.asarray(item.run.values[columns[name]]) for name in item.fit.names}
