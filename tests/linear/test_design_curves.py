"""Root locus and step response: closed forms of one disc, sampled loops against simulation."""

from __future__ import annotations

import copy
import json

import numpy as np
import pytest

from rotorsim import RotorsimError, load, root_locus, simulate, step_response
from tests.acceptance.machines import jeffcott

M, K, D = 2.0, 1.4e6, 150.0  # of `jeffcott(4e5, 150.0)`
SAMPLED = {"type": "discrete_pid", "parameters": {"KP": 12500.0, "KI": 0.0, "KD": 3.75, "sample_time": "0.1 ms"}}


def test_an_entry_of_a_parameter_is_varied_as_the_whole_with_the_others_as_they_are():
    diagram = load("rk4_first_mode")
    y, mass = diagram.nodes["support"].values["stiffness"][1], float(diagram.nodes["rotor"].values["mass"])
    found = root_locus(diagram, "support.stiffness[1]", [1e5, 2e5])
    for value, poles in zip(found.values, found.poles, strict=True):
        own = root_locus(load("rk4_first_mode", set={"support.stiffness": [value, y]}), "rotor.mass", [mass]).poles[0]
        np.testing.assert_array_equal(poles, own)
    assert found.unit == "N/m"


def test_poles_over_a_gain_and_the_limit_of_stability() -> None:
    """m s^2 + k_i KD s + 1e6 - k_s + k_i KP: no pole grows from KD = 0 on."""
    gains = np.linspace(-2.0, 8.0, 11) + 0.1
    found = root_locus(load(jeffcott(4e5, 150.0)), "controller.KD", gains)
    for gain, poles in zip(gains, found.poles, strict=True):
        truth = [s for s in np.roots([M, 40 * gain, K]) if s.imag > 0]
        assert poles[np.isfinite(poles)] == pytest.approx(np.repeat(truth, 2), rel=1e-9)
    assert [one.value for one in found.limits] == pytest.approx([0.0], abs=1e-9)
    assert found.limits[0].frequency == pytest.approx(np.sqrt(K / M) / (2 * np.pi), rel=1e-6)
    hz, ratio, _ = found.least_damped()
    assert ratio == pytest.approx(40 * gains / (2 * np.sqrt(K * M)), rel=1e-9)
    assert hz == pytest.approx(np.sqrt(K / M - (40 * gains / (2 * M)) ** 2) / (2 * np.pi), rel=1e-9)
    assert found.stable.tolist() == (gains > 0).tolist()
    assert found.unit == "A s/m"


def test_the_limit_of_a_sampled_loop_is_that_of_the_simulation() -> None:
    """More computing time: stable below the limit of the sample time, diverging above."""
    machine = jeffcott(4e5, 150.0, copy.deepcopy(SAMPLED))
    found = root_locus(load(machine), "controller.sample_time", np.arange(0.1e-3, 0.5e-3, 0.05e-3))
    (limit,) = (one.value for one in found.limits)
    ends = []
    for factor in (0.97, 1.03):
        machine["blocks"]["controller"]["parameters"]["sample_time"] = float(limit * factor)
        machine["solver"]["step"] = float(limit * factor / 8)
        run = simulate(load(machine), initial=np.array([1e-6, 0.0, 0.0, 0.0]), stop=1.0)
        size = np.abs(run["rotor.displacement"][:, 0])
        half = len(size) // 2
        ends.append(size[half:].max() / size[:half].max())
    assert ends[0] < 1 < ends[1]


def test_a_parameter_that_is_not_there_and_values_that_fall() -> None:
    with pytest.raises(RotorsimError) as caught:
        root_locus(load("jeffcott"), "controller.KD", [2.0, 1.0])
    assert str(caught.value) == "error: controller.KD: values must be finite and ascending"
    with pytest.raises(RotorsimError) as caught:
        root_locus(load("jeffcott"), "controller.KQ", [1.0, 2.0])
    assert "controller.KQ" in str(caught.value)


def test_a_step_of_the_load_in_closed_form() -> None:
    found = step_response(load(jeffcott(4e5, 150.0)), "amb.force", "rotor.displacement[1]", stop=0.2)
    w, z = np.sqrt(K / M), D / (2 * np.sqrt(K * M))
    wd = w * np.sqrt(1 - z**2)
    t = found.time
    truth = (1 - np.exp(-z * w * t) * (np.cos(wd * t) + z * w / wd * np.sin(wd * t))) / K
    assert found.value[:, 0, 0] == pytest.approx(truth, abs=1e-12 * truth.max())
    numbers = found.numbers[0]
    assert numbers.final == pytest.approx(1 / K, rel=1e-9)
    between = (wd * t[1]) ** 2 / 8  # of a peak between two points of time
    assert numbers.overshoot == pytest.approx(np.exp(-np.pi * z / np.sqrt(1 - z**2)), rel=2 * between)
    assert numbers.at == pytest.approx(np.pi / wd, abs=t[1])
    assert numbers.settling == pytest.approx(np.log(1 / 0.02 / np.sqrt(1 - z**2)) / (z * w), rel=0.03)
    share = truth * K
    assert numbers.rise == pytest.approx(t[np.argmax(share > 0.9)] - t[np.argmax(share > 0.1)], abs=1e-12)
    assert (found.numbers[1].largest, found.units[0]) == (0.0, ("m", "N"))


