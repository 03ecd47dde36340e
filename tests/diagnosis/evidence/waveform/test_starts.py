"""Where the search for a line, a step, and what acts late in the runs begins."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

from rotorsim.diagnosis.catalogue.insertion import DOMINANT, LONGEST, ONSETS, SAMPLED, starts_of
from rotorsim.diagnosis.diagnosis import diagnose
from rotorsim.diagnosis.evidence.fit import Fit
from rotorsim.diagnosis.evidence.waveform import fits
from rotorsim.diagnosis.evidence.waveform.dominant_line import dominant_line, line_beside_noise
from rotorsim.diagnosis.evidence.waveform.fits import WaveformFits
from rotorsim.diagnosis.evidence.waveform.onset import onset_times
from rotorsim.fault import Dominant, Fault, Onset
from rotorsim.model.load import load
from tests.diagnosis.evidence.waveform.level_control import CONTROL, FINE, controlled, made

DT, SIZES = 0.02, (1500, 1200)


def noisy(seed: int, frequency: float, amplitude: float) -> list[np.ndarray]:
    """Runs of two signals with a line in one: resonant noise at 3 rad/s that is ten times as large, a drift, white."""
    random, parts = np.random.default_rng(seed), []
    pole = 0.995 * np.exp(3.0j * DT)
    for size in SIZES:
        t = np.arange(size) * DT
        coloured = lfilter([1.0], [1.0, -2 * pole.real, abs(pole) ** 2], random.normal(size=size))
        coloured *= 10 * amplitude / coloured.std()
        line = amplitude * np.sin(frequency * t + random.uniform(0, 6))
        parts.append(np.column_stack([coloured + 0.3 * random.normal(size=size) + t, line + random.normal(size=size)]))
    return parts


@pytest.mark.parametrize("frequency", [1.7, 23.4, 140.0])
def test_a_search_for_a_line_begins_within_a_quarter_of_a_cycle_over_the_run(frequency):
    found = dominant_line(noisy(1, frequency, 2.0), DT).frequency
    assert abs(found - frequency) * SIZES[0] * DT < np.pi / 2


def test_samples_that_are_missing_do_not_hide_a_line():
    parts = noisy(2, 23.4, 2.0)
    parts[0][100:140] = np.nan
    assert abs(dominant_line(parts, DT).frequency - 23.4) * SIZES[0] * DT < np.pi / 2


@pytest.mark.slow
@pytest.mark.parametrize("tau", [1.5, 20.0, 400.0])
def test_noise_of_any_memory_has_no_line_and_a_line_stands_out_unless_it_is_hum(tau):
    """Ninety draws of a level of 10^-4 in all. The line has 2 % of the power of the noise, or 0.1 % of slow noise."""
    dt, left = 1e-3, np.exp(-1 / tau)
    random = np.random.default_rng(5)
    largest = []
    for _ in range(30):
        runs = [lfilter([1], [1, -left], random.normal(size=4000 + int(20 * tau)))[-4000:] for _ in range(3)]
        largest.append(line_beside_noise(runs, dt))
    assert max(largest) < 1.0
    unlike = [runs[0], 3 * runs[1][:1000], 0.1 * runs[2][:1000]]
    assert line_beside_noise(unlike, dt) < 1.0
    for frequency, seen in ((83.0, True), (50.3, False), (179.0, False), (220.0, True)):
        size = 0.2 * runs[0].std() if tau < 100 else 0.05 * runs[0].std()
        lined = [run + size * np.sin(2 * np.pi * frequency * np.arange(4000) * dt) for run in runs]
        assert (line_beside_noise(lined, dt) > 1.0) == seen


def test_a_frequency_begins_at_the_line_or_far_from_both_ends():
    fault = Fault(physics="hum", enters="signal", free={"frequency": (Dominant(),)})
    insertion = type("Insertion", (), {"fault": fault})
    assert starts_of(insertion, {DOMINANT: 23.4, SAMPLED: DT}) == [{"frequency": 23.4}]
    assert starts_of(insertion, {SAMPLED: DT}) == [{"frequency": pytest.approx(3.0)}]


TIME = 11.7  # of a step, in runs of 16 s at 50 samples a second


def stepped(seed: int) -> dict[str, np.ndarray]:
    data = controlled(seed)
    data["level"][round(TIME * 50) :] += 0.03
    return data


@pytest.mark.slow
def test_a_step_behind_the_samples_that_starts_are_chosen_on_is_found(monkeypatch):
    """FAULT: of 15000 samples the first 8192 were looked at, and a reading that jumped at 80 % was `consistent`."""
    monkeypatch.setattr(fits, "SHORT", 800)
    done = diagnose(
        load(CONTROL),
        made([stepped(seed) for seed in (1, 2, 3)], 50),
        physics=["step_disturbance", "offset"],
        workers=1,
    )
    [effect] = done.effects
    assert effect.physics == "step_disturbance"
    assert {spot.words for spot in effect.spots} == {"the reading of level.output"}
    assert done.after.values["step_disturbance.time"] == pytest.approx(TIME, abs=0.02)
    assert done.after.values["step_disturbance.height"] == pytest.approx(0.03, rel=0.05)
    assert done.after.std([*done.after.values].index("step_disturbance.time")) < 0.02  # between two samples, not open


@pytest.mark.parametrize(("late", "looked_at"), [(1.19, 8192), (1.21, 15000)])
def test_all_samples_are_looked_at_where_a_fit_leaves_a_fifth_more_of_the_later_ones(late, looked_at):
    runs, stretches = [], []
    for r in range(3):
        runs.append(SimpleNamespace(size=5000))
        stretches += [(r, first, first + 499) for first in range(0, 5000, 500)]
    evidence = SimpleNamespace(runs=runs, parts=(), stretches=stretches)
    left = np.array([late if (first + last) / 2 > 5000 * 8192 / 15000 else 1.0 for _, first, last in stretches])
    assert WaveformFits._beginning(evidence, Fit({}, run_misfit=left)) == looked_at
    assert WaveformFits._beginning(evidence, Fit({}, run_misfit=left, failure="it diverges")) == 8192


@pytest.mark.parametrize("lasting", [0.3, 10.0], ids=["as long as a controller lets it", "to the end"])
def test_a_search_for_a_step_begins_where_all_runs_change(lasting):
    random, times, parts = np.random.default_rng(1), [], []
    for size, begins in ((1500, 0.0), (1200, 1.0)):
        t = begins + np.arange(size) * 0.01
        part = random.normal(size=(size, 2))
        part[:, 1] += 6 * ((t >= 7.3) & (t < 7.3 + lasting))
        part[40:50] = np.nan
        times.append(t)
        parts.append(part)
    found = onset_times(parts, times)
    assert min(abs(time - 7.3) for time in found) < 0.02


def test_without_a_residual_the_onsets_are_eighths_of_the_longest_run():
    fault = Fault(physics="step", enters="signal", free={"time": tuple(map(Onset, range(3)))})
    item = type("Item", (), {"fault": fault, "kind": None, "spot": None})()
    assert [start["time"] for start in starts_of(item, {LONGEST: 8.0})] == [1.0, 3.0, 5.0]
    assert [start["time"] for start in starts_of(item, {LONGEST: 8.0, ONSETS[1]: 2.5})] == [1.0, 2.5, 5.0]


@pytest.mark.slow
@pytest.mark.parametrize("frequency", [17.0, pytest.param(60.0, marks=pytest.mark.slow)])
def test_a_mode_that_is_broad_is_found_at_any_frequency(frequency):
    """FAULT: searched from 1.5, 7.5 and 37.5 rad/s with a damping ratio of 0.1, one with 0.3 was called a delay, two
    effects, or outside the catalogue."""
    damping = 0.3

    def behind_a_mode(seed: int) -> dict[str, np.ndarray]:
        random = np.random.default_rng(seed)
        reference = np.repeat(random.uniform(-1, 1, 8) * 4, 100)
        x, h, out = np.zeros(4), 1 / 50 / FINE, np.empty((800, 2))  # level, integral, and the mode with its rate

        def rates(x: np.ndarray, r: float) -> np.ndarray:
            level, integral, value, rate = x
            u = 1.5 * (r - level) + 4.0 * integral
            force = frequency**2 * (u - value) - 2 * damping * frequency * rate
            return np.array([2.0 * value - level, r - level, rate, force])

        for k, r in enumerate(reference.tolist()):
            out[k] = 1.5 * (r - x[0]) + 4.0 * x[1], x[0]
            for _ in range(FINE):
                x = x + h * rates(x + h / 2 * rates(x, r), r)
        noisy = out + random.normal(size=out.shape) * (5e-3, 2e-3)
        return {"reference": reference, "control": noisy[:, 0], "level": noisy[:, 1]}

    runs = [behind_a_mode(seed) for seed in (1, 2, 3)]
    done = diagnose(load(CONTROL), made(runs, 50), physics=["missing_mode", "lag", "delay", "cross_talk"], workers=1)
    [effect] = done.effects
    assert effect.physics == "missing_mode"
    assert "control.output" in {str(spot) for spot in effect.spots}
    for key, truth in (("frequency", frequency), ("damping_ratio", damping)):
        name = f"{effect.candidate.insertion.name}.{key}"
        std = done.after.std([*done.after.values].index(name))
        assert abs(done.after.values[name] - truth) < 4 * std < 0.1 * truth
