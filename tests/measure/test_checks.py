"""Findings about signals: each is made once, and good data have none."""

import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rotorsim.errors import Place, Problem
from rotorsim.measure.checks import check_signals
from rotorsim.recordings.recording import Channel, Recording, Run
from rotorsim.signals.stretches import clipped_stretches, flat_stretches
from tests.recordings.made import RATE, SPEED, pulses, samples

CHANNELS = {
    "x": Channel("x", "rotor.displacement", "x", None, None, "um"),
    "y": Channel("y", "rotor.displacement", "y", None, None, "um"),
    "ix": Channel("ix", "controller.current", "x", None, None, "A"),
    "iy": Channel("iy", "controller.current", "y", None, None, "A"),
}
TIME = np.arange(5000) / RATE
GOOD = Run(
    "run1",
    "run1.csv",
    TIME,
    samples(),
    SPEED,
    np.array(pulses()),
    {"controller.KP": 12200.0},
    "identify",
    Place("recording.json", 20, 3),
    RATE,
)


def recording(*runs: Run, channels: dict[str, Channel] | None = None) -> Recording:
    return Recording("made", "made for a test", Path("made"), channels or CHANNELS, runs)


def found(*runs: Run, channels: dict[str, Channel] | None = None) -> list[str]:
    problems = check_signals(recording(*runs, channels=channels))
    for problem in problems:
        assert problem.code == "run_up" or problem.what.startswith(problem.code.replace("_", " "))
    return [shown(problem) for problem in problems]


def shown(problem: Problem) -> str:
    return f"{problem.severity}: {problem.subject}: {problem.what}"


def changed(column: str, values: np.ndarray) -> Run:
    return replace(GOOD, values={**GOOD.values, column: values})


def with_pulses(tacho: np.ndarray, speed: float | None = SPEED) -> Run:
    return replace(GOOD, tacho=np.asarray(tacho), speed=speed, tacho_resolution=0.0)


def with_time(time: np.ndarray, rate: float | None = None) -> Run:
    return replace(GOOD, time=np.asarray(time), sample_rate=rate, tacho=None)


def turning(speed: np.ndarray) -> np.ndarray:
    """Return the times of the pulses of a shaft whose speed (5000,) [rad/s] varies."""
    angle = np.concatenate(([0.0], np.cumsum((speed[1:] + speed[:-1]) / 2 / RATE)))
    return np.interp(2 * np.pi * np.arange(1, int(angle[-1] / (2 * np.pi)) + 1), angle, TIME)


def test_good_data_have_no_findings():
    other = replace(GOOD, id="run2", values=samples(seed=1), settings={"controller.KP": 14000.0})
    third = replace(GOOD, id="run3", values=samples(2 * SPEED, 2), speed=2 * SPEED, tacho=np.array(pulses(2 * SPEED)))
    assert found(GOOD, other, third) == []


@pytest.mark.parametrize(
    "run",
    [
        replace(GOOD, tacho=None),
        replace(GOOD, speed=None),
        replace(GOOD, tacho=None, speed=0.0),
        replace(GOOD, tacho=np.empty(0)),
        replace(GOOD, tacho=GOOD.tacho[:1]),
        replace(GOOD, tacho=GOOD.tacho[:2]),
        replace(GOOD, tacho=np.concatenate(([GOOD.tacho[0] - 2 * np.pi / SPEED], GOOD.tacho))),  # just before the run
        replace(GOOD, speed=-SPEED),
        replace(GOOD, sample_rate=RATE * 1.0009),
        replace(GOOD, time=TIME + 3600.0, tacho=GOOD.tacho + 3600.0),
        replace(GOOD, time=np.round(TIME, 4) + 1e-9 * np.arange(5000), sample_rate=RATE),  # rounded when it was written
        replace(GOOD, speed=SPEED * 1.019),
        with_pulses(GOOD.tacho + np.random.default_rng(0).normal(0, 1e-4, len(GOOD.tacho))),  # 0.25 % of a turn
        with_pulses(turning(SPEED * (1 + 0.009 * TIME))),
    ],
)
def test_other_good_data_have_no_findings(run):
    assert found(run) == []


