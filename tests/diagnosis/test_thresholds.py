"""Where small deciders turn over: each is driven with what is just below and just above a number stated here."""

from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pytest

from rotorsim.diagnosis.catalogue.insertion import Spot
from rotorsim.diagnosis.conclude.verdict import effect_of
from rotorsim.diagnosis.evidence.fit import Fit
from rotorsim.diagnosis.evidence.harmonic import drifts, pickups, stability
from rotorsim.diagnosis.evidence.harmonic.drifts import find_drifts, tells_drifts, with_drifts
from rotorsim.diagnosis.evidence.harmonic.evidence import HarmonicEvidence
from rotorsim.diagnosis.evidence.harmonic.open import settled_runs
from rotorsim.diagnosis.evidence.harmonic.pickups import find_pickups
from rotorsim.diagnosis.evidence.harmonic.residual import taken_at
from rotorsim.diagnosis.evidence.harmonic.scoring import standardised
from rotorsim.diagnosis.evidence.resonance.evidence import ResonanceEvidence
from rotorsim.diagnosis.search.candidates import Round
from rotorsim.diagnosis.search.selection import likely_places
from rotorsim.diagram.diagram import Free
from rotorsim.errors import Place, Problem
from rotorsim.identification.waveform.search import OutputErrorSearch
from rotorsim.signals.noise.noise import Noise
from tests.diagnosis.evidence.test_scoring import fitted_runs
from tests.diagnosis.test_selection import candidate
from tests.diagnosis.test_verdicts import ROWS

# --- parameters at their bounds ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(("low", "high"), [(-np.inf, 2.0), (2.0, np.inf), (-2.0, 2.0)])
@pytest.mark.parametrize(("off", "held"), [(0.0, True), (1.9e-9, True), (2.1e-9, False)])
def test_a_parameter_at_either_bound_takes_no_part_in_linear_theory(low, high, off, held):
    """Within 1e-9 of the bound: runs are judged as without it."""
    random = np.random.default_rng(2)
    J, residual = random.standard_normal((12, 2)), random.standard_normal(12)

    def judged(columns: np.ndarray, values: list[float], *bounds: tuple[float, float]):
        found = fitted_runs(residual, columns, [4, 4, 4])
        found.experiment.theta0 = np.array(values)
        for item, ends in zip(found.experiment.free, bounds, strict=True):
            item.low, item.high = ends
        return standardised(found)

    value = 2.0 - off if high == 2.0 else 2.0 + off
    found = judged(J, [0.3, value], (-np.inf, np.inf), (low, high))
    one, both = judged(J[:, :1], [0.3], (-np.inf, np.inf)), judged(J, [0.3, 0.0], *[(-np.inf, np.inf)] * 2)
    np.testing.assert_allclose(found, one if held else both, rtol=1e-12)
    assert np.abs(np.array(one) - both).max() > 0.01


class Straight(ResonanceEvidence):
    """Residuals that are ten times what four parameters are off what the data want: beyond a bound, or inside."""

    def _problem(self, document: object) -> tuple[list[Free], Callable[[np.ndarray], np.ndarray]]:
        ends = {"a": (0.0, 2.0), "b": (0.0, np.inf), "c": (1.0, 9.0), "d": (-9.0, 9.0)}
        free = [Free(name, name, 0, 1.5, "m", low, high, scale=1.0) for name, (low, high) in ends.items()]
        return free, lambda theta: 10 * (theta - [5.0, -0.5, 0.5, 3.0])


def test_a_fit_to_resonances_says_which_parameters_ended_at_a_bound():
    """Above, at zero, below; the search keeps a little off all of them."""
    found = Straight(None, (), None, {}, None, False, strong=(None, None), weak=()).fit({}, [[{}]])
    assert found.theta == pytest.approx([2.0, 0.0, 1.0, 3.0], abs=1e-6)
    assert found.at_bound.tolist() == [True, True, True, False]


def test_a_search_in_time_says_which_parameters_are_at_a_bound():
    search = SimpleNamespace(bounds=np.array([[0.0, -np.inf, 1.0], [np.inf, 2.0, 3.0]]))
    for theta, ended in (([0.0, 2.0, 2.0], [True, True, False]), ([1e-9, 1.9, 3.0], [False, False, True])):
        assert OutputErrorSearch.at_bound(search, np.array(theta)).tolist() == ended


