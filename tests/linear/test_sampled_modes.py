"""Modes of loops with sampled controllers: whirl, frequencies above half of the sample rate, Campbell diagrams."""

from __future__ import annotations

import json

import numpy as np
import pytest

from rotorsim import RotorsimError, campbell, load, modes, root_locus
from rotorsim.linear.modes.eigenmodes import Mode
from tests.acceptance.machines import jeffcott
from tests.systems.shipped import DIAGRAMS

SPEED = {"speed": 300.0}


def machine(*sample_times: float) -> dict:
    """Return a rotor in two magnetic bearings, with sampled controllers of these sample times [s], if any."""
    made = json.loads((DIAGRAMS / "two_amb_rotor.json").read_text())
    for name, T in zip(("controller_a", "controller_b"), sample_times, strict=False):
        made["blocks"][name]["type"] = "discrete_pid"
        made["blocks"][name]["parameters"]["sample_time"] = T
    return made


def seen(document: dict, highest: float) -> list[Mode]:
    return [
        mode for mode in modes(load(document), parameters=SPEED).modes if mode.resonant and mode.frequency_hz < highest
    ]


def likeness(a: Mode, b: Mode) -> float:
    """Return the modal assurance criterion of two shapes."""
    return float(abs(np.vdot(a.shape, b.shape)) ** 2 / (np.vdot(a.shape, a.shape) * np.vdot(b.shape, b.shape)).real)


def test_modes_and_whirl_go_to_those_of_the_continuous_controller_with_the_sample_time() -> None:
    continuous = seen(machine(), 12e3)
    errors = []
    for T in (2e-5, 1e-5):
        sampled = seen(machine(T, T), 12e3)
        assert [mode.whirl for mode in sampled] == [mode.whirl for mode in continuous]
        assert {mode.whirl for mode in sampled} == {"forward", "backward"}
        pairs = list(zip(sampled, continuous, strict=True))
        assert min(likeness(*pair) for pair in pairs) > 0.98
        errors.append(np.array([abs(one.eigenvalue - other.eigenvalue) for one, other in pairs]))
    np.testing.assert_allclose(errors[1][:8] / errors[0][:8], 0.5, rtol=0.05)  # of first order in T


def test_bent_modes_above_half_of_the_sample_rate_have_their_own_frequencies() -> None:
    """At 5 kHz a mode of 6.7 kHz is seen at 1.7 kHz; of gains of nearly nothing it is that without a controller."""
    weak = {f"{name}.{gain}": 1e-6 for name in ("controller_a", "controller_b") for gain in ("KP", "KI", "KD")}
    for times in ((2e-4, 2e-4), (1e-4, 2e-4)):
        found = [modes(load(one), parameters=SPEED | weak).modes for one in (machine(*times), machine())]
        bent = [[mode for mode in every if 3e3 < mode.frequency_hz < 9.5e3 and mode.resonant] for every in found]
        assert len(bent[1]) == 8
        assert [one.eigenvalue for one in bent[0]] == pytest.approx([one.eigenvalue for one in bent[1]], rel=1e-6)
        assert [one.whirl for one in bent[0]] == [one.whirl for one in bent[1]]


def test_the_campbell_diagram_of_a_sampled_machine() -> None:
    speeds = np.linspace(300.0, 370.0, 3)
    sampled, continuous = (campbell(load(one), speeds=speeds) for one in (machine(1e-5, 1e-5), machine()))
    first = [[one.speed for one in found.crossings if one.order == 1] for found in (sampled, continuous)]
    assert len(first[1]) == 2
    assert first[0] == pytest.approx(first[1], rel=1e-3)
    assert [one.whirl for one in sampled.crossings] == [one.whirl for one in continuous.crossings]
    assert sampled.stable.all()
    assert {one.modulo_text for one in sampled.crossings} == {""}