# --- samples ----------------------------------------------------------------------------------------------------------


def test_an_empty_run():
    nothing = replace(GOOD, time=np.empty(0), values={column: np.empty(0) for column in CHANNELS})
    one = replace(GOOD, id="run2", time=np.zeros(1), values={column: np.zeros(1) for column in CHANNELS})
    assert found(nothing, one) == ["error: run1: empty run: 0 samples", "error: run2: empty run: 1 sample"]


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_samples_that_are_not_finite(bad):
    values = np.where((TIME > 0.5) & (TIME < 0.501), bad, GOOD.values["x"])
    problem = check_signals(recording(changed("x", values)))[0]
    assert shown(problem) == "error: run1: column x: not finite: 4 of 5000 samples, first at 0.5002 s"
    assert problem.place == Place("run1.csv")
    time = np.where(TIME == 0.5, bad, TIME)
    assert found(with_time(time)) == ["error: run1: not finite: 1 values of time, the first is sample 2501"]


def test_a_constant_signal():
    assert found(changed("iy", np.full(5000, 0.25))) == [
        "warning: run1: column iy: constant signal: all samples are 0.25 A"
    ]


@pytest.mark.parametrize("limit", [8e-6, 1.5e-5, 1.9e-5])
@pytest.mark.parametrize("resolution", [0.0, 1e-9, 3e-8])
def test_a_clipped_signal(limit, resolution):
    values = np.clip(GOOD.values["x"], -limit, limit)
    if resolution:
        values = np.round(values / resolution) * resolution
    (problem,) = found(changed("x", values))
    assert problem.startswith("warning: run1: column x: clipped signal: ")
    assert problem.endswith(f"{values.max() * 1e6:.6g} um")


def test_a_signal_clipped_on_one_side_only():
    (problem,) = found(changed("x", np.minimum(GOOD.values["x"], 2e-5)))
    assert problem.endswith(" stand at 20 um")


signals = st.fixed_dictionaries(
    {
        "frequency": st.floats(0.3, 400.0),
        "levels": st.floats(1.5, 3000.0),  # of the resolution in the amplitude
        "noise": st.sampled_from([0.0, 0.05, 0.3, 1.0, 3.0]),  # of the resolution
        "second": st.floats(0.0, 0.6),
        "phase": st.floats(0.0, 6.28),
        "offset": st.floats(0.0, 1.0),
        "seed": st.integers(0, 100),
    }
)


def coarse(frequency, levels, noise, second, phase, offset, seed):
    angle = 2 * np.pi * frequency * TIME + phase
    values = levels * (np.cos(angle) + second * np.cos(2 * angle + 3 * phase)) + offset
    return np.round(values + np.random.default_rng(seed).normal(0, 1, 5000) * noise)


@pytest.mark.slow
@settings(max_examples=120, deadline=None)
@given(signals)
def test_coarse_resolution_is_neither_clipping_nor_a_stuck_converter(signal):
    values = coarse(**signal)
    assert clipped_stretches(values) == []
    assert flat_stretches(values) == []


@pytest.mark.slow
@settings(max_examples=100, deadline=None)
@given(signals, st.floats(0.3, 0.9))
def test_clipping_is_found_where_it_cuts_more_than_the_resolution(signal, limit):
    signal |= {"frequency": 5 + signal["frequency"] / 10, "levels": 1000 + signal["levels"]}
    signal["noise"] = max(signal["noise"], 0.3)  # else samples may repeat from period to period and hide the resolution
    values = coarse(**signal)
    cut = np.clip(values, np.round(limit * values.min()), np.round(limit * values.max()))
    assert clipped_stretches(cut)


@settings(max_examples=100, deadline=None)
@given(signals, st.integers(500, 4000), st.integers(20, 300))
def test_a_stuck_converter_is_found(signal, first, count):
    signal |= {"frequency": 20 + signal["frequency"], "levels": 200 + signal["levels"]}
    signal["noise"] = max(signal["noise"], 0.3)  # else samples that repeat hide the resolution, as with 50 Hz exactly
    values = coarse(**signal)
    level = values[first]
    values[first : first + count] = level
    sides = values[first - count : first + 1], values[first + count - 1 : first + 2 * count]
    if min(np.ptp(side) for side in sides) > 83 and values.min() < level < values.max():
        assert any(start <= first and first + count <= stop for start, stop in flat_stretches(values))


