"""Asynchronous frequency: the one whose combinations with the speed explain the asynchronous lines of all runs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from math import tau

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.stats import binom, chi2

from rotorsim.jobs.threads import one_thread
from rotorsim.recordings.recording import Recording
from rotorsim.signals.angle_refinement import refined_angle
from rotorsim.signals.harmonic_basis import Basis, harmonic_basis
from rotorsim.signals.harmonic_fit import NEAR, HarmonicFit, fit_harmonics
from rotorsim.signals.harmonics import RunHarmonics, samples_of, with_one_noise
from rotorsim.signals.noise.lines import FEWEST_PERIODS, Spectrum, faint_line, spectrum_of
from rotorsim.signals.noise.whitening import FALSE_ALARM
from rotorsim.signals.shaft_angle import SLOPE, ShaftAngle

SIDEBANDS = 5  # combinations k W + nu with |k| up to this
MULTIPLES = (1, 2, 3)  # of the frequency, that a strong swing of the angle has
MISSES = 0.4  # of the resolution of a run, by which a line may miss its place
EXPLAINED = 0.7  # of the strongest lines, by their sizes, that one frequency must explain
STRONG = 6  # lines of a run that are looked at
DECISIVE = 10.0  # variances of the noise by which the residual of one angle says nothing against another
PULSES = 8  # of a run, at least, to see its speed swing
NO_SWING = 1e-12  # of the length of a run, or of a radian
MOVED = 2000  # times that spectra of pulses are moved against each other to see what coincides by chance
LESS = 0.98  # of the residual of a fit: then what the lines weigh against the noise is worth estimating again


@dataclass(frozen=True)
class Asynchronous:
    """An asynchronous frequency [rad/s], or its ratio to the speed where it follows that; std: of either.

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


def find_asynchronous(recording: Recording, runs: Sequence[RunHarmonics]) -> Asynchronous | None:
    """Return the asynchronous frequency of lines that at least two runs show, or of a swing of their pulses, or None.

    nu is taken as constant, or as a part of the speed: whichever explains more of the lines as |k W + nu|, with the
    smaller orders k. Lines too faint for one run are looked for in all runs together.
    """
    seen = frequency_of_lines(runs)
    swing = None if seen else frequency_of_pulses(runs)
    seen = seen or (None if swing else _frequency_of_spectra(recording, runs))
    nu = seen or swing
    if nu is None:
        return None
    with one_thread():
        for _ in range(4):
            nu = _refined(nu, recording, runs)
            fitted = {item.run.id: item for item in with_asynchronous(recording, runs, nu)[0]}
            if not fitted:  # its lines are at harmonics in every run
                return None
            hidden = _shown(nu, list(fitted.values()))
            again = [fitted.get(item.run.id, item) for item in runs]
            less = [(new.fit.residual < LESS * old.fit.residual).any() for new, old in zip(again, runs, strict=True)]
            if hidden <= set(nu.orders) and not any(less):
                break
            nu, runs = replace(nu, orders=tuple(sorted({*nu.orders, *hidden}))), again
    if seen is None and not nu.even:  # no swing of one frequency: the measured angle follows it better
        return None
    return _centred(nu, {float(np.sign(item.fit.speed)) for item in runs})


