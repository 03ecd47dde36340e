"""A force that nothing recorded predicts, in an oscillator that NumPy simulates: named only where runs come again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rotorsim.diagnosis.catalogue.catalogue import Catalogue
from rotorsim.diagnosis.catalogue.insertion import Spot
from rotorsim.diagnosis.conclude.disturbance import is_unpredicted, unmeasured
from rotorsim.diagnosis.conclude.result import Diagnosis
from rotorsim.diagnosis.diagnosis import diagnose
from rotorsim.diagnosis.evidence.waveform.open import waveform_evidence
from rotorsim.diagnosis.files import diagnosis_data, repaired_document
from rotorsim.model.load import load
from rotorsim.recordings.recording import Recording
from tests.diagnosis.evidence.machines import recording
from tests.diagnosis.evidence.test_memory_laws import NOISE, OSCILLATOR, RATE

SAMPLES, FINE = 1500, 10
RMS, TAU = 6.0, 0.1  # of the force [its unit], and [s]
SOME = ["unmeasured_disturbance", "offset", "dry_friction"]  # that are tried


def run(
    drive_seed: int, seed: int, *, random_force: float = 0.0, ripple: float = 0.0, start: float = 0.0
) -> dict[str, np.ndarray]:
    """Return a run by midpoint steps: x'' = u - 12 x' - 90 x + d; d: exp(-t / TAU) noise, or a ripple over x.

    start: where x begins.
    """
    u = np.repeat(np.random.default_rng(drive_seed).uniform(-1, 1, SAMPLES // 20) * 80, 20)
    random = np.random.default_rng(seed)
    left = np.exp(-1 / RATE / TAU)
    d, noise = np.zeros(SAMPLES), random.normal(size=SAMPLES) * np.sqrt(1 - left**2)
    for k in range(1, SAMPLES):
        d[k] = left * d[k - 1] + noise[k]
    v, x = 0.0, start
    out, h = np.empty((SAMPLES, 2)), 1 / RATE / FINE
    for k in range(SAMPLES):
        out[k] = v, x
        for _ in range(FINE):
            a = u[k] - 12 * v - 90 * x + random_force * d[k] + ripple * np.sin(60 * x)
            w, y = v + h / 2 * a, x + h / 2 * v
            v += h * (u[k] - 12 * w - 90 * y + random_force * d[k] + ripple * np.sin(60 * y))
            x += h * w
    noisy = out + random.normal(size=out.shape) * [*NOISE.values()]
    return {"drive": u, "speed": noisy[:, 0], "position": noisy[:, 1]}


def made(*runs: dict[str, np.ndarray]) -> Recording:
    names = {name: (f"{name}.output", "1") for name in ("drive", "speed", "position")}
    return recording([(one, "identify") for one in runs], names, RATE)


def diagnosed(*runs: dict[str, np.ndarray]) -> Diagnosis:
    return diagnose(load(OSCILLATOR), made(*runs), physics=SOME, workers=1)


@pytest.fixture(scope="module")
def disturbed() -> Diagnosis:
    return diagnosed(run(1, 1, random_force=RMS), run(1, 2, random_force=RMS), run(3, 3, random_force=RMS))


@pytest.mark.slow
def test_a_force_that_does_not_come_again_is_an_unmeasured_disturbance(disturbed):
    found = disturbed
    assert found.verdict == "missing_physics"
    [effect] = found.effects
    assert effect.members == {"unmeasured_disturbance": 1.0}
    assert "force.output" in {str(spot) for spot in found.spots}
    known = found.measured(effect)
    for key, truth in (("rms", RMS), ("correlation_time", TAU)):
        value, std, _ = known[key]
        assert abs(value - truth) < 3 * std < 0.5 * truth
    [signal] = found.signals
    assert abs(signal.repeated) < 0.3
    assert signal.left < 1.05 < 2 < signal.without
    again = f"In runs with the same inputs it has another course (correlation {signal.repeated:.2g}), and nothing that"
    assert again in found.statement
    assert found.next_experiment == f"record the signal that acts at {signal.place.words}: it is an input then"
    [missing] = diagnosis_data(found)["missing"]
    assert missing["parameters"]["correlation_time"]["unit"] == "s"
    document = repaired_document(found)
    assert document["blocks"][effect.candidate.insertion.name]["type"] == "disturbance"
    assert load(document).nodes  # it is a diagram, and simulates as before
    assert found.proof is None  # no simulation predicts it, nor is to
    assert found.score_after.total == pytest.approx(found.score_before.total, rel=1e-6)


@pytest.mark.slow
def test_what_comes_again_in_part_is_no_disturbance(disturbed):
    """Half of it, three standard deviations of chance included: sqrt(tau / T) = sqrt(0.1 / 7.5) = 0.115."""
    catalogue, base, [signal] = Catalogue.of(load(OSCILLATOR)), disturbed.selection.base, disturbed.signals
    free = replace(signal, physics="")
    assert is_unpredicted(base, [free], disturbed.evidence)
    named = [
        unmeasured(base, replace(free, repeated=again), disturbed.evidence, catalogue) is not None
        for again in (-0.1, 0.14, 0.17, 1.0)
    ]
    assert named == [True, True, False, False]
    assert unmeasured(base, replace(free, repeated=None), disturbed.evidence, catalogue) is None
    assert not is_unpredicted(base, [replace(free, predicted=0.06)], disturbed.evidence)
    assert not is_unpredicted(base, [replace(free, without=1.9)], disturbed.evidence)
    assert not is_unpredicted(base, [replace(free, left=0.03 * free.without)], disturbed.evidence)


@pytest.mark.slow
def test_without_runs_that_come_again_it_may_be_a_law_that_no_black_box_knows():
    found = diagnosed(run(1, 1, random_force=RMS), run(2, 2, random_force=RMS))
    assert found.verdict == "outside_catalogue"
    assert found.unpredicted
    said = "Nothing that is simulated, nor time, predicts the signal missing at "
    assert said in found.statement
    assert "): an unmeasured disturbance, or a law that no black box knows." in found.statement
    wanted = "a run with the inputs and start of another: a law adds the same again, an unmeasured disturbance does not"
    assert found.next_experiment.startswith(wanted)


def test_runs_that_begin_elsewhere_do_not_come_again():
    """The same inputs, and another motion: what a law adds is another then, too."""
    diagram, found = load(OSCILLATOR), []
    for start in (0.0, 5.0):
        evidence = waveform_evidence(diagram, made(run(1, 1, ripple=RMS), run(1, 2, ripple=RMS, start=start)))
        fit = evidence.fit(diagram.document, [])
        found.append(evidence.missing_signal(fit, fit, None, Spot("force", "output"), ()).repeated)
    assert found[0] > 0.98
    assert found[1] is None


@pytest.mark.slow
def test_a_law_that_no_black_box_knows_comes_again_and_is_no_disturbance():
    found = diagnosed(run(1, 1, ripple=RMS), run(1, 2, ripple=RMS), run(3, 3, ripple=RMS))
    assert found.verdict == "outside_catalogue"
    assert not found.unpredicted
    [signal] = found.signals
    assert signal.repeated > 0.98


def test_nothing_is_found_where_nothing_is_hidden():
    found = diagnosed(run(1, 1), run(1, 2), run(3, 3))
    assert found.verdict == "consistent"
    assert not found.effects
