"""The missing signal of a servo that Python steps through: as it is, where it is, and what cannot be simulated."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace
from math import tanh

import numpy as np
import pytest

from rotorsim.diagnosis.catalogue.catalogue import Catalogue
from rotorsim.diagnosis.catalogue.insertion import Spot
from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.evidence.fit import Effort
from rotorsim.diagnosis.evidence.missing_signal import MissingSignal
from rotorsim.diagnosis.evidence.waveform.laws import SETTLED, STEPS, LawBounds
from rotorsim.diagnosis.evidence.waveform.missing import explained_by
from rotorsim.diagnosis.evidence.waveform.open import waveform_evidence
from rotorsim.model.load import load
from rotorsim.report.figures.missing_signal import missing_signal_figure
from tests.diagnosis.evidence.waveform.machines import recording
from tests.diagnosis.evidence.waveform.test_any_wire import SERVO

RATE, SAMPLES, FINE, DRY = 200, 1000, 20, 0.4
NAMES = ("reference", "speed", "angle")


def braked(seed: int, dry: float = DRY) -> dict[str, np.ndarray]:
    """Return a run of the servo with dry friction, by midpoint steps a twentieth of a sample long."""
    random = np.random.default_rng(seed)
    reference = np.repeat(random.uniform(-1, 1, SAMPLES // 100), 100)
    w = a = 0.0
    h, out = 1 / RATE / FINE, np.empty((SAMPLES, 2))
    for k, wanted in enumerate(reference.tolist()):
        out[k] = w, a
        for _ in range(FINE):
            middle = w + h / 2 * (12.0 * (wanted - a) - 4.4 * w - dry * tanh(w / 0.01))
            rate = 12.0 * (wanted - a - h / 2 * w) - 4.4 * middle - dry * tanh(middle / 0.01)
            a, w = a + h * middle, w + h * rate
    noisy = out + random.normal(size=out.shape) * [4e-3, 2e-3]
    return dict(zip(NAMES, (reference, *noisy.T), strict=True))


@pytest.fixture(scope="module")
def lacking():
    """Evidence, the fit of the diagram without dry friction and with it, what was put in, and classes of places."""
    measured = recording([(braked(1), "identify")], {name: (f"{name}.output", "1") for name in NAMES}, RATE)
    diagram = load(SERVO)
    evidence = waveform_evidence(diagram, measured)
    before = evidence.fit(diagram.document, [])
    found = Catalogue.of(diagram, {"dry_friction"}).candidates(diagram, evidence.recorded)
    item = next(item for item in found if item.spot.block == "friction" and not item.spot.side)
    start = dict.fromkeys(item.fault.free, DRY / 2)
    after = evidence.fit(item.document(values_in(before.document, before.values), start), [[{}]])
    return evidence, before, after, item, evidence.bounds(before).classes


@pytest.fixture(scope="module")
def signal(lacking):
    evidence, before, after, item, classes = lacking
    return evidence.missing_signal(before, after, item, item.spot, classes)


@pytest.mark.slow
def test_the_missing_signal_is_the_friction(signal):
    assert (str(signal.place), signal.physics, signal.over) == ("friction.output", "dry_friction", "friction.output")
    assert signal.share > 0.9
    [run] = signal.runs
    sliding = np.abs(run.over) > 0.5  # 4.4 times the speed: away from where it turns
    assert sliding.mean() > 0.3
    towards = run.added[sliding] * np.sign(run.over[sliding])
    assert np.median(towards) == pytest.approx(0.4, rel=0.05)
    assert np.mean(np.abs(towards - 0.4) < 1.96 * run.std[sliding]) > 0.85
    np.testing.assert_allclose(np.abs(run.law[sliding]), 0.4, rtol=0.05)


def test_places_that_no_data_tell_apart_are_one_class(lacking):
    """What drives the torque and what brakes it act on the speed alike; the reading of the speed does not."""
    *_, classes = lacking
    best = classes[0]
    assert {str(spot) for spot in best.places} >= {"friction.output", "torque.output"}
    assert not any(spot.side == "reading" for spot in best.places)
    assert sum(one.probability for one in classes) == pytest.approx(1.0)
    assert [one.probability for one in classes] == sorted((one.probability for one in classes), reverse=True)


def test_without_a_law_it_is_drawn_over_the_signal_that_explains_it(lacking):
    evidence, before, after, item, classes = lacking
    found = evidence.missing_signal(before, after, None, item.spot, classes)
    assert found.physics == ""
    assert found.runs[0].law is None
    assert found.share > 0.8


@pytest.mark.slow
def test_what_a_sensor_adds_with_time_is_drawn_over_time():
    """FAULT: the law at a reading was zero: what it reads was looked up where the recording reads what it gives."""
    runs = [braked(seed, dry=0.0) for seed in (3, 4)]
    for run in runs:
        run["speed"] = run["speed"] + 0.02 * np.arange(SAMPLES) / RATE
    made = recording([(run, "identify") for run in runs], {name: (f"{name}.output", "1") for name in NAMES}, RATE)
    diagram = load(SERVO)
    evidence = waveform_evidence(diagram, made)
    before = evidence.fit(diagram.document, [])
    found = Catalogue.of(diagram, {"drift"}).candidates(diagram, evidence.recorded)
    item = next(item for item in found if item.spot == Spot("speed", "output", side="reading"))
    after = evidence.fit(item.document(values_in(before.document, before.values), {"rate": 0.01}), [[{}]])
    signal = evidence.missing_signal(before, after, item, item.spot, ())
    assert (signal.place, signal.over, signal.over_unit) == (item.spot, "time", "s")
    for run in signal.runs:
        np.testing.assert_allclose(run.law, 0.02 * run.time, atol=0.002)
        assert np.mean(np.abs(run.added - 0.02 * run.time) < 1.96 * run.std) > 0.85


def test_a_diagram_that_diverges_has_no_missing_signal(lacking):
    evidence, before, after, item, _ = lacking
    wild, gone = (replace(fit, theta=np.full(len(fit.theta), -1e6)) for fit in (before, after))
    assert evidence.missing_signal(wild, gone, item, item.spot, ()) is None


def test_a_place_that_is_no_signal_has_none(lacking):
    evidence, before, after, item, _ = lacking
    assert evidence.missing_signal(before, after, None, replace(item.spot, port="nothing"), ()) is None


def test_what_is_drawn(signal):
    made = missing_signal_figure(signal)
    assert made.get_suptitle() == "Missing signal at friction.output, estimated from all recorded outputs"
    assert [axes.get_xlabel() for axes in made.axes] == ["time [s]", "time [s]", "friction.output [SI]"]
    assert [axes.get_ylabel() for axes in made.axes] == ["[SI]"] * 3
    texts = [text.get_text() for text in made.legends[0].get_texts()]
    assert texts == ["its 95 % band", "estimated, without a law", "law found: dry friction"]
    np.testing.assert_allclose(made.axes[0].lines[0].get_ydata(), signal.loudest.added)


def test_a_signal_without_a_law_has_none_in_its_figure(signal):
    runs = tuple(replace(run, law=None, law_over=None) for run in signal.runs)
    made = missing_signal_figure(
        MissingSignal(signal.place, "A", "time", "s", 0.5, runs, signal.classes, 1.0, 9.0, 0.0)
    )
    assert [text.get_text() for text in made.legends[0].get_texts()] == ["its 95 % band", "estimated, without a law"]
    assert made.axes[2].get_xlabel() == "time [s]"
    assert made.axes[0].get_ylabel() == "[A]"


def test_a_map_explains_what_follows_from_a_signal_and_nothing_else():
    random = np.random.default_rng(0)
    x = random.uniform(-1, 1, 4000)
    assert explained_by(x, np.abs(x)) > 0.99
    assert explained_by(x, random.normal(size=4000)) < 0.02  # 38 of 4000 by chance
    seldom = random.normal(size=4000) ** 3
    assert explained_by(seldom, np.maximum(seldom - 3, 0)) > 0.95  # a stop that is hardly ever reached
    assert explained_by(np.ones(4000), x) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.slow
def test_what_only_adds_promises_the_same_where_places_act_in_proportion(lacking):
    """A function of the reference, added to the brake's force or, negative, to the sum behind it."""
    evidence, before, *_ = lacking
    found = Catalogue.of(evidence.load(before.document), {"cross_talk"})
    items = found.candidates(evidence.load(before.document), evidence.recorded)
    pairs = [item for item in items if item.depends_on and not item.spot.side]
    alike = {}
    for item, promise in zip(pairs, evidence.bounds(before).promises(pairs), strict=True):
        alike.setdefault((item.depends_on, promise.misfit), []).append((item, promise))
    shared = [group for group in alike.values() if len(group) > 1]
    assert shared
    for group in shared:
        for item, promise in group:
            [alone] = evidence.bounds(before).promises([item])
            assert promise.misfit == pytest.approx(alone.misfit, rel=1e-6)
            assert list(promise.start.values()) == pytest.approx(list(alone.start.values()), rel=1e-4)


