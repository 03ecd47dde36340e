"""Simulated runs as recordings: what is written is read back to the same numbers."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rotorsim.diagram.resolve.resolution import shipped_diagrams
from rotorsim.errors import RotorsimError
from rotorsim.measure.checks import check_signals
from rotorsim.model.load import load
from rotorsim.recordings import writing
from rotorsim.recordings.loading import load_recording
from rotorsim.recordings.writing import NewRun, save_recording
from rotorsim.simulation.result import Result
from rotorsim.simulation.run import simulate

SPEED = 2 * np.pi * 25.0


def result(n: int = 1000, step: float = 1e-3, speed: float = SPEED, nodes: int = 0, seed: int = 0) -> Result:
    noise = np.random.default_rng(seed)
    time = step * np.arange(n)
    shape = (n, nodes, 2) if nodes else (n, 2)
    signals = {
        "rotor.displacement": noise.normal(size=shape) * 1e-5,
        "controller.current": noise.normal(size=(n, 2)),
        "drive.output": noise.normal(size=n),
        "plant.state": noise.normal(size=(n, 3)),
        "clock.theta": speed * time + 1.0,
        "clock.speed": np.full(n, speed),
    }
    units = {"rotor.displacement": "m", "controller.current": "A", "drive.output": "V", "clock.theta": "rad"}
    return Result(time, signals, units)


def save(folder, *runs, **changes):
    return save_recording(folder, runs, **({"name": "made", "source": "simulated"} | changes))


def problems(*args, **changes) -> list[str]:
    with pytest.raises(RotorsimError) as error:
        save(*args, **changes)
    return [f"{p.subject}: {p.what} | {p.hint}" for p in error.value.problems]


@pytest.mark.parametrize("suffix", [".npz", ".csv"])
@pytest.mark.parametrize("nodes", [0, 3])
def test_what_is_written_is_read_back_to_the_same_numbers(tmp_path, suffix, nodes):
    gains = {"controller.KP": 12200.0, "rotor.gains": np.array([1.0, 2.0]), "speed": np.float64(3.5)}
    one, two = result(nodes=nodes), result(step=2e-4, speed=2 * SPEED, nodes=nodes, seed=1)
    path = save(
        tmp_path / "new" / "folder",
        NewRun("run1", one, settings=gains),
        {"id": "run2", "result": two, "speed": 300.0, "use": "hold_out", "window": (0.05, 0.15)},
        suffix=suffix,
        angle=True,
    )
    found = load_recording(path)
    assert (found.name, found.source, found.warnings) == ("made", "simulated", ())
    displacements = [f"{axis}{k or ''}" for k in (range(1, nodes + 1) if nodes else [0]) for axis in "xy"]
    columns = [*displacements, "ix", "iy", "drive.output", *(f"plant.state[{k}]" for k in (1, 2, 3)), "clock.theta"]
    assert list(found.channels) == columns
    first, second = found.runs
    for column, channel in found.channels.items():
        np.testing.assert_array_equal(first.values[column], one.column(channel.name))
        np.testing.assert_array_equal(second.values[column], two.column(channel.name)[250:751])
    np.testing.assert_allclose(first.time, one.time, rtol=1e-12)
    np.testing.assert_allclose(second.time, two.time[250:751] - 0.05, rtol=1e-12, atol=1e-12)
    assert (first.sample_rate, second.sample_rate) == (1000.0, 5000.0)
    assert first.speed == pytest.approx(SPEED, rel=1e-12)
    assert (second.speed, first.use, second.use) == (300.0, "identify", "hold_out")
    assert first.settings == {"controller.KP": 12200.0, "rotor.gains": [1.0, 2.0], "speed": 3.5}
    np.testing.assert_allclose(first.tacho, (2 * np.pi * np.arange(1, len(first.tacho) + 1) - 1) / SPEED, rtol=1e-12)
    assert len(first.tacho) == 25
    angle = np.interp(second.tacho + 0.05, two.time, two["clock.theta"]) / (2 * np.pi)
    np.testing.assert_allclose(angle, np.round(angle), rtol=1e-12)
    assert len(second.tacho) == 5
    assert found.column("rotor.displacement[3,2]" if nodes else "rotor.displacement[2]") == ("y3" if nodes else "y")


@settings(max_examples=50, deadline=None)
@given(
    st.floats(1e-6, 1e3), st.floats(0, 1e3), st.integers(2, 200), st.floats(-1e3, 1e3).filter(lambda w: abs(w) > 1e-3)
)
def test_any_step_start_and_speed_are_read_back(tmp_path_factory, step, start, n, speed):
    time = start + step * np.arange(n)
    speed /= max(1.0, abs(speed * step))  # fewer than one turn in six samples
    if np.any(np.diff(time) <= 0):
        return
    theta = speed * time
    made = Result(time, {"a.b": np.arange(float(n)), "clock.theta": theta}, {"a.b": "m"})
    folder = tmp_path_factory.getbasetemp() / "any"
    (run,) = load_recording(save(folder, NewRun("r", made), overwrite=True)).runs
    shift = time[0] if run.sample_rate is not None else 0.0
    np.testing.assert_allclose(run.time, time - shift, rtol=1e-9, atol=2e-6 * step)
    np.testing.assert_array_equal(run.values["a.b"], made["a.b"])
    turns = np.interp(run.tacho + shift, time, theta) / (2 * np.pi)
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-6)
    assert len(turns) >= abs(theta[-1] - theta[0]) / (2 * np.pi) - 1


def test_time_that_is_not_even_becomes_a_column(tmp_path):
    time = np.cumsum(np.random.default_rng(0).uniform(1e-4, 1e-3, 300))
    made = Result(time, {"a.b": np.sin(time), "clock.theta": SPEED * time}, {})
    path = save(tmp_path, NewRun("uneven", made), NewRun("even", result(), window=(0.2, 0.4)), signals=["clock.theta"])
    uneven, even = load_recording(path).runs
    np.testing.assert_array_equal(uneven.time, time)
    assert uneven.sample_rate is None
    np.testing.assert_allclose(np.sin(SPEED * uneven.tacho), 0.0, atol=1e-10)
    assert even.time[0] == 0.0
    assert "sample_rate" not in json.loads(path.read_text())["runs"][0]


def test_a_simulated_run_is_a_good_recording(tmp_path):
    diagram = load(shipped_diagrams()["jeffcott"])
    runs = [
        NewRun(f"run{k}", simulate(diagram, parameters={"speed": speed}, stop=1.0), window=(0.5, 1.0))
        for k, speed in enumerate((150.0, 200.0))
    ]
    found = load_recording(save(tmp_path, *runs))
    assert list(found.channels) == ["x", "y", "ix", "iy"]
    assert [run.speed for run in found.runs] == pytest.approx([150.0, 200.0], rel=1e-9)
    assert check_signals(found) == []
    for new, run in zip(runs, found.runs, strict=True):
        part = new.result.time >= 0.5 - 1e-9
        np.testing.assert_array_equal(run.values["y"], new.result["rotor.displacement[2]"][part])


def test_parts_of_signals_and_shapes_are_named_as_the_diagram_does(tmp_path):
    signals = {
        "rotor.displacement[4]": np.ones((3, 2)),
        "rotor.velocity[4,1]": np.ones(3),
        "sub/amb.force": np.ones((3, 2)),
        "a.matrix": np.ones((3, 2, 3)),
        "b.tensor": np.ones((3, 1, 2, 2)),
    }
    made = Result(np.arange(3.0), signals, {})
    found = load_recording(save(tmp_path, NewRun("r", made)))
    assert [channel.name for channel in found.channels.values()] == made.flat_names()
    four = found.channels["x4"]
    assert (four.signal, four.node, four.axis) == ("rotor.displacement", 4, "x")
    assert [found.channels[f"sub/amb.force[{k}]"].axis for k in (1, 2)] == ["x", "y"]


def test_a_rotor_that_stands_or_turns_back_has_no_pulses(tmp_path):
    still = Result(np.arange(9.0), {"a.b": np.ones(9), "clock.theta": np.zeros(9)}, {})
    back = Result(np.arange(9.0), {"a.b": np.ones(9), "clock.theta": 9 * np.sin(np.arange(9.0))}, {})
    found = load_recording(save(tmp_path, NewRun("still", still), NewRun("back", back)))
    assert [run.tacho.tolist() for run in found.runs] == [[], []]
    without = Result(np.arange(9.0), {"a.b": np.ones(9)}, {})
    (run,) = load_recording(save(tmp_path / "b", NewRun("r", without))).runs
    assert (run.tacho, run.speed) == (None, None)


def test_files_are_replaced_only_when_asked(tmp_path):
    save(tmp_path, NewRun("a", result()), NewRun("b", result()))
    hint = "choose another folder, or overwrite=True"
    assert problems(tmp_path, NewRun("b", result())) == [f": 2 files would be replaced: recording.json, b.npz | {hint}"]
    save(tmp_path, NewRun("b", result(n=10)), overwrite=True)
    assert [len(run.time) for run in load_recording(tmp_path).runs] == [10]


def test_a_write_that_fails_leaves_the_old_recording(tmp_path, monkeypatch):
    path = save(tmp_path, NewRun("a", result()))
    before = path.read_bytes(), (tmp_path / "a.npz").read_bytes()

    def fail(*args, **kwargs):
        raise KeyboardInterrupt

    monkeypatch.setattr(writing.np, "savez", fail)
    with pytest.raises(KeyboardInterrupt):
        save(tmp_path, NewRun("a", result(n=10)), overwrite=True)
    assert (path.read_bytes(), (tmp_path / "a.npz").read_bytes()) == before
    assert sorted(file.name for file in tmp_path.iterdir()) == ["a.npz", "recording.json"]


def test_mistakes_write_nothing(tmp_path):
    folder = tmp_path / "new"
    good = NewRun("r", result())
    assert problems(folder, {"id": "r", "resul": 3}) == [
        "run 1: unknown key 'resul' | did you mean 'result'?",
        "run 1: key 'result' is missing | ",
    ]
    assert problems(folder, good, suffix=".mat") == [": '.mat' cannot be written | suffix='.npz' or '.csv'"]
    assert problems(folder, good, signals=["rotor.displacment"]) == [
        "r: rotor.displacment: this signal was not recorded | did you mean 'rotor.displacement'?"
    ]
    assert problems(folder, good, NewRun("s", result(nodes=2))) == [
        "rotor.displacement: the runs differ in shape: r (2,), s (2, 2) | "
    ]
    assert problems(folder, NewRun("r", result(), window=(5, 6))) == [
        "r: window 5..6 s holds fewer than 2 samples | the result lasts from 0 to 0.999 s"
    ]
    assert problems(folder, good, good) == ["r: run 1 has the same id | every run needs an id of its own"]
    assert problems(folder, NewRun("../r", result())) == [
        "run 1: the id is empty, too long or has one of / \\ or a control character | ",
        "run 1: file '../r.npz' is not inside the folder of recording.json | "
        "name a file below that folder, such as 'data/run1.csv'",
    ]
    assert problems(folder, NewRun("r", result(), use="both")) == [
        "r: use 'both' is not known | known: hold_out, identify"
    ]
    assert problems(folder, NewRun("r", result(), settings={"a b": 3})) == [
        "r: set: 'a b' is not a parameter | write block.parameter or the name of a diagram parameter"
    ]
    assert len(problems(folder, NewRun("r", result(), speed=float("nan")))) == 1
    assert len(problems(folder, NewRun("r", result(), settings={"a": object()}))) == 1
    assert problems(folder) == [
        'channels: names no channel | "channels": {"x": {"signal": "rotor.displacement", "axis": "x", "unit": "um"}}',
        'runs: names no run | "runs": [{"id": "run1", "file": "run1.csv", "sample_rate": "5000 Hz"}]',
    ]
    scaled = Result(np.arange(3.0), {"a.b": np.ones(3)}, {"a.b": "mm"})
    assert problems(folder, NewRun("r", scaled)) == ["a.b: unit 'mm' is not SI | results are in SI"]
    assert not folder.exists()
    (tmp_path / "file").write_text("x")
    assert len(problems(tmp_path / "file" / "new", good)) == 1
