"""Every controller of the library, swapped into the thesis rotors, levitates them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.engine.controllers import CONTROLLERS, judge, sampled_sensitivity, swapped
from rotorsim.linear.frequency import sensitivity
from rotorsim.model.compiled import compile_diagram
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
    assert sensitivity(shipped("jeffcott")).peak == pytest.approx(peak, rel=1e-6)


def test_sampled_sensitivity_tends_to_the_continuous_one() -> None:
    content = document("jeffcott")
    parameters = {"sample_time": 1e-8, "delay_samples": 0}
    content["blocks"]["controller"] = {"type": "discrete_pid", "parameters": parameters}
    found = sampled_sensitivity(compile_diagram(load_document(content)))
    assert found == pytest.approx(sensitivity(shipped("jeffcott")).peak, rel=1e-4)