def test_of_a_law_that_linear_theory_fails_at_nothing_is_known(lacking, monkeypatch):
    """FAULT: one singular matrix in one law ended a diagnosis; now it is fitted without a promise."""
    evidence, before, *_ = lacking
    diagram = evidence.load(before.document)
    items = [
        item
        for item in Catalogue.of(diagram, {"dry_friction", "saturation"}).candidates(diagram, evidence.recorded)
        if item.spot.block == "friction"
    ]
    bounds, whole = evidence.bounds(before), LawBounds._promise

    def failing(self, one, steps):
        if one.item.physics == "saturation":
            raise np.linalg.LinAlgError("singular")
        return whole(self, one, steps)

    monkeypatch.setattr(LawBounds, "_promise", failing)
    known = {item.physics: promise is not None for item, promise in zip(items, bounds.promises(items), strict=True)}
    assert known == {"dry_friction": True, "saturation": False}


def test_sensitivities_that_overflow_are_a_failure_and_no_warning(lacking):
    evidence, before, *_ = lacking
    search = evidence.search(before.document)
    here = search.evaluate(search.first(evidence.starts), 1)
    huge = [[1e200 * part for part in parts] for parts in here.jacobians]
    found = evidence._summary(before.document, search, replace(here, jacobians=huge))
    assert found.failure == "the sensitivities of the simulation diverge"


