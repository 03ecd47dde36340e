"""Modes and Campbell diagram of rotors whose frequencies are known in closed form."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rotorsim.errors import RotorsimError
from rotorsim.linear.modes.campbell import campbell
from rotorsim.linear.modes.eigenmodes import modes
from tests.reference.handmade import gyroscopic, handmade, jeffcott


def tilting(speed, polar=0.02, diametral=0.012, stiffness=1e6):
    """Return backward and forward frequency [rad/s]: I_d w^2 -+ W I_p w - k = 0."""
    half = speed * polar / (2 * diametral)
    root = math.sqrt(half**2 + stiffness / diametral)
    return root - half, root + half


@settings(deadline=None, max_examples=25)
@given(speed=st.floats(1.0, 5000.0))
def test_forward_whirl_rises_and_backward_whirl_falls_with_the_gyroscopic_moment(speed):
    found = modes(gyroscopic(), parameters={"speed": speed})
    backward, forward = tilting(speed)
    assert [mode.whirl for mode in found.modes] == ["backward", "forward"]
    np.testing.assert_allclose(
        [mode.frequency_hz for mode in found.modes], np.array([backward, forward]) / (2 * math.pi), rtol=1e-10
    )
    assert found.speed == speed


def test_like_modes_of_an_isotropic_rotor_are_two_planar_modes():
    found = modes(jeffcott())
    assert [mode.whirl for mode in found.modes] == ["planar", "planar"]
    poles = np.roots([2, 76 + 42.1 * 3, 7.6e5 - 105210 + 42.1 * 12200, 42.1 * 2000])
    pair = poles[poles.imag > 0][0]
    for mode in found.modes:
        assert mode.frequency_hz == pytest.approx(pair.imag / (2 * math.pi), rel=1e-10)
        assert mode.natural_frequency_hz == pytest.approx(abs(pair) / (2 * math.pi), rel=1e-10)
        assert mode.damping_ratio == pytest.approx(-pair.real / abs(pair), rel=1e-8)
        assert not mode.unstable
        assert abs(mode.shape).max() == pytest.approx(1)
    np.testing.assert_allclose(found.real_poles, [poles[poles.imag == 0][0].real] * 2, rtol=1e-9)
    assert found.stable
    assert found.shape_names == ("rotor.displacement[1]", "rotor.displacement[2]")


def test_anisotropic_rotor_at_rest_moves_in_planes_and_whirls_when_it_turns():
    at_rest = modes(gyroscopic(k_y=1.3e6), parameters={"speed": 0.0})
    assert [mode.whirl for mode in at_rest.modes] == ["planar", "planar"]
    turning = modes(gyroscopic(k_y=1.3e6), parameters={"speed": 800.0})
    assert [mode.whirl for mode in turning.modes] == ["backward", "forward"]


def test_negative_damping_is_flagged():
    found = modes(gyroscopic(rotor__damping=-1.0))
    assert not found.stable
    assert all(mode.unstable and mode.damping_ratio < 0 for mode in found.modes)
    assert [row["unstable"] for row in found.to_table()] == [True, True]


def test_frequencies_ascend_and_conjugates_appear_once():
    found = modes(jeffcott(), parameters={"controller.KI": 4e7})
    frequencies = [mode.frequency_hz for mode in found.modes]
    assert frequencies == sorted(frequencies)
    assert 2 * len(found.modes) + len(found.real_poles) == 6


def test_campbell_follows_both_branches_and_finds_the_critical_speeds():
    speeds = np.linspace(0, 12000, 25)
    found = campbell(gyroscopic(rotor__diametral=0.025), speeds=speeds)
    expected = np.array([tilting(speed, diametral=0.025) for speed in speeds]) / (2 * math.pi)
    np.testing.assert_allclose(found.frequency_hz, expected, rtol=1e-9)
    assert set(found.whirl[1:, 0]) == {"backward"}
    assert set(found.whirl[1:, 1]) == {"forward"}
    # order n: (n W)^2 I_d -+ n W^2 I_p = k
    stiffness, polar, diametral = 1e6, 0.02, 0.025
    closed = [
        (1, "backward", math.sqrt(stiffness / (diametral + polar))),
        (1, "forward", math.sqrt(stiffness / (diametral - polar))),
        (2, "backward", math.sqrt(stiffness / (4 * diametral + 2 * polar))),
        (2, "forward", math.sqrt(stiffness / (4 * diametral - 2 * polar))),
    ]
    expected_crossings = sorted((c for c in closed if c[2] < 12000), key=lambda c: (c[0], c[2]))
    assert len(found.crossings) == len(expected_crossings)
    for crossing, (order, direction, speed) in zip(found.crossings, expected_crossings, strict=True):
        assert (crossing.order, crossing.whirl) == (order, direction)
        assert crossing.speed == pytest.approx(speed, rel=1e-9)
        assert crossing.frequency_hz == pytest.approx(order * speed / (2 * math.pi), rel=1e-9)


def test_campbell_keeps_modes_apart_that_cross():
    """Two uncoupled discs: the forward mode of one passes the other's modes as speed grows."""

    def build(t, x, p, v):
        xdot, tilts = {}, []
        for name, polar, stiffness in (("a", 0.02, 1e6), ("b", 0.001, 3e6)):
            tilt, rate = x[f"{name}.tilt"], x[f"{name}.rate"]
            turned = p["clock.speed"] * polar * np.array([[0, -1], [1, 0]]) @ rate
            xdot[f"{name}.tilt"], xdot[f"{name}.rate"] = rate, (turned - stiffness * tilt) / 0.012
            tilts.append(tilt)
        return {"xdot": xdot, "signals": {"a.tilt": tilts[0], "b.tilt": tilts[1]}}

    model = handmade({"a.tilt": 2, "a.rate": 2, "b.tilt": 2, "b.rate": 2}, {"speed": 0.0}, build)
    speeds = np.linspace(0, 15000, 31)
    found = campbell(model, speeds=speeds, orders=())
    for polar, stiffness in ((0.02, 1e6), (0.001, 3e6)):
        for branch in np.array([tilting(w, polar=polar, stiffness=stiffness) for w in speeds]).T:
            distance = np.abs(found.frequency_hz * 2 * math.pi - branch[:, None]).max(axis=0)
            assert distance.min() < 1e-6 * branch.max()


def test_campbell_without_a_speed_parameter_says_what_to_declare():
    model = handmade({"a.x": 1}, {}, lambda t, x, p, v: {"xdot": {"a.x": -x["a.x"]}, "signals": {"a.y": x["a.x"]}})
    with pytest.raises(RotorsimError) as caught:
        campbell(model, speeds=[1.0])
    assert str(caught.value) == (
        "error: handmade: campbell varies the diagram parameter 'speed', but no block follows it\n\n"
        'hint: declare "parameters": {"speed": "1500 rpm"} and use "$speed" in the blocks'
    )


def test_speeds_must_be_finite():
    with pytest.raises(RotorsimError, match=r"speeds must be finite and not negative \[rad/s\]"):
        campbell(gyroscopic(), speeds=[1.0, float("nan")])


def test_parameters_may_have_units() -> None:
    """They were taken for numbers when it was noted what was set, and a bare ValueError came."""
    found = modes(jeffcott(), parameters={"speed": "1800 rpm"})
    assert found.speed == pytest.approx(1800 * np.pi / 30)
    assert found.provenance["set"] == {"speed": "1800 rpm"}
