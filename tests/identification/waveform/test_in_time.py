"""Identification from samples in time: parameters, intervals, ordinary data that are not ideal, and what is refused."""

import copy
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binom

from rotorsim.errors import RotorsimError
from rotorsim.identification.files import identification_data, save_identification
from rotorsim.identification.identification import identify
from rotorsim.identification.waveform.recorded.along_angle import is_in_time
from rotorsim.model.load import load
from rotorsim.recordings.loading import load_recording
from tests.identification.waveform.in_time import OSCILLATOR, TRUTH, even, measured, motion, pushes, recording, run_of

SHARED = Path(__file__).parents[4] / "shared" / "recordings" / "generic"
EXACT = (2 * np.pi * 8.0 * 0.008) ** 4 / 120  # what RK4 gets wrong at the highest line in the longest step


@pytest.fixture(scope="module")
def diagram():
    return load(OSCILLATOR)


@pytest.fixture(scope="module")
def noisy(diagram):
    runs = [measured(f"run{k}", k, even(1200), 0.02, use) for k, use in enumerate(["identify", "identify", "hold_out"])]
    return identify(diagram, recording(*runs))


def near_truth(found, rel: float) -> None:
    for name, truth in TRUTH.items():
        assert found.parameters[name].value == pytest.approx(truth, rel=rel), name


# --- parameters -------------------------------------------------------------------------------------------------------


def test_parameters_come_back_with_their_scores(noisy):
    for name, truth in TRUTH.items():
        item = noisy.parameters[name]
        assert abs(item.value - truth) < 4 * item.std
        assert item.interval90[0] < item.value < item.interval90[1]
        assert item.joint90[0] < item.interval90[0]
        assert item.verdict.identifiable
        assert item.std < 0.01 * truth
    assert noisy.adequate
    assert set(noisy.fit) == {"identify", "hold_out"}
    for scores in noisy.fit.values():
        assert scores["position.output"] == pytest.approx(0.02, rel=0.1)
    assert noisy.noise_floor["position.output"] == pytest.approx(0.02, rel=0.1)
    assert noisy.run_ids == ["run0", "run1"]
    assert noisy.correlation.shape == (3, 3)
    assert noisy.statement == "3 of 3 parameters are identified: inverse_mass.gain, damper.gain, spring.gain."


def test_the_file_has_the_keys_of_any_identification_that_make_sense(noisy, tmp_path):
    files = save_identification(noisy, tmp_path)
    data = json.loads(files[0].read_text())
    assert data == json.loads(json.dumps(identification_data(noisy)))
    assert list(data) == [
        "method",
        "diagram",
        "parameters",
        "correlation",
        "identifiable",
        "fit",
        "noise_floor",
        "adequate",
        "excess_variance",
        "next_experiment",
        "statement",
        "warnings",
        "runs",
        "settings",
        "provenance",
    ]
    assert data["method"] == "likelihood"
    assert load(files[1]).nodes["spring"].values["gain"] == pytest.approx(noisy.values["spring.gain"])


@pytest.mark.slow
def test_intervals_cover_the_truth_as_often_as_they_claim(diagram):
    """Of 60 machines with coloured noise and hum; by less than chance in 1000 cases (independent parameters)."""
    covered = []
    for seed in range(60):
        found = identify(diagram, recording(*(measured(f"run{k}", 7 * seed + k, even(1500), 0.02) for k in range(2))))
        ends = [(found.parameters[name].interval90, truth) for name, truth in TRUTH.items()]
        covered += [low <= truth <= high for (low, high), truth in ends]
    low, high = binom.ppf([5e-4, 1 - 5e-4], len(covered), 0.9)
    assert low <= sum(covered) <= high


@pytest.mark.slow
def test_a_start_at_which_output_error_is_lost_is_left_by_multiple_shooting(diagram):
    soft = {"type": "gain", "parameters": {"gain": 150.0}}
    far = load({**OSCILLATOR, "blocks": {**OSCILLATOR["blocks"], "spring": soft}})
    found = identify(far, recording(measured("run0", 3, even(1500), 0.01)))
    near_truth(found, 0.01)
    assert found.adequate