def test_a_flat_stretch():
    values = GOOD.values["x"].copy()
    values[1000:1025] = values[1000]
    assert found(changed("x", values)) == ["warning: run1: column x: flat stretch: 25 equal samples from 0.2 s on"]
    values[3000:3040] = values[3000]
    assert found(changed("x", values)) == [
        "warning: run1: column x: flat stretch: 25 equal samples from 0.2 s on (and 1 more)"
    ]


def test_a_switched_signal_is_not_clipped():
    values = np.where(np.sin(SPEED * TIME) > 0, 1.0, -1.0)
    assert clipped_stretches(values) == []


def test_set_points_pulses_and_angles_may_stand_still():
    values = np.where(TIME < 0.3, 5 * TIME, 1.5 * np.clip(1 - (TIME % 0.1) * 20, 0, 1))
    channels = {name: Channel(name, name, None, None, None, "1") for name in ("reference.output", "tacho")}
    run = replace(GOOD, values=dict.fromkeys(channels, values))
    assert found(run, channels=channels) == []
    other = {name: replace(channel, signal="drive.output") for name, channel in channels.items()}
    assert len(found(run, channels=other)) == 2


# --- time -------------------------------------------------------------------------------------------------------------


def test_lost_samples():
    step = 1 / RATE
    gaps = TIME + 3 * step * (TIME > 0.5) + step * (TIME > 0.7)
    assert found(with_time(gaps)) == ["warning: run1: lost samples: 2 gaps in time, first 0.0008 s long at 0.5 s"]
    back = TIME - 0.1 * (TIME > 0.5)
    assert found(with_time(back)) == [
        "error: run1: lost samples: time does not rise at 1 sample, first from 0.5 to 0.4002 s"
    ]
    twice = np.where(TIME == 0.5, 0.4998, TIME)
    assert found(with_time(twice)) == [
        "error: run1: lost samples: time does not rise at 1 sample, first from 0.4998 to 0.4998 s"
    ]
    wrong = check_signals(recording(with_time(TIME * 1.002, RATE)))[0]
    assert shown(wrong) == "error: run1: lost samples: sample_rate says 5000 Hz, the time column 4990.01996 Hz"
    assert wrong.place == GOOD.place
    assert found(with_time(gaps, RATE)) == found(with_time(gaps))  # gaps do not make a wrong rate
    uneven = np.cumsum(np.where(np.arange(5000) % 3 == 0, 2.0, 1.0))
    assert found(with_time(uneven)) == ["warning: run1: lost samples: time is uneven, its steps are 1 to 2 s"]


# --- units and channels -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("factor", "unit"), [(1e6, "um"), (1e3, "um")])
def test_displacements_too_large_for_a_rotor(factor, unit):
    rms = np.sqrt(np.mean(np.square(GOOD.values["x"]))) * factor
    assert found(changed("x", GOOD.values["x"] * factor)) == [
        f"warning: run1: column x: wrong unit? rms {rms:.4g} m with unit '{unit}' is more than 5 mm"
    ]


def test_displacements_too_small_for_a_rotor_and_currents_too_large():
    (problem,) = found(changed("x", GOOD.values["x"] * 1e-6))
    assert problem.startswith("warning: run1: column x: wrong unit? rms 1.4")
    assert problem.endswith("e-11 m with unit 'um' is less than 1 nm")
    (problem,) = found(changed("iy", GOOD.values["iy"] * 1e5))
    assert problem.endswith("A with unit 'A' is more than 1 kA")


def test_other_machines_move_further():
    channels = {"x": Channel("x", "carriage.displacement", None, None, None, "m")}
    assert found(replace(GOOD, values={"x": GOOD.values["x"] * 1e4}), channels=channels) == []


