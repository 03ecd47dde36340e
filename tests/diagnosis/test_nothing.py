"""A law of size nothing is the diagram without it: misfit, unknowns of no interest and predictions are the same."""

from functools import cache

import numpy as np
import pytest

from rotorsim.diagnosis.catalogue.finder import insertions
from rotorsim.diagnosis.catalogue.insertion import LONGEST, Insertion, fixed_of, limits_of, sizes_at, starts_of
from rotorsim.diagnosis.evidence.harmonic.evidence import HarmonicEvidence
from rotorsim.identification.harmonic.likelihood import Evaluation, Likelihood
from rotorsim.signals.harmonics import harmonics_of
from tests.identification import TRUTH, made, recorded, shipped

RPM = 2 * np.pi / 60
SPEEDS = {"jeffcott": (900 * RPM, 2400 * RPM), "fe_rigid": (900 * RPM,)}
# values at which a law does nothing, where that is not zero of the parameters that are its sizes
NOTHING = {
    "clearance": {"stiffness": 0.0},
    "cubic_stiffness": {"stiffness": 0.0},
    "current_clipping": {"limit": 1e3, "slew": 1e9},
    "eddy_current_lag": {"time_constant": 1e-12, "share": 0.0},
    "foundation_mode": {"mass": 1e18},
    "rub": {"stiffness": 0.0},
    "speed_fluctuation": {"amplitude": 0.0},
    "torsion_coupling": {"unbalance": 0.0, "crack_coupling": 0.0},
}
# lags of at least 1 us, another law in the place of one that is there, a converter: none of them has a size of zero
NO_ZERO = {
    "amplifier_bandwidth",
    "control_delay",
    "breathing_crack",
    "open_crack",
    "crack_location",
    "magnetic_saturation",
    "magnetic_nonlinearity",
    "quantisation",
    "disc_rotary_inertia",
}
# the loss of eddy currents goes with the root of W time_constant: 1e-12 s leaves 1e-5 of it
CLOSE = {"eddy_current_lag/0": 1e-3}
NEXT_TO = 1e-18  # not zero: what is next to nothing must not be fitted by means that nothing bounds
WITH_STATES = ("hysteretic_damping", "thermal_bow", "eddy_current_lag", "foundation_mode", "mass_error")


@cache
def source(model: str) -> HarmonicEvidence:
    """Return runs of half a second, so short that filters of a few hertz have no time to settle."""
    recording = recorded(made(model, SPEEDS[model], TRUTH, level=1e-3, duration=0.5))
    return HarmonicEvidence(recording, tuple(harmonics_of(recording, recording.runs)), None)


@cache
def places(model: str) -> tuple[Insertion, ...]:
    found = insertions(shipped(model), source(model).recorded)
    return tuple(item for item in found if item.physics not in NO_ZERO and not item.from_lines)


@cache
def evaluated(model: str, item: Insertion | None) -> Evaluation:
    """Return what the diagram says at the values that it has, with a law of size nothing or without."""
    document = shipped(model).document
    if item is not None:
        sizes = sizes_at(item, source(model).largest())
        start = starts_of(item, sizes)[0]
        none = NOTHING.get(item.physics, dict.fromkeys(item.fault.sizes, NEXT_TO))
        start |= {key: value for key, value in none.items() if key in item.fault.free}
        document = item.document(document, {**fixed_of(item, sizes), **start}, limits_of(item, sizes))
    experiment = source(model).open(source(model).load(document))
    return Likelihood(experiment).evaluate(experiment.theta0)


def check(model: str, item: Insertion) -> None:
    base, found = evaluated(model, None), evaluated(model, item)
    close = CLOSE.get(f"{item.physics}/{item.variant}", 1e-8)
    assert found.rows == base.rows, item.key
    np.testing.assert_allclose(found.misfit, base.misfit, rtol=close, err_msg=item.key)
    scale = np.abs(base.Y).max(axis=(0, 1))
    np.testing.assert_allclose(found.Y / scale, base.Y / scale, rtol=0, atol=close, err_msg=item.key)


