"""What may be called noise, and when nothing can be said: each number that decides is stated here."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from rotorsim.diagnosis.diagnosis import diagnose
from rotorsim.diagnosis.evidence.fit import Fit
from rotorsim.diagnosis.evidence.waveform.evidence import WaveformEvidence
from rotorsim.diagnosis.evidence.waveform.open import waveform_evidence
from rotorsim.diagram.diagram import Free
from rotorsim.errors import RotorsimError
from rotorsim.identification.waveform import noise
from rotorsim.identification.waveform.predictability import Predictability
from rotorsim.identification.waveform.recorded.along_angle import is_in_time
from rotorsim.model.load import load
from tests.diagnosis.evidence.waveform.test_any_wire import SERVO, recording


@pytest.mark.parametrize(("samples", "why"), [(487, "487 samples are too few to tell"), (488, "")])
def test_too_few_samples_judge_nothing(tmp_path, samples, why):
    """A law of ten parameters makes 23.2 of the misfit by chance at 1 %; structure of 1/21 of n samples n / 21: 488."""
    found = waveform_evidence(load(SERVO), recording(tmp_path, samples // 2, samples - samples // 2))
    assert found.unjudged.startswith(why)
    assert bool(found.unjudged) == bool(why)


@pytest.mark.slow
def test_what_does_not_move_judges_nothing(tmp_path):
    found = diagnose(load(SERVO), recording(tmp_path, 400, 400, still=True), physics=("gain_error",), workers=1)
    assert found.verdict == "not_identifiable"
    assert "Whether that is all cannot be judged, though: nothing moves by more than its noise." in found.statement
    more = "longer runs, with reference.output so large that every signal moves by far more than its noise"
    assert found.next_experiment == f"{more}: nothing moves by more than its noise"


@pytest.mark.slow
def test_a_residual_that_is_predicted_is_not_consistent(tmp_path, monkeypatch):
    monkeypatch.setattr(WaveformEvidence, "structure", lambda self, fit: 0.3)
    found = diagnose(load(SERVO), recording(tmp_path, 500, 500), physics=("gain_error",), workers=1)
    assert found.verdict == "outside_catalogue"


@pytest.mark.parametrize(("structure", "most"), [(False, 6.0), (True, 1.5)])
def test_noise_is_a_few_times_its_white_part(tmp_path, monkeypatch, structure, most):
    """Six times where nothing is predicted, one and a half where something is; slow motion of any size is no noise."""
    diagram, taken = load(SERVO), recording(tmp_path, 500, 500)
    evidence = waveform_evidence(diagram, taken)
    search = evidence.search(SERVO)
    evaluation = search.minimise(search.first(evidence.starts))
    random = np.random.default_rng(3)
    rest = [random.normal(size=(500, 2)) + np.linspace(-50, 50, 500)[:, None] for _ in range(2)]
    share = np.array([0.5, 0.5]) * structure
    monkeypatch.setattr(noise, "judged_beside", lambda *_: Predictability(share, np.zeros(2), rest))
    found = noise.unpredicted(diagram, search, evaluation, evidence.stretches)
    white = (np.diff(np.stack(rest), axis=1) ** 2).mean(axis=(0, 1)) / 2
    assert [*found.variance.values()] == pytest.approx((most * white).tolist(), rel=2e-3)


def test_what_acts_in_few_stretches_is_no_noise():
    """Two of twenty leave up to a hundred times what they may: the logarithms scatter, the sum does not hide it."""
    allowed, left = np.ones(20), np.ones(20)
    assert noise.goodness_left_out(left, allowed) > 0.4
    for ratio, adequate in ((2.9, True), (3.1, False), (10.9, False)):
        left[[3, 11]] = 1 + 10 * (ratio - 1)
        assert (noise.goodness_left_out(left, allowed) >= 1e-4) == adequate


def test_sensors_are_no_louder_in_motion_than_twice_as_at_rest():
    """White noise is all of it; what jumps from sample to sample in motion only counts twice what is there at rest."""
    random = np.random.default_rng(5)
    rest = random.normal(size=(1000, 1))
    assert noise.sensor_noise([rest], [rest]) == pytest.approx(noise.white_part([rest], 1))
    jumps = np.concatenate([rest[:500], rest[500:] + 10 * random.choice([-1, 1], size=(500, 1))])
    assert noise.white_part([jumps], 1).item() > 50
    assert noise.sensor_noise([jumps], [jumps]).item() == pytest.approx(2.0 * 0.77, rel=0.15)
    steps = np.round(jumps / 4) * 4  # readings of a coarse converter
    assert noise.sensor_noise([0 * rest], [steps]).item() == 0.0
    assert noise.sensor_noise([steps - jumps], [steps]).item() == pytest.approx(4.0**2 / 12, rel=0.05)


def test_a_clock_without_a_wire_turns_no_shaft(tmp_path):
    taken, idle, wired = recording(tmp_path, 100), copy.deepcopy(SERVO), copy.deepcopy(SERVO)
    idle["blocks"]["clock"] = wired["blocks"]["clock"] = {"type": "clock", "parameters": {"speed": "100 rad/s"}}
    wired["wires"] = [["clock.theta", wire[1]] if wire[0] == "reference.output" else wire for wire in wired["wires"]]
    del wired["blocks"]["reference"]
    assert is_in_time(load(idle), taken)
    assert not is_in_time(load(wired), taken)


@pytest.mark.slow
def test_what_runs_away_is_said_to_diverge(tmp_path):
    wrong = copy.deepcopy(SERVO)
    wrong["blocks"]["controller"]["parameters"]["gain"] = -1e6
    with pytest.raises(RotorsimError) as caught:
        waveform_evidence(load(wrong), recording(tmp_path, 300, 300))
    assert str(caught.value) == (
        "error: servo: its simulation diverges when it is driven as recorded\n\n"
        "hint: start from values nearer to the machine's, or check the signs and units of what drives it"
    )


@pytest.mark.parametrize(
    ("std", "other", "free"),
    [(0.1, 0.01, {"step.height", "step.width"}), (1e5, 0.01, {"step.height"}), (0.1, 1e5, set())],
)
def test_what_the_data_leave_open_is_no_number_of_the_statement(std, other, free):
    """FAULT: of a step between two samples the width was stated as 0 +- 130 ks, and then the time as 0 +- 1900000 s."""

    def fit(document, starts):
        names = document["identify"]
        items = tuple(Free(name, "", 0, 1.0, "s", 0.0, np.inf) for name in names)
        variance = np.diag([std**2 if name == "step.width" else other**2 for name in names])
        none = np.zeros(len(items), bool)
        return Fit(document, items, np.ones(len(items)), variance, none, misfit=900.0, rows=1000, goodness=0.5)

    before = Fit({"blocks": {"step": {}}, "identify": {"step.height": {}}}, misfit=1000.0, rows=1000, goodness=0.5)
    item = SimpleNamespace(stated_once=("step.width",))
    found = WaveformEvidence.finished(SimpleNamespace(fit=fit), before, [item])
    assert found.values.keys() == free


@pytest.mark.parametrize(
    ("misfits", "steps", "time"),
    [
        ([1100.0, 1050.0, 1049.5, 1000.0], 16, 0.05),  # until it shows no more: a fall by less than 1
        ([1100.0, 1050.0, 1051.5], 4, 0.2),  # explains less
        ([1100.0, None], 1, 0.8),  # diverges
        ([1100.0, 1000.0, 900.0, 800.0, 700.0], 64, 0.0125),  # no more steps between samples
    ],
)
def test_laws_are_sharpened_until_that_no_longer_shows(misfits, steps, time):
    """FAULT: a play that lags by 0.8 samples was 4.2705 +- 0.0061 wide instead of 4.3129."""

    @dataclass(frozen=True)
    class Steps:
        least: int = 1

        def steps(self, document):
            return self.least

        def in_steps(self, document, steps):
            return Steps(steps)

        def fit(self, document, starts):
            at = [0.8, 0.2, 0.05, 0.0125].index(document["blocks"]["play"]["parameters"]["time_constant"])
            assert self.least == 4**at
            left = misfits[at]
            return Fit(document, failure="it diverges") if left is None else Fit(document, misfit=left)

    start = {"blocks": {"play": {"parameters": {"time_constant": 0.8}}}}
    item = SimpleNamespace(smoothed=("play.time_constant",))
    finer, found = WaveformEvidence.sharpened(Steps(), Fit(start, misfit=misfits[0]), [item])
    assert (finer.least, found.document["blocks"]["play"]["parameters"]["time_constant"]) == (
        steps,
        pytest.approx(time),
    )
    none = WaveformEvidence.sharpened(Steps(), Fit(start, misfit=1.0), [SimpleNamespace(smoothed=())])
    assert (none[0].least, none[1].document) == (1, start)
