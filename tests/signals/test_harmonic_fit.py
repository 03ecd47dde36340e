"""Harmonics of measured signals: exact on clean data, with the covariance that noise gives them, and lines."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter
from scipy.stats import binom, chi2, norm

from rotorsim.errors import RotorsimError
from rotorsim.signals.covariance import complex_values, real_vector, scaled_cholesky
from rotorsim.signals.harmonic_fit import HarmonicFit, Samples, fit_harmonics

RATE = 2000.0
TURN = 2 * np.pi
LEVEL = 1e-4  # significance of every statistical test; the seeds are fixed
MIX = np.array([[1.0, 0.8], [0.0, 0.3]])  # noise of the two channels: correlation 0.94


def signal(c: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Return sum over |k| <= K of c_k e^{i k theta}, (n, C), for c (K+1, C)."""
    waves = [2 * (np.exp(1j * k * theta)[:, None] * c[k]).real for k in range(1, len(c))]
    return np.asarray(c[0].real + sum(waves, np.zeros((len(theta), c.shape[1]))))


def harmonics(K: int, C: int = 2, seed: int = 5) -> np.ndarray:
    random = np.random.default_rng(seed)
    c = random.standard_normal((K + 1, C)) + 1j * random.standard_normal((K + 1, C))
    c[0] = c[0].real
    return np.asarray(c)


def fitted(time: np.ndarray, theta: np.ndarray, y: np.ndarray, *, orders: int | None = None, **named) -> HarmonicFit:
    signals = {f"s{k}": y[:, k] for k in range(y.shape[1])}
    return fit_harmonics(Samples("run1", time, theta, signals, **named), orders=orders)


def std_of(fit: HarmonicFit) -> np.ndarray:
    """Return the standard deviations of real and imaginary part of each harmonic, complex (K+1, C)."""
    return complex_values(np.sqrt(np.diag(fit.covariance)), len(fit.names))


def noise(kind: str, n: int, random: np.random.Generator) -> np.ndarray:
    """Return noise (n, 2): white, coloured (AR(1) with 0.7; a resonance), across channels, or late in one of them."""
    w = random.standard_normal((n + 200, 2))
    if kind in ("coloured", "coloured across"):
        w = lfilter([1], [1, -0.7], w, axis=0)
    if kind == "resonance":
        w = lfilter([1], [1, -1.6, 0.8], w, axis=0)
    if kind in ("across", "coloured across"):
        w = w @ MIX
    if kind == "late":  # what one channel sees comes three samples later in the other, beside noise of its own
        w = np.column_stack([w[:, 0], np.roll(w[:, 0], 3) + 0.3 * w[:, 1]])
    return w[200:]


def same_covariance(errors: np.ndarray, expected: np.ndarray) -> float:
    """Return the probability of errors (N, m), of mean zero, at least as far from N(0, expected).

    Likelihood ratio N (tr W - ln det W - m) of the whitened sample covariance W, with Bartlett's factor:
    Anderson, An Introduction to Multivariate Statistical Analysis (3rd ed.), section 10.8.
    """
    N, m = errors.shape
    z = np.linalg.solve(np.linalg.cholesky(expected), errors.T)
    W = z @ z.T / N
    ratio = N * (np.trace(W) - np.linalg.slogdet(W)[1] - m)
    return float(chi2.sf(ratio * (1 - (2 * m + 1 - 2 / (m + 1)) / (6 * N)), m * (m + 1) / 2))


# --- clean data -------------------------------------------------------------------------------------------------------


@settings(max_examples=20, deadline=None)
@given(
    turns=st.floats(3.0, 60.0),
    start=st.floats(-10, 10),
    sweep=st.floats(-0.05, 0.05),
    backward=st.booleans(),
    drift=st.tuples(st.floats(-1, 1), st.floats(-1, 1)),
    seed=st.integers(0, 1000),
)
def test_clean_signals_are_found_to_rounding(turns, start, sweep, backward, drift, seed):
    """Any window, speeds that drift, backward rotation, a mean that drifts as a parabola."""
    n, K = 2000, 5
    time = np.arange(n) / RATE
    u = 2 * time / time[-1] - 1
    theta = start + TURN * turns * (time / time[-1] + sweep * (u**2 - 1)) * (-1 if backward else 1)
    c = harmonics(K, seed=seed)
    y = signal(c, theta) + np.outer(u, drift) + np.outer(1.5 * u**2 - 0.5, drift[::-1])
    found = fitted(time, theta, y, orders=K)
    np.testing.assert_allclose(found.values, c, atol=1e-9)
    np.testing.assert_allclose(found.drift, [drift, drift[::-1]], atol=1e-9)
    assert found.speed == pytest.approx((theta[-1] - theta[0]) / time[-1], rel=1e-12)
    assert found.lines == ()
    assert (np.sqrt(np.diag(found.covariance)) < 1e-8).all()


