"""What the data determine, what only in combination, why; which experiment would help; priors and profiles."""

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom, norm

from rotorsim.diagram.diagram import Diagram, Free
from rotorsim.identification.files import identification_data
from rotorsim.identification.harmonic.estimate import Search, estimate
from rotorsim.identification.harmonic.profile import joint_factor, profile_intervals
from rotorsim.identification.identification import identify
from rotorsim.identification.result import Identification, Identified
from rotorsim.identification.verdict import Combination, relative_width
from rotorsim.recordings.recording import Recording
from rotorsim.signals.harmonics import harmonics_of
from tests.identification import MAKERS, RATE, TRUTH, changed, free, made, recorded, shipped
from tests.identification.test_likelihood import LEVEL, at, likelihood_of, two_gains
from tests.reference.recordings import LOWER, THESIS_GAINS, UPPER, RecordedRun, Truth

THESIS = Truth()
Z90 = 1.644854  # standard deviations of a normal distribution
K_S, K_I = "force_displacement_factor", "force_current_factor"


def upper(seed: int = 0, gains: int = 1, profile: bool = True) -> Identification:
    """Return the identification in the upper range of chapter 2 under 5 % white noise."""
    maker = made if gains == 1 else two_gains
    speeds = UPPER["jeffcott"][:: 1 if profile else 2]
    recording = recorded(maker("jeffcott", speeds, THESIS, level=0.05, seed=seed))
    harmonics = None if profile else harmonics_of(recording, orders=7)
    return identify(shipped("jeffcott"), recording, profile=profile, harmonics=harmonics)


def true_combination(combination: Combination) -> float:
    return sum(factor * THESIS[name] for name, factor in combination.factors.items())


@pytest.fixture(scope="module")
def one_set() -> Identification:
    return upper()


# --- one set of gains -------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_one_set_of_gains_leaves_k_s_open(one_set):
    """i = K_P u + K_D u' in all but the mean: k_s, c and k_i act alike; thesis facts, "does not hold", 6."""
    item = one_set.parameters[K_S]
    assert one_set.adequate
    assert K_S in one_set.open
    assert not item.verdict.identifiable
    assert {K_I, "viscous_damping"} >= set(item.verdict.partners) >= {K_I}
    assert K_I in item.verdict.reason
    assert item.verdict.reason.startswith(f"cannot be told from {K_I}")
    assert K_S in one_set.statement
    assert item.verdict.reason in one_set.statement
    low, high = item.interval90
    assert (high - low) / 2 / item.value > 0.05
    assert {"crack_stiffness", "crack_phase", "eccentricity", "unbalance_phase"}.isdisjoint(one_set.open)


@pytest.mark.slow
def test_the_combination_is_the_stiffness_of_the_loop(one_set):
    """k_s - K_P k_i is what the motion shows; K_D k_i / c enters beside it."""
    combination = one_set.parameters[K_S].verdict.combination
    assert combination.factors[K_S] == 1.0
    assert combination.factors[K_I] == pytest.approx(-THESIS_GAINS[0], rel=0.05)
    assert combination.unit == "N/m"
    assert Z90 * combination.std < 0.01 * abs(combination.value)
    assert combination.std < 0.2 * one_set.parameters[K_S].std
    assert combination.expression in one_set.parameters[K_S].verdict.reason


@pytest.mark.slow
def test_the_combination_holds_the_truth_as_often_as_stated():
    """20 seeds, 90 %; and the parameter itself."""
    seeds = 20
    held, alone = 0, 0
    for seed in range(seeds):
        item = upper(seed, profile=False).parameters[K_S]
        combination = item.verdict.combination
        assert combination is not None
        held += abs(true_combination(combination) - combination.value) <= Z90 * combination.std
        alone += item.interval90[0] <= THESIS[K_S] <= item.interval90[1]
    low, high = binom.ppf([LEVEL / 2, 1 - LEVEL / 2], seeds, 0.9)
    assert low <= held <= high
    assert low <= alone <= high


