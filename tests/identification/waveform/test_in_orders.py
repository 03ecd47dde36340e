"""Order vectors of run-ups that SciPy made, beside the order-tracked simulation of a diagram."""

import copy
import json
from dataclasses import replace

import numpy as np
import pytest

from rotorsim.errors import RotorsimError
from rotorsim.identification.identification import identify
from rotorsim.identification.in_orders import identify_orders
from rotorsim.identification.waveform.order_tracking import order_noise, order_search, tracked_orders
from rotorsim.model.load import load
from rotorsim.recordings.orders import load_orders
from tests.identification.waveform.orders import ROTOR, SLOW_ROLL, TRUTH, noisy, passage, write

SIGMA = 5e-8  # m, of amplitudes up to 4e-5


@pytest.fixture(scope="module")
def diagram(tmp_path_factory):
    file = tmp_path_factory.mktemp("diagram") / "disc.json"
    file.write_text(json.dumps(ROTOR))
    return load(str(file))


@pytest.fixture(scope="module")
def runup():
    """A run-up that rings: 230 rpm/s through 1598 rpm."""
    return passage(1250.0, 230.0, 1)


def off(result):
    """Return how far parameters are from the truth, in half widths of their 90 % intervals."""
    items = result.parameters
    return {n: abs(items[n].value - TRUTH[n]) / (items[n].interval90[1] - items[n].value) for n in TRUTH}


