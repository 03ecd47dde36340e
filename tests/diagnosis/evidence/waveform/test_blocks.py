"""The blocks of machines that do not turn, beside the solutions of their equations."""

import numpy as np
import pytest

from rotorsim.diagram.resolve.resolution import shipped_diagrams
from rotorsim.model.load import load
from rotorsim.simulation.run import simulate
from tests.diagnosis.evidence.waveform.machines import OSCILLATOR, POSITIONER


def test_a_recorded_signal_is_its_value_and_offset_without_a_recording():
    document = {
        "name": "drive",
        "schema_version": 1,
        "solver": {"step": "1 ms", "stop": "2 ms"},
        "record": ["drive.output"],
        "blocks": {
            "drive": {"type": "recorded", "parameters": {"value": [1.0, 2.0], "offset": 0.5}},
            "scope": {"type": "norm"},
        },
        "wires": [["drive.output", "scope.input"]],
    }
    assert simulate(load(document))["drive.output"].tolist() == [[1.5, 2.5]] * 3


def test_an_oscillator_rings_down_as_it_must():
    m, c, k, force = 1.3, 3.0, 900.0, 18.0
    document = {**OSCILLATOR, "blocks": {**OSCILLATOR["blocks"]}}
    document["blocks"]["drive"] = {"type": "recorded", "parameters": {"value": force}}
    result = simulate(load(document), stop=1.0, step=1e-3)
    t = result.time
    w, zeta = np.sqrt(k / m), c / 2 / np.sqrt(k * m)
    wd = w * np.sqrt(1 - zeta**2)
    exact = force / k * (1 - np.exp(-zeta * w * t) * (np.cos(wd * t) + zeta * w / wd * np.sin(wd * t)))
    assert result["oscillator.displacement"] == pytest.approx(exact, abs=1e-7 * force / k)


def test_a_carriage_under_its_controller_ends_where_it_is_wanted():
    document = {**POSITIONER, "blocks": {**POSITIONER["blocks"]}}
    document["blocks"]["reference"] = {"type": "recorded", "parameters": {"value": 0.1}}
    document["record"] = ["carriage.displacement", "controller.voltage"]
    result = simulate(load(document), stop=1.0, step=2e-4)
    assert result["carriage.displacement"][-1] == pytest.approx(0.1, rel=1e-6)
    assert result["controller.voltage"][0] == pytest.approx(150.0 * 100.0 * 0.1)
    # the closed loop: (s + 1 / lag) [s (M s + F) + G Kv Kp] + G Kv s / lag = 0
    lag, mass, friction, gain = 1e-3, 100.0, 100.0, 30.0 * 150.0
    poles = np.roots([mass, friction + mass / lag, gain * 100.0 + (friction + gain) / lag, gain * 100.0 / lag])
    from rotorsim.linear.linearisation import linearise

    system = linearise(load(POSITIONER), inputs=["drive.output"], outputs=["carriage.displacement"])
    assert np.sort_complex(system.poles()) == pytest.approx(np.sort_complex(poles), rel=1e-9)


@pytest.mark.parametrize("name", sorted({"silverbox", "emps"} & set(shipped_diagrams())))
def test_a_shipped_diagram_loads_without_a_warning(name):
    assert load(name).warnings == ()