def test_orders_that_are_not_asked_for_do_no_harm():
    time = np.arange(4000) / RATE
    theta = TURN * 23.37 * time
    c = harmonics(3)
    found = fitted(time, theta, signal(c, theta))
    assert found.orders.tolist() == list(range(17))
    np.testing.assert_allclose(found.values[:4], c, atol=1e-9)
    np.testing.assert_allclose(found.values[4:], 0, atol=1e-9)


def test_x_and_y_make_forward_and_backward_harmonics():
    """x + i y = sum R_k e^{i k theta}."""
    time = np.arange(3000) / RATE
    theta = TURN * 31.3 * time + 0.2
    R = {-2: 0.3 - 0.1j, -1: 0.5j, 0: 0.2 + 0.7j, 1: 1 - 1j, 2: -0.4 + 0j}
    z = sum(value * np.exp(1j * k * theta) for k, value in R.items())
    found = fit_harmonics(Samples("run1", time, theta, {"x": z.real, "y": z.imag}), orders=2)
    both = found.two_axis("x", "y")
    assert set(both) == set(R)
    for k, value in R.items():
        assert both[k] == pytest.approx(value, abs=1e-9)
    np.testing.assert_allclose(found.at(theta), np.column_stack([z.real, z.imag]), atol=1e-9)


@given(st.integers(1, 6), st.integers(1, 4), st.integers(0, 1000))
def test_real_vector_and_back(K, C, seed):
    c = harmonics(K, C, seed)
    vector = real_vector(c)
    assert vector.shape == ((2 * K + 1) * C,)
    np.testing.assert_array_equal(complex_values(vector, C), c)
    assert vector[C : 2 * C].tolist() == c[1].real.tolist()
    assert vector[2 * C : 3 * C].tolist() == c[1].imag.tolist()


# --- covariance -------------------------------------------------------------------------------------------------------


def test_covariance_of_some_channels_and_orders():
    """Entries by unit harmonics; the resolution of a channel is a share of its mean where that is above its rms."""
    time = np.arange(1500) / RATE
    theta = TURN * 31.3 * time
    c = harmonics(3, 3)
    c[0] = [0.0, 50.0, 0.1]
    random = np.random.default_rng(1).standard_normal((1500, 3))
    y = signal(c, theta) + 0.1 * (random + random[:, :1])  # correlated across the channels
    found = fitted(time, theta, y, orders=3, angle_std=1e-3)
    columns, orders = np.array([2, 1]), (2, 0)
    wanted = [(2, 2, 1), (2, 1, 1), (2, 2, 1j), (2, 1, 1j), (0, 2, 1), (0, 1, 1)]
    units = np.zeros((len(wanted), 4, 3), complex)
    for row, (k, channel, part) in enumerate(wanted):
        units[row, k, channel] = part
    pick = real_vector(units)
    expected = pick @ found.covariance @ pick.T
    np.testing.assert_allclose(found.covariance_at(columns, orders, 0.0), expected, rtol=1e-12, atol=1e-30)
    floor = found.covariance_at(columns, orders, 0.01) - expected
    size = np.tile([found.rms[2], abs(found.values[0, 1])], 3)
    assert found.rms[1] < size[1]
    np.testing.assert_allclose(floor, np.diag((0.01 * size) ** 2), rtol=1e-9, atol=1e-15)


def test_a_factor_of_a_covariance_of_small_and_large_numbers():
    """Standard deviations of 1e-150 to 1e120: what is factored is the correlation."""
    correlation = np.array([[1.0, 0.6, 0.2], [0.6, 1.0, -0.3], [0.2, -0.3, 1.0]])
    std = np.array([1e-150, 1.0, 1e120])
    scale, factor = scaled_cholesky(correlation * np.outer(std, std))
    np.testing.assert_allclose(scale, std, rtol=1e-14)
    assert (np.triu(factor, 1) == 0).all()
    np.testing.assert_allclose(factor @ factor.T, correlation, rtol=1e-14, atol=1e-15)


