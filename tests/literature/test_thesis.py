"""Numbers of the thesis from the shipped diagrams, at the tolerance of their source."""

from __future__ import annotations

import pytest

from rotorsim.linear.modes.eigenmodes import modes
from tests.reference.excitation import RPM
from tests.reference.published import FE_RIGID_AT_3000_RPM, FE_RIGID_AT_REST, RUN_UP_RIGHT, RUN_UP_THESIS, as_printed
from tests.reference.rotor import fe_rigid
from tests.systems import figures
from tests.systems.shipped import shipped

UNDAMPED = {"rotor.mass_damping": 0.0, "rotor.stiffness_damping": 0.0}


@pytest.mark.parametrize("name", ["jeffcott", "jeffcott_elementary"])
def test_table_2_2(name: str) -> None:
    for signal, order, amplitude, phase, _ in figures.table_2_2(shipped(name)):
        assert abs(amplitude) <= 2e-3, (signal, order)
        assert abs(phase) <= 0.1, (signal, order)


@pytest.mark.parametrize(("rpm", "printed"), [(0.0, FE_RIGID_AT_REST), (3000.0, FE_RIGID_AT_3000_RPM)])
def test_natural_frequencies_of_fe_rigid(rpm: float, printed: tuple[str, ...]) -> None:
    found = modes(shipped("fe_rigid", without=("amb",)), parameters={"speed": rpm * RPM, **UNDAMPED})
    frequencies = sorted(mode.frequency_hz for mode in found.modes)
    independent = fe_rigid(a0=0.0, a1=0.0).at_speed(rpm * RPM).frequencies()
    assert frequencies == pytest.approx(list(independent), rel=1e-9)
    assert as_printed(frequencies[:: 2 if rpm == 0.0 else 1], printed)


def test_run_up_resonance_with_the_right_angle() -> None:
    assert figures.run_up_peak("jeffcott_runup") == pytest.approx(RUN_UP_RIGHT, rel=0.01)


def test_run_up_resonance_with_the_angle_of_the_thesis() -> None:
    assert figures.run_up_peak(figures.thesis_run_up()) == pytest.approx(RUN_UP_THESIS, rel=0.01)
