"""The generated recordings agree with the other independent programs and with what they say of themselves."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.reference.excitation import RPM, harmonics
from tests.reference.jeffcott import Jeffcott
from tests.reference.published import TABLE_2_2
from tests.reference.recordings import (
    LOWER,
    PARAMETERS,
    UPPER,
    RecordedRun,
    Truth,
    add_noise,
    fe_flexible_run,
    fe_rigid_run,
    jeffcott_run,
    offset_disc_run,
    rotor_of,
    tacho_times,
    write_recording,
)

RUNS = {
    "jeffcott": jeffcott_run,
    "offset_disc": offset_disc_run,
    "fe_rigid": fe_rigid_run,
    "fe_flexible": fe_flexible_run,
}
DIAGRAMS = Path(__file__).parents[2] / "diagrams"
OTHER = {
    "crack_stiffness": 2.1e5,
    "force_displacement_factor": 9e4,
    "force_current_factor": 50.0,
    "viscous_damping": 60.0,
    "eccentricity": 31e-6,
    "unbalance_phase": 1.1,
    "eccentricity1": 17e-6,
    "unbalance_phase2": -0.4,
    "rotor.mass_damping": 0.3,
    "support_left.stiffness[2]": 7e8,
    "support_right.damping[1]": 300.0,
}


def as_complex(run: RecordedRun, suffix: str = "") -> np.ndarray:
    """Return x + i y of a place, or i_x + i i_y for the suffix "current"."""
    x, y = ("ix", "iy") if suffix == "current" else (f"x{suffix}", f"y{suffix}")
    return run.columns[x] + 1j * run.columns[y]


def assert_close(found: np.ndarray, expected: np.ndarray, error: float) -> None:
    np.testing.assert_allclose(found, expected, rtol=0, atol=error * np.abs(expected).max())


class TurnedJeffcott(Jeffcott):
    """The rotor of chapter 2 whose shaft starts at 0.8 rad and whose crack is at 0.5 rad."""

    def angle(self, t: float) -> tuple[float, float]:
        return self.speed * t + 0.8, self.speed

    def crack(self, theta: float, displacement: complex) -> complex:
        return super().crack(theta + 0.5, displacement)


def test_table_2_2() -> None:
    run = jeffcott_run(Truth(), 1500 * RPM)
    assert len(run.time) == 10_000
    for suffix, column in (("", 0), ("current", 2)):
        found = harmonics(run.time, as_complex(run, suffix), run.speed, list(TABLE_2_2))
        for order, numbers in TABLE_2_2.items():
            assert abs(found[order]) == pytest.approx(numbers[column], rel=2e-3), order
            turn = np.exp(-1j * math.radians(numbers[column + 1]))
            assert abs(math.degrees(np.angle(found[order] * turn))) <= 0.1, order


def test_jeffcott_against_the_matrix_exponential() -> None:
    run = jeffcott_run(Truth(), 1560 * RPM, duration=0.1)
    for found, expected in zip((as_complex(run), as_complex(run, "current")), _jeffcott_exact(run), strict=True):
        assert_close(found, expected, 1e-10)  # round-off of 41000 steps there


def _jeffcott_exact(run: RecordedRun) -> tuple[np.ndarray, np.ndarray]:
    time = np.arange(41_000) * 1e-4
    displacement, current = Jeffcott(speed=run.speed).exact(time)
    return displacement[-len(run.time) :], current[-len(run.time) :]


def test_crack_phase_and_first_angle_against_time_integration() -> None:
    run = jeffcott_run(Truth(crack_phase=0.5), 1500 * RPM, start=0.0, duration=0.1, theta0=0.8)
    y = TurnedJeffcott().solve(run.time)
    assert_close(as_complex(run), y[:, 2] + 1j * y[:, 3], 1e-9)
    assert run.theta[0] == 0.8


@pytest.mark.parametrize("gains", [(12200.0, 2000.0, 3.0), (15000.0, 9000.0, 5.0), (12200.0, 0.0, 3.0)])
@pytest.mark.parametrize(("model", "duration"), [("offset_disc", 0.05), ("fe_rigid", 0.01), ("fe_flexible", 0.005)])
def test_rotors_against_time_integration(model: str, duration: float, gains: tuple[float, float, float]) -> None:
    truth, speed = Truth().changed(OTHER), 1620 * RPM
    run = RUNS[model](truth, speed, gains, start=0.0, duration=duration)
    rotor, nodes = rotor_of(model, truth, speed, gains)
    y = rotor.solve(run.time)
    for suffix, dof in nodes.items():
        expected = np.zeros(len(run.time)) if dof is None else rotor.displacement(y, dof)
        assert_close(as_complex(run, suffix), expected, 1e-8)  # the integration's, as in test_reference.py
    assert_close(as_complex(run, "current"), rotor.current(y), 1e-8)


@pytest.mark.parametrize("model", ["offset_disc", "fe_rigid", "fe_flexible"])
def test_settled_motion_against_the_frequency_domain(model: str) -> None:
    speed = LOWER[model][4]
    rotor, nodes = rotor_of(model, Truth(), speed)
    turn = 2 * math.pi / speed
    run = RUNS[model](Truth(), speed, start=0.0, duration=turn, rate=64 / turn, settled=True)
    for suffix, dof in [*nodes.items(), ("current", None)]:
        expected = rotor.settled_current() if suffix == "current" else {} if dof is None else rotor.settled(dof)
        found = harmonics(run.time, as_complex(run, suffix), speed, list(range(-11, 12)))
        scale = max((abs(value) for value in expected.values()), default=0.0)
        for order, value in found.items():
            assert abs(value - expected.get(order, 0.0)) <= 1e-9 * scale, (suffix, order)


@pytest.mark.parametrize("model", RUNS)
def test_integral_action_settles_in_the_end_only(model: str) -> None:
    speed = LOWER[model][0]
    early, late, settled = (
        as_complex(RUNS[model](Truth(), speed, start=start, duration=0.01, settled=at_once), "current")
        for start, at_once in ((4.0, False), (1000.0, False), (1000.0, True))
    )
    assert_close(late, settled, 1e-9)  # exp(-1000 s / 13.9 s) is nothing, the phase at 1000 s has 1e-12
    assert np.abs(early - as_complex(RUNS[model](Truth(), speed, duration=0.01, settled=True), "current")).max() > 1e-3


@pytest.mark.parametrize("model", RUNS)
def test_crack_phase_turns_each_harmonic_by_its_order(model: str) -> None:
    """Without unbalance, theta + phase is another origin of time: u(t; phase) = u(t + phase / W; 0)."""
    truth = Truth(eccentricity=0.0, eccentricity1=0.0, eccentricity2=0.0)
    speed, phase = LOWER[model][0], 0.7
    shifted = RUNS[model](Truth(**{**vars(truth), "crack_phase": phase}), speed, duration=0.1, settled=True)
    plain = RUNS[model](truth, speed, start=4.0 + phase / speed, duration=0.1, settled=True)
    for name, values in shifted.columns.items():
        assert_close(values, plain.columns[name], 1e-9)


def test_nothing_without_crack_and_unbalance() -> None:
    truth = Truth(crack_stiffness=0.0, eccentricity1=0.0, eccentricity2=0.0)
    assert not any(values.any() for values in fe_flexible_run(truth, 100.0, duration=0.01).columns.values())


def test_a_loop_without_enough_gain_is_refused() -> None:
    with pytest.raises(ValueError, match="unstable"):
        jeffcott_run(Truth(force_displacement_factor=9e5), 100.0, gains=(1000.0, 2000.0, 3.0))


@pytest.mark.parametrize("model", PARAMETERS)
def test_names_and_values_are_those_of_the_diagram(model: str) -> None:
    diagram = json.loads((DIAGRAMS / f"{model}.json").read_text(encoding="utf-8"))
    for name, value in Truth().of(model).items():
        if "." in name:
            block, parameter = name.split(".")
            parameter, _, index = parameter.partition("[")
            given = diagram["blocks"][block]["parameters"][parameter]
            given = given[int(index[0]) - 1] if index else given
        else:
            given = diagram["parameters"][name]
        number, unit = given.split(" ", 1)
        factor = {"um": 1e-6, "deg": math.pi / 180, "MN/m": 1e6}.get(unit, 1.0)
        assert value == pytest.approx(float(number) * factor, rel=1e-15), name
    free = set(diagram["parameters"]) - {"speed"}
    assert free <= set(PARAMETERS[model])


def test_truth_changes_by_name() -> None:
    truth = Truth().changed(OTHER)
    assert {name: truth[name] for name in OTHER} == OTHER
    assert truth.support_left_stiffness == (495.82e6, 7e8)
    for name in ("speed", "support_left.stiffness[3]", "support_left_stiffness", "rotor.crack_stiffness"):
        with pytest.raises(KeyError):
            truth[name]


def test_speeds_of_the_tables() -> None:
    ends = {
        "jeffcott": (19, 27, 92, 100),
        "offset_disc": (15, 23, 93, 101),
        "fe_rigid": (15, 23),
        "fe_flexible": (26, 34, 104, 112),
    }
    for model, hertz in ends.items():
        for speeds, (first, last) in zip((LOWER, UPPER), (hertz[:2], hertz[2:] or (0, 0)), strict=True):
            if last:
                np.testing.assert_allclose(speeds[model], 2 * math.pi * np.arange(first, last + 1), rtol=1e-14)


def test_white_noise() -> None:
    run = jeffcott_run(Truth(), 1500 * RPM)
    noisy = add_noise(run, 0.05, seed=1)
    draws = []
    for name, clean in run.columns.items():
        draw = (noisy.columns[name] - clean) / (0.05 * np.sqrt(np.mean(clean**2)))
        draws.append(draw)
        assert abs(draw.mean()) < 5 / math.sqrt(len(draw))  # five standard errors, here and below
        assert abs(draw.std() - 1) < 5 / math.sqrt(2 * len(draw))
        assert abs(np.mean(draw[1:] * draw[:-1])) < 5 / math.sqrt(len(draw))
    assert np.abs(np.corrcoef(draws) - np.eye(4)).max() < 5 / math.sqrt(len(run.time))
    part = add_noise(run.select(["y", "ix"]), 0.05, seed=1)
    other = add_noise(run, 0.05, seed=(1, 2))
    assert list(part.columns) == ["y", "ix"]
    assert np.array_equal(part.columns["y"], noisy.columns["y"])
    correlation = np.corrcoef(other.columns["y"] - run.columns["y"], noisy.columns["y"] - run.columns["y"])[0, 1]
    assert abs(correlation) < 5 / math.sqrt(len(run.time))


def test_noise_of_the_thesis_rescales_by_half_its_level() -> None:
    run = fe_rigid_run(Truth(), 1140 * RPM)
    noisy = add_noise(run, 0.05, seed=3, kind="thesis")
    for name, clean in run.columns.items():
        if not clean.any():
            assert not noisy.columns[name].any()
            continue
        draw = (noisy.columns[name] / clean - 1) / 0.05
        assert abs(draw.mean() + 0.5) < 5 / math.sqrt(len(draw))
        assert abs(draw.std() - 1) < 5 / math.sqrt(2 * len(draw))
    with pytest.raises(ValueError, match="pink"):
        add_noise(run, 0.05, seed=3, kind="pink")


def test_tacho_pulses_once_a_turn_at_angle_zero() -> None:
    run = jeffcott_run(Truth(), 1500 * RPM, start=4.0, theta0=1.0)
    pulses = tacho_times(run)
    assert len(pulses) == 25
    turns = (run.speed * pulses + 1.0) / (2 * math.pi)
    np.testing.assert_allclose(turns, np.round(turns), rtol=0, atol=1e-12)
    assert run.time[0] <= pulses[0] < run.time[0] + 0.04
    assert len(tacho_times(jeffcott_run(Truth(), 1500 * RPM))) == 25  # the first pulse is the first sample
    long = jeffcott_run(Truth(), 6000 * RPM, duration=20.0, rate=100.0, theta0=1.0)
    jitter = tacho_times(long, jitter=1e-6, seed=5) - tacho_times(long)
    assert abs(jitter.std() - 1e-6) < 5e-6 / math.sqrt(2 * len(jitter))


@pytest.mark.parametrize("file_format", ["npz", "csv"])
@pytest.mark.parametrize("clock", ["rate", "column"])
@pytest.mark.parametrize("angle", ["tacho", "theta", "none"])
def test_files(tmp_path: Path, file_format: str, clock: str, angle: str) -> None:
    runs = [fe_flexible_run(Truth(), speed, duration=0.1, theta0=0.3) for speed in LOWER["fe_flexible"][:2]]
    uses = ["identify", "hold_out"]
    path = write_recording(tmp_path / "new", runs, "two", uses, file_format=file_format, clock=clock, angle=angle)
    content = json.loads(path.read_text(encoding="utf-8"))
    assert content["name"] == "two"
    assert content["channels"]["y4"] == {"signal": "rotor.displacement", "node": 4, "axis": "y", "unit": "m"}
    assert content["channels"]["ix"] == {"signal": "controller.current", "axis": "x", "unit": "A"}
    assert content.get("time") == ("time" if clock == "column" else None)
    assert ("theta" in content["channels"]) == (angle == "theta")
    for run, use, entry in zip(runs, uses, content["runs"], strict=True):
        data = _read(path.parent / entry["file"])
        for column in run.columns:
            assert np.array_equal(data[column], run.columns[column])
        assert set(data) == set(content["channels"]) | ({"time"} if clock == "column" else set())
        assert entry["use"] == use
        assert entry["set"] == {"controller.KP": 12200.0, "controller.KI": 2000.0, "controller.KD": 3.0}
        assert float(entry["speed"].removesuffix(" rpm")) * RPM == pytest.approx(run.speed, rel=1e-14)
        offset = 0.0
        if clock == "rate":
            assert entry["sample_rate"] == "10000 Hz"
            offset = run.time[0]
        else:
            assert np.array_equal(data["time"], run.time)
        if angle == "tacho":
            np.testing.assert_allclose(entry["tacho"], tacho_times(run) - offset, rtol=0, atol=1e-15)
        elif angle == "theta":
            assert np.array_equal(data["theta"], run.theta)
        assert ("tacho" in entry) == (angle == "tacho")


def _read(path: Path) -> dict[str, Any]:
    if path.suffix == ".npz":
        with np.load(path) as data:
            return {name: data[name] for name in data}
    table = np.genfromtxt(path, delimiter=",", names=True)
    return {name: table[name] for name in table.dtype.names or ()}


def test_channel_without_node_for_one_place(tmp_path: Path) -> None:
    path = write_recording(tmp_path, [jeffcott_run(Truth(), 100.0, duration=0.1).select(["x", "ix"])], "part")
    channels = json.loads(path.read_text(encoding="utf-8"))["channels"]
    assert channels == {
        "x": {"signal": "rotor.displacement", "axis": "x", "unit": "m"},
        "ix": {"signal": "controller.current", "axis": "x", "unit": "A"},
    }