@pytest.mark.slow
def test_a_run_up_gives_parameters_and_slow_roll(diagram, runup, tmp_path):
    speed, _, vectors = runup
    result = identify(diagram, load_orders(write(tmp_path / "up", speed, noisy(vectors, SIGMA))))
    assert result.adequate
    assert result.statement.startswith("4 of 4 parameters are identified")
    assert max(off(result).values()) < 2.0
    for name, share in {"rotor.stiffness": 1e-3, "rotor.viscous_damping": 0.02, "unbalance.eccentricity": 0.01}.items():
        assert result.values[name] == pytest.approx(TRUTH[name], rel=share)
    assert result.values["unbalance.phase"] == pytest.approx(0.6, abs=0.01)
    [found] = result.slow_roll.values()
    assert abs(found.vector - SLOW_ROLL) < 4 * found.std < 2e-7
    assert result.noise["1X of rotor.displacement[1]"] == pytest.approx(SIGMA, rel=0.25)
    assert 0.7 < result.excess < 1.4


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    """The diagram with the true parameters."""
    true = copy.deepcopy(ROTOR)
    for name, value in TRUTH.items():
        block, _, key = name.partition(".")
        true["blocks"][block]["parameters"][key] = value
    file = tmp_path_factory.mktemp("truth") / "true.json"
    file.write_text(json.dumps(true))
    return load(str(file))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("start", "rate", "turns", "skip", "timed"),
    [(1250.0, 230.0, 1, 0, False), (1250.0, 230.0, 2, 0, False), (2000.0, -180.0, 2, 1, True)],
)
def test_without_noise_the_simulation_is_what_scipy_integrates(truth, tmp_path, start, rate, turns, skip, timed):
    """1X of both: to the errors of Runge-Kutta steps of a 32nd of a turn, and of a start before the first row."""
    speed, time, vectors = passage(start, rate, turns, rows=60 // turns, skip=skip)
    folder = write(tmp_path / "up", speed, vectors, time=time if timed else None, turns=turns, slow_roll="subtracted")
    recording = load_orders(folder)
    tracked = tracked_orders(truth, recording, recording.runs, truth.free)
    search = order_search(tracked, {("", label): 1.0 for label in tracked.labels})
    residual = search.evaluate(search.first(), 1).residuals[0][0]
    assert np.abs(residual).max() < 1e-3 * np.abs(vectors).max()


def test_an_order_is_twice_the_mean_over_the_turns_of_a_row(truth, runup, tmp_path):
    """x = 3 cos(2 theta + 0.4) + cos(theta) + 5: 2X is 3 exp(0.4 i) in every row, whatever the others are."""
    recording = load_orders(write(tmp_path / "up", runup[0][:40], runup[2][:40]))
    [track] = tracked_orders(truth, recording, recording.runs, truth.free).tracks
    theta = track.run.values["clock.theta"]
    x = 3 * np.cos(2 * theta + 0.4) + np.cos(theta) + 5
    found = track.extracted(x[:, None], [0, 0], [2, 1])
    np.testing.assert_allclose(found, np.tile([3 * np.exp(0.4j), 1.0], (40, 1)), atol=1e-12)
    turns = np.diff(theta[track.first]) / (2 * np.pi)
    np.testing.assert_allclose(turns, 1.0, rtol=1e-12)
    elapsed = np.diff(track.run.time[track.first])
    np.testing.assert_allclose(2 * np.pi / elapsed, recording.runs[0].speed[:-1], rtol=1e-6)


def test_sensitivities_are_the_differences_of_simulations(diagram, runup, tmp_path):
    speed, _, vectors = runup
    recording = load_orders(write(tmp_path / "up", speed[:40], vectors[:40]))
    tracked = tracked_orders(diagram, recording, recording.runs, diagram.free)
    search = order_search(tracked, {("", label): 1.0 for label in tracked.labels})
    at = search.first()
    J = search.evaluate(at, 1).jacobians[0][0]
    for j, x in enumerate(at):
        h = 1e-4 * max(abs(x), 1e-7)
        step = np.zeros(len(at))
        step[j] = h
        ends = [search.evaluate(at + sign * step, 1, sensitivities=False).residuals[0][0] for sign in (1, -1)]
        slope = (ends[0] - ends[1]) / (2 * h)
        np.testing.assert_allclose(J[:, :, j], slope, atol=1e-5 * np.abs(slope).max())


def test_without_a_compiler_the_numbers_are_the_same(diagram, runup, tmp_path):
    recording = load_orders(write(tmp_path / "up", runup[0][:20], runup[2][:20]))
    tracked = tracked_orders(diagram, recording, recording.runs, diagram.free)
    interpreted = replace(tracked, simulation=replace(tracked.simulation, use_compiler=False))
    ends = []
    for one in (tracked, interpreted):
        search = order_search(one, {("", label): 1.0 for label in one.labels})
        ends.append(search.evaluate(search.first(), 1))
    np.testing.assert_allclose(ends[1].residuals[0][0], ends[0].residuals[0][0], rtol=1e-9, atol=1e-18)
    np.testing.assert_allclose(ends[1].jacobians[0][0], ends[0].jacobians[0][0], rtol=1e-7, atol=1e-18)


@pytest.mark.slow
def test_a_coast_down_in_rows_of_two_turns_with_gaps_peak_to_peak_and_lag(diagram, tmp_path):
    speed, time, vectors = passage(2000.0, -180.0, 2, rows=45, skip=1)
    folder = write(tmp_path / "down", speed, noisy(vectors, SIGMA), time=time, turns=2, words=("peak-peak", "lag"))
    result = identify(diagram, load_orders(folder))
    assert result.adequate
    assert result.noise["1X of rotor.displacement[1]"] == pytest.approx(SIGMA, rel=0.35)
    for name, share in {"rotor.stiffness": 2e-3, "rotor.viscous_damping": 0.03, "unbalance.eccentricity": 0.02}.items():
        assert result.values[name] == pytest.approx(TRUTH[name], rel=share)
    assert result.values["unbalance.phase"] == pytest.approx(0.6, abs=0.03)


@pytest.mark.parametrize("seed", [2, 3, 4])
def test_nothing_is_missed_where_nothing_is_missing(diagram, runup, tmp_path, seed):
    speed, _, vectors = runup
    result = identify(diagram, load_orders(write(tmp_path / "up", speed, noisy(vectors, SIGMA, seed))))
    assert result.adequate
    assert max(off(result).values()) < 2.5


@pytest.mark.slow
def test_a_second_critical_speed_that_the_diagram_lacks_is_not_explained(diagram, runup, tmp_path):
    speed, _time, vectors = runup
    _, _, stiff = passage(1250.0, 230.0, 1, truth={**TRUTH, "rotor.stiffness": 31e3})
    result = identify(diagram, load_orders(write(tmp_path / "up", speed, noisy((vectors + stiff) / 2, SIGMA))))
    assert not result.adequate
    assert "does not explain the data" in result.statement
    assert result.excess > 100


def test_run_out_that_was_not_subtracted_is_not_explained_without_slow_roll(diagram, runup, tmp_path):
    speed, _, vectors = runup
    folder = write(tmp_path / "up", speed, noisy(vectors, SIGMA), slow_roll="subtracted")
    result = identify(diagram, load_orders(folder))
    assert not result.slow_roll
    assert not result.adequate


def test_held_out_rows_are_predicted(diagram, runup, tmp_path):
    speed, _, vectors = runup
    folder = write(tmp_path / "up", speed, noisy(vectors, SIGMA))
    held = write(tmp_path / "held", speed, noisy(vectors, SIGMA, 7))
    result = identify(diagram, load_orders(folder), hold_out=load_orders(held))
    label = "1X of rotor.displacement[1]"
    assert result.fit["hold_out"][label] == pytest.approx(result.noise_floor[label], rel=0.2)


def test_noise_is_what_differs_from_row_to_row(diagram, tmp_path):
    rows = np.arange(400)
    smooth = 1e-5 * np.exp(2j * np.pi * rows / 9)  # a beat of nine rows
    speed = 1000 + rows
    found = []
    for noise in (SIGMA, 0.0):
        random = np.random.default_rng(5)
        white = noise * (random.normal(size=400) + 1j * random.normal(size=400))
        recording = load_orders(write(tmp_path / str(noise), speed, smooth + white))
        [value] = order_noise(tracked_orders(diagram, recording, recording.runs, diagram.free), 1e-4).values()
        found.append(np.sqrt(value))
    assert found[0] == pytest.approx(SIGMA, rel=0.2)
    assert found[1] < 4e-8  # of the beat, 1e-5 / sqrt(2), one part in 200


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"method": "regression"}, "is of steady runs"),
        ({"given": ["rotor.displacement"]}, "cannot be taken as measured"),
        ({"free": []}, "no free parameters"),
    ],
)
def test_what_makes_no_sense_of_orders_is_refused(diagram, runup, tmp_path, change, said):
    recording = load_orders(write(tmp_path / "up", runup[0], runup[2]))
    with pytest.raises(RotorsimError, match=said):
        identify_orders(diagram, recording, **change)


