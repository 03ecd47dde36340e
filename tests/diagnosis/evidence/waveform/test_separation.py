"""The next experiment in time: the run named separates two diagrams by as much as is said of it."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from rotorsim.diagnosis.catalogue.insertion import Spot
from rotorsim.diagnosis.conclude.wording import _elsewhere, _separating
from rotorsim.diagnosis.evidence.change import Change, best_of
from rotorsim.diagnosis.evidence.missing_signal import PlaceClass
from rotorsim.diagnosis.evidence.waveform.open import waveform_evidence
from rotorsim.diagnosis.evidence.waveform.separation import Contrast, sensors_of
from rotorsim.model.load import load
from tests.diagnosis.evidence.waveform.machines import recording
from tests.diagnosis.evidence.waveform.test_any_wire import SERVO

RATE, SAMPLES, FINE, LIMIT = 200, 800, 20, 10.0
NAMES, NOISE = ("reference", "speed", "angle"), np.array([4e-3, 2e-3])


def driven(
    amplitude: float, limit: float, friction: float = 5.0, start: tuple[float, float] = (0.0, 0.0)
) -> dict[str, np.ndarray]:
    """Return a run of the servo whose controller saturates, by midpoint steps a twentieth of a sample long."""
    random = np.random.default_rng(5)
    levels = random.uniform(-1, 1, SAMPLES // 100)
    reference = amplitude * np.repeat(levels - levels.mean(), 100)
    w, a = start
    h, out = 1 / RATE / FINE, np.empty((SAMPLES, 2))
    for k, wanted in enumerate(reference.tolist()):
        out[k] = w, a
        for _ in range(FINE):
            middle = w + h / 2 * (min(max(12.0 * (wanted - a), -limit), limit) - friction * w)
            rate = min(max(12.0 * (wanted - a - h / 2 * w), -limit), limit) - friction * middle
            a, w = a + h * middle, w + h * rate
    return dict(zip(NAMES, (reference, *out.T), strict=True))


def whitened(limit: float, friction: float = 5.0, start: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    """Return speed and angle at twice the amplitude, in their noise."""
    run = driven(2.0, limit, friction, start)
    return np.concatenate([run[name] / noise for name, noise in zip(NAMES[1:], NOISE, strict=True)])


def saturated(limit: float) -> dict:
    """The servo with a controller that saturates."""
    block = {"type": "saturation", "parameters": {"lower": -limit, "upper": limit}}
    wires = [wire for wire in SERVO["wires"] if wire[0] != "controller.output"]
    wires += [["controller.output", "saturation.input"], ["saturation.output", "torque.input1"]]
    return {**SERVO, "blocks": {**SERVO["blocks"], "saturation": block}, "wires": wires}


@pytest.fixture(scope="module")
def servo():
    """Evidence of a run in which the controller stays below its limit, and the fits of both diagrams."""
    run, random = driven(1.0, LIMIT), np.random.default_rng(6)
    assert 12.0 * np.abs(run["reference"] - run["angle"]).max() < LIMIT
    for name, noise in zip(NAMES[1:], NOISE, strict=True):
        run[name] = run[name] + noise * random.normal(size=SAMPLES)
    evidence = waveform_evidence(
        load(SERVO), recording([(run, "identify")], {name: (f"{name}.output", "1") for name in NAMES}, RATE)
    )
    return evidence, evidence.fit(SERVO, []), evidence.fit(saturated(LIMIT), [])


@pytest.mark.slow
def test_a_limit_that_was_not_reached_shows_at_twice_the_amplitude(servo):
    evidence, linear, limited = servo
    assert abs(linear.misfit - limited.misfit) < 1.0  # the recording does not tell them apart
    change = evidence.separation(linear, limited)
    assert change is not None
    assert (change.words, change.runs) == ("run run0 again with reference.output at 2 times its amplitude", 1)
    columns = []
    for limit, fit in ((np.inf, linear), (LIMIT, limited)):
        middle, small = whitened(limit), 1e-4
        columns.append((whitened(limit, 5.0 + small) - middle) / small * np.sqrt(fit.covariance[0, 0]))
        columns += [1e6 * (whitened(limit, start=at) - middle) for at in ((small, 0.0), (0.0, small))]
    one = np.sqrt(evidence.rows / (2 * SAMPLES))  # of a sample: the evidence counts both signals as one equation
    S, d = one * np.stack(columns, axis=1), one * (whitened(LIMIT) - whitened(np.inf))
    expected = np.sqrt(d @ np.linalg.solve(np.eye(len(d)) + S @ S.T, d))
    assert expected > 100  # the limit is reached
    assert change.separation == pytest.approx(expected, rel=0.05)  # to which the variance of the noise is known


def test_nothing_separates_a_diagram_from_itself(servo):
    evidence, linear, _ = servo
    assert evidence.separation(linear, linear) is None


def test_a_sensor_is_named_where_no_amplitude_tells():
    """Two laws of equal effect on what is recorded: only the wire between them knows."""
    evidence_of = recording([(driven(1.0, np.inf), "identify")], {n: (f"{n}.output", "1") for n in NAMES}, RATE)
    evidence = waveform_evidence(load(SERVO), evidence_of)
    gains = {"controller": {"gain": 6.0}, "error": {"signs": "+-"}}
    split = {**SERVO["blocks"], "controller": {"type": "gain", "parameters": gains["controller"]}}
    split["amplifier"] = {"type": "gain", "parameters": {"gain": 2.0}}
    wires = [wire for wire in SERVO["wires"] if wire[0] != "controller.output"]
    wires += [["controller.output", "amplifier.input"], ["amplifier.output", "torque.input1"]]
    pair = evidence.fit(SERVO, []), evidence.fit({**SERVO, "blocks": split, "wires": wires}, [])
    change = evidence.separation(*pair)
    assert change is not None
    # no noise was added, and 0.1 % is the least that a sensor is taken to have
    assert change.words == "run run0 again with controller.output recorded as well, with noise of 0.1 % of its rms"
    assert change.runs == 1
    inserted = [load({**SERVO, "blocks": split, "wires": wires})] * 2
    signals = [f"{name}.output" for name in SERVO["blocks"]]
    assert "amplifier.output" not in sensors_of(inserted, signals, evidence.recorded)
    assert "torque.output" in sensors_of(inserted, signals, evidence.recorded)


def test_what_parameters_imitate_does_not_count():
    """s_n = d / sqrt(1 / n + S^2) along S, sqrt(n) d across it."""
    y, held, none = np.array([[6.0], [2.0]]), np.array([[[2.0]], [[0.0]]]), np.zeros((2, 1, 0))
    told = Contrast.of([(y, held, none), (np.zeros((2, 1)), np.zeros((2, 1, 0)), none)], np.ones(1))
    for n in (1, 4):
        assert told.separation([0], n) == pytest.approx(np.sqrt(6**2 / (1 / n + 2**2) + n * 2**2))
    free = Contrast.of([(y, none, held), (np.zeros((2, 1)), np.zeros((2, 1, 0)), none)], np.ones(1))
    assert free.separation([0], 1) == pytest.approx(2.0, rel=1e-4)  # of a start that nobody knows nothing is left


def test_the_change_that_takes_fewest_runs_is_best():
    few, far, never = Change("a", 3.2, 1), Change("b", 9.0, 2), Change("c", 2.0, 0)
    assert best_of([never, far, None, few]) is few
    assert best_of([never, None]) is never
    assert best_of([None]) is None


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (Change("run a again", 7.0, 1), "run a again (predictions 7 standard deviations apart)"),
        (Change("run a again", 3.3, 4), "run a again, 4 times, (predictions 3.3 standard deviations apart)"),
        (None, "no amplitude of its inputs, further sensor or repeated run does"),
    ],
)
def test_words(servo, change, words):
    evidence, fit, _ = servo
    fault = SimpleNamespace(told_apart_by="", told_apart_at_rest_by="", confused_with=(), physics="lag")
    item = SimpleNamespace(insertion=SimpleNamespace(fault=fault), fit=fit)
    terms = replace(evidence.terms)
    asked = SimpleNamespace(evidence=SimpleNamespace(terms=terms, separation=lambda first, second: change))
    assert _separating(SimpleNamespace(candidate=item), item, asked) == words


def test_the_same_physics_elsewhere_is_told_apart_where_it_is_nearly_as_likely():
    def item(block: str, physics: str = "lag", failure: str = "") -> SimpleNamespace:
        insertion = SimpleNamespace(spot=Spot(block, "output"), physics=physics)
        return SimpleNamespace(insertion=insertion, fit=SimpleNamespace(failure=failure))

    best, far, gone, other = item("a"), item("b"), item("c", failure="diverges"), item("d", "delay")
    here, there = Spot("a", "output"), Spot("b", "output")
    effect = SimpleNamespace(candidate=best, places=(PlaceClass((here,), 0.6), PlaceClass((there,), 0.4)))
    found = SimpleNamespace(tried=(best, other, gone, far))
    assert _elsewhere(effect, found) is far
    sure = SimpleNamespace(candidate=best, places=(PlaceClass((here,), 0.98), PlaceClass((there,), 0.02)))
    assert _elsewhere(sure, found) is None
    alike = SimpleNamespace(candidate=best, places=(PlaceClass((here, there), 1.0),))
    assert _elsewhere(alike, found) is far


def test_runs_that_show_an_unknown_law_are_named(servo):
    assert servo[0].terms.more_runs == "runs with reference.output at 0.5 and at 2 times the amplitude"