def frequency_of_lines(runs: Sequence[RunHarmonics]) -> Asynchronous | None:
    """Return the asynchronous frequency that explains most of the strongest lines, to their resolution."""
    lines = [(r, *line) for r, item in enumerate(runs) for line in _beside_harmonics(item)[:STRONG]]
    if len({r for r, _, _ in lines}) < 2:
        return None
    run, at, weight = (np.array(each) for each in zip(*lines, strict=True))
    speeds = np.array([item.fit.speed for item in runs])[run] / tau
    close = MISSES / np.array([item.run.time[-1] - item.run.time[0] for item in runs])[run]
    k, every = np.arange(-SIDEBANDS, SIDEBANDS + 1), float(weight.sum())
    ranked = []
    for follows in (False, True):
        unit = np.abs(speeds) if follows else np.ones(len(at))
        tried = np.unique(np.abs(at[:, None] - k * speeds[:, None]) / unit[:, None])
        for value in tried[tried > 0]:
            miss = np.abs(np.abs(k * speeds[:, None] + (value * unit)[:, None]) - at[:, None])
            order, missed = k[miss.argmin(axis=1)], miss.min(axis=1) / close
            good = missed < 1
            explained = float(weight[good].sum())
            if explained < EXPLAINED * every or len(set(run[good])) < 2:
                continue
            rank = explained - 0.2 * float(np.average(np.abs(order[good]), weights=weight[good])) * every
            own = (at * np.sign(order * speeds + value * unit) - order * speeds)[good] / unit[good]
            shown = {n: len(set(run[good & (order == n)])) for n in k.tolist()}
            orders = tuple(n for n in shown if shown[n] > 1) or tuple(n for n in shown if shown[n])
            nu = Asynchronous((1.0 if follows else tau) * float(np.median(own)), 0.0, follows, orders)
            ranked.append((rank, -float(missed[good].mean()), nu))
    return max(ranked, key=lambda item: item[:2])[2] if ranked else None


def _frequency_of_spectra(recording: Recording, runs: Sequence[RunHarmonics]) -> Asynchronous | None:
    """Return the frequency of a line that all runs show together, though none by itself."""
    with one_thread():
        line = faint_line(spectra_of(recording, runs), _all_orders(runs)[-1])
    if line is None:
        return None
    value, follows, orders = line
    return Asynchronous(value if follows else tau * value, 0.0, follows, orders)


def spectra_of(recording: Recording, runs: Sequence[RunHarmonics]) -> list[Spectrum]:
    """Return the spectra of the residuals of runs, whitened by the colour of their noise; none of those without."""
    made = [
        spectrum_of(
            item.run.time,
            _residual(recording, item, item.angle.theta)[1],
            item.fit.speed,
            int(item.fit.orders[-1]),
            item.fit.noise.colour,
        )
        for item in runs
    ]
    return [spectrum for spectrum in made if spectrum is not None]


def _residual(recording: Recording, item: RunHarmonics, theta: np.ndarray) -> tuple[Basis, np.ndarray]:
    """Return harmonics of an angle (n,) with the lines that are picked up, and the residual of the signals, (n, C)."""
    basis = harmonic_basis(item.fit.run, item.run.time, theta, orders=int(item.fit.orders[-1]))
    basis = basis.with_lines(item.run.time, item.fit.pickups)
    return basis, basis.solve(np.column_stack(list(samples_of(recording, item.run, item.angle).signals.values())))[1]


def frequency_of_pulses(runs: Sequence[RunHarmonics]) -> Asynchronous | None:
    """Return the frequency at which pulses of most runs swing about an even speed, by more than they jitter.

    An angle that follows the pulses takes lines of a slow swing away.
    """
    swings = []
    for item in _pulsed(runs):
        pulses = np.asarray(item.run.tacho)
        k = np.arange(len(pulses))
        early = pulses - np.polyval(np.polyfit(k, pulses, 2), k)
        size = float(np.sqrt(np.mean(early**2)))
        if size > NO_SWING * float(np.ptp(pulses)):
            swings.append((pulses - pulses.mean(), early / size))
    if len(swings) < 2:
        return None
    longest = max(float(np.ptp(t)) for t, _ in swings)
    rates = [len(t) / float(np.ptp(t)) for t, _ in swings]
    grid = np.arange(FEWEST_PERIODS / longest, 0.5 * min(rates), 0.2 / longest)
    if not len(grid):
        return None
    power = []
    for rate, (t, early) in zip(rates, swings, strict=True):  # over the whole rate, above which it repeats
        at = grid[0] + np.arange(0.0, rate, 0.2 / longest)
        power.append(np.abs(np.exp(-1j * tau * np.outer(at, t)) @ early) ** 2 * 2 / len(t))
    shared = int(np.ceil(EXPLAINED * len(swings)))

    def shown(moved: Sequence[int]) -> np.ndarray:
        parts = [np.roll(p, by)[: len(grid)] for p, by in zip(power, moved, strict=True)]
        return np.asarray(np.sort(parts, axis=0)[-shared])

    together = shown([0] * len(power))
    best = int(np.argmax(together))
    if binom.sf(shared - 1, len(swings), chi2.sf(together[best], 2)) > FALSE_ALARM / len(grid):
        return None
    random = np.random.default_rng(0)  # pulses of a coarse timer have strong lines, but others in every run
    moved = random.integers(0, [len(p) for p in power], (MOVED, len(power)))
    if sum(float(shown(by).max()) >= together[best] for by in moved) > FALSE_ALARM * MOVED:
        return None
    return Asynchronous(tau * float(grid[best]), 0.0, False, (-1, 1))


