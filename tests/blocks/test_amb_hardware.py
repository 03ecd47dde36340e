"""A magnetic bearing with its hardware and a controller of translation and tilt, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from rotorsim import RotorsimError, linearise, load, margins, simulate
from rotorsim.linear.stability import growing
from rotorsim.measure.injection import Sweep, with_sweeps
from tests.acceptance.machines import jeffcott
from tests.blocks.evaluation import prepare

MU_0 = 4e-7 * np.pi
PLATE = {
    "bias_current": 2.0,
    "air_gap": 0.4e-3,
    "turns": 120.0,
    "pole_area": 3e-4,
    "pole_angle": np.pi / 8,
    "iron_length": 0.1e-3,
    "voltage": 80.0,
    "resistance": 1.5,
    "bandwidth": 9000.0,
    "largest_current": 1.8,
}
PATH = 2 * PLATE["air_gap"] + PLATE["iron_length"]
K_I = 4 * PLATE["pole_area"] * np.cos(np.pi / 8) * MU_0 * PLATE["turns"] ** 2 * PLATE["bias_current"] / PATH**2
K_S = 2 * K_I * PLATE["bias_current"] / PATH
INDUCTANCE = MU_0 * PLATE["turns"] ** 2 * PLATE["pole_area"] / PATH
AT_REST = {"displacement": np.zeros(2), "current": np.zeros(2)}


def of(displacement=(0.0, 0.0), demand=(0.0, 0.0), flowing=(0.0, 0.0), iron="linear", **more):
    block = prepare("amb_actuator", {"displacement": (2,), "current": (2,)}, {**PLATE, **more}, {"iron": iron})
    given = {"displacement": np.array(displacement), "current": np.array(demand)}
    found = block.evaluate(given, {"flowing": np.array(flowing)})
    return {"force": found.outputs["force"], "flowing": found.derivatives["flowing"]}


def test_the_small_signal_factors_are_those_of_the_magnets() -> None:
    """k_i = mu_0 N^2 A cos(alpha) i0 / g0^2, k_s = k_i i0 / g0 with no iron; Schweitzer & Maslen (2009), (4.28)."""
    h = 1e-7
    slope = (of(displacement=(h, 0.0))["force"] - of(displacement=(-h, 0.0))["force"]) / (2 * h)
    assert slope == pytest.approx([K_S, 0.0], rel=1e-6)
    h = 1e-4
    slope = (of(flowing=(0.0, h))["force"] - of(flowing=(0.0, -h))["force"]) / (2 * h)
    assert slope == pytest.approx([0.0, -K_I], rel=1e-6)
    g0 = PLATE["air_gap"]
    no_iron = MU_0 * PLATE["turns"] ** 2 * PLATE["pole_area"] * np.cos(np.pi / 8) * PLATE["bias_current"] / g0**2
    small = of(flowing=(h, 0.0), iron_length=0.0)["force"][0]
    assert small == pytest.approx(-no_iron * h, rel=1e-6)


def test_no_force_exceeds_that_of_saturated_iron() -> None:
    most = 1.2**2 * PLATE["pole_area"] * np.cos(np.pi / 8) / MU_0
    plate = {"saturation_flux_density": 1.2, "turns": 200.0, "bias_current": 1.0}
    full = of(flowing=(-1.0, 0.0), displacement=(0.39e-3, 0.0), iron="saturating", **plate)["force"][0]
    assert 0.95 * most < full < most
    assert of(flowing=(-1.5, 0.0), iron="saturating", **plate)["force"][0] < most


def test_a_magnet_does_not_push() -> None:
    beyond, at = (of(flowing=(current, 0.0))["force"][0] for current in (2.5, 2.0))
    lower = MU_0 * PLATE["turns"] * 4.5 / PATH
    assert beyond == pytest.approx(-(lower**2) * PLATE["pole_area"] * np.cos(np.pi / 8) / MU_0, rel=1e-9)
    assert beyond < at < 0


def test_the_amplifier_follows_within_its_bandwidth_and_its_voltage() -> None:
    slow = of(demand=(1e-3, 0.0), flowing=(0.0, 0.0))["flowing"]
    assert slow == pytest.approx([9000.0 * 1e-3, 0.0], rel=1e-12)
    fast = of(demand=(1.8, -1.8), flowing=(0.3, 0.3))["flowing"]
    rising = (80.0 - 1.5 * 2.3) / INDUCTANCE
    falling = (80.0 - 1.5 * 1.7) / INDUCTANCE
    assert fast == pytest.approx([rising, -falling], rel=1e-12)
    assert of(demand=(5.0, 0.0), flowing=(1.8 - 1e-4, 0.0))["flowing"][0] == pytest.approx(9000.0 * 1e-4, rel=1e-9)


def test_a_loop_with_a_slow_amplifier_has_the_margins_of_a_lag() -> None:
    machine = jeffcott(4e5, 600.0)
    machine["blocks"]["amb"] = {"type": "amb_actuator", "parameters": {**PLATE, "turns": 60.0, "voltage": 200.0}}
    machine["blocks"]["amb"]["parameters"] |= {"iron_length": 0.0}
    g0, plate = PLATE["air_gap"], machine["blocks"]["amb"]["parameters"]
    ki = MU_0 * plate["turns"] ** 2 * plate["pole_area"] * np.cos(np.pi / 8) * plate["bias_current"] / g0**2
    ks = ki * plate["bias_current"] / g0
    plate["saturation_flux_density"] = 1e3
    gains = machine["blocks"]["controller"]["parameters"]
    gains |= {"KP": (4e5 + ks) / ki, "KD": 600.0 / ki}
    hz = np.geomspace(1.0, 2000.0, 20_001)
    s = 2j * np.pi * hz
    G = ki * (gains["KP"] + gains["KD"] * s) / (1 + s / 9000.0) / (2.0 * s**2 + 1e6 - ks)
    assert margins(load(machine)).peak == pytest.approx(np.abs(1 / (1 + G)).max(), rel=1e-5)


def test_a_step_of_the_demand_is_slewed_by_the_voltage() -> None:
    machine = jeffcott(4e5, 600.0)
    machine["blocks"] |= {
        "step": {"type": "step", "parameters": {"initial": [0.0, 0.0], "final": [1.0, 0.0], "time": "1 ms"}},
        "driven": {"type": "amb_actuator", "parameters": {**PLATE, "resistance": 0.0, "voltage": 20.0}},
    }
    machine["wires"] += [["step.output", "driven.current"], ["rotor.displacement", "driven.displacement"]]
    machine["record"] = ["driven.flowing_current"]
    machine["solver"]["step"] = "0.005 ms"
    found = simulate(load(machine), stop=0.004)
    current = found["driven.flowing_current"][:, 0]
    rate = 20.0 / INDUCTANCE
    ramp = (found.time > 1.01e-3) & (current < 1.0 - 1.05 * rate / 9000.0)
    assert ramp.sum() > 10
    assert np.diff(current[ramp]) / np.diff(found.time[ramp]) == pytest.approx(rate, rel=1e-6)


@pytest.mark.parametrize(
    ("plate", "text"),
    [
        (
            {"bias_current": 6.0, "turns": 200.0},
            "error: amb: the bias makes 1.51 T in the gap, and the iron saturates at 1.5 T",
        ),
        (
            {"voltage": 2.0},
            "error: amb: bias_current and largest_current need 2.5 V over the resistance, and voltage is 2 V",
        ),
    ],
)
def test_hardware_that_cannot_be(plate, text: str) -> None:
    machine = jeffcott(4e5, 600.0)
    machine["blocks"]["amb"] = {"type": "amb_actuator", "parameters": plate}
    with pytest.raises(RotorsimError) as caught:
        load(machine)
    assert text in str(caught.value)


# -- translation and tilt ----------------------------------------------------------------------------------------------


def rigid(controller, probes=(1, 3), kp=(1.2e4, 1.2e4), kd=(20.0, 20.0)):
    """Return a rigid rotor of 4 kg in two magnetic bearings at its ends, its disc off the middle at 0.15 of 0.4 m."""
    rotor = {
        "elements": 4,
        "element_length": [0.05, 0.1, 0.15, 0.1],
        "outer_diameter": "50 mm",
        "young_modulus": "1e13 N/m^2",
        "density": "1 kg/m^3",
        "stiffness_damping": "1e-7 s",
        "disc_nodes": [3],
        "disc_mass": [4.0],
        "disc_polar_inertia": [0.0],
        "disc_diametral_inertia": [0.05],
    }
    magnets = (1, 5)
    amb = {"type": "amb", "parameters": {"force_displacement_factor": 1e5, "force_current_factor": 40.0}}
    blocks = {
        "clock": {"type": "clock", "parameters": {"speed": "$speed"}},
        "rotor": {"type": "rotor_fe", "parameters": rotor},
    }
    z = np.array([0.0, 0.05, 0.15, 0.3, 0.4]) - 0.15
    wires = [["clock.speed", "rotor.speed"]]
    for k, (probe, magnet) in enumerate(zip(probes, magnets, strict=True), 1):
        blocks[f"amb{k}"] = amb
        wires += [
            [f"rotor.displacement[{magnet}]", f"amb{k}.displacement"],
            [f"amb{k}.force", f"rotor.force[{magnet}]"],
        ]
        if controller == "modal":
            wires += [
                [f"rotor.displacement[{probe}]", f"controller.displacement[{k}]"],
                [f"rotor.velocity[{probe}]", f"controller.velocity[{k}]"],
                [f"controller.current[{k}]", f"amb{k}.current"],
            ]
        else:
            blocks[f"pid{k}"] = {"type": "pid", "parameters": {"KP": kp[0], "KI": 0.0, "KD": kd[0]}}
            wires += [
                [f"rotor.displacement[{probe}]", f"pid{k}.displacement"],
                [f"rotor.velocity[{probe}]", f"pid{k}.velocity"],
                [f"pid{k}.current", f"amb{k}.current"],
            ]
    if controller == "modal":
        places = {
            "probe_positions": [float(z[node - 1]) for node in probes],
            "magnet_positions": [float(z[node - 1]) for node in magnets],
        }
        gains = {"KP": list(kp), "KI": [0.0, 0.0], "KD": list(kd)}
        blocks["controller"] = {"type": "modal_pid", "parameters": {**places, **gains}}
    return {
        "schema_version": 1,
        "name": "rigid",
        "parameters": {"speed": "0 rad/s"},
        "blocks": blocks,
        "wires": wires,
        "solver": {"method": "lsoda", "step": "0.1 ms", "stop": "0.1 s"},
        "record": ["rotor.displacement"],
    }


def test_translation_and_tilt_have_gains_of_their_own_wherever_the_probes_are() -> None:
    """m u'' + k_i 2 (KP u + KD u') = 0 without k_s, and J v'' + 2 k_i l^2 (KP v + KD v') = 0 of the tilt."""
    machine = rigid("modal", probes=(2, 4), kp=(1.2e4, 0.6e4), kd=(20.0, 8.0))
    for name in ("amb1", "amb2"):
        machine["blocks"][name] = {
            "type": "amb",
            "parameters": {"force_displacement_factor": 1e-3, "force_current_factor": 40.0},
        }
    found = np.linalg.eigvals(linearise(load(machine), inputs=(), outputs=()).A)
    low = np.sort_complex(found[(found.imag > 1.0) & (np.abs(found) < 1e4)])
    half = 0.2
    translation = np.roots([4.0, 2 * 40 * 20.0, 2 * 40 * 1.2e4])
    tilt = np.roots([0.05 / half, 2 * 40 * half * 8.0, 2 * 40 * half * 0.6e4])
    expected = np.sort_complex([pole for pole in (*translation, *tilt) if pole.imag > 0])
    assert low == pytest.approx(np.repeat(expected, 2), rel=1e-3)  # a shaft that is not quite rigid


def test_it_is_a_pid_in_each_bearing_where_probes_and_magnets_are_at_equal_distances() -> None:
    alike = rigid("modal", probes=(1, 5))
    alike["blocks"]["controller"]["parameters"] |= {"probe_positions": [-0.2, 0.2], "magnet_positions": [-0.2, 0.2]}
    both = [linearise(load(one), inputs=(), outputs=()).A for one in (alike, rigid("pid", probes=(1, 5)))]
    poles = [np.sort_complex(np.linalg.eigvals(A)) for A in both]
    low = [values[(np.abs(values) < 1e4) & (np.abs(values) > 1e-6)] for values in poles]
    assert low[0] == pytest.approx(low[1], rel=1e-6)
    assert not growing(both[0])


@pytest.mark.slow
def test_its_loops_have_margins() -> None:
    found = margins(load(rigid("modal", probes=(2, 4))))
    assert [axis.name for axis in found.axes] == [
        f"controller.displacement[{k},{axis}]" for k in (1, 2) for axis in (1, 2)
    ]
    assert found.stable


def test_places_that_tell_no_tilt() -> None:
    machine = rigid("modal")
    machine["blocks"]["controller"]["parameters"]["probe_positions"] = [0.1, 0.1]
    with pytest.raises(RotorsimError) as caught:
        load(machine)
    assert "controller: probe_positions are 0.1 m and 0.1 m: two places tell translation from tilt" in str(caught.value)


def test_a_block_taken_out_leaves_its_part_of_an_input_at_zero() -> None:
    """FAULT of an earlier version: refused, "add a wire to each" for the wire that --without takes out."""
    machine = rigid("modal")
    machine["blocks"]["probe"] = {"type": "gain", "parameters": {"gain": 0.0}}
    for ends in machine["wires"]:
        if ends[1] == "controller.displacement[1]":
            ends[1] = "probe.input"
    machine["wires"].append(["probe.output", "controller.displacement[1]"])
    dead, cut = load(machine), load(machine, without=["probe"])
    assert ("controller", "displacement") in cut.cut
    np.testing.assert_array_equal(*(linearise(one, inputs=(), outputs=()).A for one in (dead, cut)))


@pytest.mark.slow
def test_a_test_signal_is_added_to_an_input_that_is_wired_by_parts() -> None:
    """FAULT of an earlier version: refused."""
    machine = load(rigid("modal", probes=(2, 4)))
    port = "controller.displacement"
    made = with_sweeps(machine, [port], Sweep(5.0, 500.0, {port: 1e-6}), (0.0, 1.0))
    hz = np.array([20.0, 100.0])
    ends = ("injection_test.output", "injection_test.rate")
    found = linearise(load(made.document), inputs=ends, outputs=("injection_after.output",)).response(hz)
    S = found[:, :, :4] + 2j * np.pi * hz[:, None, None] * found[:, :, 4:]
    np.testing.assert_allclose(S, margins(machine, port, frequencies=hz).sensitivity, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize(
    ("wire", "text"),
    [
        (
            None,
            "error: controller.displacement: input is wired by parts, but not displacement[2]\n\nhint: add a wire to ",
        ),
        ("controller.displacement[1]", "error: controller.displacement[1]: input is wired twice: from "),
        ("controller.displacement[1,2]", "error: controller.displacement[1,2]: "),
        ("controller.displacement", "error: controller.displacement: input is wired twice: from "),
    ],
)
def test_parts_of_an_input(wire: str | None, text: str) -> None:
    machine = rigid("modal")
    place = next(k for k, ends in enumerate(machine["wires"]) if ends[1] == "controller.displacement[2]")
    source = machine["wires"].pop(place)[0]
    if wire is not None:
        machine["wires"].append([source, wire])
    with pytest.raises(RotorsimError) as caught:
        load(machine)
    assert str(caught.value).startswith(text)
