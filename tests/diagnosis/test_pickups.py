"""Lines of fixed frequency in a closed loop: a force shows in displacement and current, pick-up in some channels."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from rotorsim.diagnosis.diagnosis import diagnose
from rotorsim.diagnosis.evidence.base_fit import base_fit
from rotorsim.diagnosis.evidence.fit import Fit
from rotorsim.diagnosis.evidence.harmonic.drifts import drift_warnings, find_drifts, with_drifts
from rotorsim.diagnosis.evidence.harmonic.evidence import HarmonicEvidence
from rotorsim.diagnosis.evidence.harmonic.open import Conditions, harmonic_evidence
from rotorsim.diagnosis.evidence.harmonic.pickups import find_pickups
from rotorsim.model.load import load
from rotorsim.recordings.recording import Recording
from rotorsim.signals.pickup import Pickup, pickup_warnings
from tests.diagnosis.test_lines import RATE, TURN, Machine, N, recording

TIME = np.arange(N) / RATE
HUM = 2e-9  # m, as large as the noise


@cache
def healthy() -> Recording:
    return recording(Machine())


@cache
def shaken(hertz: float) -> Recording:
    """Shaken by 5 mm/s2: about 40 nm of the displacement, twenty times its noise."""
    return recording(Machine(shaking=0.005, nu=TURN * hertz))


def picked_up(data: Recording, channels: dict[str, float], hertz: float) -> Recording:
    """Return a recording with a line of any phase in some channels {column: amplitude}."""
    random = np.random.default_rng(8)
    runs = []
    for run in data.runs:
        more = {c: a * np.cos(TURN * hertz * TIME + random.uniform(0, TURN)) for c, a in channels.items()}
        runs.append(replace(run, values={c: values + more.get(c, 0.0) for c, values in run.values.items()}))
    return replace(data, runs=tuple(runs))


def prepared(data: Recording) -> tuple[Fit, HarmonicEvidence]:
    source, _ = harmonic_evidence(HarmonicEvidence(data, (), None, False), None, Conditions())
    return base_fit(load("jeffcott"), source)[0], source


@pytest.mark.parametrize(
    ("channels", "hertz"),
    [
        ({"rx": HUM, "iy": 1e-5}, 50.0),
        *(
            pytest.param(*each, marks=pytest.mark.slow)
            for each in (({"rx": HUM, "ry": HUM}, 50.0), ({"ix": 1e-5}, 60.0), ({"ry": 2 * HUM}, 83.0))
        ),
    ],
)
def test_what_some_channels_show_is_picked_up(channels, hertz):
    base, source = prepared(picked_up(healthy(), channels, hertz))
    assert find_pickups(base, source) == pytest.approx([hertz], abs=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("hertz", [50.0, pytest.param(41.7, marks=pytest.mark.slow)])
def test_what_the_loop_shows_as_a_force_is_no_pickup(hertz):
    base, source = prepared(shaken(hertz))
    assert source.second is not None
    assert find_pickups(base, source) == []


def test_without_lines_nothing_is_picked_up():
    base, source = prepared(healthy())
    assert find_pickups(base, source) == []


@pytest.mark.slow
def test_hum_is_said_and_no_physics_of_the_machine():
    """15 nm of 50 Hz once made an unknown force at the rotor; here it is as large as the noise."""
    found = diagnose(
        load("jeffcott"), picked_up(healthy(), {"rx": HUM, "ry": HUM}, 50.0), physics=["runout"], workers=1
    )
    assert found.verdict == "consistent"
    assert found.effects == ()
    [said] = [problem.what for problem in found.warnings if "picked up" in problem.what]
    sizes = "2e-09 m in rotor.displacement[1], 2e-09 m in rotor.displacement[2]"
    assert said == f"a line of 50.01 Hz is picked up: {sizes}: it is fitted beside the harmonics, as no physics"
    assert 0.9 < found.after.misfit / found.after.freedom < 1.1


def test_a_pickup_is_said_with_its_size_and_the_orders_that_it_hides():
    found = Pickup(50.0, {"rotor.displacement[1]": 1.5e-8, "controller.current[1]": 0.0}, (("run04", 1),))
    warnings = pickup_warnings([found], healthy(), "is picked up", "it is fitted beside the harmonics, as no physics")
    assert [(problem.subject, problem.what) for problem in warnings] == [
        (
            healthy().name,
            "a line of 50.00 Hz is picked up: 1.5e-08 m in rotor.displacement[1]: it is fitted beside the harmonics, "
            "as no physics",
        ),
        ("run run04", "50.00 Hz is not told from order 1 here: that order counts less"),
    ]


@pytest.mark.slow
def test_an_offset_that_drifts_is_its_sensors():
    """20 nm over a run in x, and any offset beside: 45 nm^2 of variance in the mean, of which noise makes 0.002."""
    random = np.random.default_rng(9)
    runs = []
    for run in healthy().runs:
        drift = 20e-9 * (TIME / TIME[-1] + random.uniform(-0.5, 0.5))
        runs.append(replace(run, values={**run.values, "rx": run.values["rx"] + drift}))
    base, source = prepared(replace(healthy(), runs=tuple(runs)))
    assert base.misfit > 5 * base.rows
    drifts = find_drifts(base, source)
    assert drifts["rotor.displacement[1]"] == pytest.approx(10e-9, rel=0.1)
    assert "rotor.displacement[2]" not in drifts
    less = base_fit(load("jeffcott"), replace(source, harmonics=with_drifts(source.harmonics, drifts)))[0]
    assert 0.85 < less.misfit / less.rows < 1.1
    said = [(problem.subject, problem.what) for problem in drift_warnings(drifts, source.recording)]
    assert said[0] == ("rotor.displacement[1]", "its offset drifts, by 2e-08 m over a run: its mean counts less")
    found = diagnose(load("jeffcott"), source.recording, physics=["sensor_offset"], workers=1)
    assert found.verdict == "consistent"
    assert said[0] in [(problem.subject, problem.what) for problem in found.warnings]


def test_what_has_not_drifted_does_not():
    base, source = prepared(healthy())
    assert find_drifts(base, source) == {}
    assert with_drifts(source.harmonics, {}) == source.harmonics