@pytest.mark.slow
def test_a_second_set_of_gains_settles_it():
    found = upper(gains=2)
    assert found.adequate
    assert found.open == ()
    assert found.advice == ()
    assert found.parameters[K_S].verdict.combination is None
    assert found.parameters[K_S].interval90[0] < THESIS[K_S] < found.parameters[K_S].interval90[1]
    assert found.statement.startswith("7 of 7 parameters are identified: viscous_damping, crack_stiffness,")


# --- the next experiment ----------------------------------------------------------------------------------------------


def with_sigma(run: RecordedRun, sigma: dict[str, float], seed: tuple[int, ...]) -> RecordedRun:
    random = np.random.default_rng(seed)
    columns = {c: v + sigma[c] * random.standard_normal(len(v)) for c, v in run.columns.items()}
    return replace(run, columns=columns)


@pytest.mark.slow
def test_the_advice_keeps_its_promise():
    """The standard deviations that other gains promise are those that the experiment then gives, within 20 %.

    The promise stands on an estimate that is off by some of its standard deviations. The noise of the added runs is
    that of those at hand.
    """
    clean = [MAKERS["jeffcott"](THESIS, speed, rate=RATE) for speed in UPPER["jeffcott"]]
    sigma = {c: 0.05 * float(np.sqrt(np.mean(clean[0].columns[c] ** 2))) for c in clean[0].columns}
    runs = [with_sigma(run, sigma, (1, k)) for k, run in enumerate(clean)]
    before = identify(shipped("jeffcott"), recorded(runs))
    assert K_S in before.open
    best = before.advice[0]
    assert K_S in best.solves
    assert best.change in before.statement
    gains = dict(zip(("KP", "KI", "KD"), THESIS_GAINS, strict=True))
    units = {"kA/m": 1e3, "A/m": 1.0, "A s/m": 1.0, "kA s/m": 1e3, "A/(m s)": 1.0, "kA/(m s)": 1e3}
    changes = re.findall(r"controller\.(K[PID]) = ([\d.]+) ([^,]+)", best.change)
    assert changes
    for name, number, unit in changes:
        gains[name] = float(number) * units[unit.strip()]
    added = [MAKERS["jeffcott"](THESIS, speed, tuple(gains.values()), rate=RATE) for speed in UPPER["jeffcott"]]
    runs += [with_sigma(run, sigma, (2, k)) for k, run in enumerate(added)]
    after = identify(shipped("jeffcott"), recorded(runs), profile=False)
    std = [item.std for item in after.parameters.values()]
    np.testing.assert_allclose(best.std, std, rtol=0.2)
    assert all(after.parameters[name].verdict.identifiable for name in best.solves)


@pytest.mark.slow
def test_advice_when_nothing_would_help():
    """Mass times eccentricity is one number, whatever is measured: no change may promise to tell them apart."""
    names = {item.name: {} for item in shipped("jeffcott").free}
    diagram = free("jeffcott", **names, unbalance__mass={})
    found = identify(diagram, recorded(two_gains("jeffcott", LOWER["jeffcott"][::4], level=1e-3)))
    assert set(found.open) == {"eccentricity", "unbalance.mass"}
    assert found.advice == ()
    assert "No change of gains, speeds, length or excitation that was tried would determine them." in found.statement
    item = found.parameters["eccentricity"]
    assert item.verdict.partners == ("unbalance.mass",)
    # d(m e) = m de + e dm: the linear combination that is known
    known = item.verdict.combination.factors["unbalance.mass"]
    assert known == pytest.approx(item.value / found.parameters["unbalance.mass"].value, rel=0.01)


@pytest.mark.parametrize("level", [pytest.param(0.0, marks=pytest.mark.slow), 1e-2])
@pytest.mark.slow
def test_parameters_that_are_one_number_are_open_however_good_the_data(level):
    names = {item.name: {} for item in shipped("jeffcott").free}
    for second, first in (("unbalance__mass", "eccentricity"), ("crack__sag", "crack_stiffness")):
        recording = recorded(two_gains("jeffcott", LOWER["jeffcott"][::4], level=level, duration=0.5))
        found = identify(free("jeffcott", **names, **{second: {}}), recording)
        assert set(found.open) == {first, second.replace("__", ".")}
        low, high = found.parameters[first].interval90
        assert (high - low) / 2 > 0.3 * found.parameters[first].value


