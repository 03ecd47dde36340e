"""A diagram driven as recorded: against the truth, a run-up of the same rotor, and what is refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rotorsim.errors import Place, RotorsimError
from rotorsim.identification.as_recorded import simulate_as_recorded
from rotorsim.model.load import load
from rotorsim.recordings.recording import Channel, Recording, Run
from rotorsim.report.figures.as_recorded import as_recorded_figure
from rotorsim.simulation.run import simulate
from tests.identification.waveform.in_time import OSCILLATOR, TRUTH, even, measured, motion, recording, run_of

REACTION = "warning: jeffcott: unbalance.acceleration is wired to clock.acceleration: the speed changes in these runs"
RIGHT = load(OSCILLATOR, set=TRUTH)


def test_the_right_diagram_leaves_what_rk4_gets_wrong():
    made = recording(measured("run0", 1, even(700)), measured("run1", 2, even(700)))
    found = simulate_as_recorded(RIGHT, made, "run1", record=["velocity.output"])
    assert found.run == "run1"
    assert found.errors.nrmse["position.output"] < 3e-4  # the accuracy of steps between samples
    assert found.errors.rms["position.output"] == pytest.approx(
        float(np.sqrt(np.mean((found.result["measured.position.output"] - found.result["position.output"]) ** 2)))
    )
    truth = motion(even(700), made.runs[1].values["u"], [0.0, 0.0])
    started = np.random.default_rng(1002).normal(size=2) * [0.05, 1.0]
    assert [*found.starts.values()] == pytest.approx([started[1], started[0]], rel=1e-2, abs=1e-3)
    assert found.result["velocity.output"].shape == truth[:, 1].shape
    np.testing.assert_array_equal(found.result["drive.output"], made.runs[1].values["u"])


def test_starts_of_the_diagram_are_kept_on_request():
    made = recording(measured("run0", 1, even(700)))
    found = simulate_as_recorded(RIGHT, made, start="diagram")
    assert found.starts["velocity.value"] == 0.0
    assert found.errors.nrmse["position.output"] > 0.05


def test_settings_of_the_run_apply():
    time = even(700)
    run = measured("run0", 1, time)
    soft = load(OSCILLATOR, set={**TRUTH, "spring.gain": 100.0})
    found = simulate_as_recorded(soft, recording(replace(run, settings={"spring.gain": 400.0})))
    assert found.errors.nrmse["position.output"] < 3e-4


def test_the_angle_of_a_shaft_takes_the_place_of_its_clock():
    """A run-up of the same rotor, whose clock turns by itself, is what was measured."""
    names = ["rotor.displacement", "clock.theta"]
    document = load("jeffcott_runup").document
    wires = [*document["wires"], ["clock.acceleration", "unbalance.acceleration"]]
    truth = simulate(load({**document, "wires": wires}), stop=1.0, step=1e-4, record=names)
    part = slice(None, None, 2)
    time, values = truth.time[part], {"x": truth["rotor.displacement"][part, 0], "a": truth["clock.theta"][part]}
    channels = {
        "x": Channel("x", "rotor.displacement", "x", None, None, "m"),
        "a": Channel("a", "clock.theta", None, None, None, "rad"),
    }
    run = Run("up", "up.npz", time, values, None, None, {}, "identify", Place(""), 5000.0)
    made = Recording("run-up", "simulated", Path(), channels, (run,))
    found = simulate_as_recorded(load("jeffcott"), made)
    assert found.errors.nrmse["rotor.displacement[1]"] < 3e-4
    assert list(found.errors.nrmse) == ["rotor.displacement[1]"]
    assert "controller.current[2]" in found.result.signals
    assert [str(warning) for warning in found.warnings] == [REACTION]


def test_the_figure_shows_measured_beside_simulated_with_the_worst_stretch():
    time = even(700)
    run = measured("run0", 1, time)
    bumped = run.values["q"].copy()
    bumped[400:430] += 0.2
    found = simulate_as_recorded(RIGHT, recording(run_of("run0", time, {**run.values, "q": bumped})))
    made = as_recorded_figure(found)
    assert made.get_suptitle() == "oscillator driven as recorded in bench"
    whole, zoom = made.axes
    assert [text.get_text() for text in made.legends[0].get_texts()] == ["measured", "simulated"]
    np.testing.assert_array_equal(whole.lines[0].get_ydata(), bumped)
    assert whole.get_ylabel() == "[m]"
    assert zoom.get_title(loc="left") == "worst stretch"
    left, right = zoom.lines[0].get_xdata()[[0, -1]]
    assert left <= time[405]
    assert right >= time[425]
    assert whole.get_title(loc="left").startswith("position.output, run run0: NRMSE ")


def refused(*arguments, **options) -> str:
    with pytest.raises(RotorsimError) as caught:
        simulate_as_recorded(*arguments, **options)
    return str(caught.value)


def test_what_is_refused():
    made = recording(measured("run0", 1, even(200)))
    assert refused(RIGHT, made, "run1") == "error: bench: no run 'run1'\n\nhint: did you mean 'run0'?"
    assert refused(RIGHT, made, start="zero") == "error: no start 'zero'\n\nhint: one of estimated, diagram"
    assert refused(RIGHT, made, record=["positon.output"]).startswith("error: positon.output: no such signal")
    wild = load({**OSCILLATOR, "identify": {}}, set={"spring.gain": -4e5})
    assert refused(wild, made) == (
        "error: oscillator: its simulation diverges when it is driven as run run0 was\n\n"
        "hint: is the loop stable? are signs and units of what drives it right?"
    )
    turned = replace(made.runs[0], speed=100.0, place=Place("recording.json", 9, 5))
    shaft = replace(
        made, runs=(turned,), channels={"q": replace(made.channels["q"], signal="rotor.displacement", axis="x")}
    )
    assert refused(load("jeffcott"), shaft) == (
        "recording.json:9:5: error: run run0: its shaft angle was not recorded\n\n"
        'hint: give "tacho": times of a once-per-turn pulse, or a channel of clock.theta'
    )