def _pulsed(runs: Sequence[RunHarmonics]) -> list[RunHarmonics]:
    """Return the runs with enough pulses to see their speed swing."""
    return [item for item in runs if item.run.tacho is not None and len(item.run.tacho) >= PULSES]


def _beside_harmonics(item: RunHarmonics) -> list[tuple[float, float]]:
    """Return lines that are no harmonics of higher orders than were fitted: frequency [Hz] and size.

    The size counts in the residual of a channel, and as a share of that of the strongest.
    """
    speed = abs(item.fit.speed) / tau
    close = MISSES / (item.run.time[-1] - item.run.time[0])
    scale = np.where(item.fit.residual > 0, item.fit.residual, np.inf)
    kept = [line for line in item.fit.lines if abs(line.frequency - speed * round(line.frequency / speed)) >= close]
    sizes = [float(np.max(np.asarray(line.amplitude) / scale)) for line in kept]
    return [(line.frequency, size / max(sizes)) for line, size in zip(kept, sizes, strict=True)]


def _centred(nu: Asynchronous, directions: set[float]) -> Asynchronous:
    """Return a frequency that follows the speed, known but for whole orders, so that its orders lie about zero."""
    if not nu.follows or len(directions) > 1:
        return nu
    (direction,) = directions
    choices = []
    for j in range(-SIDEBANDS, SIDEBANDS + 1):
        sign = 1 if nu.value + j > 0 else -1
        orders = tuple(sorted(int(sign * (k - j * direction)) for k in nu.orders))
        choices.append((sum(map(abs, orders)), sign * (nu.value + j), orders))
    _, value, orders = min(choices)
    return replace(nu, value=value, orders=orders)


def _shown(nu: Asynchronous, runs: Sequence[RunHarmonics]) -> set[int]:
    """Return further orders that lines of at least two runs are at: stronger lines near them hid them before."""
    k = np.array(_all_orders(runs))
    seen: list[int] = []
    for item in runs:
        close = MISSES / (item.run.time[-1] - item.run.time[0])
        places = np.abs(k * item.fit.speed + nu.at(item.fit.speed)) / tau
        misses = [np.abs(places - frequency) for frequency, _ in _beside_harmonics(item)]
        seen += {int(k[miss.argmin()]) for miss in misses if miss.min() < close}
    return {order for order in seen if seen.count(order) > 1}


def _all_orders(runs: Sequence[RunHarmonics]) -> range:
    """Return the orders of either sign that all runs have."""
    highest = min(int(item.fit.orders[-1]) for item in runs)
    return range(-highest, highest + 1)


def _refined(nu: Asynchronous, recording: Recording, runs: Sequence[RunHarmonics]) -> Asynchronous:
    """Return an asynchronous frequency where its combinations hold most power in all runs, with its std."""
    measured = fitted_frequency(replace(nu, even=False), recording, runs)
    even = fitted_frequency(replace(nu, even=True), recording, runs)
    if abs(even[1].value - nu.value) > even[1].std:  # the swing that was taken out was one at the first value
        even = fitted_frequency(even[1], recording, runs)
    by_pulses = _by_pulses(even[1], runs)
    if by_pulses is not None:  # pulses that do not swing have a frequency of their own
        left = _misfit(by_pulses, recording, runs)(by_pulses.value, _all_orders(runs), MULTIPLES)
        even = (left, by_pulses) if left < even[0] - DECISIVE else even
    return even[1] if even[0] < measured[0] + DECISIVE else measured[1]