@pytest.mark.parametrize(
    ("n", "hertz", "draws"), [(2000, 23.37, 60), pytest.param(1500, 41.9, 300, marks=pytest.mark.slow)]
)
@pytest.mark.parametrize(
    "kind",
    ["white", "across", "late"]
    + [pytest.param(kind, marks=pytest.mark.slow) for kind in ("coloured", "coloured across", "resonance")],
)
def test_covariance_is_that_of_repeated_measurements(kind, n, hertz, draws):
    """The sample covariance of the errors against the mean of what the fits say.

    The window is not a whole number of turns, the mean and the speed drift. Kind "late": white in each channel, as
    behind a sampled controller, and correlated all the same.
    """
    K = 3
    time = np.arange(n) / RATE
    u = 2 * time / time[-1] - 1
    theta = TURN * hertz * time + 0.4 + 3.0 * time**2
    c = harmonics(K)
    clean = signal(c, theta) + np.outer(u, [0.5, -2]) + np.outer(u**2 - 1 / 3, [0.2, 1.0])
    errors, said = [], []
    for seed in range(draws):
        found = fitted(time, theta, clean + 0.3 * noise(kind, n, np.random.default_rng((7, seed))), orders=K)
        errors.append(real_vector(found.values - c))
        said.append(found.covariance)
    assert same_covariance(np.array(errors), np.mean(said, axis=0)) > LEVEL


@pytest.mark.slow
def test_covariance_with_an_uncertain_angle():
    """An error of angle zero turns harmonic k by k times that, in all channels together; its curve is below noise."""
    n, K, std = 1000, 2, 0.002
    time = np.arange(n) / RATE
    theta = TURN * 30 * time + 0.4
    c = harmonics(K)
    errors, said = [], []
    for seed in range(400):
        random = np.random.default_rng((8, seed))
        y = signal(c, theta + std * random.standard_normal()) + 0.02 * noise("across", n, random)
        found = fitted(time, theta, y, orders=K, angle_std=std)
        errors.append(real_vector(found.values - c))
        said.append(found.covariance)
    assert same_covariance(np.array(errors), np.mean(said, axis=0)) > LEVEL


def test_std_is_the_root_of_the_diagonal():
    time = np.arange(2000) / RATE
    theta = TURN * 25 * time
    y = signal(harmonics(3), theta) + noise("white", 2000, np.random.default_rng(0))
    found = fitted(time, theta, y, orders=3)
    diagonal = np.sqrt(np.diag(found.covariance)).reshape(-1, 2)
    np.testing.assert_allclose(std_of(found)[0].real, diagonal[0])
    np.testing.assert_allclose(std_of(found)[2], diagonal[3] + 1j * diagonal[4])
    # white noise of variance one: mean 1/n (drift marginalised: more), real and imaginary part 1/(2 n)
    np.testing.assert_allclose(std_of(found)[3].real, np.sqrt(1 / 4000), rtol=6 / np.sqrt(2 * 2000))


# --- lines ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "runs"), [("white", 50), *(pytest.param(k, 300, marks=pytest.mark.slow) for k in ("white", "coloured"))]
)
def test_noise_shows_no_more_lines_than_stated(kind, runs):
    """The stated chance of a false line is one in a thousand runs."""
    n = 1000
    time = np.arange(n) / RATE
    theta = TURN * 27.3 * time
    clean = signal(harmonics(3), theta)
    false = 0
    for seed in range(runs):
        found = fitted(time, theta, clean + 0.1 * noise(kind, n, np.random.default_rng((9, seed))), orders=5)
        false += bool(found.lines)
    assert false <= binom.isf(LEVEL, runs, 1e-3)


@pytest.mark.parametrize("hertz", [25.0, 27.3, 136.3 / 5])
@pytest.mark.parametrize("kind", ["white", "coloured"])
def test_a_line_that_does_not_follow_the_shaft(kind, hertz):
    """137.3 Hz: at order 5.49, between orders; at 5.03; and 1 Hz, two lines of the spectrum, beside order 5.

    Deviations of frequency and amplitude of a sine in noise: Rife and Boorstyn, IEEE Trans. Inf. Theory 20 (1974) 591.
    """
    n, K, amplitude, sigma = 4000, 5, np.array([0.2, 0.1]), 0.2
    time = np.arange(n) / RATE
    c = harmonics(4)
    theta = TURN * hertz * time + 0.3
    y = signal(c, theta) + np.outer(np.cos(TURN * 137.3 * time + 0.8), amplitude)
    phi = 0.7 if kind == "coloured" else 0.0
    e = noise(kind, n, np.random.default_rng(3)) * sigma * np.sqrt(1 - phi**2)
    found = fitted(time, theta, y + e, orders=K)
    (line,) = found.lines
    density = sigma**2 * (1 - phi**2) / abs(1 - phi * np.exp(-1j * TURN * 137.3 / RATE)) ** 2
    far = norm.isf(LEVEL / 2)
    grid = 0.15 * 0.75 / 12 * RATE / n  # half a step of the last grid of frequencies that is searched
    assert abs(line.frequency - 137.3) < far * np.sqrt(6 * density / n**3) / amplitude[0] * RATE / np.pi + grid
    assert line.order == pytest.approx(line.frequency / hertz)
    taken = sum(np.sinc((137.3 - k * hertz) * n / RATE) ** 2 for k in range(-K, K + 1))  # by the harmonics
    np.testing.assert_allclose(line.amplitude, amplitude, atol=far * np.sqrt(2 * density / n) + 0.2 * taken)
    far = norm.isf(LEVEL / 2 / found.values.size)
    off = found.values - np.concatenate([c, np.zeros((1, 2))])
    assert (np.abs(off.real) <= far * std_of(found).real).all()
    assert (np.abs(off.imag) <= far * np.maximum(std_of(found).imag, 1e-12)).all()