def test_an_interval_at_a_bound_has_one_side(diagram):
    document = copy.deepcopy(OSCILLATOR)
    document["identify"]["damper.gain"] = {"low": 2.2}
    document["identify"] = {name: document["identify"][name] for name in ("damper.gain", "spring.gain")}
    document["blocks"]["inverse_mass"]["parameters"]["gain"] = 1.0
    item = identify(load(document), recording(measured("run0", 1, even(1500), 0.02))).parameters["damper.gain"]
    assert item.at_bound
    assert item.value == 2.2
    assert item.interval90[0] == 2.2
    assert 2.2 < item.interval90[1] < 2.3
    assert "ended at its physical bound" in item.verdict.reason


def test_a_prior_counts_as_one_more_measured_value(diagram):
    document = copy.deepcopy(OSCILLATOR)
    document["blocks"]["offset"] = {"type": "gain", "parameters": {"gain": 3.0}}
    document["blocks"]["nothing"] = {"type": "constant", "parameters": {"value": 0.0}}
    document["blocks"]["force"]["parameters"]["signs"] = "+--+"
    document["wires"] += [["nothing.output", "offset.input"], ["offset.output", "force.input4"]]
    document["identify"]["offset.gain"] = {"prior": {"std": 0.25}}
    item = identify(load(document), recording(measured("run0", 1, even(900), 0.02))).parameters["offset.gain"]
    assert item.value == pytest.approx(3.0)
    assert item.std == pytest.approx(0.25)


def test_what_the_data_do_not_tell_is_said_with_the_experiment_that_would(diagram):
    """Nothing but the product of two gains in a row is known from behind both."""
    document = copy.deepcopy(OSCILLATOR)
    document["blocks"]["amplifier"] = {"type": "gain", "parameters": {"gain": 1.3}}
    document["wires"][0] = ["drive.output", "amplifier.input"]
    document["wires"].append(["amplifier.output", "force.input1"])
    document["blocks"]["inverse_mass"]["parameters"]["gain"] = 1.0
    document["blocks"]["sensor"] = {"type": "gain", "parameters": {"gain": 1.1}}
    document["wires"].append(["position.output", "sensor.input"])
    document["identify"] = {"amplifier.gain": {"low": 0}, "sensor.gain": {"low": 0}, "spring.gain": {"low": 0}}
    made = recording(measured("run0", 2, even(1500), 0.01))
    made = replace(made, channels={**made.channels, "q": replace(made.channels["q"], signal="sensor.output")})
    found = identify(load(document), made)
    assert set(found.open) == {"amplifier.gain", "sensor.gain"}
    assert not np.isfinite(found.parameters["sensor.gain"].std) or found.parameters["sensor.gain"].std > 1.0
    assert found.advice[0].change.startswith("a sensor of ")
    assert set(found.advice[0].solves) == {"amplifier.gain", "sensor.gain"}
    assert "Next experiment: a sensor of " in found.statement
    assert found.parameters["spring.gain"].verdict.identifiable


@pytest.mark.slow
def test_a_model_that_lacks_physics_is_said_not_to_explain_the_data(diagram):
    time = even(1500)
    u = pushes(time, 5)
    wrong = motion(time, np.abs(u), [0.0, 0.0])[:, 0]
    found = identify(diagram, recording(run_of("run0", time, {"u": u, "q": wrong})))
    assert not found.adequate
    assert found.statement.startswith("The model does not explain the data: the residual has ")


# --- ordinary data ----------------------------------------------------------------------------------------------------


def test_jitter_costs_nothing(diagram):
    rng = np.random.default_rng(0)
    time = (np.arange(900) + rng.uniform(-0.3, 0.3, 900)) / 200
    near_truth(identify(diagram, recording(measured("run0", 1, time))), EXACT)