def test_a_step_into_a_sampled_loop_is_that_of_the_simulation() -> None:
    machine = jeffcott(4e5, 150.0, copy.deepcopy(SAMPLED))
    found = step_response(load(machine), "amb.force", "rotor.displacement[1]", stop=0.05)
    machine["blocks"].pop("unbalance")
    machine["wires"] = [wire for wire in machine["wires"] if "unbalance" not in wire[0] + wire[1]]
    machine["blocks"]["load"] = {"type": "constant", "parameters": {"value": [1.0, 0.0]}}
    machine["wires"].append(["load.output", "rotor.force"])
    machine["solver"]["step"] = "0.01 ms"
    run = simulate(load(machine), stop=0.05)
    simulated = np.interp(found.time, run.time, run["rotor.displacement"][:, 0])
    inside = found.time <= 0.05
    assert found.value[inside, 0, 0] == pytest.approx(simulated[inside], abs=2e-4 * simulated.max())
    assert found.numbers[0].final == pytest.approx(1 / K, rel=1e-6)


def test_what_integral_action_makes_zero_has_no_overshoot() -> None:
    pid = {"type": "pid", "parameters": {"KP": 12500.0, "KI": 1e6, "KD": 10.0}}
    found = step_response(load(jeffcott(4e5, 150.0, pid)), "amb.force", "rotor.displacement[1]", stop=1.0)
    numbers = found.numbers[0]
    assert abs(numbers.final) < 1e-9 * numbers.largest
    assert np.isnan(numbers.overshoot)
    assert numbers.settling > 0


def test_a_loop_that_is_not_stable_has_no_final_value() -> None:
    found = step_response(load(jeffcott(4e5, -10.0)), "amb.force", "rotor.displacement[1]")
    assert not found.stable
    assert np.isnan(found.numbers[0].final)
    with pytest.raises(RotorsimError) as caught:
        step_response(load("jeffcott"), "amb.force", "rotor.displacement", stop=-1.0)
    assert str(caught.value) == "error: stop: must be positive and finite [s]"


def test_the_first_peak_is_seen_whatever_slow_poles_there_are() -> None:
    """jeffcott: 121 Hz, and an integral of -0.01 1/s."""
    found = step_response(load("jeffcott"), "amb.force", "rotor.displacement[1]").numbers[0]
    short = step_response(load("jeffcott"), "amb.force", "rotor.displacement[1]", stop=0.02).numbers[0]
    notes = step_response(load("jeffcott"), "amb.force", "rotor.displacement[1]").notes
    assert any("is slower than the" in note for note in notes)
    assert (found.largest, found.at) == (pytest.approx(short.largest, rel=1e-3), pytest.approx(short.at, abs=1e-4))


def test_what_never_comes_to_rest_has_no_final_value() -> None:
    """A body that no bearing holds, and an oscillation without damping."""
    free = jeffcott(4e5, 150.0)
    free["wires"] = [wire for wire in free["wires"] if wire != ["amb.force", "rotor.force"]]
    free["blocks"]["rotor"]["parameters"]["stiffness"] = "0 N/m"
    for machine in (free, jeffcott(4e5, 0.0)):
        for one in step_response(load(machine), "unbalance.force", "rotor.displacement[1]", stop=0.5).numbers:
            assert np.isnan(one.final) or one.largest == 0.0


def test_integral_action_of_a_stiff_machine_is_told() -> None:
    """A step of a sensor's signal is followed to -1 by the integral, however fast the poles of the shaft are."""
    found = step_response(load("two_amb_rotor"), "controller_a.displacement", "rotor.displacement[3]")
    assert [one.final for one in found.numbers if one.output[-3:-1] == one.input[-2:-1].rjust(2, ",")] == pytest.approx(
        [-1.0, -1.0], rel=1e-4
    )


@pytest.fixture
def run(tmp_path, monkeypatch):
    from click.testing import CliRunner

    from rotorsim.cli.app import rotorsim

    monkeypatch.chdir(tmp_path)
    return lambda *arguments: CliRunner().invoke(rotorsim, list(arguments))


@pytest.mark.slow
def test_the_verbs(run) -> None:
    found = run("modes", "jeffcott", "--vary", "controller.KD=-2:0.5:1", "--plot", "locus.png")
    assert (found.exit_code, found.stderr) == (0, "written: locus.png\n")
    assert found.stdout.splitlines()[-1].startswith("limit of stability: -1.80")
    data = json.loads(run("modes", "jeffcott", "--vary", "controller.KD=1, 2", "--json").stdout)
    assert (data["stable"], data["limits"]) == ([True, True], [])
    refused = run("modes", "jeffcott", "--vary", "controller.KD=normal(1, 0.1)")
    assert refused.stderr == (
        "error: --vary controller.KD=normal(1, 0.1): a root locus needs values, not a distribution\n"
    )
    step = ("step", "jeffcott", "--from", "amb.force", "--to", "rotor.displacement", "--stop")
    found = run(*step, "0.1 s", "--plot", "step.png")
    assert found.stdout.splitlines()[0].split()[:4] == ["from", "to", "final", "largest"]
    assert json.loads(run(*step, "0.1 s", "--json").stdout)["numbers"][0]["at"] == pytest.approx(4.1e-3, rel=0.02)
    assert run(*step, "0 s").stderr == "error: --stop 0 s: not a length\n\nhint: for example --stop '0.1 s'\n"
