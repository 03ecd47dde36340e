"""What is said of parameters: one value and one interval for statement, diagnosis.json, report and terminal."""

from dataclasses import fields
from types import SimpleNamespace

import numpy as np
import pytest

from rotorsim.diagnosis.catalogue.insertion import Spot
from rotorsim.diagnosis.conclude.result import Effect, estimates, interval
from rotorsim.diagnosis.conclude.wording import _sentence
from rotorsim.diagnosis.evidence.fit import Fit
from rotorsim.diagnosis.evidence.waveform import evidence as waveform
from rotorsim.diagnosis.files import _parameters
from rotorsim.diagnosis.search.candidates import Candidate
from rotorsim.diagram.diagram import Free
from rotorsim.identification.waveform.noise_model import allowed_misfits
from rotorsim.report.diagnosis.words import estimate, own_parameters


def fitted(*, misfit: float = 900.0, goodness: float = 0.5, ended: tuple[bool, ...] = (False, False, False)) -> Fit:
    free = (
        Free("bow.amplitude", "bow", 0, 1.0, "m", 0.0, np.inf),
        Free("bow.phase", "bow", 0, 1.0, "rad", -np.inf, np.inf),
        Free("share", "", 0, 1.0, "1", 0.0, 1.0),
    )
    theta, std = np.array([1.5e-6, 0.5, 0.9]), np.array([1e-6, 0.1, 0.1])
    return Fit({}, free, theta, np.diag(std**2), np.array(ended), misfit, 903, 903, goodness=goodness)


def test_an_interval_of_90_percent_reaches_1_645_standard_deviations():
    assert interval(10.0, 1.0) == (pytest.approx(8.35515, abs=1e-4), pytest.approx(11.64485, abs=1e-4))


def test_intervals_end_where_parameters_must():
    found = estimates(fitted())
    assert found["bow.amplitude"].interval == (0.0, pytest.approx(3.145e-6, abs=1e-9))
    assert found["share"].interval == (pytest.approx(0.7355, abs=1e-4), 1.0)
    assert found["bow.phase"].interval == (pytest.approx(0.3355, abs=1e-4), pytest.approx(0.6645, abs=1e-4))


def test_what_noise_does_not_explain_widens_all_intervals():
    """Four times the variance of the noise is left: twice the standard deviation."""
    assert estimates(fitted(misfit=3600.0, goodness=1e-9))["bow.phase"].std == pytest.approx(0.2)
    assert estimates(fitted(misfit=3600.0, goodness=2e-4))["bow.phase"].std == pytest.approx(0.1)


def test_no_interval_has_zero_width_at_a_bound():
    data = _parameters(fitted(ended=(True, False, True)))
    for name, ended in (("bow.amplitude", True), ("bow.phase", False), ("share", True)):
        low, high = data[name]["interval90"]
        assert None in (low, high) or low < high
        assert data[name]["at_bound"] is ended
    assert estimate(data["share"]) == ["0.9", "at its bound"]


def effect() -> Effect:
    """Return an effect whose fit of its round had other values than that of all effects, with one rival."""
    round_fit = fitted()
    other = Fit(
        {}, (Free("gain.error", "gain", 0, 1.0, "1", -np.inf, np.inf),), np.array([0.02]), np.eye(1), np.zeros(1)
    )

    def put(physics: str, spot: str, fit: Fit, *free: str) -> Candidate:
        insertion = SimpleNamespace(
            physics=physics, spot=Spot(*spot.split(".")), free=free, from_lines=(), from_steps=(), depends_on=""
        )
        return Candidate(insertion, fit)

    own = put("residual_bow", "rotor.force", round_fit, "bow.amplitude", "bow.phase")
    rival = put("sensor_gain", "rotor.displacement", other, "gain.error")
    return Effect(
        own, {"residual_bow": 0.7, "sensor_gain": 0.3}, {"sensor_gain": rival}, (("rotor.displacement", 0.6),)
    )


def test_every_explanation_stands_at_its_own_place_everywhere():
    found = effect()
    assert [str(found.spot_of(name)) for name in found.members] == ["rotor.force", "rotor.displacement"]
    assert found.spot_of("rub") is None