def test_modes_too_fast_for_the_steps_are_told(runup, tmp_path):
    fast = copy.deepcopy(ROTOR)
    fast["blocks"]["rotor"]["parameters"]["stiffness"] = 28e9
    (tmp_path / "fast.json").write_text(json.dumps(fast))
    recording = load_orders(write(tmp_path / "up", runup[0], runup[2]))
    with pytest.raises(RotorsimError, match="has modes too fast for 64 steps between samples, 32 a turn"):
        identify(load(str(tmp_path / "fast.json")), recording)


def test_a_diagram_without_the_signal_or_a_clock_is_refused(diagram, runup, tmp_path):
    channels = {"a": {"signal": "rotr.displacement", "unit": "um", "amplitude": "amp", "phase": "ph"}}
    recording = load_orders(write(tmp_path / "up", runup[0], runup[2], channels=channels))
    with pytest.raises(RotorsimError) as error:
        identify(diagram, recording)
    assert [problem.what for problem in error.value.problems] == ["no such signal"]
    assert error.value.problems[0].hint == "did you mean 'rotor.displacement'?"
    still = {
        **ROTOR,
        "parameters": {},
        "blocks": {"rotor": ROTOR["blocks"]["rotor"], "drive": {"type": "constant", "parameters": {"value": [1.0, 0]}}},
        "wires": [["drive.output", "rotor.force"]],
        "identify": {"rotor.stiffness": {}},
    }
    (tmp_path / "still.json").write_text(json.dumps(still))
    recording = load_orders(write(tmp_path / "up", runup[0], runup[2]))
    with pytest.raises(RotorsimError, match="has no clock"):
        identify(load(str(tmp_path / "still.json")), recording)