def test_stamps_that_are_rounded_are_even(diagram):
    run = measured("run0", 1, np.arange(900) / 300)
    found = identify(diagram, recording(replace(run, time=np.round(run.time, 3))))
    near_truth(found, EXACT)
    assert found.warnings == ()


def test_outputs_that_are_missing_are_not_compared(diagram):
    run = measured("run0", 1, even(900))
    q = run.values["q"].copy()
    q[100:180] = np.nan
    found = identify(diagram, recording(replace(run, values={**run.values, "q": q})))
    near_truth(found, EXACT)
    assert [problem.what for problem in found.warnings] == [
        "not finite: 80 of 900 samples, first at 0.5 s",
        "80 of 900 samples of q are missing, and are not compared",
    ]


def test_rows_that_were_lost_are_bridged_where_the_input_is_smooth(diagram):
    run = measured("run0", 1, even(900))
    keep = np.ones(900, bool)
    keep[[50, 51, 200, 431, 700]] = False
    lost = replace(run, time=run.time[keep], values={c: values[keep] for c, values in run.values.items()})
    found = identify(diagram, recording(lost))
    near_truth(found, EXACT)
    assert found.run_ids == ["run0"]
    assert any("5 missing samples of u are filled in: good to " in problem.what for problem in found.warnings)


def test_a_run_is_cut_where_its_input_is_not_known(diagram):
    run = measured("run0", 1, even(900))
    u, q = (values.copy() for values in run.values.values())
    u[300:420] = np.nan
    found = identify(diagram, recording(replace(run, values={"u": u, "q": q})))
    near_truth(found, EXACT)
    assert found.run_ids[0] == "run0 from 0 s"
    said = [problem.what for problem in found.warnings]
    assert "120 of 900 samples are not used, for what drives the diagram is not known there" in said
    assert "is cut at 1 gap of what drives it, and begins anew behind each" in said


def test_runs_of_other_rates_and_outputs_of_other_rates(diagram):
    slow, fast = measured("slow", 1, np.arange(500) / 120), measured("fast", 2, np.arange(1500) / 350)
    sparse = np.full(1500, np.nan)
    sparse[::4] = fast.values["q"][::4]
    found = identify(diagram, recording(slow, replace(fast, values={**fast.values, "q": sparse})))
    near_truth(found, EXACT)


def test_a_channel_that_one_run_lacks(diagram):
    runs = []
    for k in range(2):
        run = measured(f"run{k}", k, even(700))
        v = motion(run.time, run.values["u"], np.random.default_rng(k + 1000).normal(size=2) * [0.05, 1.0])[:, 1]
        runs.append(replace(run, values={**run.values, "v": v}) if k else run)
    found = identify(diagram, recording(*runs, columns=("u", "q", "v")))
    near_truth(found, EXACT)
    assert [problem.what for problem in found.warnings] == ["v was not measured in this run, and is not compared"]
    assert set(found.fit["identify"]) == {"position.output", "velocity.output"}


def test_an_input_that_was_constant_is_said_in_set(diagram):
    time = even(700)
    free = run_of("free", time, {"q": motion(time, 0 * time, [0.1, 0.0])[:, 0]}, **{"drive.value": 0.0})
    near_truth(identify(diagram, recording(measured("run0", 1, time), free)), EXACT)


# --- what is refused --------------------------------------------------------------------------------------------------


def refused(diagram, made, **options) -> str:
    with pytest.raises(RotorsimError) as caught:
        identify(diagram, made, **options)
    return str(caught.value)


def test_what_belongs_to_a_turning_shaft_is_refused_all_at_once(diagram):
    made = recording(measured("run0", 1, even(300)))
    assert refused(diagram, made, method="regression", given=["force.output"], free=()) == (
        "error: oscillator: method 'regression' is of harmonics at steady speeds, and nothing turns so here\n\n"
        "hint: --method likelihood: in time it is output error\n"
        "error: oscillator: force.output cannot be taken as measured in time\n\n"
        "hint: put a block 'recorded' in the place of what makes it, and let the channel name that block\n"
        "error: oscillator: no free parameters\n\n"
        'hint: add "identify": {"block.parameter": {}, ...} to the diagram'
    )