@pytest.mark.slow
def test_a_parameter_that_nothing_depends_on():
    """An eccentricity of a second disc without mass: no data can say anything about it."""
    names = {item.name: {} for item in shipped("jeffcott").free}

    def change(document):
        document["identify"] = {**names, "idle.gain": {}}
        document["blocks"]["idle"] = {"type": "gain", "parameters": {"gain": 2.0}}
        document["wires"].append(["clock.theta", "idle.input"])

    found = identify(changed("jeffcott", change), recorded(two_gains("jeffcott", LOWER["jeffcott"][::4], level=0.01)))
    assert found.open == ("idle.gain",)
    low, high = found.parameters["idle.gain"].interval90
    assert high - low > 4


# --- one parameter and all at once ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "half", "unit", "width"),
    [
        (2.0, 0.1, "m", 0.05),
        (-2.0, 0.1, "m", 0.05),
        (0.0, 0.1, "m", np.inf),
        (3.0, 0.1, "rad", 0.1),
        (0.0, 0.1, "rad", 0.1),
    ],
)
def test_relative_width(value, half, unit, width):
    assert relative_width(value, half, unit) == pytest.approx(width)


@pytest.mark.slow
def test_precision_decides():
    recording = recorded(made("jeffcott", UPPER["jeffcott"], THESIS, level=0.05))
    wide = identify(shipped("jeffcott"), recording, precision=0.5)
    narrow = identify(shipped("jeffcott"), recording, precision=1e-6)
    assert wide.open == ()
    assert len(narrow.open) == 7
    assert wide.values == narrow.values
    alone = narrow.parameters["crack_stiffness"].verdict
    assert alone.reason.startswith("the data say too little about it: its 90 % interval is +-")
    assert alone.combination is None


def test_all_intervals_at_once():
    """For independent parameters the factor is that of the largest of m normal numbers: (1 + 0.9^(1/m)) / 2."""
    for m in (1, 3, 7):
        expected = norm.ppf((1 + 0.9 ** (1 / m)) / 2) / Z90
        # the 90 % quantile of 20 000 draws: density at it at least 0.1 per std, sqrt(0.09 / 20 000) / 0.1 = 0.02
        assert joint_factor(np.eye(m)) == pytest.approx(expected, abs=4 * 0.02)
    assert joint_factor(np.ones((4, 4))) == pytest.approx(1.0, abs=0.08)


@pytest.mark.slow
def test_joint_intervals_hold_all_parameters(one_set):
    for item in one_set.parameters.values():
        assert isinstance(item, Identified)
        assert item.joint90[0] <= item.interval90[0] < item.value < item.interval90[1] <= item.joint90[1]


@pytest.mark.slow
def test_correlation_is_one(one_set):
    np.testing.assert_allclose(np.diag(one_set.correlation), 1.0)
    np.testing.assert_allclose(one_set.correlation, one_set.correlation.T)
    names = list(one_set.parameters)
    assert one_set.correlation[names.index(K_S), names.index(K_I)] > 0.98


# --- a model that does not explain the data ---------------------------------------------------------------------------


def no_crack() -> tuple[Recording, Identification]:
    runs = made("jeffcott", LOWER["jeffcott"][::4], THESIS, level=0.01, duration=0.5)
    recording = recorded(runs, ["identify", "identify", "hold_out"])
    from rotorsim.model.load import load

    return recording, identify(load("jeffcott", without=["crack"]), recording)


@pytest.mark.slow
def test_a_missing_crack_is_seen():
    _, found = no_crack()
    assert not found.adequate
    assert found.goodness < 1e-6
    assert found.excess > 10
    assert {"crack_stiffness", "crack_phase"}.isdisjoint(found.parameters)
    assert "The model does not explain the data" in found.statement
    assert f"{found.excess:.3g} times the variance" in found.statement
    for use in ("identify", "hold_out"):
        for signal, floor in found.noise_floor.items():
            assert found.fit[use][signal] > 3 * floor


