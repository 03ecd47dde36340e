"""Probes that do not show the motion: nothing is met by what they say."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from rotorsim import Recording, RotorsimError, accept, load, load_recording
from rotorsim.acceptance.acceptance import Acceptance
from tests.cli.conftest import Run

RPM = np.pi / 30
TIME = np.arange(8000) / 4000.0
SPEEDS = 300.0 + 100.0 * TIME  # rad/s
GIVEN = {"operating": (2900 * RPM, 4500 * RPM), "clearance": 0.2e-3}


def steady(size: float = 10.0) -> np.ndarray:
    """Return a circle [um] at 3000 rpm, some nm of noise on it."""
    noise = 0.01 * np.random.default_rng(0).standard_normal((len(TIME), 2))
    return size * np.column_stack([np.cos(100 * np.pi * TIME), np.sin(100 * np.pi * TIME)]) + noise


def recorded(folder: Path, values: np.ndarray, unit: str = "um", theta: np.ndarray | None = None) -> Recording:
    """Return a recording of x and y, and of an angle: at 3000 rpm where none is given."""
    theta = 100 * np.pi * TIME if theta is None else theta
    channels = {axis: {"signal": "rotor.displacement", "axis": axis, "unit": unit} for axis in "xy"}
    channels["angle"] = {"signal": "clock.theta", "unit": "rad"}
    run = {"id": "a", "file": "a.csv", "sample_rate": 4000}
    document = {"name": "machine", "source": "written down", "channels": channels, "runs": [run]}
    folder.mkdir(exist_ok=True)
    (folder / "recording.json").write_text(json.dumps(document))
    table = np.column_stack([values, theta])
    np.savetxt(folder / "a.csv", table, delimiter=",", header="x,y,angle", comments="", fmt="%.9g")
    return load_recording(folder)


def verdicts(found: Acceptance) -> dict[str, tuple[str, str]]:
    return {one.what: (one.verdict, one.said) for one in found.criteria}


def test_sound_probes_are_judged(tmp_path) -> None:
    found = verdicts(accept(None, recorded(tmp_path, steady()), **{**GIVEN, "operating": (2900 * RPM, 3000 * RPM)}))
    assert found["D_max / C_min"][0] == found["vibration, peak to peak"][0] == "met"


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda y: 0 * y, "constant signal: all samples are 0 um"),
        (lambda y: np.clip(3 * y, -15, 15), "clipped signal: "),
    ],
)
def test_dead_and_clipped_probes_meet_nothing(tmp_path, change, said) -> None:
    """FAULT: probes that show nothing had a displacement of zero, and all requirements were met."""
    given = {**GIVEN, "operating": (2900 * RPM, 3000 * RPM)}
    found = verdicts(accept(None, recorded(tmp_path, change(steady())), **given))
    assert found["D_max / C_min"][0] == "unsure"
    assert f"a, rotor.displacement[1]: {said}" in found["D_max / C_min"][1]
    assert found["vibration, peak to peak"][0] != "met"


def test_dead_probes_pass_no_critical_speed(tmp_path) -> None:
    theta = np.cumsum(SPEEDS) / 4000.0
    found = verdicts(accept(None, recorded(tmp_path, 0 * steady(), theta=theta), operating=(400.0, 410.0)))
    said = "no critical speed; x: constant signal: all samples are 0 um; y: constant signal: all samples are 0 um"
    assert found["1X of the vibration, peak to peak"][0] == "unsure"
    passed = accept(None, load_recording(tmp_path), operating=(400.0, 410.0)).criteria
    assert ("unsure", said) in [(one.verdict, one.said) for one in passed]


def test_volts_are_no_displacement(tmp_path) -> None:
    with pytest.raises(RotorsimError) as caught:
        accept(None, recorded(tmp_path, steady(), unit="V"), **GIVEN)
    assert str(caught.value).startswith("error: machine: column x: 'rotor.displacement' in V is no displacement\n")


@pytest.mark.slow
def test_orders_leave_a_dead_probe_out(run: Run, tmp_path: Path) -> None:
    """FAULT: a forward mode was planar beside a dead probe."""
    theta = np.cumsum(SPEEDS) / 4000.0
    mode = 1 / (350.0**2 - SPEEDS**2 + 2j * 0.05 * 350.0 * SPEEDS) * SPEEDS**2 * np.exp(1j * theta)
    both = 5 * np.column_stack([mode.real, mode.imag]) + 0.01 * np.random.default_rng(0).standard_normal((len(TIME), 2))
    recorded(tmp_path / "dead", both * [1, 0], theta=theta)
    found = run("orders", "dead", "--order", "1")
    assert "a: column y: constant signal: all samples are 0 um" in found.stderr
    assert "rotor.displacement[2]" not in found.stdout


@pytest.mark.slow
@pytest.mark.parametrize("further", [(), ("--filter", "10 %")])
def test_orders_refuse_a_lost_pulse_with_and_without_a_filter(run: Run, tmp_path: Path, further) -> None:
    theta = np.cumsum(SPEEDS) / 4000.0
    recorded(tmp_path / "lost", steady(), theta=theta)
    marks = 2 * np.pi * np.arange(1, int(theta[-1] / 2 / np.pi) + 1)
    document = json.loads((tmp_path / "lost" / "recording.json").read_text())
    document["channels"].pop("angle")
    document["runs"][0]["tacho"] = np.delete(np.interp(marks, theta, TIME), 60).tolist()
    (tmp_path / "lost" / "recording.json").write_text(json.dumps(document))
    found = run("orders", "lost", "--order", "1", *further)
    assert found.exit_code == 1
    assert "error: a: tacho: 1 missing, the first after " in found.stderr
    assert found.stdout == ""


@pytest.mark.slow
def test_a_gain_in_the_wrong_unit_is_not_accepted() -> None:
    """FAULT: KP in A/mm put the first mode above 2 kHz, where its decrement of 0.02 was not judged."""
    found = accept(load("jeffcott", set={"controller.KP": 1.22e7}), operating=(2000 * RPM, 3000 * RPM))
    [decrement] = [one for one in found.criteria if one.what == "log decrement"]
    s = max(np.roots([2.0, 76.0 + 42.1 * 3.0, 7.6e5 - 105210.0 + 42.1 * 1.22e7, 42.1 * 2000.0]), key=np.imag)
    assert decrement.value == pytest.approx(-2 * np.pi * s.real / s.imag, rel=1e-6)
    assert (decrement.verdict, found.verdict) == ("not met", "not met")