def test_an_axis_without_its_partner():
    channels = {name: CHANNELS[name] for name in ("x", "ix", "iy")}
    assert found(replace(GOOD, values={c: GOOD.values[c] for c in channels}), channels=channels) == [
        "warning: channel x: missing channel: rotor.displacement[1] is measured, its y axis is not"
    ]
    nodes = {"x": replace(CHANNELS["x"], node=3), "y": replace(CHANNELS["y"], node=4)}
    assert len(found(replace(GOOD, values={c: GOOD.values[c] for c in nodes}), channels=nodes)) == 2


def test_swapped_axes():
    swapped = replace(GOOD, values={**GOOD.values, "ix": GOOD.values["iy"], "iy": GOOD.values["ix"]})
    assert found(swapped) == ["warning: column x: swapped axes? x follows iy and y follows ix in 1 of 1 runs"]
    still = replace(GOOD, id="run2", values=samples(seed=4), settings={})
    assert found(swapped, still) == []  # the other run is sure that they are not


@pytest.mark.parametrize("lead", np.arange(0, 360, 15))
@pytest.mark.parametrize("ratio", [1.0, -1.0, 0.8, 0.2])
def test_any_phase_between_displacement_and_current_is_no_swap(lead, ratio):
    angle, lead = SPEED * TIME, np.radians(lead)
    table = {
        "x": 1e-5 * np.cos(angle),
        "y": ratio * 1e-5 * np.sin(angle),
        "ix": np.cos(angle + lead),
        "iy": ratio * np.sin(angle + lead),
    }
    assert found(replace(GOOD, values=table)) == []


# --- phase ------------------------------------------------------------------------------------------------------------


def test_no_phase_reference():
    nothing = replace(GOOD, tacho=None, speed=None)
    problem = check_signals(recording(nothing))[0]
    assert shown(problem) == "warning: run1: no phase reference: neither tacho nor angle nor speed"
    assert problem.place == GOOD.place
    flat_channels = {name: replace(channel, axis=None) for name, channel in CHANNELS.items()}
    assert found(nothing, channels=flat_channels) == []  # nothing turns
    for signal in ("clock.theta", "tacho"):
        channels = {**CHANNELS, "a": Channel("a", signal, None, None, None, "rad")}
        values = {**GOOD.values, "a": (SPEED * TIME) % (2 * np.pi)}
        assert found(replace(nothing, values=values), channels=channels) == []


def test_tacho_pulses_that_are_wrong():
    good = GOOD.tacho
    back = good.copy()
    back[3] = back[2]
    assert found(with_pulses(back)) == [
        f"error: run1: tacho: pulse 4 at {good[2]:.9g} s is not after pulse 3 at {good[2]:.9g} s"
    ]
    assert found(with_pulses(good + 3600)) == [
        f"error: run1: tacho: {len(good)} of {len(good)} pulses are outside the run (0 to 0.9998 s)"
    ]
    turn = 2 * np.pi / SPEED
    assert found(with_pulses(np.delete(good, 7))) == [
        f"error: run1: tacho: 1 missing, the first after {good[6]:.6g} s, by {2 * turn:.4g} s instead of {turn:.4g} s"
    ]
    double = np.insert(good, 7, good[6] + 1e-4)
    assert found(with_pulses(double)) == [
        f"error: run1: tacho: 1 too early, the first after {good[6]:.6g} s, by 0.0001 s instead of {turn:.4g} s"
    ]
    assert found(with_pulses(good, SPEED * 1.03)) == [
        "error: run1: tacho: the tacho says 1518 rpm, the stated speed is 1563.5 rpm"
    ]


def test_several_pulses_in_a_turn_are_named():
    four = np.interp(np.arange(0, len(GOOD.tacho) - 1, 0.25), np.arange(len(GOOD.tacho)), GOOD.tacho)
    (problem,) = check_signals(recording(with_pulses(four)))
    assert problem.what == "tacho: the tacho says 6072 rpm, the stated speed is 1518 rpm"
    assert problem.hint == "there may be 4 pulses in a turn: keep one"


def test_a_speed_that_wanders():
    for rise, text in ((0.02, "+2 %"), (-0.015, "-1.5 %")):
        (problem,) = found(with_pulses(turning(SPEED * (1 + rise * TIME))))
        assert problem.startswith(f"warning: run1: speed wanders: by {text} over the run, around 15")