def test_a_right_model_reaches_the_noise_floor():
    """Noise of 5 % of the rms, mean included: its part of what varies; also of runs that took no part.

    The root of a variance from 2 x 2000 samples is known within 1.1 % (the run held out), four of these.
    """
    speeds = LOWER["jeffcott"][::2]
    found = identify(
        shipped("jeffcott"), recorded(made("jeffcott", speeds, THESIS, level=0.05), ["identify"] * 4 + ["hold_out"])
    )
    clean = made("jeffcott", speeds, THESIS)
    for signal, columns in (("rotor.displacement", ("x", "y")), ("controller.current", ("ix", "iy"))):
        for use, runs in (("identify", clean[:4]), ("hold_out", clean[4:])):
            noise = sum(0.05**2 * np.mean(run.columns[c] ** 2) for run in runs for c in columns)
            varying = sum(np.var(run.columns[c]) for run in runs for c in columns)
            expected = np.sqrt(noise / (varying + noise))
            assert found.fit[use][signal] == pytest.approx(expected, rel=0.045)
            if use == "identify":
                assert found.noise_floor[signal] == pytest.approx(expected, rel=0.045)
                assert found.noise_floor[signal] < found.fit[use][signal]


# --- priors -----------------------------------------------------------------------------------------------------------


def known(*names: str) -> Diagram:
    """Return the diagram with the true values; the named parameters are free."""
    values = {item.name: TRUTH[item.name] for item in shipped("jeffcott").free}

    def change(document: dict[str, Any]) -> None:
        document["parameters"].update(values)
        document["identify"] = {name: document["identify"][name] for name in names}

    return changed("jeffcott", change)


def with_prior(std: float, mean: float | None = None, value: float = 76.0) -> Free:
    return Free("viscous_damping", "viscous_damping", 0, value, "N s/m", 0.0, np.inf, mean or value, std)


@pytest.mark.slow
def test_a_prior_is_one_more_measurement():
    """Weights of the inverse variances, analytic for a parameter that enters almost linearly."""
    recording = recorded(two_gains("jeffcott", LOWER["jeffcott"][::4], level=0.02))
    diagram = known("viscous_damping", "eccentricity")
    plain = identify(diagram, recording)
    before = plain.parameters["viscous_damping"]
    std = 0.7 * before.std
    prior = with_prior(std, before.value + 2 * std)
    after = identify(diagram, recording, free=[prior, diagram.free[1]]).parameters["viscous_damping"]
    weight = np.array([before.std**-2, std**-2])
    expected = weight @ [before.value, before.value + 2 * std] / weight.sum()
    assert after.value == pytest.approx(expected, abs=0.05 * before.std)
    assert after.std == pytest.approx(weight.sum() ** -0.5, rel=0.02)
    assert after.interval90 == pytest.approx((after.value - Z90 * after.std, after.value + Z90 * after.std), rel=2e-3)


@pytest.mark.slow
def test_a_known_mass_settles_what_the_data_leave_open():
    """At one speed range and one set of gains, rotor.mass and the stiffness of the loop are one number."""
    recording = recorded(two_gains("jeffcott", LOWER["jeffcott"][::4], level=0.01))
    names = {item.name: {} for item in shipped("jeffcott").free}
    known = free("jeffcott", **names, rotor__mass={"prior": {"std": "1 %"}})
    found = identify(known, recording)
    mass = found.parameters["rotor.mass"]
    assert mass.verdict.identifiable
    assert mass.std <= 0.02 * (1 + 1e-6)
    assert abs(mass.value - 2.0) < norm.isf(LEVEL) * mass.std
    assert found.adequate
    for name, item in found.parameters.items():
        if name != "rotor.mass":
            assert abs(item.value - TRUTH[name]) < norm.isf(LEVEL) * item.std


def test_a_mass_without_prior_stays_above_zero():
    """The bound is "above zero", not "zero or more"."""
    recording = recorded(two_gains("jeffcott", LOWER["jeffcott"][::4], level=0.01))
    names = {item.name: {} for item in shipped("jeffcott").free}
    found = identify(free("jeffcott", **names, rotor__mass={}), recording, profile=False)
    assert found.parameters["rotor.mass"].value > 0
    assert found.adequate


# --- profiles ---------------------------------------------------------------------------------------------------------