def test_a_growing_mode_of_a_sampled_loop_is_told() -> None:
    slow = {"type": "discrete_pid", "parameters": {"KP": 12500.0, "KI": 0.0, "KD": 3.75, "sample_time": "3 ms"}}
    assert not modes(load(jeffcott(4e5, 10.0, slow))).stable


def test_a_machine_that_is_not_linear_has_no_modes_with_a_sampled_controller() -> None:
    nonlinear = machine(1e-4, 1e-4)
    nonlinear["blocks"]["amb_a"] = {"type": "amb_nonlinear"}
    with pytest.raises(RotorsimError) as caught:
        modes(load(nonlinear))
    assert "with sampled blocks a diagram must be linear, with constant coefficients" in str(caught.value)


def test_the_root_locus_has_poles_above_half_of_the_sample_rate_where_they_are() -> None:
    """Of gains of nearly nothing: a bent mode of 6.7 kHz that is sampled at 5 kHz."""
    weak = {f"{name}.{gain}": 1e-6 for name in ("controller_a", "controller_b") for gain in ("KP", "KI", "KD")}
    sampled, continuous = (
        root_locus(load(one), "speed", [300.0, 400.0], parameters=weak) for one in (machine(2e-4, 2e-4), machine())
    )
    for own, truth, modulo in zip(sampled.poles, continuous.poles, sampled.modulo, strict=True):
        bent = truth[
            (truth.imag > 2 * np.pi * 3e3) & (truth.imag < 2 * np.pi * 9.5e3) & (-truth.real < 0.7 * truth.imag)
        ]
        nearest = np.nanargmin(np.abs(own[:, None] - bent), axis=0)  # a row may be filled up
        np.testing.assert_allclose(own[nearest], bent, rtol=1e-6)
        assert np.isnan(modulo[nearest]).all()


def test_poles_of_which_several_images_show_alike_say_modulo_what_their_frequency_is() -> None:
    found = modes(load(machine(5e-4, 5e-4)), parameters=SPEED).modes
    assert {mode.modulo and round(mode.modulo, 6) for mode in found} == {None, 2000.0}
    slow = [mode for mode in found if mode.frequency_hz < 1500 and mode.damping_ratio < 0.2]
    assert len(slow) == 12
    assert all(mode.modulo is None for mode in slow)
    locus = root_locus(load(machine(5e-4, 5e-4)), "speed", [300.0])
    own = locus.poles[0][np.isfinite(locus.modulo[0])]
    assert sorted(own.imag) == pytest.approx(sorted(mode.eigenvalue.imag for mode in found if mode.modulo))


def test_a_crossing_of_a_folded_mode_says_modulo_what_its_frequency_is() -> None:
    """The controller of 2 kHz mixes images of a mode at 346 Hz and at 2346 Hz, which 50X meets near 295 rad/s."""
    found = campbell(load(machine(5e-4, 5e-4)), speeds=np.linspace(290.0, 310.0, 3), orders=(50,)).crossings
    folded = [one for one in found if 2300 < one.frequency_hz < 2400]
    assert [one.order for one in folded] == [50, 50]
    assert [one.modulo for one in folded] == pytest.approx([2000.0, 2000.0])
    assert {one.modulo_text for one in folded} == {" modulo 2000 Hz"}


def test_the_limit_of_stability_is_told_at_the_frequency_that_grows() -> None:
    """A mode of 1.6 kHz that a controller of 2 kHz drives: as a simulation shows it, not folded to 0.4 kHz."""
    spring = {"rotor.stiffness": 2.0 * (2 * np.pi * 1600.0) ** 2}
    slow = {"type": "discrete_pid", "parameters": {"KP": 12500.0, "KI": 0.0, "KD": 0.0, "sample_time": "0.5 ms"}}
    machine = load(jeffcott(4e5, 1.0, slow))
    found = root_locus(machine, "rotor.viscous_damping", [0.0, 10.0, 50.0], parameters=spring)
    assert len(found.limits) == 1
    assert found.limits[0].frequency == pytest.approx(1600.0, rel=1e-3)
    assert np.isnan(found.limits[0].modulo)