def test_statement_and_tables_have_the_values_of_the_fit_of_all_effects():
    after = fitted(misfit=3600.0, goodness=1e-9)
    after.theta[0] = 2.5e-6
    text = _sentence(effect(), SimpleNamespace(after=after, measured=lambda _: {}))
    assert text == (
        "Missing physics: one of these, which the data do not separate: residual_bow at rotor.force, sensor_gain at "
        "rotor.displacement (as residual_bow: amplitude 2.5 +- 2.0 um, phase 29 +- 11 deg)."
    )
    assert own_parameters(effect().candidate, after) == "amplitude 2.5 um, phase 28.65 deg"
    assert _parameters(after)["bow.amplitude"]["value"] == 2.5e-6
    assert _parameters(after)["bow.amplitude"]["std"] == pytest.approx(2e-6)


class Judged(waveform.WaveformEvidence):
    """What stands for a recording in time."""

    def __init__(self, **values: object) -> None:
        known = {"stretches": (), "starts": {}, "runs": (), "rows": 0, "beginning": 8192, **values}
        for item in fields(waveform.WaveformEvidence):
            object.__setattr__(self, item.name, known.get(item.name))

    def search(self, document):
        still = SimpleNamespace(cost=1.0)
        return SimpleNamespace(
            first=lambda starts=None: None, substeps=lambda x: 1, evaluate=lambda x, sub, sensitivities: still
        )

    def load(self, document):
        return None


@pytest.mark.parametrize(
    ("now", "steps", "replaced"), [(0.83, 1, True), (0.84, 1, False), (1.19, 1, False), (1.21, 1, True), (1.0, 2, True)]
)
def test_noise_is_measured_again_where_a_fit_leaves_another_by_a_fifth(monkeypatch, now, steps, replaced):
    """What an adequate model may leave: a twentieth more than what is not predictable beside the fit.

    FAULT: a saturated coil was simulated with the steps of the plain circuit, and its inductance was off by 0.6 %.
    """
    monkeypatch.setattr(waveform, "reweighted", lambda *_: (None, SimpleNamespace(cost=1.0)))
    monkeypatch.setattr(waveform, "variance_scale", lambda *_: {})
    monkeypatch.setattr(waveform, "refined", lambda _, evaluation, scale: (SimpleNamespace(least=steps), evaluation))
    monkeypatch.setattr(
        waveform, "unpredicted", lambda *_: SimpleNamespace(variance={"y": now}, rows=7, left=np.array([1.0, 2.0]))
    )
    found = Judged(variance={"y": 1.0}, least=1, steps_of_laws={}, given={}).recalibrated(
        Fit({"blocks": {}}, misfit=49.9, rows=100)
    )
    assert (found is not None) == replaced
    if replaced:
        np.testing.assert_allclose(found.allowed, [1.05, 2.1])
        assert found.least == steps


def test_steps_that_a_law_needs_are_those_of_diagrams_that_have_it():
    """FAULT: once a rate limit had been found, every other law was simulated in as many steps, too."""
    plain: dict = {"blocks": {"pump": {"type": "gain"}}, "identify": {"pump.gain": {}}}
    rate_limit = {"type": "rate_limiter"}
    limited = {
        "blocks": {**plain["blocks"], "rate_limit": rate_limit},
        "identify": {**plain["identify"], "rate_limit.rising": {}},
    }
    evidence = Judged(least=2, steps_of_laws={}, given={"pump": "gain"}, smoothed=frozenset({"rate_limiter", "play"}))
    of_law = evidence.in_steps(limited, 8)
    assert (of_law.steps(limited), of_law.steps(plain), of_law.least) == (8, 2, 2)
    assert of_law.steps({"blocks": {"backlash": {"type": "play"}}}) == 8  # a rival is judged by the same steps
    everywhere = evidence.in_steps(plain, 4)
    assert (everywhere.steps(limited), everywhere.steps(plain)) == (4, 4)


def test_a_model_in_time_may_leave_a_hundredth_of_what_the_diagram_left():
    """Of its square beyond the flexible model's, or a quarter more than that one's rms; of noise, where that fails."""
    flexible, given = np.array([1.0, 1.0, 4.0]), np.array([57.0, 58.0, 4.0])
    np.testing.assert_allclose(allowed_misfits(flexible, given, 1.0), [1.5625, 1.57, 6.25])
    np.testing.assert_allclose(allowed_misfits(flexible, given, 0.1), [0.15625, 0.15625, 0.625])
