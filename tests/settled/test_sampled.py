"""Settled motion with sampled controllers against long simulations, and against the continuous controller."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from rotorsim import RotorsimError, load, periodic, simulate
from tests.systems.shipped import DIAGRAMS

RPM = math.pi / 30
GAINS = {"KP": 12200.0, "KI": 3e5, "KD": 6.0}
INCOMMENSURATE = 1500.0 * RPM * (1 + 0.01 * math.sqrt(2))  # 131.5.. samples of 0.3 ms a turn


def machine(name: str = "jeffcott", *sample_times: float, **more: object) -> dict:
    """Return a machine with sampled controllers of these sample times [s]."""
    made = json.loads((DIAGRAMS / f"{name}.json").read_text())
    controllers = [key for key in made["blocks"] if key.startswith("controller")]
    for key, T in zip(controllers, sample_times, strict=False):
        made["blocks"][key] = {"type": "discrete_pid", "parameters": {**GAINS, "sample_time": T, **more}}
    return made


def sampled_sensor(T: float, of_controller: float) -> dict:
    """Return one whose displacement is sampled by itself."""
    made = machine("jeffcott", of_controller)
    made["blocks"]["sensor"] = {"type": "sample_hold", "parameters": {"sample_time": T}}
    made["wires"].remove(["rotor.displacement", "controller.displacement"])
    made["wires"] += [["rotor.displacement", "sensor.input"], ["sensor.output", "controller.displacement"]]
    return made


def settled_run(document: dict, speed: float, signal: str, start: float, stop: float) -> tuple[np.ndarray, np.ndarray]:
    """Return times and x + i y of a run, from when its start is forgotten, in steps of 0.01 ms."""
    made = document | {"solver": {"method": "rk4", "step": 1e-5, "stop": stop}, "record": [signal.partition("[")[0]]}
    run = simulate(load(made), parameters={"speed": speed})
    assert run.status == "finished"
    kept = run.time >= start
    row = run[signal][kept]
    return run.time[kept], row[:, 0] + 1j * row[:, 1]


def harmonics(t: np.ndarray, y: np.ndarray, speed: float, orders: list[int]) -> np.ndarray:
    """Return the components of orders by least squares, with a window that keeps the images apart."""
    weight = np.sqrt(np.hanning(len(t)))[:, None]
    waves = np.exp(1j * np.outer(t, np.array(orders) * speed))
    return np.linalg.lstsq(waves * weight, y * weight[:, 0], rcond=None)[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("document", "signal"),
    [
        (machine("jeffcott", 3e-4), "rotor.displacement"),
        (sampled_sensor(2e-4, 1e-4), "rotor.displacement"),
        (sampled_sensor(2e-4, 3e-4), "rotor.displacement"),
        (machine("fe_flexible", 2e-4), "rotor.displacement[2]"),
    ],
)
def test_harmonics_and_largest_displacement_are_those_of_a_long_run(document: dict, signal: str) -> None:
    found = periodic(load(document), speeds=[INCOMMENSURATE], signals=[signal])
    assert found.status == ("settled",)
    assert found.stable == (True,)
    t, y = settled_run(document, INCOMMENSURATE, signal, 1.5, 3.5)
    orders = found.orders.astype(int).tolist()
    measured = harmonics(t, y, INCOMMENSURATE, orders)
    size = np.abs(found.harmonics[signal][0]).max()
    assert np.abs(measured - found.harmonics[signal][0]).max() < 2e-5 * size  # what is left of the start
    largest = np.abs(y).max()
    assert found.largest(signal)[0] == pytest.approx(largest, rel=3e-4)  # of 256 angles, 8 phases
    beside = np.abs(y - np.exp(1j * np.outer(t, np.array(orders) * INCOMMENSURATE)) @ measured).max()
    assert found.images[signal][0] == pytest.approx(beside, rel=0.05, abs=3e-6 * size)


def test_the_held_current_has_images_as_large_as_its_steps() -> None:
    """A current of one order is held for T: its images are what the staircase is off its own fundamental."""
    T = 5e-4
    document = machine("jeffcott", T)
    machine_of_1x = load(document, without=["crack"])
    found = periodic(machine_of_1x, speeds=[INCOMMENSURATE], signals=["controller.current"])
    size = abs(found.harmonic("controller.current", 1)[0])
    half = INCOMMENSURATE * T / 2
    staircase = size * half / math.sin(half)  # sampled amplitude of which the hold makes this fundamental
    off = staircase * abs(np.exp(1j * half) - math.sin(half) / half)
    assert found.images["controller.current"][0] == pytest.approx(off, rel=1e-6)
    assert found.largest("controller.current")[0] == pytest.approx(staircase, rel=1e-9)


def test_it_goes_to_the_continuous_controller_with_the_sample_time() -> None:
    speed = 2000 * RPM
    wired = json.loads((DIAGRAMS / "jeffcott.json").read_text())
    wired["blocks"]["controller"]["parameters"] = GAINS
    continuous = periodic(load(wired), speeds=[speed]).harmonics["rotor.displacement"][0]
    errors = []
    for T in (2e-5, 1e-5):
        sampled = periodic(load(machine("jeffcott", T)), speeds=[speed])
        middle, half = len(sampled.orders) // 2, len(continuous) // 2
        n = min(middle, half)
        pair = sampled.harmonics["rotor.displacement"][0][middle - n : middle + n + 1]
        errors.append(np.abs(pair - continuous[half - n : half + n + 1]).max() / np.abs(continuous).max())
    assert errors[1] / errors[0] == pytest.approx(0.5, rel=0.02)
    assert errors[1] < 0.01


def test_an_integral_that_nothing_reads_drifts_and_leaves_the_rest() -> None:
    found = periodic(load(machine("jeffcott", 1e-4, KI=0.0)), speeds=[2000 * RPM], signals=["rotor.displacement"])
    assert found.drifting == ("controller.integral[1]", "controller.integral[2]")
    assert found.status[0] == "settled; drifts: controller.integral[1], controller.integral[2]"
    assert np.isfinite(found.harmonics["rotor.displacement"]).all()


def test_an_unstable_loop_says_so() -> None:
    found = periodic(load(machine("jeffcott", 3e-3)), speeds=[2000 * RPM])
    assert found.stable == (False,)
    assert found.status[0].startswith("unstable")


def test_orders_that_are_left_out_are_counted() -> None:
    every, some = (periodic(load(machine("jeffcott", 1e-4)), speeds=[2000 * RPM], harmonics=H) for H in (None, 2))
    assert some.orders.tolist() == [-2, -1, 0, 1, 2]
    assert every.truncation[0] == 0.0
    assert 0.05 < some.truncation[0] < 1.0
    assert some.largest("rotor.displacement") == every.largest("rotor.displacement")  # of the whole motion
    assert every.harmonic("rotor.displacement", 9)[0] != 0


def test_images_that_fall_on_orders_are_said() -> None:
    speed = 2 * math.pi / (4 * 1e-4)  # four samples a turn
    found = periodic(load(machine("jeffcott", 1e-4)), speeds=[speed])
    assert found.status[0].startswith("settled; 4 samples in a period: images fall on its orders")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"amb": "amb_nonlinear"}, "rotor: with sampled blocks a diagram must be linear, with constant coefficients"),
        ({"noise": "noise"}, "noise: random signals have no settled motion"),
    ],
)
def test_what_cannot_be_told_is_refused(change: dict, said: str) -> None:
    document = machine("jeffcott", 1e-4)
    for name, kind in change.items():
        document["blocks"][name] = {"type": kind}
        if kind == "noise":
            document["wires"].append(["noise.output", "rotor.force"])
    with pytest.raises(RotorsimError) as caught:
        periodic(load(document), speeds=[2000 * RPM])
    assert said in str(caught.value)