def _by_pulses(nu: Asynchronous, runs: Sequence[RunHarmonics]) -> Asynchronous | None:
    """Return the frequency near a first value at which the pulses of all runs swing, by maximum likelihood.

    None where they swing by no more than noise makes them.
    """
    having = _pulsed(runs)
    if not having:
        return None

    def unlikely(residuals: Iterable[np.ndarray]) -> float:
        return float(sum(len(left) * np.log(np.mean(left**2) + NO_SWING**2) for left in residuals))

    def cost(value: float) -> float:
        return unlikely(_swing(item, replace(nu, value=value).at(item.fit.speed))[2] for item in having)

    at, curvature = _least(cost, nu, having)
    if unlikely(_swing(item, None)[2] for item in having) - cost(at) < chi2.isf(FALSE_ALARM, 2 * len(having)):
        return None
    return replace(nu, value=at, std=float(np.sqrt(2 / max(curvature, 1e-300))))


def _least(cost: Callable[[float], float], nu: Asynchronous, runs: Sequence[RunHarmonics]) -> tuple[float, float]:
    """Return where a function of the frequency is least, near a first value, and its second derivative there."""
    scale = float(np.median([abs(item.fit.speed) for item in runs])) if nu.follows else 1.0
    width = 0.5 * tau / max(float(item.run.time[-1] - item.run.time[0]) for item in runs) / scale
    bounds = (nu.value - width, nu.value + width)
    at = float(minimize_scalar(cost, bounds=bounds, method="bounded", options={"xatol": 1e-6 * width}).x)
    step = 0.05 * width
    return at, float((cost(at + step) - 2 * cost(at) + cost(at - step)) / step**2)


def fitted_frequency(
    nu: Asynchronous, recording: Recording, runs: Sequence[RunHarmonics]
) -> tuple[float, Asynchronous]:
    """Return the frequency near a first value with the least residual, and that residual, in variances of the noise.

    The latter with all combinations and multiples: a measured angle that follows a swing takes them all away.
    """
    misfit = _misfit(nu, recording, runs)
    at, curvature = _least(misfit, nu, runs)
    std = float(np.sqrt(2 / max(curvature, 1e-300)))
    return misfit(at, _all_orders(runs), MULTIPLES), replace(nu, value=at, std=std)


def _misfit(nu: Asynchronous, recording: Recording, runs: Sequence[RunHarmonics]) -> Callable[..., float]:
    """Return the residual of harmonics and combinations, in variances of the noise, as a function of the frequency."""
    parts = []
    for item, angle in zip(runs, _angles(recording, runs, nu), strict=True):
        time, theta = item.run.time, angle.theta
        basis, left = _residual(recording, item, theta)
        scale = abs(item.fit.speed) if nu.follows else 1.0
        own = [np.exp(1j * k * theta) for k in nu.orders]
        left = left / np.maximum(item.fit.residual, 1e-300)
        parts.append((scale * (time - time.mean()), theta, own, basis, left))
    every = sum(float((left**2).sum()) for *_, left in parts)

    def misfit(value: float, orders: Sequence[int] = nu.orders, multiples: Sequence[int] = (1,)) -> float:
        total = every
        for time, theta, own, basis, left in parts:
            swings = [np.exp(1j * m * value * time) for m in multiples]
            turns = own if orders is nu.orders else (np.exp(1j * k * theta) for k in orders)
            waves = [turn * swing for turn in turns for swing in swings]
            columns = np.column_stack([part for wave in waves for part in (wave.real, wave.imag)])
            onto = columns.T @ left  # of which the basis explains nothing
            total -= float((onto * np.linalg.lstsq(basis.left_of(columns), onto, rcond=1e-9)[0]).sum())
        return total

    return misfit