def test_runs_that_say_nothing_are_refused_all_at_once(diagram):
    good = measured("good", 1, even(300))
    made = recording(
        run_of("still", even(300), {"q": good.values["q"]}), run_of("blind", even(300), {"u": good.values["u"]})
    )
    assert refused(diagram, made) == (
        "recording.json:9:5: error: run still: 'u', which drives the diagram, was not measured\n\n"
        'hint: if it was constant, say so: "set": {"drive.value": 0}\n'
        "recording.json:9:5: error: run blind: nothing was measured that the diagram could be compared with"
    )


@pytest.mark.slow
def test_a_parameter_that_nothing_measured_depends_on_is_not_identified():
    document = copy.deepcopy(OSCILLATOR)
    document["blocks"]["lamp"] = {"type": "gain", "parameters": {"gain": 2.0}}
    document["wires"].append(["position.output", "lamp.input"])
    document["identify"] = {"lamp.gain": {}}
    said = identify(load(document), recording(measured("run0", 1, even(300)))).parameters["lamp.gain"]
    assert said.std == np.inf
    assert not said.verdict.identifiable


# --- what turns -------------------------------------------------------------------------------------------------------


def test_whether_a_shaft_turns_is_decided_by_blocks_and_channels(diagram):
    made = recording(measured("run0", 1, even(300)))
    servo = load({**OSCILLATOR, "parameters": {"speed": 3.0}})
    assert is_in_time(servo, made)
    assert is_in_time(diagram, made)
    assert not is_in_time(load("jeffcott"), made)
    angle = replace(made.channels["q"], signal="clock.theta", unit="rad")
    assert not is_in_time(diagram, replace(made, channels={**made.channels, "theta": angle}))
    assert not is_in_time(diagram, replace(made, runs=(replace(made.runs[0], tacho=np.array([0.1, 0.2])),)))
    document = copy.deepcopy(OSCILLATOR)
    document["blocks"]["clock"] = {"type": "clock"}
    assert is_in_time(load(document), made)  # nothing listens to it


# --- simulated elsewhere ----------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.skipif(not SHARED.exists(), reason="the shared recordings are not here")
@pytest.mark.parametrize(
    ("case", "name"),
    [("kdev01_nothing", "servo_position"), ("kdev05_nothing", "suspension"), ("kdev09_nothing", "maglev")],
)
def test_parameters_of_machines_simulated_elsewhere_come_back(case, name):
    found = identify(
        load(SHARED / "diagrams" / f"{name}.json"),
        load_recording(SHARED / "development" / case),
        hold_out=load_recording(SHARED / "development_hold_out" / case),
    )
    truth = json.loads((SHARED / "development" / case / "truth.json").read_text())
    assert found.adequate
    assert found.open == ()
    for parameter, value in truth["parameters"].items():
        item = found.parameters[parameter]
        assert abs(item.value - value) < 4 * item.std
        assert item.value == pytest.approx(value, rel=0.01)
    achievable = truth["scores"]["true_model"]
    assert np.hypot(*found.fit["hold_out"].values()) / np.sqrt(2) < 1.01 * achievable["held_out_total"]


@pytest.mark.slow
@pytest.mark.skipif(not SHARED.exists(), reason="the shared recordings are not here")
def test_machines_simulated_elsewhere_that_lack_physics_are_not_explained():
    verdicts = {}
    for folder in sorted((SHARED / "development").iterdir()):
        truth = json.loads((folder / "truth.json").read_text())
        found = identify(load(SHARED / "diagrams" / f"{truth['diagram']}.json"), load_recording(folder))
        verdicts[folder.name] = found.adequate
    assert verdicts == {name: name.endswith("_nothing") for name in verdicts}