# --- settled runs -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("left", "kept"), [((0.51, 0.51), False), ((0.49, 0.51), True), ((0.51, 0.49), True), ((0.0, 0.0), True)]
)
def test_a_run_is_left_out_where_half_of_all_its_signals_does_not_follow_the_shaft(left, kept):
    """One sensor that fails says nothing of the motion."""
    place = Place("recording.json", 1, 1)
    fit = SimpleNamespace(residual=2e-6 * np.array(left), rms=np.array([2e-6, 2e-6]))
    angle = SimpleNamespace(contradicted=False)
    item = SimpleNamespace(fit=fit, run=SimpleNamespace(id="a", place=place), angle=angle, lost=0)
    warnings: list[Problem] = []
    assert settled_runs([item], warnings, "used") == ((item,) if kept else ())
    assert [problem.subject for problem in warnings] == ([] if kept else ["run a"])
    angle.contradicted = True
    warnings.clear()
    assert settled_runs([item], warnings, "used") == ((item,) if kept else ())
    assert ["than its pulses say" in problem.what for problem in warnings] == [kept]


@pytest.mark.parametrize(("rate", "grows"), [(0.049, []), (0.051, [1])])
def test_a_motion_that_grows_by_a_tenth_over_a_run_is_not_settled(rate, grows):
    """Rates in 1/s, over windows of two seconds; the first run falls."""
    motion = SimpleNamespace(windows=np.array([2.0, 2.0]), growth=lambda _: np.array([-rate, rate]))
    experiment = SimpleNamespace(theta0=None, motion=motion)
    assert stability.unsettled(experiment) == grows


@pytest.mark.parametrize(
    ("second", "gain", "alike"), [(101.9, 1.0, True), (-101.9, 1.0, False), (102.1, 1.0, False), (100.0, 2.0, False)]
)
def test_runs_within_two_percent_of_a_speed_are_alike(second, gain, alike):
    """With the same settings: then anything explains them."""
    runs = [
        SimpleNamespace(fit=SimpleNamespace(speed=speed), run=SimpleNamespace(settings={"speed": speed, "KP": kp}))
        for speed, kp in ((100.0, 1.0), (second, gain))
    ]
    assert HarmonicEvidence(None, tuple(runs)).alike is alike


@pytest.mark.parametrize(("square", "orders"), [(15.9, {}), (16.1, {1: pytest.approx(np.sqrt(2 * 16.1))})])
def test_an_order_of_a_residual_has_a_size_where_noise_makes_any_once_in_a_thousand(square, orders):
    """Of three orders: chi-squared of two, 2 ln 3000 = 16.01."""
    likelihood = SimpleNamespace(
        orders=3, white_at=lambda r, order, columns: np.concatenate([columns.real, columns.imag])
    )
    D = np.zeros((1, 3, 1), complex)
    D[0, 1] = np.sqrt(square) * np.exp(0.3j)
    gain, sizes = taken_at(likelihood, D, np.ones((1, 3, 1, 1), complex))
    assert sizes == orders
    assert gain == pytest.approx(square - 2 * 2)  # two real numbers of two orders beside the mean


# --- places -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("more", "places"), [(9.1, {"rotor.force", "rotor.elsewhere"}), (9.3, {"rotor.force"})])
def test_places_are_listed_from_one_percent_on(more, places):
    """Odds of 99 to 1 are a criterion of 2 ln 99 = 9.19."""
    before = Fit({}, misfit=5000.0, rows=ROWS, equations=ROWS)
    here, there = candidate("rub", 900.0, 1), candidate("rub", 900.0 + more, 1)
    there.insertion.spot = Spot("rotor", "elsewhere")
    assert {str(spot) for spot in effect_of(here, Round(before, (here, there)), 0.0).spots} == places


@pytest.mark.parametrize(
    ("scale", "more", "sizes"), [(1.0, 0.009, [2]), (1.0, 0.011, [1, 1]), (5.0, 0.049, [2]), (5.0, 0.051, [1, 1])]
)
def test_places_whose_criteria_are_a_hundredth_apart_are_one_class(scale, more, sizes):
    """In units of the noise: odds of e^0.005, 1.005 to 1."""
    here, there = candidate("rub", 900.0, 1), candidate("rub", 900.0 + more, 1)
    there.insertion.spot = Spot("rotor", "elsewhere")
    places = likely_places((here, there), scale)
    assert [len(one.places) for one in places] == sizes
    assert sum(one.probability for one in places) == pytest.approx(1.0)
    assert likely_places((), scale) == ()


