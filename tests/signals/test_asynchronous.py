"""A second frequency of lines that do not follow the shaft: found in closed-form signals, with honest uncertainty."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.signal import lfilter
from scipy.special import jv
from scipy.stats import chi2

from rotorsim.errors import Place
from rotorsim.recordings.recording import Channel, Recording, Run
from rotorsim.signals import asynchronous
from rotorsim.signals.asynchronous import Asynchronous, find_asynchronous, with_asynchronous
from rotorsim.signals.harmonic_fit import Samples, fit_harmonics
from rotorsim.signals.harmonics import RunHarmonics, harmonics_of
from tests.signals.test_harmonic_fit import std_of

TURN = 2 * np.pi
RATE, N = 2000.0, 2000
NOISE = 0.01
LEVEL = 1e-4  # significance of every statistical test; the seeds are fixed
FEW = 1  # draws of each case; as many as its statistics need are slow
SPEEDS = TURN * np.array([19.3, 27.7, 37.9, 52.3])
NU, RATIO = TURN * 31.17, 0.3137
CHANNELS = {axis: Channel(axis, "rotor.displacement", axis, None, None, "m") for axis in "xy"}
HARMONICS = np.array([[0.3, -0.2], [1 - 0.5j, 0.4 + 0.8j], [0.1j, 0.2], [0.05, -0.03j]])
LINES = {0: np.array([0.05, 0.03j]), 1: np.array([0.02 - 0.02j, 0.01 + 0.03j]), -1: np.array([0.01j, 0.025])}
Lines = Mapping[int, np.ndarray]


def pulses(angle, end: float) -> np.ndarray:
    """Return the times within [0, end] at which an angle of time passes whole turns."""
    ends = sorted((float(angle(0.0)), float(angle(end))))
    turns = np.arange(np.ceil(ends[0] / TURN), np.floor(ends[1] / TURN) + 1)
    return np.sort([brentq(lambda t, k=k: angle(t) - TURN * k, 0.0, end, xtol=1e-14) for k in turns])


def closed_form(theta: np.ndarray, harmonics: np.ndarray) -> np.ndarray:
    """Return sum over |k| <= K of c_k e^{i k theta}, (n, C)."""
    waves = sum(2 * (np.exp(1j * k * theta)[:, None] * harmonics[k]).real for k in range(1, len(harmonics)))
    return np.asarray(harmonics[0].real + waves)


def recording(signals: Sequence[np.ndarray], speeds: Sequence[float], tacho: Sequence[np.ndarray]) -> Recording:
    time = np.arange(len(signals[0])) / RATE
    runs = tuple(
        Run(f"run{r}", "", time, {"x": y[:, 0], "y": y[:, 1]}, speed, at, {}, "identify", Place("", r, 1), RATE)
        for r, (y, speed, at) in enumerate(zip(signals, speeds, tacho, strict=True))
    )
    return Recording("made", "closed form", Path(), CHANNELS, runs)


def made(
    lines: Lines,
    *,
    seed: int,
    speeds: Sequence[float] = SPEEDS,
    nu: float = NU,
    follows: bool = False,
    only: Sequence[int] | None = None,
    noise: float = NOISE,
) -> tuple[Recording, np.ndarray]:
    """Return runs with lines at k W + nu, and the phase of nu in each; only: the runs that have lines."""
    random = np.random.default_rng(seed)
    time = np.arange(N) / RATE
    phases = random.uniform(0, TURN, len(speeds))
    signals, tacho = [], []
    for r, (speed, phase) in enumerate(zip(speeds, phases, strict=True)):
        theta = speed * time + 0.7 * r
        y = closed_form(theta, HARMONICS) + noise * random.standard_normal((N, 2))
        second = (nu * abs(speed) if follows else nu) * time + phase
        for k, value in lines.items() if only is None or r in only else ():
            y += 2 * (np.exp(1j * (k * theta + second))[:, None] * value).real
        signals.append(y)
        tacho.append(pulses(lambda t, W=speed, r=r: W * t + 0.7 * r, time[-1]))
    return recording(signals, speeds, tacho), phases


def misses(
    found: Asynchronous, runs: Sequence[RunHarmonics], true: Mapping[str, np.ndarray], nu: float
) -> list[np.ndarray]:
    """Return what the lines of each run are off, (L, C); a small error of nu turns them about the middle of a run."""
    out = []
    for item in runs:
        beside = item.fit.beside
        assert beside is not None
        turn = (found.value - nu) * (abs(item.fit.speed) if found.follows else 1.0)
        out.append(beside.values * np.exp(0.5j * turn * item.run.time[-1]) - true[item.run.id])
    return out


def chi_squared(errors: np.ndarray, item: RunHarmonics) -> float:
    """Return e^T C^-1 e of errors (L, C) with the covariance of the lines."""
    e = np.concatenate([np.concatenate([line.real, line.imag]) for line in errors])
    return float(e @ np.linalg.solve(item.fit.covariance_beside(np.arange(2), 0.0), e))


def assert_chi_squared(total: float, count: int) -> None:
    low, high = chi2.ppf([LEVEL / 2, 1 - LEVEL / 2], count)
    assert low < total < high


CASES = {  # lines, nu, whether it follows the speed, direction of rotation, draws
    "constant": (LINES, NU, False, 1, 20),
    "follows": (LINES, RATIO, True, 1, 20),
    "backward": ({k: LINES[k] for k in (0, 1)}, NU, False, -1, 5),
    "follows backward": ({k: LINES[k] for k in (0, -1)}, RATIO, True, -1, 5),
}


@cache
def found_in(
    case: str, draws: int
) -> list[tuple[Asynchronous | None, tuple[RunHarmonics, ...], list[str], np.ndarray]]:
    """Return for every draw the second frequency, the runs fitted with it, those lost, and the true phases."""
    lines, nu, follows, direction, _ = CASES[case]
    out = []
    for seed in range(draws):
        data, phases = made(lines, seed=seed, speeds=direction * SPEEDS, nu=nu, follows=follows)
        runs = harmonics_of(data)
        second = find_asynchronous(data, runs)
        out.append((second, *(((), []) if second is None else with_asynchronous(data, runs, second)), phases))
    return out


def off(case: str, draws: int) -> np.ndarray:
    """Return what the second frequency is off in every draw, in its standard deviations."""
    return np.array([(second.value - CASES[case][1]) / second.std for second, *_ in found_in(case, draws)])


DRAWN = pytest.mark.parametrize(
    ("case", "draws"),
    [("follows backward", FEW)] + [pytest.param(case, CASES[case][-1], marks=pytest.mark.slow) for case in CASES],
)


@pytest.mark.slow
@DRAWN
def test_the_frequency_is_found(case, draws):
    lines, _, follows, _, _ = CASES[case]
    for second, _, lost, _ in found_in(case, draws):
        assert second is not None
        assert (second.follows, second.orders, lost) == (follows, tuple(sorted(lines)), [])
    assert np.abs(off(case, draws)).max() < 3


@pytest.mark.slow
@pytest.mark.parametrize("case", ["constant", "follows"])
def test_its_deviation_is_honest(case):
    assert 0.6 < np.sqrt(np.mean(off(case, CASES[case][-1]) ** 2)) < 1.5


@pytest.mark.slow
def test_the_deviation_is_the_least_that_is_possible():
    """Cramer-Rao: var nu = 24 sigma^2 / (T^2 N sum of squared amplitudes). Source: Kay (1993), section 3.11."""
    second = found_in("constant", FEW)[0][0]
    amplitudes = np.concatenate([2 * np.abs(value) for value in LINES.values()])
    least = np.sqrt(24 * NOISE**2 / ((N / RATE) ** 2 * N * len(SPEEDS) * (amplitudes**2).sum()))
    assert second.std == pytest.approx(least, rel=0.05)  # harmonics near by and the scatter of the noise: 1 %


@pytest.mark.slow
@DRAWN
def test_amplitudes_are_right_within_their_noise(case, draws):
    lines, nu, *_ = CASES[case]
    total, count = 0.0, 0
    for second, runs, _, phases in found_in(case, draws):
        true = {
            f"run{r}": np.array([lines[k] for k in second.orders]) * np.exp(1j * phase)
            for r, phase in enumerate(phases)
        }
        for item, errors in zip(runs, misses(second, runs, true, nu), strict=True):
            total += chi_squared(errors, item)
            count += 2 * errors.size
    assert_chi_squared(total, count)


@pytest.mark.slow
def test_a_line_hidden_by_a_stronger_one_is_found():
    """With little noise a strong line hides all within 40 lines of the spectrum."""
    data, _ = made({0: 10 * LINES[0], 1: LINES[1], -1: LINES[-1]}, seed=3, noise=1e-3)
    runs = harmonics_of(data)
    assert all(len(item.fit.lines) < 3 for item in runs)
    assert find_asynchronous(data, runs).orders == (-1, 0, 1)


# --- nothing to be found ----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_noise_has_no_second_frequency():
    found = [made({}, seed=100 + seed)[0] for seed in range(10)]
    assert sum(find_asynchronous(data, harmonics_of(data)) is not None for data in found) <= 1


@pytest.mark.slow
def test_lines_of_one_run_are_no_second_frequency():
    for seed in range(5):
        one = (0, 2, 3)[seed % 3]
        data, _ = made(LINES, seed=seed, only=[one])
        runs = harmonics_of(data)
        assert [bool(item.fit.lines) for item in runs] == [r == one for r in range(4)]
        assert find_asynchronous(data, runs) is None


@pytest.mark.slow
def test_runs_in_which_a_line_is_too_near_to_a_harmonic_are_lost():
    """Nearer than one and a half lines of the spectrum, which are 1 Hz apart."""
    near, far = (NU + TURN * 1.2) / 2, (NU + TURN * 1.8) / 2
    for speed, expected in ((near, ["run2"]), (far, [])):
        data, _ = made({0: LINES[0]}, seed=1, speeds=[*SPEEDS[:2], speed])
        runs = harmonics_of(data)
        second = find_asynchronous(data, runs)
        assert abs(second.value - NU) < 4 * second.std
        kept, lost = with_asynchronous(data, runs, second)
        assert lost == expected
        assert [item.run.id for item in kept] == [f"run{r}" for r in range(3 - len(expected))]


def test_a_frequency_that_no_run_resolves_is_none(monkeypatch):
    """FAULT: hum next to harmonics of all runs of a healthy beam ended its diagnosis with an error of min()."""
    data, _ = made(LINES, seed=1)
    monkeypatch.setattr(asynchronous, "with_asynchronous", lambda data, runs, nu: ((), [item.run.id for item in runs]))
    assert find_asynchronous(data, harmonics_of(data)) is None


# --- a shaft whose speed swings ---------------------------------------------------------------------------------------


def swinging(
    nu: float,
    swing: float,
    seed: int,
    harmonics: np.ndarray = HARMONICS,
    noise: float = NOISE,
    speeds: Sequence[float] = SPEEDS,
) -> tuple[Recording, np.ndarray]:
    """Return runs that are harmonics of theta = W t + theta0 + swing sin(nu t + phase), pulses at the true angle."""
    random = np.random.default_rng(seed)
    time = np.arange(N) / RATE
    phases = random.uniform(0, TURN, len(speeds))
    signals, tacho = [], []
    for r, (speed, phase) in enumerate(zip(speeds, phases, strict=True)):

        def theta(t, W=speed, r=r, phase=phase):
            return W * t + 0.7 * r + swing * np.sin(nu * t + phase)

        signals.append(closed_form(theta(time), harmonics) + noise * random.standard_normal((N, 2)))
        tacho.append(pulses(theta, time[-1]))
    return recording(signals, speeds, tacho), phases


@pytest.mark.parametrize("frequency", [23.17, *(pytest.param(f, marks=pytest.mark.slow) for f in (5.3, 7.7, 71.7))])
@pytest.mark.slow
def test_a_swinging_shaft_has_sidebands_of_bessel_functions(frequency):
    """e^{i m theta} = sum J_n(m swing) e^{i (m W t + n (nu t + phase))}: those of n = 1 stand beside order m.

    At 5.3 and 7.7 Hz a spline through the pulses follows the swing in the faster runs and not in the slower ones.
    """
    nu, swing = TURN * frequency, 0.03
    data, phases = swinging(nu, swing, seed=4)
    runs = harmonics_of(data)
    second = find_asynchronous(data, runs)
    assert not second.follows
    assert abs(second.value - nu) < 3 * second.std
    assert {-1, 1, -2, 2} <= set(second.orders) <= {-3, -2, -1, 1, 2, 3}
    kept, lost = with_asynchronous(data, runs, second)
    assert lost == []
    c = {m: HARMONICS[m] if m > 0 else HARMONICS[-m].conj() for m in second.orders}
    sidebands = np.array([jv(1, m * swing) * c[m] for m in second.orders])
    true = {f"run{r}": sidebands * np.exp(1j * phase) for r, phase in enumerate(phases)}
    errors = misses(second, kept, true, nu)
    assert_chi_squared(sum(map(chi_squared, errors, kept)), sum(2 * error.size for error in errors))
    carriers = jv(0, np.arange(4) * swing)[:, None] * HARMONICS  # at the even angle, which the swing does not turn
    for item in kept:
        std = std_of(item.fit)[:4]
        assert (np.abs((item.fit.values[:4] - carriers).real) < 5 * std.real).all()
        assert (np.abs((item.fit.values[1:4] - carriers[1:]).imag) < 5 * std[1:].imag).all()


# --- covariance -------------------------------------------------------------------------------------------------------


def noise(kind: str, random: np.random.Generator) -> np.ndarray:
    """Return noise (n, 2): white, across channels, late in one of them, or coloured."""
    w = random.standard_normal((N + 200, 2))
    if kind == "across":
        w = w @ np.array([[1.0, 0.8], [0.0, 0.3]])
    if kind == "late":  # what one channel sees comes three samples later in the other, beside noise of its own
        w = np.column_stack([w[:, 0], np.roll(w[:, 0], 3) + 0.3 * w[:, 1]])
    if kind == "coloured":
        w = lfilter([1], [1, -0.7], w, axis=0)
    return np.asarray(NOISE * w[200:])


@pytest.mark.parametrize(
    ("kind", "draws"), [pytest.param(k, 100, marks=pytest.mark.slow) for k in ("white", "across", "late", "coloured")]
)
def test_amplitudes_scatter_as_their_covariance_says(kind, draws):
    """Draws of the noise at a known frequency; every line on its own, as `covariance_beside` has them."""
    random = np.random.default_rng(7)
    time, speed = np.arange(N) / RATE, SPEEDS[1]
    clean = closed_form(speed * time, HARMONICS)
    for k, value in LINES.items():
        clean = clean + 2 * (np.exp(1j * (k * speed + NU) * time)[:, None] * value).real
    tacho = pulses(lambda t: speed * t, time[-1])
    data = recording([clean + noise(kind, random) for _ in range(draws)], [speed] * draws, [tacho] * draws)
    orders = (-1, 0, 1)
    kept, lost = with_asynchronous(data, harmonics_of(data), Asynchronous(NU, 0.0, False, orders))
    assert (len(kept), lost) == (draws, [])
    for k, order in enumerate(orders):
        part = slice(4 * k, 4 * k + 4)
        total = 0.0
        for item in kept:
            e = item.fit.beside.values[k] - LINES[order]
            block = item.fit.covariance_beside(np.arange(2), 0.0)[part, part]
            total += float(np.append(e.real, e.imag) @ np.linalg.solve(block, np.append(e.real, e.imag)))
        assert_chi_squared(total, 4 * draws)


def test_harmonics_of_higher_orders_than_are_fitted_are_no_second_frequency():
    time, random, signals, tacho = np.arange(N) / RATE, np.random.default_rng(5), [], []
    for speed in SPEEDS[:2]:
        high = dict.fromkeys((23, 24, 26), 0.4)
        theta = speed * time
        waves = sum(size * np.cos(k * theta + k) for k, size in high.items())
        y = closed_form(theta, HARMONICS) + waves[:, None] + NOISE * random.standard_normal((N, 2))
        signals.append(y)
        tacho.append(pulses(lambda t, speed=speed: speed * t, time[-1]))
    made_here = recording(signals, SPEEDS[:2], tacho)
    runs = harmonics_of(made_here, made_here.runs)
    assert all(item.fit.orders[-1] < 23 for item in runs)
    assert all(len(item.fit.lines) >= 3 for item in runs)
    assert find_asynchronous(made_here, runs) is None


def test_weak_lines_of_other_origin_do_not_hide_a_second_frequency():
    """Three runs show it strongly, and more weak lines that it does not explain (higher orders, noise)."""

    def shown(speed: float, *lines: tuple[float, float]) -> SimpleNamespace:
        found = [SimpleNamespace(frequency=at, amplitude=(size, 0.1 * size)) for at, size in lines]
        fit = SimpleNamespace(speed=2 * np.pi * speed, residual=np.array([1.0, 1.0]), lines=found)
        return SimpleNamespace(fit=fit, run=SimpleNamespace(time=np.array([0.0, 1.0])))

    nu, weak = 56.7, 0.1
    runs = [
        shown(15.2, (nu + 15.2, 1.0), (41.9, weak), (193.1, weak), (23.3, weak)),
        shown(24.9, (nu + 24.9, 0.6), (167.7, weak * 0.6), (9.1, weak * 0.6), (111.4, weak * 0.6)),
        shown(40.5, (nu + 40.5, 2.0), (178.9, weak * 2), (64.2, weak * 2)),
    ]
    found = asynchronous.frequency_of_lines(runs)
    assert found is not None
    assert found.value == pytest.approx(2 * np.pi * nu, rel=1e-9)
    alone = [shown(15.2, (71.9, 1.0), (41.9, 1.0)), shown(24.9, (33.3, 1.0), (167.7, 1.0), (9.1, 1.0), (111.4, 1.0))]
    assert asynchronous.frequency_of_lines(alone) is None


@pytest.mark.parametrize(("swing", "found"), [(2e-3, True), (0.0, False)])
def test_pulses_show_a_slow_swing_that_the_measured_angle_follows(swing, found):
    """theta = W t + swing sin(nu t): pulses lead by - swing / W sin(nu t), beside 1 us of jitter and a slow drift."""
    random, nu = np.random.default_rng(4), 2 * np.pi * 3.7

    def turned(speed: float) -> SimpleNamespace:
        even = np.arange(0.05, 1.0, 1 / speed)
        late = -swing / (2 * np.pi * speed) * np.sin(nu * even + speed) + 1e-3 * (even - 0.5) ** 2 / speed
        return SimpleNamespace(run=SimpleNamespace(tacho=even + late + 1e-6 * random.standard_normal(len(even))))

    runs = [turned(speed) for speed in (2.1, 15.3, 20.2, 31.4, 44.0, 63.0)]
    second = asynchronous.frequency_of_pulses(runs)
    assert (second is not None) is found
    if second is not None:
        assert second.value == pytest.approx(nu, rel=0.05)


@pytest.mark.slow
def test_pulses_that_only_jitter_show_no_swing():
    """A false alarm in about one of a thousand machines: in 300, more than three have a probability of 0.03 %."""
    random = np.random.default_rng(6)
    alarms = 0
    for _ in range(300):
        runs = []
        for speed in (15.3, 31.4, 44.0):
            even = np.arange(0.05, 1.0, 1 / speed)
            runs.append(SimpleNamespace(run=SimpleNamespace(tacho=even + 1e-6 * random.standard_normal(len(even)))))
        alarms += asynchronous.frequency_of_pulses(runs) is not None
    assert alarms <= 3


@pytest.mark.parametrize("timer", [0.0, *(pytest.param(t, marks=pytest.mark.slow) for t in (1e-7, 1e-5, 2e-4))])
def test_pulses_of_a_coarse_timer_show_no_swing(timer):
    """At an even speed their rounding repeats, at a frequency of its own in every run.

    With false alarms in a thousandth of machines, more than two of 200 have a probability of 0.1 %.
    """
    random = np.random.default_rng(8)
    alarms = 0
    for _ in range(200):
        runs = []
        for speed in random.uniform(8, 70, random.integers(2, 9)):
            even = np.arange(random.uniform(0, 1 / speed), 1.0, 1 / speed)
            pulses = timer * np.round(even / timer) if timer else even
            runs.append(SimpleNamespace(run=SimpleNamespace(tacho=pulses)))
        alarms += asynchronous.frequency_of_pulses(runs) is not None
    assert alarms <= 2


@pytest.mark.slow
def test_a_strong_slow_swing_of_many_harmonics_is_found():
    """Sidebands of orders 6 to 9 and of twice the frequency stand out of noise, and an angle by pulses follows most."""
    nu, harmonics = TURN * 3.1, np.array([[1.0, 1.0j]] * 10) / np.arange(1, 11)[:, None]
    data, _ = swinging(nu, 0.02, 7, harmonics, 1e-3, [*SPEEDS, TURN * 14.9, TURN * 30.3, TURN * 45.1])
    second = find_asynchronous(data, harmonics_of(data))
    assert second is not None
    assert second.even
    assert abs(second.value - nu) < 3 * second.std < 1e-2 * nu


def test_pulses_of_a_swinging_shaft_share_what_their_clock_leaves_open():
    """FAULT: their common delay was taken off a covariance that did not hold it, which had no root then."""
    data, _ = made(LINES, seed=4)
    coarse = 1e-4
    runs = [replace(run, tacho=coarse * np.ceil(run.tacho / coarse), tacho_resolution=coarse) for run in data.runs]
    data = replace(data, runs=tuple(runs))
    kept, _ = with_asynchronous(data, harmonics_of(data), Asynchronous(NU, 0.0, False, (-1, 0, 1), even=True))
    assert len(kept) == len(SPEEDS)
    for item in kept:
        fit = item.fit
        assert fit.stamp == pytest.approx(coarse / np.sqrt(6))
        assert fit.angle_std >= fit.stamp * abs(fit.speed)
        covariance = fit.covariance_at(np.arange(2), range(3), 1e-5, stamp=False)
        assert np.linalg.eigvalsh(covariance).min() > 0


def test_runs_in_which_twice_a_strong_swing_falls_on_harmonics_are_left_out():
    """A harmonic of 10 um with lines of 1 um beside it has lines of 50 nm at twice their distance: noise hides 5 nm."""

    def hidden(speed: float, nu: float, line: float) -> bool:
        beside = SimpleNamespace(second=TURN * nu, values=np.array([[line], [0.5j * line]]), gram=np.full(2, 1 / 5000))
        values, residual = np.array([[1.0], [1e-5j], [2e-6]]), np.array([5e-9 * np.sqrt(5000)])
        fit = SimpleNamespace(speed=-TURN * speed, values=values, residual=residual, beside=beside)
        return asynchronous.has_multiples(fit, 1.0)

    assert hidden(20.0, 50.4, 1e-6)  # 100.8 Hz is 5X
    assert hidden(20.0, 46.9, 1e-6)  # 140.7 Hz is 7X: twice the swing falls on its other side, 7X - 46.9 Hz
    assert not hidden(20.0, 50.4, 1e-7)
    assert not hidden(20.0, 53.9, 1e-6)


def test_a_combination_where_a_line_is_picked_up_is_not_told():
    """At 2 turns and 31.17 Hz: columns twice the same would end the diagnosis of a machine for one of its runs."""
    time = np.arange(N) / RATE
    y = {"y": np.cos(NU * time) + NOISE * np.random.default_rng(0).standard_normal(N)}
    for away, told in ((0.0, False), (1.4, False), (1.6, True)):  # lines of the spectrum; 1.5 are needed
        samples = Samples("run", time, TURN * 7.3 * time, y)
        found = fit_harmonics(samples, orders=2, second=(NU, np.array([0])), pickups=[NU / TURN + away])
        assert found.beside is not None
        assert found.beside.told.tolist() == [told]
