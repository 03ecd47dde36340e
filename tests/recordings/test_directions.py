"""Probes at +-45 deg, as machines have them: x and y are made of two, and nothing is guessed."""

import json

import numpy as np
import pytest

from rotorsim import load_orders, load_recording
from rotorsim.errors import RotorsimError
from rotorsim.recordings.order_writing import save_orders

PROBES = {"A": "45 deg", "B": "135 deg"}


def _written(folder, channels, **values):
    document = {
        "name": "rig",
        "source": "a test",
        "channels": channels,
        "runs": [{"id": "run", "file": "run.csv", "sample_rate": "100 Hz", "tacho": [0.0, 0.1]}],
    }
    (folder / "recording.json").write_text(json.dumps(document))
    rows = np.column_stack(list(values.values()))
    np.savetxt(folder / "run.csv", rows, delimiter=",", header=",".join(values), comments="")
    return folder


def _channel(direction, **more):
    return {"signal": "rotor.displacement", "unit": "um", "direction": direction, **more}


@pytest.mark.parametrize("angles", [(45.0, 135.0), (45.0, -45.0), (-30.0, 75.0)])
def test_two_probes_are_turned_to_x_and_y(tmp_path, angles):
    t = np.arange(50) / 100
    x, y = np.cos(30 * t), 0.3 * np.sin(30 * t) + 0.1
    readings = [np.cos(a) * x + np.sin(a) * y for a in np.radians(angles)]
    channels = {name: _channel(f"{a} deg") for name, a in zip("AB", angles, strict=True)}
    recording = load_recording(_written(tmp_path, channels, A=readings[0], B=readings[1]))
    assert [one.name for one in recording.channels.values()] == ["rotor.displacement[1]", "rotor.displacement[2]"]
    assert recording.runs[0].values["A"] == pytest.approx(1e-6 * x, abs=1e-15)
    assert recording.runs[0].values["B"] == pytest.approx(1e-6 * y, abs=1e-15)


@pytest.mark.parametrize(
    ("channels", "said"),
    [
        ({"A": _channel("45 deg")}, "channel A: 1 probe of rotor.displacement with a direction"),
        ({"A": _channel("45 deg"), "B": _channel("46 deg")}, "channel B: points along the same line as 'A'"),
        ({"A": _channel("45 deg"), "B": _channel("135 deg", unit="mil")}, "channel B: differs from 'A' in unit"),
        (
            {"A": _channel("45 deg"), "B": {"signal": "rotor.displacement", "unit": "um", "axis": "x"}},
            "channel A: 1 probe of rotor.displacement with a direction beside one with an axis",
        ),
        ({"A": _channel("45 deg", axis="x")}, "channel A: both axis and direction"),
        ({"A": _channel("45 m")}, "channel A: direction: unit 'm' does not fit 'rad'"),
    ],
)
def test_probes_that_do_not_make_two_axes_are_refused(tmp_path, channels, said):
    values = {name: np.zeros(20) for name in channels}
    with pytest.raises(RotorsimError) as caught:
        load_recording(_written(tmp_path, channels, **values))
    assert said in str(caught.value)


def test_a_table_of_probes_is_turned_alike_and_comes_back_as_it_was_written(tmp_path):
    rpm = np.linspace(1000, 2000, 30)
    x, y = 10 * np.exp(1j * rpm / 300), 4 * np.exp(-1j * rpm / 500)
    columns = {"rpm": rpm}
    for name, a in zip("AB", np.radians([45, 135]), strict=True):
        value = np.cos(a) * x + np.sin(a) * y
        columns |= {f"amp {name}": 2 * np.abs(value) / 25.4, f"lag {name}": -np.degrees(np.angle(value))}
    document = {
        "kind": "orders",
        "name": "rig",
        "source": "a test",
        "amplitude": "peak-peak",
        "phase": "lag",
        "channels": {
            name: _channel(where, unit="mil", amplitude=f"amp {name}", phase=f"lag {name}")
            for name, where in PROBES.items()
        },
        "runs": [{"id": "up", "file": "up.csv", "speed": "rpm", "turns": 1}],
    }
    (tmp_path / "recording.json").write_text(json.dumps(document))
    header = ",".join(columns)
    np.savetxt(tmp_path / "up.csv", np.column_stack(list(columns.values())), delimiter=",", header=header, comments="")
    recording = load_orders(tmp_path)
    assert recording.runs[0].vectors["A"] == pytest.approx(1e-6 * x, abs=1e-12)
    assert recording.runs[0].vectors["B"] == pytest.approx(1e-6 * y, abs=1e-12)
    for words in (("0-peak", "lead"), ("peak-peak", "lag"), ("rms", "lead")):
        save_orders(tmp_path / "again", recording, amplitude=words[0], phase=words[1], overwrite=True)
        again = load_orders(tmp_path / "again")
        assert again.channels["A"].axis == "x"
        assert again.runs[0].speed == pytest.approx(recording.runs[0].speed)
        for name in PROBES:
            assert again.runs[0].vectors[name] == pytest.approx(recording.runs[0].vectors[name], abs=1e-15)


def test_files_are_not_replaced_unasked_and_words_are_known(tmp_path):
    test_a_table_of_probes_is_turned_alike_and_comes_back_as_it_was_written(tmp_path)
    recording = load_orders(tmp_path / "again")
    with pytest.raises(RotorsimError, match=r"2 files would be replaced: recording\.json, up\.csv"):
        save_orders(tmp_path / "again", recording)
    with pytest.raises(RotorsimError, match="'pp' says not what numbers are"):
        save_orders(tmp_path / "other", recording, amplitude="pp")