def linear(recording: Recording, names: tuple[str, ...], **bounds: float) -> Identification:
    """Return the identification of forces only: the residual is linear in crack_stiffness and eccentricity."""
    diagram = known(*names)
    items = [replace(item, **bounds) if item.name == "crack_stiffness" else item for item in diagram.free]
    return identify(diagram, recording, free=items)


def test_profile_intervals_of_a_linear_problem():
    """They are those of the normal distribution: estimate +- 1.645 std, std from (J^T J)^-1."""
    recording = recorded(made("jeffcott", LOWER["jeffcott"][::4], level=0.05))
    found = linear(recording, ("crack_stiffness", "eccentricity"))
    likelihood = likelihood_of("jeffcott", recording, found.diagram, free=found.free)
    J = likelihood.evaluate(np.array(list(found.values.values()))).jacobian
    std = np.sqrt(np.diag(np.linalg.inv(J.T @ J)))
    for item, deviation in zip(found.parameters.values(), std, strict=True):
        assert item.std == pytest.approx(deviation, rel=1e-6)
        ends = (item.value - Z90 * deviation, item.value + Z90 * deviation)
        assert item.interval90 == pytest.approx(ends, abs=1e-3 * deviation)


def test_profile_interval_beside_a_bound():
    """The bound cuts the interval, and the other end stays where it was."""
    recording = recorded(made("jeffcott", LOWER["jeffcott"][::4], level=0.05))
    whole = linear(recording, ("crack_stiffness", "eccentricity")).parameters["crack_stiffness"]
    low = whole.value - 0.5 * whole.std
    cut = linear(recording, ("crack_stiffness", "eccentricity"), low=low).parameters["crack_stiffness"]
    assert cut.interval90[0] == low
    assert cut.interval90[1] == pytest.approx(whole.interval90[1], abs=1e-3 * whole.std)


@pytest.mark.slow
def test_profile_interval_of_a_parameter_at_its_bound():
    """The estimate is at the bound; the profile rises by 2.71 at a known place beyond it: (bound, that place).

    With the others at their best the rise over the bound b is ((x - v)^2 - (b - v)^2) / std^2, v the free estimate.
    """
    recording = recorded(made("jeffcott", LOWER["jeffcott"][::4], level=0.05))
    whole = linear(recording, ("crack_stiffness", "eccentricity")).parameters["crack_stiffness"]
    low = whole.value + 0.5 * whole.std
    cut = linear(recording, ("crack_stiffness", "eccentricity"), low=low).parameters["crack_stiffness"]
    assert cut.value == pytest.approx(low, rel=1e-5)
    assert not cut.verdict.identifiable
    assert "its physical bound" in cut.verdict.reason
    expected = whole.value + whole.std * np.sqrt(Z90**2 + 0.5**2)
    assert cut.interval90 == pytest.approx((low, expected), abs=0.02 * whole.std)


def test_widened_profiles():
    """Where the model does not explain the data the intervals are wider by the root of the excess."""
    recording = recorded(made("jeffcott", LOWER["jeffcott"][::4], level=0.05))
    likelihood = likelihood_of("jeffcott", recording)
    search = Search(likelihood)
    found = estimate(search, at(likelihood))
    one, three = (profile_intervals(search, found, widen) for widen in (1.0, 3.0))
    j = [item.name for item in found.free].index("crack_stiffness")
    assert np.diff(three[j]) == pytest.approx(3 * np.diff(one[j]), rel=0.05)


# --- as data ----------------------------------------------------------------------------------------------------------


def test_the_identification_as_data(one_set):
    data = identification_data(one_set)
    assert data["identifiable"][K_S]["identifiable"] is False
    assert data["identifiable"][K_S]["combination"]["factors"][K_S] == 1.0
    assert data["parameters"][K_S]["unit"] == "N/m"
    assert data["parameters"][K_S]["interval90"] == list(one_set.parameters[K_S].interval90)
    assert data["next_experiment"][0]["change"] == one_set.advice[0].change
    assert set(data["next_experiment"][0]["expected_std"]) == set(one_set.parameters)
    assert data["correlation"]["names"] == list(one_set.parameters)
    assert data["runs"] == [f"run{k}" for k in range(9)]
