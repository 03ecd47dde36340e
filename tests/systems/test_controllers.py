"""Every controller of the library, swapped into the thesis rotors, levitates them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.signal import cont2discrete

from benchmarks.engine.controllers import CONTROLLERS, judge, swapped
from rotorsim.linear.control.margins import margins
from tests.reference.jeffcott import Jeffcott
from tests.systems.shipped import document, load_document, shipped


@pytest.mark.parametrize(
    "controller", [c if c == "pid" else pytest.param(c, marks=pytest.mark.slow) for c in CONTROLLERS]
)
def test_swapped_controller_levitates(controller: str, tmp_path: Path) -> None:
    row = judge(swapped("jeffcott", controller, tmp_path), controller)
    assert row.levitates, row.note
    assert 1e-6 < row.peak < 2e-5


def test_sensitivity_of_pid_against_its_formula() -> None:
    """S = 1 / (1 + k_i (K_P + K_I / s + K_D s) / (m s^2 + c s + k - k_s))."""
    d = Jeffcott()
    s = 2j * np.pi * np.geomspace(0.1, 2000.0, 400_000)
    plant = d.force_current / (d.mass * s**2 + d.damping * s + d.stiffness - d.force_displacement)
    peak = np.abs(1 / (1 + plant * (d.kp + d.ki / s + d.kd * s))).max()
    assert margins(shipped("jeffcott")).peak == pytest.approx(peak, rel=1e-6)


def sampled_loop(hz: np.ndarray, period: float, delay: int) -> np.ndarray:
    """Return S at the sensor of the thesis' rotor with a sampled PID, from the z-transform of what a hold drives.

    Samples u = C(z) z^-d (w + e), w: displacement and velocity, e: test signal and its rate; w = P(z) u, held; what is
    seen at the frequency of the test signal is the plant's response to the component of the held signal there.
    """
    d = Jeffcott()
    A = np.array([[0.0, 1.0], [-(d.stiffness - d.force_displacement) / d.mass, -d.damping / d.mass]])
    B = np.array([[0.0], [-d.force_current / d.mass]])
    F, G, *_ = cont2discrete((A, B, np.eye(2), np.zeros((2, 1))), period)
    found = []
    for s in 2j * np.pi * hz:
        z = np.exp(s * period)
        law = np.array([d.kp + d.ki * period / (1 - 1 / z), d.kd]) * z**-delay
        test = np.array([1.0, s])
        held = law @ test / (1 - law @ np.linalg.solve(z * np.eye(2) - F, G[:, 0]))
        hold = (1 - 1 / z) / (s * period)
        found.append(1 + np.linalg.solve(s * np.eye(2) - A, B[:, 0])[0] * hold * held)
    return np.array(found)


@pytest.mark.parametrize(("period", "delay"), [(1e-4, 1), (5e-4, 0), (1e-3, 2)])
def test_a_sampled_loop_is_that_of_the_z_transform_beyond_half_the_rate_too(period: float, delay: int) -> None:
    content = document("jeffcott")
    parameters = {"sample_time": period, "delay_samples": delay}
    content["blocks"]["controller"] = {"type": "discrete_pid", "parameters": parameters}
    hz = np.array([0.1, 30.0, 123.0, 480.0, 700.0, 1900.0, 7000.0])
    found = margins(load_document(content), frequencies=hz)
    np.testing.assert_allclose(found.sensitivity[:, 0, 0], sampled_loop(hz, period, delay), rtol=1e-7)
    assert found.stable == (period < 1e-3)
