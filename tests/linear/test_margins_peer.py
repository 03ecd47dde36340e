"""Margins beside python-control, an optional package: the same loop, made of its own transfer functions."""

import numpy as np
import pytest

from rotorsim.linear.control.margins import margins
from rotorsim.model.load import load

control = pytest.importorskip("control")

STIFFNESS, MASS, DAMPING, FORCE_PER_CURRENT = 7.6e5, 2.0, 76.0, 42.1


def loop(negative_stiffness, kp=12200.0, ki=2000.0, kd=3.0):
    s = control.tf("s")
    plant = FORCE_PER_CURRENT / (MASS * s**2 + DAMPING * s + STIFFNESS - negative_stiffness)
    return (kp + ki / s + kd * s) * plant


@pytest.mark.parametrize("negative_stiffness", [105210.0, 9e5])
def test_margins_are_those_of_python_control(negative_stiffness):
    """Gain, phase, and the least distance of G_o from -1, which is 1 / max |S|."""
    found = margins(load("jeffcott"), parameters={"force_displacement_factor": negative_stiffness}).axes[0]
    gains, phases, distances, at_gain, at_phase, at_distance = control.stability_margins(
        loop(negative_stiffness), returnall=True
    )
    assert found.phase == pytest.approx(np.abs(phases).min(), rel=1e-6)
    assert found.phase_frequency == pytest.approx(at_phase[np.argmin(np.abs(phases))] / 2 / np.pi, rel=1e-6)
    assert found.peak == pytest.approx(1 / min(distances), rel=1e-5)
    assert found.frequency == pytest.approx(at_distance[np.argmin(distances)] / 2 / np.pi, rel=1e-3)
    below = [(gain, w) for gain, w in zip(gains, at_gain, strict=True) if 0 < gain < 1]
    if below:
        gain, w = max(below)
        assert (found.gain_down, found.gain_down_frequency) == pytest.approx((gain, w / 2 / np.pi), rel=1e-6)
    else:
        assert found.gain_down == 0.0


def test_sensitivity_is_that_of_python_control():
    hz = np.geomspace(1, 2000, 40)
    found = margins(load("jeffcott"), frequencies=hz)
    S = control.feedback(1, loop(105210.0))
    np.testing.assert_allclose(found.sensitivity[:, 0, 0], S(2j * np.pi * hz), rtol=1e-9)
    np.testing.assert_allclose(found.closed_loop()[:, 0, 0], 1 - S(2j * np.pi * hz), rtol=1e-8, atol=1e-12)