def test_several_lines_largest_first():
    n = 4000
    time = np.arange(n) / RATE
    theta = TURN * 25 * time
    lines = {50.9: 0.3, 137.3: 1.0, 410.1: 0.1}
    y = signal(harmonics(3), theta)[:, :1]
    y = y + sum(size * np.cos(TURN * hertz * time)[:, None] for hertz, size in lines.items())
    found = fitted(time, theta, y + 0.05 * noise("white", n, np.random.default_rng(0))[:, :1], orders=4)
    strong = [line for line in found.lines if line.amplitude[0] > 0.05]
    assert found.residual[0] == pytest.approx(0.05, rel=6 / np.sqrt(2 * n))
    assert sorted(round(line.frequency, 1) for line in strong) == [50.9, 137.3, 410.1]
    assert [round(line.frequency, 1) for line in strong] == [137.3, 50.9, 410.1]


# --- what cannot be fitted --------------------------------------------------------------------------------------------


def refused(n: int, turns: float, orders: int | None = None, bad: float | None = None) -> list[tuple[str, str, str]]:
    time = np.arange(n) / RATE
    y = np.sin(np.linspace(0, TURN * turns, n))[:, None] if n else np.zeros((0, 1))
    if bad is not None:
        y[n // 2] = bad
    with pytest.raises(RotorsimError) as error:
        fitted(time, np.linspace(0, TURN * turns, n), y, orders=orders)
    return [(problem.subject, problem.what, problem.hint) for problem in error.value.problems]


def test_less_than_a_turn():
    assert refused(500, 0.8) == [
        ("run run1", "only 0.8 turns of the shaft were recorded", "harmonics need at least one turn")
    ]
    assert refused(500, 0.0)[0][1] == "only 0 turns of the shaft were recorded"


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_samples_that_are_not_finite(bad):
    assert refused(500, 10, bad=bad) == [("run run1: s0", "1 sample is not finite, first at sample 251", "")]


def test_too_few_samples():
    assert refused(11, 3)[0][1] == "11 samples over 3.3 turns cannot carry a harmonic"
    assert refused(100, 90)[0][1] == "100 samples over 90.9 turns cannot carry a harmonic"
    assert refused(200, 20, orders=5)[0][1:] == (
        "order 5 cannot be told from 200 samples over 20.1 turns; at most 4",
        "fewer orders, or sample more often",
    )


@pytest.mark.parametrize("n", [0, 1, 2, 3])
def test_hardly_any_samples(n):
    assert refused(n, 5)[0][0] == "run run1"


def test_orders_that_alias_are_left_out():
    """Below half the sampling rate there is room for 0.45 n / turns orders."""
    time = np.arange(1000) / RATE
    found = fitted(time, TURN * 200.3 * time, np.cos(TURN * 200.3 * time)[:, None])
    assert found.orders[-1] == 4


@settings(max_examples=75, deadline=None)
@given(
    n=st.integers(0, 300),
    turns=st.floats(-50, 50),
    C=st.integers(1, 3),
    scale=st.sampled_from([0.0, 1e-300, 1e-12, 1.0, 1e6]),
    offset=st.sampled_from([0.0, 1.0, -1e9]),
    orders=st.none() | st.integers(0, 20),
    seed=st.integers(0, 100),
)
@example(n=258, turns=2.0, C=1, scale=0.0, offset=-1e9, orders=0, seed=0)  # what is left over is rounding
def test_whatever_comes_is_fitted_or_refused(n, turns, C, scale, offset, orders, seed):
    time = np.arange(n) / RATE
    y = scale * np.random.default_rng(seed).standard_normal((n, C)) + offset
    try:
        found = fitted(time, np.linspace(0, TURN * turns, n), y, orders=orders)
    except RotorsimError:
        return
    assert np.isfinite(found.values).all()
    assert np.isfinite(found.covariance).all()
    assert np.linalg.eigvalsh(found.covariance).min() > -1e-9 * np.abs(found.covariance).max()