# --- lines that channels pick up --------------------------------------------------------------------------------------


def line(monkeypatch, shown: list[complex], mains: list[float], second: object = None) -> list[float]:
    """Return what is picked up of a line in two channels of one run, of noise one in every real and imaginary part.

    A force shows in both alike, (1, 1) / sqrt 2.
    """
    likelihood = SimpleNamespace(
        K=1,
        c=2,
        data=np.array([[[0, 0], [0, 0], shown]], complex),
        experiment=SimpleNamespace(predicted=["x", "i"]),
        white_at=lambda r, order, columns: np.concatenate([columns.real, columns.imag]),
    )
    transfer = np.zeros((1, 3, 2, 1), complex)
    transfer[0, 2, :, 0] = np.sqrt(0.5)
    opened = SimpleNamespace(likelihood=likelihood, places={"rotor.force": 0}, transfer=transfer)
    monkeypatch.setattr(pickups, "open_bounds", lambda *_: opened)
    monkeypatch.setattr(pickups, "find_mains", lambda *_: mains)
    monkeypatch.setattr(pickups, "with_asynchronous", lambda *_: ([None], []))
    run = SimpleNamespace(run=SimpleNamespace(time=np.linspace(0, 2, 9)))
    return find_pickups(Fit({}), HarmonicEvidence(None, (run,), second=second))


@pytest.mark.parametrize(("gain", "found"), [(13.7, [50.0]), (13.9, [])])
def test_mains_are_picked_up_unless_a_force_is_a_thousand_times_likelier(monkeypatch, gain, found):
    """2 ln 1000 = 13.82 of the criterion: one channel alone leaves half of |a|^2, the force nothing."""
    a = np.sqrt(2 * gain)
    assert line(monkeypatch, [a / np.sqrt(2)] * 2, [50.0]) == found


@pytest.mark.parametrize(("hertz", "found"), [(50.4, True), (50.6, False)])
def test_a_line_within_the_resolution_of_the_mains_is_theirs(monkeypatch, hertz, found):
    """Runs of two seconds tell frequencies 0.5 Hz apart; a line elsewhere is as likely a force beforehand."""
    second = SimpleNamespace(value=2 * np.pi * hertz, follows=False, orders=(0,))
    a = np.sqrt(2 * 6.0)
    picked = line(monkeypatch, [a / np.sqrt(2)] * 2, [50.0], second)
    assert picked == ([pytest.approx(hertz)] if found else [50.0])


@pytest.mark.parametrize(("left", "found"), [(1001.0, []), (1003.0, [83.0])])
def test_a_force_explains_nine_tenths_of_a_line(monkeypatch, left, found):
    """Of |a|^2 = 10004 in four real numbers 10000 are no noise; a force has two: 10004 - left - 2 > 9000."""
    a, b = np.sqrt(10004 - left), np.sqrt(left)
    second = SimpleNamespace(value=2 * np.pi * 83.0, follows=False, orders=(0,))
    assert (
        line(monkeypatch, [(a + b) / np.sqrt(2), (a - b) / np.sqrt(2)], [], second)
        == [pytest.approx(83.0)][: len(found)]
    )


# --- offsets that drift -----------------------------------------------------------------------------------------------


def drifting(monkeypatch, white: list[list[list[float]]], slow: list[list[float]] | None = None) -> dict[str, float]:
    """Return what drifts, of Legendre coefficients white (R, 2, 2) in standard deviations of the mean, here 0.1.

    slow: directions of slow states in the two channels.
    """

    class Known:
        def __init__(self, experiment: object) -> None: ...

        def response(self, theta: np.ndarray) -> SimpleNamespace:
            states = np.zeros((2, 0)) if slow is None else np.array(slow).T
            return SimpleNamespace(C=[np.eye(2)] * len(white), slow_states=lambda r: states)

    noise = Noise(4.0 * np.eye(2)[None], True, 400.0)  # of 400 samples: 0.1 in the mean
    runs = [SimpleNamespace(fit=SimpleNamespace(drift=0.1 * np.array(w), noise=noise, samples=400)) for w in white]
    experiment = SimpleNamespace(
        motion=SimpleNamespace(is_linear=True),
        predicted=["x", "y"],
        runs=runs,
        columns=[np.array([0, 1])] * len(runs),
        use_mean=np.array([True, True]),
        theta0=np.zeros(0),
    )
    monkeypatch.setattr(drifts, "Likelihood", Known)
    monkeypatch.setattr(drifts, "values_in", lambda document, values: document)
    return find_drifts(Fit({}), SimpleNamespace(load=lambda document: document, open=lambda diagram: experiment))


