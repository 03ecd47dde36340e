"""The report of a diagnosis in time: figures, their numbers, and places on the wires of the diagram."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from rotorsim.diagnosis.catalogue.insertion import Spot
from rotorsim.diagnosis.diagnosis import Diagnosis, diagnose
from rotorsim.diagnosis.evidence.missing_signal import MissingSignal, PlaceClass
from rotorsim.model.load import load
from rotorsim.report.diagnosis.compared import OfSamples, compared
from rotorsim.report.diagnosis.places import SHADES, block_diagram, place_classes
from rotorsim.report.diagnosis.report import save_report
from tests.diagnosis.evidence.waveform.machines import OSCILLATOR, oscillator_recording
from tests.diagnosis.evidence.waveform.test_any_wire import SERVO
from tests.report import undrawn
from tests.report.test_diagnosis_report import _Page


@cache
def swinging() -> Diagnosis:
    measured = oscillator_recording(3e4, 1e-3)
    return diagnose(load(OSCILLATOR), measured, physics=("cubic_stiffness", "sensor_gain"), workers=1)


@pytest.mark.slow
def test_signals_in_time_are_simulated_again() -> None:
    both = compared(swinging())
    assert isinstance(both, OfSamples)
    shown = both.beside(swinging().evidence.runs, "fitted")
    assert shown.traces
    for trace in shown.traces:
        assert trace.time.shape == trace.measured.shape
        assert trace.nrmse(1) < trace.nrmse(0)


@pytest.mark.slow
def test_a_report_in_time(tmp_path: Path) -> None:
    with undrawn():
        files = save_report(swinging(), tmp_path)
    page = _Page(files[0].read_text(encoding="utf-8"))
    assert page.wrong == []
    assert page.open == []
    names = {file.name for file in files}
    assert {"traces.png", "residuals.png", "missing_signal.png"} <= names
    assert not names & {"spectra.png", "orbits.png", "speed_curves.png"}
    assert "cubic stiffness" in page.text
    [signal] = swinging().signals  # a force where a wire ends, over what its law reads
    assert (str(signal.place), signal.over) == ("drive.output", "oscillator.displacement")
    run = signal.loudest
    np.testing.assert_allclose(run.law, -3e4 * run.law_over**3, atol=0.03 * np.abs(run.law).max())
    assert np.corrcoef(run.added, run.law)[0, 1] > 0.95


def test_wires_are_marked_with_the_class_of_places_that_a_missing_signal_may_act_at():
    spots = [Spot("angle", "output", side="reading"), Spot("torque", "output"), Spot("friction", "output")]
    pairs = ((tuple(spots[1:]), 0.93), ((spots[0],), 0.07), ((Spot("speed", "output"),), 0.0))
    classes = tuple(PlaceClass(*pair) for pair in pairs)
    signal = MissingSignal(spots[2], None, "time", "s", 0.5, (), classes, 1.0, 9.0, 0.0)
    assert [item[0] for item in place_classes([signal])] == ["A", "B"]
    assert [item[0] for item in place_classes([signal, signal])] == ["1A", "1B", "2A", "2B"]
    svg = block_diagram(load(SERVO), [PlaceClass((spots[2],), 1.0)], [], [signal])
    written = re.findall(r'paint-order="stroke"[^>]*>([^<]*)<', svg)
    assert sorted(written) == ["A 0.93", "A 0.93", "B 0.07 (reading)"]
    assert svg.count('stroke-width="3.5"') == 3  # a wire of torque, one of friction, one of angle
    assert SHADES[0][1] not in re.findall(r'stroke="(#[0-9a-f]+)" stroke-width="3.0"', svg)  # no frame
    assert block_diagram(load(SERVO), [PlaceClass((spots[2],), 1.0)], []).count('stroke-width="3.5"') == 0
