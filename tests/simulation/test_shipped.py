"""Linear analyses and periodic motion of the shipped diagrams, made of real blocks."""

import math

import numpy as np
import pytest

from rotorsim.diagram.resolve.resolution import shipped_diagrams
from rotorsim.errors import RotorsimError
from rotorsim.linear.control.design import closed_loop, design_state_feedback, plant_of
from rotorsim.linear.control.margins import margins
from rotorsim.linear.modes.eigenmodes import modes
from rotorsim.model.compiled import compile_diagram
from rotorsim.model.load import load
from rotorsim.settled.periodic import periodic
from tests.reference.jeffcott import Jeffcott
from tests.reference.settle import settled_by_shooting

RPM = math.pi / 30


def shipped(name, **kwargs):
    return load(shipped_diagrams()[name], **kwargs)


@pytest.mark.parametrize("name", ["jeffcott", "jeffcott_elementary"])
def test_jeffcott_diagrams_settle_to_the_closed_form(name):
    found = periodic(shipped(name), speeds=np.array([900.0, 1500.0, 4000.0]) * RPM)
    for j, speed in enumerate(found.speeds):
        displacement, current = Jeffcott(speed=float(speed)).settled()
        for signal, expected in (("rotor.displacement", displacement), ("controller.current", current)):
            largest = max(abs(value) for value in expected.values())
            for order, value in expected.items():
                assert abs(found.harmonic(signal, order)[j] - value) <= 1e-10 * largest
    assert "clock.theta" not in found.harmonics


def test_an_angle_has_no_harmonics():
    with pytest.raises(RotorsimError) as caught:
        periodic(shipped("jeffcott"), signals=["clock.theta"])
    assert str(caught.value) == (
        "error: clock.theta: this signal does not return after one period: it has no harmonics"
    )


def test_a_run_up_is_not_periodic():
    with pytest.raises(RotorsimError, match="the motion is not periodic"):
        periodic(shipped("offset_disc_runup"), speeds=[100.0])
    with pytest.raises(RotorsimError, match="the diagram's own speed is zero"):
        periodic(shipped("offset_disc_runup"))


@pytest.mark.parametrize(
    "name", ["jeffcott", "offset_disc", "fe_rigid", pytest.param("fe_flexible", marks=pytest.mark.slow)]
)
def test_thesis_rotors_are_stable_and_settle(name):
    diagram = shipped(name)
    assert modes(diagram).stable
    assert periodic(diagram).status == ("settled",)


@pytest.mark.parametrize("name", ["offset_disc", "fe_rigid"])
def test_forward_whirl_is_the_faster_of_each_pair(name):
    found = modes(shipped(name, without=["amb"]), parameters={"speed": 3000 * RPM})
    light = [mode for mode in found.modes if mode.damping_ratio < 0.5]
    assert [mode.whirl for mode in light[:4]] == ["backward", "forward"] * (len(light[:4]) // 2)


def test_fe_rotor_has_the_published_natural_frequencies():
    """Undamped, without bearing force: computed by two programs, E = 2.1e11."""
    still = {"rotor.mass_damping": 0.0, "rotor.stiffness_damping": 0.0}
    diagram = shipped("fe_rigid", without=["amb"])
    at_rest = modes(diagram, parameters={**still, "speed": 0.0})
    found = [mode.frequency_hz for mode in at_rest.modes[:6]]
    np.testing.assert_allclose(found, np.repeat([54.3005, 338.398, 678.808], 2), rtol=3e-6)
    assert {mode.whirl for mode in at_rest.modes[:6]} == {"planar"}
    turning = modes(diagram, parameters={**still, "speed": 3000 * RPM})
    found = [mode.frequency_hz for mode in turning.modes[:4]]
    np.testing.assert_allclose(found, [54.1532, 54.4399, 312.997, 364.277], rtol=3e-6)


@pytest.mark.parametrize(
    "name", ["jeffcott", "offset_disc", *(pytest.param(n, marks=pytest.mark.slow) for n in ("fe_rigid", "fe_flexible"))]
)
def test_state_feedback_can_be_designed_for_every_thesis_rotor(name):
    diagram = shipped(name)
    found = design_state_feedback(diagram)
    assert found["A"].shape[0] <= 8
    plant = plant_of(diagram, "controller")
    assert np.linalg.eigvals(closed_loop(plant, tuple(found[key] for key in "ABCD"))).real.max() < 0
    parameters = {key: value.tolist() for key, value in found.items()}
    blocks = {**diagram.document["blocks"], "controller": {"type": "state_feedback", "parameters": parameters}}
    swapped = load({**diagram.document, "blocks": blocks})
    assert modes(swapped).stable
    assert margins(swapped).peak < margins(diagram).peak
    assert periodic(swapped).status == ("settled",)


@pytest.mark.parametrize(
    ("block", "replacement", "changes"),
    [
        pytest.param("amb", "amb_nonlinear", {}, marks=pytest.mark.slow),
        pytest.param("crack", "crack_breathing", {}, marks=pytest.mark.slow),
    ],
)
def test_nonlinear_blocks_settle_to_the_time_simulation(block, replacement, changes):
    source = shipped("jeffcott").document
    blocks = {**source["blocks"], block: {"type": replacement, "parameters": changes}}
    wires = [list(wire) for wire in source["wires"]]
    if replacement == "crack_breathing":
        wires.append(["rotor.displacement", "crack.displacement"])
    model = compile_diagram(load({**source, "blocks": blocks, "wires": wires}))
    assert not model.linear
    found = periodic(model, speeds=[157.0])
    assert found.status == ("settled",)
    expected = settled_by_shooting(model, 157.0, 256)
    place = model.states["rotor.position"].part.start
    got = found.harmonics["rotor.displacement[1]"][0, int(found.orders[-1]) :]
    column = expected[: len(got), place]
    np.testing.assert_allclose(got, column, rtol=0, atol=1e-6 * np.abs(column).max())