@settings(max_examples=50, deadline=None)
@given(st.floats(5, 60), st.floats(1, 10), st.sampled_from([1, -1]))
def test_a_run_up_has_no_wrong_pulses(start, ratio, way):
    speed = 2 * np.pi * start * np.linspace(1, ratio, 5000)[::way]
    said = found(with_pulses(turning(speed), None))
    assert all(any(word in text for word in ("speed wanders", "run-up", "coast-down")) for text in said)


def turns_from_rest(n: int, turns: float) -> np.ndarray:
    """Return when a shaft that starts at rest passes whole turns: theta = 2 pi turns t^2 within a second."""
    return np.sqrt(np.arange(n) / turns)


def test_a_run_up_from_standstill_lacks_no_pulse():
    """Constant angular acceleration: the first interval is 2.4 times the second; without a pulse it is said."""
    pulses = turns_from_rest(40, 40.5)
    run = with_pulses(pulses, None)
    assert found(run) == ["warning: run1: run-up from 48.11 to 4811 rpm"]
    (problem,) = check_signals(recording(run))
    assert (
        problem.hint == "identify, diagnose and run compare it in time; spectrum and locate need runs at steady speeds"
    )
    for lost in (1, 20):
        (text,) = found(with_pulses(np.delete(pulses, lost), None))
        assert text.startswith("error: run1: tacho: 1 missing, the first after ")


def test_the_limit_of_a_steady_run():
    """25 turns: e / (2 pi 25 0.1^2) = 1 deg at e = 2.74 %."""
    for rise, names in ((0.026, "speed wanders"), (0.029, "run-up"), (-0.026, "speed wanders"), (-0.029, "coast-down")):
        (text,) = found(with_pulses(turning(2 * np.pi * 25.3 * (1 + rise * TIME)), None))
        assert text.startswith(f"warning: run1: {names}")


def test_the_angle_is_checked_like_the_tacho():
    channels = {**CHANNELS, "a": Channel("a", "clock.theta", None, None, None, "deg")}

    def run(angle, speed):
        return replace(GOOD, values={**GOOD.values, "a": angle % (2 * np.pi)}, tacho=None, speed=speed)

    assert found(run(SPEED * TIME, SPEED), channels=channels) == []
    assert found(run(SPEED * TIME, None), channels=channels) == []
    assert found(run(SPEED * TIME, 2 * SPEED), channels=channels) == [
        "error: run1: tacho: the angle says 1518 rpm, the stated speed is 3036 rpm"
    ]
    (problem,) = found(run(SPEED * (TIME + 0.02 * TIME**2), None), channels=channels)
    assert problem == "warning: run1: run-up from 1519 to 1578 rpm"


# --- runs -------------------------------------------------------------------------------------------------------------


def test_two_runs_alike():
    other = replace(GOOD, id="run2", values=samples(seed=1), speed=SPEED * 1.0005)
    assert found(GOOD, other) == ["warning: run2: two runs alike: run1 and run2 have the same speed and set"]
    assert found(GOOD, replace(other, settings={})) == []
    assert found(GOOD, replace(other, use="hold_out")) == []
    assert found(GOOD, replace(other, speed=SPEED * 1.002)) == []
    assert found(replace(GOOD, speed=None), replace(other, speed=None)) == []
    copy = replace(GOOD, id="run2", use="hold_out", settings={})
    assert found(GOOD, copy) == ["error: run2: two runs alike: the data of run1 and run2 are identical"]


def test_a_long_run_takes_no_more_memory_than_six_of_its_columns():
    """Beside the run itself: eleven were taken by fits to all samples and by an angle for each degree."""
    n = 400_000
    time = np.arange(n) / RATE
    angle = SPEED * time
    columns = {"x": 1e-6 * np.cos(angle), "y": 1e-6 * np.sin(angle)}
    turn = 2 * np.pi / SPEED
    run = replace(GOOD, time=time, values=columns, tacho=np.arange(1, int(time[-1] / turn)) * turn)
    made = recording(run, channels={name: CHANNELS[name] for name in columns})
    tracemalloc.start()
    try:
        assert check_signals(made) == []
        assert tracemalloc.get_traced_memory()[1] < 6 * 8 * n
    finally:
        tracemalloc.stop()