@pytest.mark.parametrize(("times", "found"), [(13.7, False), (13.9, True)])
@pytest.mark.parametrize("part", [0.0, 0.7])
def test_an_offset_drifts_by_noise_once_in_a_thousand_channels(monkeypatch, part, times, found):
    """Chi-squared of two, 2 ln 1000 = 13.82, of slope and bend over what white noise makes of them: 3 and 5.

    The size is that of the slope without what noise makes of it.
    """
    legendre = np.polynomial.legendre.legvander(np.linspace(-1, 1, 4001), 2)
    variance = np.diag(np.linalg.inv(legendre.T @ legendre)) * 4001  # over that of the mean
    slope, bend = np.sqrt(variance[1:] * np.array([1 - part, part]) * times)
    expected = {"x": pytest.approx(0.1 * np.sqrt(slope**2 - 3), rel=1e-3)} if found else {}
    assert drifting(monkeypatch, [[[slope, 0.0], [bend, 0.0]]]) == expected


@pytest.mark.parametrize(("times", "found"), [(18.4, False), (18.6, True)])
def test_runs_together_show_a_drift_that_none_shows_alone(monkeypatch, times, found):
    """Chi-squared of four with probability 0.001: 18.467."""
    each = [[0.0, np.sqrt(3 * times / 2)], [0.0, 0.0]]
    assert list(drifting(monkeypatch, [each, each])) == (["y"] if found else [])


@pytest.mark.parametrize(("slope", "found"), [(10.6, []), (10.8, ["x", "y"])])
def test_what_slow_states_leave_of_a_drift_may_be_any_channels(monkeypatch, slope, found):
    """Along (0.8, 0.6) nothing is told: of a slope in x 0.36 of its square is left, 0.12 of it over its variance."""
    assert list(drifting(monkeypatch, [[[slope, 0.0], [0.0, 0.0]]], [[0.8, 0.6]])) == found


def test_slow_states_of_one_channel_take_all_of_its_drift(monkeypatch):
    """But for 1e-10 of it, which is rounding; the rest is in the other channel."""
    assert list(drifting(monkeypatch, [[[1e7, 0.0], [0.0, 0.0]]], [[1.0, 1e-5]])) == ["y"]


@pytest.mark.parametrize(("times", "failure", "told"), [(1.99, "", True), (2.01, "", False), (0.0, "diverges", False)])
def test_a_diagram_that_leaves_twice_the_noise_does_not_tell_drifts(times, failure, told):
    assert tells_drifts(Fit({}, misfit=times * 1000, rows=1000, failure=failure)) is told


@dataclass(frozen=True)
class Some:
    """What stands for a run and its fit."""

    fit: object = None
    names: tuple[str, ...] = ("x", "y")
    hum: dict[int, np.ndarray] = field(default_factory=dict)


def test_a_mean_is_as_uncertain_as_a_walk_of_that_slope_makes_it():
    """A random walk from zero at the start, Cov = min(s, t): the variance of its mean over that of its slope, 10/9."""
    n = 600
    t = (np.arange(n) + 0.5) / n
    walk = np.minimum.outer(t, t)
    mean, slope = np.full(n, 1 / n), 3 * (2 * t - 1) / n
    ratio = (mean @ walk @ mean) / (slope @ walk @ slope)
    assert ratio == pytest.approx(10 / 9, rel=1e-3)
    [found] = with_drifts([Some(Some(hum={0: np.array([0.5, 0.5]), 2: np.ones(2)}))], {"y": 3.0})
    np.testing.assert_allclose(found.fit.hum[0], [0.5, 0.5 + 9 * ratio], rtol=1e-3)
    np.testing.assert_allclose(found.fit.hum[2], [1.0, 1.0])