@pytest.mark.parametrize("physics", WITH_STATES)
def test_a_filter_of_size_nothing_has_no_mean_of_its_own(physics):
    """Half a second is short for filters of 0.4 Hz and a drift of 10 s: they stay what they are, nothing."""
    for item in places("jeffcott"):
        if item.physics == physics:
            check("jeffcott", item)


@pytest.mark.slow
@pytest.mark.parametrize("model", ["jeffcott", "fe_rigid"])
def test_every_law_of_size_nothing_is_no_law_at_every_place(model):
    assert len(places(model)) > 40
    for item in places(model):
        check(model, item)


def test_a_law_has_sizes_or_is_told_here_how_it_is_nothing():
    unknown = {item.physics for item in places("jeffcott") if not item.fault.sizes} - NOTHING.keys()
    assert not unknown


def test_a_time_cannot_be_longer_than_thirty_runs():
    [bow] = [item for item in places("jeffcott") if item.physics == "thermal_bow"]
    sizes = sizes_at(bow, {LONGEST: 0.5, "rotor.displacement[1]": 2e-5, "rotor.displacement[2]": 3e-5})
    limits = limits_of(bow, sizes)
    assert limits["time_constant"] == pytest.approx((0.015, 15.0))
    assert limits["growth"] == pytest.approx((0.0, 0.03))
    assert [start["time_constant"] for start in starts_of(bow, sizes)] == [0.5, 5.0] * 3
    document = bow.document(shipped("jeffcott").document, starts_of(bow, sizes)[0], limits)
    assert document["identify"]["thermal_bow.time_constant"] == pytest.approx({"low": 0.015, "high": 15.0})
    assert document["identify"]["thermal_bow.growth_phase"] == {}
    [offset] = [item for item in places("jeffcott") if item.physics == "sensor_offset"]
    assert limits_of(offset, sizes)["offset_x"] == pytest.approx((-0.03, 0.03))  # a sensor may be off to either side
    assert limits_of(bow, {}) == {}


def bow(growth: float, time_constant: float):
    """Return the likelihood of a thermal bow beside the shipped rotor, and where its parameters are."""
    [item] = [item for item in places("jeffcott") if item.physics == "thermal_bow"]
    start = {"growth": growth, "growth_phase": 0.7, "time_constant": time_constant}
    experiment = source("jeffcott").open(source("jeffcott").load(item.document(shipped("jeffcott").document, start)))
    names = [free.name for free in experiment.free]
    return Likelihood(experiment), [names.index(name) for name in item.free]


@pytest.mark.parametrize("time_constant", [0.05, 0.4, 10.0, 1e4])
def test_a_bow_that_grows_has_come_as_far_as_since_the_start_of_the_run(time_constant):
    """Its mean over T = 0.4995 s is b (1 - tau / T (1 - e^(-T / tau))), in every run: as of a bow that stays."""
    likelihood, places = bow(2e-6, time_constant)
    theta = likelihood.experiment.theta0
    T = 0.4995
    mean = 2e-6 * (1 - time_constant / T * -np.expm1(-T / time_constant))
    grown = likelihood.evaluate(theta)
    stays, own = bow(mean, 1e-5)
    settled = stays.evaluate(np.where(np.isin(np.arange(len(theta)), own), stays.experiment.theta0, theta))
    assert grown.rows == settled.rows == evaluated("jeffcott", None).rows
    np.testing.assert_allclose(grown.misfit, settled.misfit, rtol=1e-3)
    for j in places:  # the slopes of the misfit are those of differences
        step = 1e-4 * theta[j] * (np.arange(len(theta)) == j)
        slope = (likelihood.evaluate(theta + step).misfit.sum() - likelihood.evaluate(theta - step).misfit.sum()) / 2
        exact = 2 * grown.residual @ grown.jacobian[:, j] * step[j]
        assert exact == pytest.approx(slope, rel=1e-3, abs=1e-9 * grown.misfit.sum())