@pytest.mark.slow
@pytest.mark.parametrize(("slow", "size"), [(5000.0, 1.0), (1.0, 1e-6)])
def test_slow_and_small_machines_are_promised_the_same_laws(lacking, slow, size):
    """FAULT: beside samples seconds apart, a mode began below what its block allows, and the diagnosis ended.

    A sample every 25 s, of the servo in rad and rad per 5000 s; and everything a million times smaller.
    """
    document = deepcopy(SERVO)
    document["blocks"]["controller"]["parameters"]["gain"] /= slow**2
    document["blocks"]["friction"]["parameters"]["gain"] /= slow
    run = {name: size * values for name, values in braked(1).items()}
    run["speed"] = run["speed"] / slow
    made = recording([(run, "identify")], {name: (f"{name}.output", "1") for name in NAMES}, RATE / slow)
    evidence = waveform_evidence(load(document), made)
    before = evidence.fit(load(document).document, [])
    physics = {"lag", "missing_mode", "delay", "play", "rate_limit", "periodic_disturbance", "drift", "cross_talk"}
    found = []
    for here, fit in (lacking[:2], (evidence, before)):
        diagram = here.load(fit.document)
        items = Catalogue.of(diagram, physics).candidates(diagram, here.recorded)
        assert {item.physics for item in items} == physics
        promises = zip(items, here.bounds(fit).promises(items), strict=True)
        found.append({item.key: promise.misfit for item, promise in promises if promise is not None})
    if slow == 1.0:  # strengths of free signals are tried in root seconds, by half decades
        assert found[1] == pytest.approx(found[0], rel=STEPS * SETTLED)
    else:
        assert found[1].keys() == found[0].keys()


def test_what_leaves_more_than_a_rival_may_after_the_first_steps_is_not_followed(lacking):
    evidence, before, after, item, _ = lacking
    document = item.document(values_in(before.document, before.values), dict.fromkeys(item.fault.free, 1e-3))
    whole, same = evidence.fit(document, [[{}]]), evidence.fit(document, [[{}]], Effort(beyond=1.2 * after.misfit))
    assert same.misfit == whole.misfit == pytest.approx(after.misfit, rel=1e-3)
    ended = evidence.fit(document, [[{}]], Effort(beyond=0.5 * after.misfit))
    assert 0.5 * after.misfit < ended.misfit < before.misfit