def _angles(recording: Recording, runs: Sequence[RunHarmonics], nu: Asynchronous) -> list[ShaftAngle]:
    """Return the angles of runs: as measured, or of a shaft that turns evenly but for a swing, without the swing.

    Those are refined by the harmonics, as every angle of pulses is; the pulses of all runs jitter by one time.
    """
    if not nu.even:
        return [item.angle for item in runs]
    swings = [_swing(item, nu.at(item.fit.speed)) for item in runs]
    free = sum(max(len(left) - len(best), 0) for best, _, left in swings)
    late = [left / item.fit.speed for item, (best, _, left) in zip(runs, swings, strict=True) if len(left) > len(best)]
    jitter = float(np.sqrt(sum(float(each @ each) for each in late) / max(free, 1)))
    angles = []
    for item, (best, middle, left) in zip(runs, swings, strict=True):
        time, size, n = item.run.time, abs(item.fit.speed) * jitter, len(left)
        smooth = float(np.hypot(SLOPE * size / np.sqrt(n), item.angle.alike))
        theta = np.asarray(best[0] + best[1] * (time - middle))
        angle = replace(item.angle, theta=theta, jitter=size, smooth=smooth, contradicted=False)
        if angle.pulses:
            signals = np.column_stack(list(samples_of(recording, item.run, angle).signals.values()))
            basis = harmonic_basis(item.fit.run, time, theta, orders=int(item.fit.orders[-1]))
            angle = refined_angle(time, angle, signals, basis)[0]
        angles.append(angle)
    return angles


def _swing(item: RunHarmonics, nu: float | None) -> tuple[np.ndarray, float, np.ndarray]:
    """Return angle, speed and swing (4,) that fit the pulses of a run, the time they count from, and the residual.

    nu: frequency of the swing [rad/s]; None: there is none.
    """
    at, turned = item.run.time, item.angle.theta
    pulses = item.run.tacho
    if pulses is not None and len(pulses) > 6:  # they are right where an angle between them is a guess
        at, turned = pulses, np.sign(item.fit.speed) * tau * np.arange(len(pulses))
    middle = float(at.mean())
    waves = [] if nu is None else [np.cos(nu * at), np.sin(nu * at)]
    columns = np.column_stack([np.ones(len(at)), at - middle, *waves])
    best = np.linalg.lstsq(columns, turned, rcond=1e-9)[0]
    return best, middle, turned - columns @ best


def with_asynchronous(
    recording: Recording, runs: Sequence[RunHarmonics], nu: Asynchronous
) -> tuple[tuple[RunHarmonics, ...], list[str]]:
    """Return runs with the combinations of an asynchronous frequency fitted, and ids of those that do not resolve it.

    Pulses of a shaft whose speed swings are too few to follow it at some speeds, and follow it at others: all runs are
    taken alike.
    """
    kept, lost = [], []
    with one_thread():
        for item, angle in zip(runs, _angles(recording, runs, nu), strict=True):
            fit = fit_harmonics(
                samples_of(recording, item.run, angle, item.lost),
                orders=int(item.fit.orders[-1]),
                second=(nu.at(item.fit.speed), np.array(nu.orders)),
                pickups=list(item.fit.pickups),
                hum=item.fit.hum,
            )
            assert fit.beside is not None
            if not fit.beside.told.all() or (nu.swings and has_multiples(fit, float(np.ptp(item.run.time)))):
                lost.append(item.fit.run)
            else:
                kept.append(replace(item, fit=fit))
    return tuple(with_one_noise(kept)), lost


def has_multiples(fit: HarmonicFit, duration: float) -> bool:
    """Return whether twice or three times a swing's frequency adds to harmonics or combinations more than noise does.

    A swing m of the angle makes J_1(k m) = k m / 2 of order k at nu, and J_2(k m) = J_1^2 / 2 at 2 nu.
    """
    assert fit.beside is not None
    speed = abs(fit.speed) / tau
    multiples = np.array(MULTIPLES[1:]) * fit.beside.second / tau
    if (np.abs(multiples - speed * np.round(multiples / speed)) > NEAR / duration).all():
        return False
    own, beside = (np.abs(values).max(axis=0) for values in (fit.values[1:], fit.beside.values))
    return bool((beside**2 > 2 * own * fit.residual * np.sqrt(fit.beside.gram.max())).any())
