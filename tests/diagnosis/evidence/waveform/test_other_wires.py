"""What depends on another wire in motors and circuits that NumPy simulates: named, located, sized, and nothing else."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from rotorsim import load_recording
from rotorsim.diagnosis.catalogue.finder import insertions
from rotorsim.diagnosis.catalogue.insertion import Insertion
from rotorsim.diagnosis.diagnosis import diagnose
from rotorsim.model.load import load
from rotorsim.recordings.recording import Recording

SAMPLES, FINE = 1600, 8
MOTOR = {  # w' = 30 u - 2 w, a' = w: a motor, without the mass on its disc
    "schema_version": 1,
    "name": "motor",
    "blocks": {
        "voltage": {"type": "recorded", "parameters": {"interpolation": "hold"}},
        "motor": {"type": "gain", "parameters": {"gain": 25.0}},
        "friction": {"type": "gain", "parameters": {"gain": 3.0}},
        "torque": {"type": "sum", "parameters": {"signs": "+-"}},
        "speed": {"type": "integrator"},
        "angle": {"type": "integrator"},
    },
    "wires": [
        ["voltage.output", "motor.input"],
        ["motor.output", "torque.input1"],
        ["friction.output", "torque.input2"],
        ["torque.output", "speed.input"],
        ["speed.output", "friction.input"],
        ["speed.output", "angle.input"],
    ],
    "solver": {"method": "rk4", "step": "1 ms", "stop": "1 s"},
    "record": ["speed.output", "angle.output"],
    "identify": {"motor.gain": {"low": 0.0}, "friction.gain": {"low": 0.0}},
}
CIRCUIT = {  # L i' = u - R i - v, C v' = i
    "schema_version": 1,
    "name": "circuit",
    "blocks": {
        "source": {"type": "recorded", "parameters": {"interpolation": "hold"}},
        "voltage": {"type": "sum", "parameters": {"signs": "+--"}},
        "inductance": {"type": "gain", "parameters": {"gain": 10.0}},
        "coil": {"type": "integrator"},
        "resistor": {"type": "gain", "parameters": {"gain": 1.5}},
        "capacitance": {"type": "gain", "parameters": {"gain": 10.0}},
        "capacitor": {"type": "integrator"},
    },
    "wires": [
        ["source.output", "voltage.input1"],
        ["resistor.output", "voltage.input2"],
        ["capacitor.output", "voltage.input3"],
        ["voltage.output", "inductance.input"],
        ["inductance.output", "coil.input"],
        ["coil.output", "resistor.input"],
        ["coil.output", "capacitance.input"],
        ["capacitance.output", "capacitor.input"],
    ],
    "solver": {"method": "rk4", "step": "1 ms", "stop": "1 s"},
    "record": ["coil.output", "capacitor.output"],
    "identify": {f"{name}.gain": {"low": 0.0} for name in ("inductance", "resistor", "capacitance")},
}


def simulated(
    rates: Callable[[np.ndarray, float], np.ndarray], rate: float, size: float, noise: tuple[float, float], seed: int
) -> np.ndarray:
    """Return input and both states, with noise, by Runge-Kutta steps of an eighth of a sample."""
    random = np.random.default_rng(seed)
    u = np.repeat(random.normal(size=SAMPLES // 10) * size, 10)
    x, h = np.zeros(2), 1 / rate / FINE
    out = np.empty((SAMPLES, 3))
    for k in range(SAMPLES):
        out[k] = u[k], *x
        for _ in range(FINE):
            k1 = rates(x, u[k])
            k2 = rates(x + h / 2 * k1, u[k])
            k3 = rates(x + h / 2 * k2, u[k])
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + rates(x + h * k3, u[k]))
    out[:, 1:] += random.normal(size=(SAMPLES, 2)) * noise
    return out


def motor(mass: float) -> Callable[[np.ndarray, float], np.ndarray]:
    return lambda x, u: np.array([30.0 * u - 2.0 * x[0] - mass * np.sin(x[1]), x[0]])


def circuit(drop: float) -> Callable[[np.ndarray, float], np.ndarray]:
    """A coil whose inductance falls beyond a current of 1.5, to 1 - drop of what it was; 1/L = 12, R = 1, 1/C = 12."""

    def rates(x: np.ndarray, u: float) -> np.ndarray:
        fallen = 1 - drop * (1 + np.tanh((abs(x[0]) - 1.5) / 0.3)) / 2
        return np.array([12.0 * (u - x[0] - x[1]) / fallen, 12.0 * x[0]])

    return rates


def recording(folder: Path, names: tuple[str, ...], rate: float, runs: list[np.ndarray]) -> Recording:
    channels = {name: {"signal": f"{name}.output", "unit": "1"} for name in names}
    listed = []
    for number, run in enumerate(runs, start=1):
        np.savez(folder / f"run{number}.npz", **dict(zip(names, run.T, strict=True)))
        use = "hold_out" if number == len(runs) else "identify"
        listed.append({"id": f"run{number}", "file": f"run{number}.npz", "sample_rate": f"{rate} Hz", "use": use})
    (folder / "recording.json").write_text(
        json.dumps({"name": "other wires", "source": "NumPy", "channels": channels, "runs": listed})
    )
    return load_recording(folder)


def motors(folder: Path, mass: float) -> Recording:
    runs = [simulated(motor(mass), 50.0, 1.5, (0.05, 5e-3), seed) for seed in (1, 2, 3)]
    return recording(folder, ("voltage", "speed", "angle"), 50.0, runs)


def circuits(folder: Path, drop: float) -> Recording:
    runs = [simulated(circuit(drop), 50.0, 3.0, (5e-3, 5e-3), seed) for seed in (1, 2, 3)]
    return recording(folder, ("source", "coil", "capacitor"), 50.0, runs)


ADDED = {
    "friction.output": 1.0,
    "motor.output": -1.0,
    "voltage.output": -30.0,
}  # what it adds, as a torque: no data tell


@pytest.mark.slow
def test_a_torque_that_depends_on_the_angle_is_named_with_the_angle(tmp_path):
    found = diagnose(load(MOTOR), motors(tmp_path, 80.0), workers=1)
    assert found.verdict == "missing_physics"
    [effect] = found.effects
    item = effect.candidate.insertion
    assert (item.physics, item.depends_on) == ("position_ripple", "angle.output")
    assert {str(spot) for spot in found.spots} <= {*ADDED, "torque.output"}
    assert "position_ripple at" in found.statement
    assert "(depends on angle.output)" in found.statement
    values, factor = found.after.values, ADDED.get(str(item.spot), -1.0)
    assert abs(values[f"{item.name}.wave_number"] - 1.0) < 0.01
    assert abs(factor * values[f"{item.name}.sine"] - 80.0) < 0.8
    assert abs(values["motor.gain"] - 30.0) < 0.3
    assert abs(values["friction.gain"] - 2.0) < 0.1


@pytest.mark.slow
def test_an_inductance_that_depends_on_the_current_is_located_at_the_coil(tmp_path):
    found = diagnose(load(CIRCUIT), circuits(tmp_path, 0.8), workers=1)
    assert found.verdict == "missing_physics"
    [effect] = found.effects
    item = effect.candidate.insertion
    assert (item.physics, item.depends_on) == ("signal_dependent_gain", "coil.output")
    assert {str(spot) for spot in found.spots} <= {"voltage.output", "inductance.output"}
    before, after = found.score_before.total, found.score_after.total
    assert before > 10 * after
    values = found.after.values
    assert abs(values["resistor.gain"] - 1.0) < 0.02
    assert abs(values["inductance.gain"] - 12.0) < 0.24


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["motor", "circuit"])
def test_nothing_depends_on_another_wire_where_nothing_does(tmp_path, kind):
    made, document = (motors, MOTOR) if kind == "motor" else (circuits, CIRCUIT)
    found = diagnose(load(document), made(tmp_path, 0.0), workers=1)
    assert found.verdict == "consistent"
    assert not found.effects


def test_what_depends_on_another_wire_is_tried_with_signals_that_differ_by_more_than_a_gain():
    diagram = load(CIRCUIT)
    found = [item for item in insertions(diagram, ["coil.output", "capacitor.output"]) if item.depends_on]
    pairs = {(str(item.spot), item.spot.side, item.depends_on) for item in found}
    assert ("voltage.output", "", "coil.output") in pairs
    assert ("coil.output", "reading", "voltage.output") in pairs
    assert {other for *_, other in pairs} == {"source.output", "voltage.output", "coil.output", "capacitor.output"}
    assert not {place for place, side, other in pairs if other == "coil.output"} & {"resistor.output", "coil.output"}
    # the voltage across the coil follows from the capacitor's at once: beside it there would be an algebraic loop
    assert ("capacitor.output", "", "voltage.output") not in pairs
    # a polynomial of the current beside the resistor's voltage is one of that voltage, which is tried by itself
    assert not [
        i
        for i in found
        if (i.spot.port, i.spot.block) == ("output", "voltage")
        and i.physics == "cross_talk"
        and i.depends_on == "coil.output"
    ]
    for item in found[::7]:
        load(item.document(diagram.document, dict.fromkeys(item.fault.free, 1.0)))


GENERATOR = {  # e = k i W behind a field of 1/L and R, W recorded
    "schema_version": 1,
    "name": "generator",
    "blocks": {
        "voltage": {"type": "recorded"},
        "speed": {"type": "recorded"},
        "balance": {"type": "sum", "parameters": {"signs": "+-"}},
        "inverse_inductance": {"type": "gain", "parameters": {"gain": 5.0}},
        "current": {"type": "integrator"},
        "resistance": {"type": "gain", "parameters": {"gain": 2.0}},
        "flux": {"type": "gain", "parameters": {"gain": 0.5}},
        "emf": {"type": "product"},
        "voltmeter": {"type": "gain", "parameters": {"gain": 1.0}},
    },
    "wires": [
        ["voltage.output", "balance.input1"],
        ["resistance.output", "balance.input2"],
        ["balance.output", "inverse_inductance.input"],
        ["inverse_inductance.output", "current.input"],
        ["current.output", "resistance.input"],
        ["current.output", "flux.input"],
        ["flux.output", "emf.input1"],
        ["speed.output", "emf.input2"],
        ["emf.output", "voltmeter.input"],
    ],
    "record": ["voltmeter.output"],
}


RECORDED = ["voltage.output", "speed.output", "voltmeter.output"]


def without_resistance() -> dict:
    document = copy.deepcopy(GENERATOR)
    document["blocks"]["balance"]["parameters"]["signs"] = "+"
    del document["blocks"]["resistance"]
    document["wires"] = [wire for wire in document["wires"] if not any("resistance" in end for end in wire)]
    return document


def test_what_an_integral_adds_to_its_own_rate_is_a_leak():
    """FAULT: each leak was named as cross-talk from the integral as well."""
    document = without_resistance()
    found = [item for item in insertions(load(document), RECORDED) if item.depends_on == "current.output"]
    leaks = [item for item in found if item.physics == "integrator_leak"]
    before = {"voltage.output", "balance.output", "inverse_inductance.output"}
    assert {str(item.spot) for item in leaks} == before
    assert not before & {str(item.spot) for item in found if item.physics == "cross_talk"}
    assert {item.name for item in leaks} == {"integrator_leak"}
    load(leaks[0].document(document, {"linear": -1.0}))
    beside = insertions(load(GENERATOR), RECORDED)  # where it enters the same sum it is a gain of the resistance
    assert not [i for i in beside if (i.physics, i.depends_on) == ("integrator_leak", "current.output")]


def test_what_an_integral_adds_in_front_of_a_rate_that_is_recorded_is_no_leak():
    found = insertions(load(without_resistance()), [*RECORDED, "balance.output"])
    leaks = [i for i in found if (i.physics, i.depends_on) == ("integrator_leak", "current.output")]
    assert {str(item.spot) for item in leaks} == {"balance.output", "inverse_inductance.output"}
    assert {item.spot.side for item in leaks} == {""}


def test_a_gain_that_depends_on_another_factor_of_a_product_is_a_law_of_that_factor():
    """FAULT: an iron that saturates was a gain of the voltage, or of the speed, that depends on the current."""

    def places(items: list[Insertion], law: str) -> set[str]:
        of_law = (i for i in items if i.physics == "signal_dependent_gain" and i.values["law"] == law)
        return {str(i.spot) for i in of_law if i.depends_on == "current.output" and not i.spot.side}

    for law in ("linear", "square"):  # of its square and its cube
        assert not places(insertions(load(GENERATOR), RECORDED), law) & {"emf.output", "speed.output"}
    assert {"emf.output", "speed.output"} <= places(
        insertions(load(GENERATOR), RECORDED), "knee"
    )  # a polynomial has none
    divided = copy.deepcopy(GENERATOR)
    divided["blocks"]["emf"]["parameters"] = {"operations": "/*"}
    assert "speed.output" in places(insertions(load(divided), RECORDED), "linear")
