"""Diagnosis of machines that do not turn, from runs that scipy computed and from the shared measurements."""

import json
from functools import cache
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from click.testing import CliRunner

from rotorsim.cli.app import rotorsim
from rotorsim.diagnosis.catalogue.finder import insertions
from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.diagnosis import Diagnosis, diagnose
from rotorsim.diagnosis.evidence.waveform.open import waveform_evidence
from rotorsim.diagnosis.files import diagnosis_data, diagnosis_schema, save_diagnosis
from rotorsim.errors import RotorsimError
from rotorsim.identification.waveform.recorded.data import channels_of
from rotorsim.identification.waveform.recorded.reading import read_runs
from rotorsim.identification.waveform.search import OutputErrorSearch
from rotorsim.identification.waveform.subsystems import subsystems_of
from rotorsim.model.load import load
from rotorsim.recordings.loading import load_recording
from rotorsim.recordings.recording import Recording
from rotorsim.simulation.run import simulate
from tests.diagnosis.evidence.waveform import machines
from tests.diagnosis.evidence.waveform.machines import OSCILLATOR, POSITIONER, carriage_recording, oscillator_recording

PHYSICS = ("cubic_stiffness", "coulomb_friction", "hysteretic_damping", "clearance")
KEYS = {  # of diagnosis.json
    "": {"verdict", "where", "missing", "rejected", "parameters", "fit", "next_experiment", "statement", "diagram"},
    "where": {"block", "port", "node", "axis", "probability", "class"},
    "missing": {"physics", "class", "probability", "parameters"},
    "fit": {"before", "after", "noise_floor"},
}
SHARED = Path(__file__).parents[5] / "shared" / "recordings"


def std_of(found: Diagnosis, name: str) -> float:
    names = [item.name for item in found.after.free]
    return float(np.sqrt(found.after.covariance[names.index(name), names.index(name)]))


@cache
def diagnosed(cubic: float, noise: float, *physics: str) -> Diagnosis:
    return diagnose(load(OSCILLATOR), oscillator_recording(cubic, noise), physics=physics or PHYSICS[:2], workers=1)


@pytest.mark.slow
@pytest.mark.parametrize("noise", [machines.NOISE, 0.0])
def test_a_linear_oscillator_lacks_nothing(noise):
    found = diagnosed(0.0, noise, *PHYSICS)
    assert found.verdict == "consistent"
    assert found.effects == ()
    for name, truth in (("mass", machines.MASS), ("damping", machines.DAMPING), ("stiffness", machines.STIFFNESS)):
        value, std = found.after.values[f"oscillator.{name}"], std_of(found, f"oscillator.{name}")
        assert abs(value - truth) < 4 * std
        assert std < 0.02 * truth
    assert found.score_before.total == pytest.approx(noise, rel=0.1, abs=1e-3)
    said = "Of oscillator.displacement 0.1 % of the rms counts as noise: smaller effects are not looked for."
    assert (said in found.statement) == (noise == 0.0)


@pytest.mark.parametrize(("noise", "physics"), [(machines.NOISE, ()), (machines.NOISE, PHYSICS), (0.0, PHYSICS)])
@pytest.mark.slow
def test_the_cubic_spring_of_a_duffing_oscillator_is_named_and_measured(noise, physics):
    found = diagnosed(machines.CUBIC, noise, *physics)
    assert found.verdict == "missing_physics"
    [effect] = found.effects
    assert effect.physics == "cubic_stiffness"
    assert dict(effect.members) == {"cubic_stiffness": 1.0}
    assert [(one.words, one.probability) for one in found.places] == [("oscillator.force", 1.0)]
    name = f"{effect.candidate.insertion.name}.stiffness"
    assert abs(found.after.values[name] - machines.CUBIC) < 4 * std_of(found, name)
    assert std_of(found, name) < 0.01 * machines.CUBIC
    assert found.score_before.total > 0.3
    assert found.score_after.total == pytest.approx(noise, rel=0.1, abs=1e-3)


@pytest.mark.slow
def test_the_repaired_diagram_moves_as_the_machine(tmp_path):
    found = diagnosed(machines.CUBIC, machines.NOISE)
    files = save_diagnosis(found, tmp_path)
    document = json.loads(files[1].read_text())
    document["blocks"]["drive"] = {"type": "constant", "parameters": {"value": 30.0}}
    document["record"] = ["oscillator.displacement"]
    rest = simulate(load(document), stop=20.0, step=1e-3)["oscillator.displacement"][-1]
    roots = np.roots([machines.CUBIC, 0.0, machines.STIFFNESS, -30.0])
    assert rest == pytest.approx(float(roots[np.abs(roots.imag) < 1e-9][0].real), rel=5e-3)


@pytest.mark.slow
def test_the_statement_gives_errors_in_the_units_of_the_signals():
    text = diagnosed(machines.CUBIC, machines.NOISE).statement
    assert "Missing physics: cubic_stiffness at oscillator.force (stiffness " in text
    assert "Error of the simulation there: oscillator.displacement " in text
    assert " mm rms, " in text
    assert "stands for" not in text


@pytest.mark.slow
def test_what_is_written_has_the_keys_of_any_diagnosis():
    data = diagnosis_data(diagnosed(machines.CUBIC, machines.NOISE))
    assert KEYS[""] <= set(data)
    assert KEYS["where"] == set(data["where"][0])
    assert KEYS["missing"] <= set(data["missing"][0])
    assert KEYS["fit"] <= set(data["fit"])
    assert 0 < data["fit"]["noise_floor"] < 2 * machines.NOISE
    assert data["fit"]["after"]["hold_out"] < data["fit"]["before"]["hold_out"] / 10
    [stiffness] = [item for name, item in data["missing"][0]["parameters"].items() if name == "stiffness"]
    assert set(stiffness) == {"value", "std", "interval90", "unit", "at_bound"}
    jsonschema.Draft202012Validator(diagnosis_schema()).validate(json.loads(json.dumps(data, allow_nan=False)))
    for when, adequate in (("before", False), ("after", True)):
        assert (data["fit"][when]["goodness"], data["fit"][when]["adequate"]) == (None, adequate)


@pytest.mark.slow
def test_units_of_an_electric_analogue_are_said_to_stand_for_those_of_a_machine():
    made = oscillator_recording(machines.CUBIC, units=("V", "V"))
    found = diagnose(load(OSCILLATOR), made, physics={"cubic_stiffness"}, workers=1)
    assert found.statement.endswith(
        "cubic_stiffness has the units of a machine: m stands for the V of oscillator.displacement and N stands for "
        "the V of drive.output."
    )


@pytest.mark.slow
def test_a_law_outside_the_catalogue_is_mapped_and_not_named():
    made = oscillator_recording(lambda q, v: 3.0 * abs(v) * v)
    found = diagnose(load(OSCILLATOR), made, physics={"cubic_stiffness", "clearance"}, workers=1)
    assert found.verdict == "outside_catalogue"
    assert [str(spot) for spot in found.spots] == ["oscillator.force"]
    assert list(found.unknown.data["map"]["terms"]) == ["drag"]
    assert found.unknown.data["map"]["terms"]["drag"] == pytest.approx(3.0, rel=0.02)
    assert found.score_after.total == pytest.approx(machines.NOISE, rel=0.1)
    assert "a map of displacement and velocity (drag) explains 99" in found.statement
    assert found.next_experiment.startswith(
        "runs with drive.output at 0.5 and at 2 times the amplitude, to see the law of the missing signal at drive"
    )


@pytest.mark.slow
def test_motion_that_no_model_follows_is_not_taken_for_noise():
    made = oscillator_recording(lambda q, v: 3e3 * np.sign(q) * max(abs(q) - 0.06, 0.0))  # its motion is chaotic
    found = diagnose(load(OSCILLATOR), made, physics={"cubic_stiffness", "coulomb_friction"}, workers=1)
    assert found.score_before.total > 0.5
    assert found.verdict != "consistent"


def test_physics_in_a_plane_is_not_put_where_motion_has_one_axis():
    items = insertions(load(OSCILLATOR), ["oscillator.displacement"])
    found = {item.physics for item in items if item.fault.enters != "signal"}
    assert {"cubic_stiffness", "coulomb_friction", "clearance", "mass_error"} <= found
    assert not found & {"seal_cross_coupling", "anisotropic_support", "base_excitation", "quantisation", "sensor_gain"}


@cache
def positioned(friction: float) -> Diagnosis:
    return diagnose(load(POSITIONER), carriage_recording(friction), physics=PHYSICS, workers=1)


@pytest.mark.slow
def test_dry_friction_is_named_at_the_carriage_and_the_controller_is_cleared():
    found = positioned(1.0)
    assert found.verdict == "missing_physics"
    [effect] = found.effects
    assert effect.physics == "coulomb_friction"
    assert [str(spot) for spot in found.spots] == ["carriage.force"]
    name = effect.candidate.insertion.name
    truth = {
        f"{name}.friction": machines.COULOMB,
        f"{name}.offset": machines.OFFSET,
        "carriage.mass": machines.CARRIAGE,
        "carriage.viscous_friction": machines.VISCOUS,
        "controller.position_gain": machines.POSITION_GAIN,
        "controller.velocity_gain": machines.VELOCITY_GAIN,
        "controller.velocity_lag": machines.LAG,
    }
    for key, value in truth.items():
        assert abs(found.after.values[key] - value) < 4 * std_of(found, key) + 1e-3 * abs(value), key
        assert std_of(found, key) < 0.05 * abs(value), key
    before, after = found.score_before.ports, found.score_after.ports
    assert before["carriage.displacement"] > 3 * after["carriage.displacement"]
    assert "controller.voltage follows from the measured motion by the law of controller to " in found.statement
    assert "stretches left out one by one" in found.statement


@pytest.mark.slow
def test_a_carriage_without_dry_friction_lacks_nothing():
    found = positioned(0.0)
    assert found.verdict == "consistent"
    assert found.after.values["carriage.viscous_friction"] == pytest.approx(machines.VISCOUS, rel=0.01)


def test_the_gains_of_a_controller_follow_from_its_own_law_whatever_moves():
    made = carriage_recording(1.0, noise=0.0)
    diagram = load(POSITIONER)
    channels = channels_of(diagram, made)
    runs = read_runs(diagram, made.runs[:1], channels)
    system = subsystems_of(diagram, channels)[1]
    search = OutputErrorSearch((system,), runs, {("controller", "controller.voltage"): 1.0}, least=4)
    unknowns = search.minimise(search.first()).unknowns[: search.m]
    names = [item.name for item in search.free]
    found = {name: float(value) for name, value in zip(names, unknowns, strict=True)}
    assert found["controller.position_gain"] == pytest.approx(machines.POSITION_GAIN, rel=2e-3)
    assert found["controller.velocity_gain"] == pytest.approx(machines.VELOCITY_GAIN, rel=2e-3)
    assert found["controller.velocity_lag"] == pytest.approx(machines.LAG, rel=2e-2)
    assert found["carriage.mass"] == pytest.approx(100.0, rel=1e-9)  # the controller says nothing of it


@pytest.mark.slow
def test_without_free_parameters_an_effect_is_found_all_the_same():
    right = {"mass": machines.MASS, "damping": machines.DAMPING, "stiffness": machines.STIFFNESS}
    document = values_in(OSCILLATOR, {f"oscillator.{key}": value for key, value in right.items()})
    found = diagnose(
        load({**document, "identify": {}}),
        oscillator_recording(machines.CUBIC),
        workers=1,
        physics={"cubic_stiffness", "clearance"},
    )
    assert [effect.physics for effect in found.effects] == ["cubic_stiffness"]


def refusal(document, recording) -> str:
    with pytest.raises(RotorsimError) as caught:
        diagnose(load(document), recording, workers=1)
    return str(caught.value)


def test_a_channel_that_the_diagram_does_not_have_is_refused():
    runs = [(machines.oscillator(1, 0.0, 100), "identify")]
    made = machines.recording(runs, {"u": ("drive.output", "N"), "y": ("oscilator.displacement", "m")}, machines.RATE)
    assert refusal(OSCILLATOR, made) == (
        "error: channel y: no such signal\n\nhint: did you mean 'oscillator.displacement'?"
    )


def test_a_recording_of_inputs_alone_is_refused():
    runs = [({"u": machines.oscillator(1, 0.0, 100)["u"]}, "identify")]
    made = machines.recording(runs, {"u": ("drive.output", "N")}, machines.RATE)
    assert refusal(OSCILLATOR, made) == (
        "error: made: nothing was measured that the diagram could be compared with\n\n"
        "hint: a channel must name a signal that the diagram computes"
    )


@pytest.mark.slow
def test_a_mode_too_fast_to_simulate_is_said_to_be():
    document = values_in({**OSCILLATOR, "identify": {}}, {"oscillator.mass": 1e-12})
    assert refusal(document, oscillator_recording(machines.CUBIC)) == (
        "error: oscillator: has modes too fast for 64 steps between samples\n\n"
        "hint: correct its stiffness or mass, or leave it out: a lag that is faster than the recording shows is a gain"
    )


def at_the_command_line(diagram: str, recording: Path, out: Path) -> tuple[int, dict]:
    given = ["diagnose", diagram, str(recording), "--out", str(out), "--workers", "1", "--json", "--no-progress"]
    given += ["--physics", "cubic_stiffness,coulomb_friction,clearance"]  # all of them: benchmarks.diagnosis.measured
    result = CliRunner().invoke(rotorsim, given)
    return result.exit_code, json.loads(result.stdout)


def write(made: Recording, folder: Path) -> None:
    """Write the form that the loader reads, by hand."""
    folder.mkdir()
    runs = []
    for run in made.runs:
        np.savez(folder / f"{run.id}.npz", **run.values)
        runs.append({"id": run.id, "file": f"{run.id}.npz", "sample_rate": f"{run.sample_rate} Hz", "use": run.use})
    channels = {c: {"signal": channel.signal, "unit": channel.unit} for c, channel in made.channels.items()}
    document = {"name": "parts", "source": "measured", "channels": channels, "runs": runs}
    (folder / "recording.json").write_text(json.dumps(document))


@pytest.mark.slow
@pytest.mark.skipif(not (SHARED / "silverbox").exists(), reason="the shared recordings are not here")
def test_silverbox(tmp_path):
    whole = load_recording(SHARED / "silverbox")
    parts = [({key: array[:8000] for key, array in run.values.items()}, run.use) for run in whole.runs]
    signals = {c: (channel.signal, channel.unit) for c, channel in whole.channels.items()}
    made = machines.recording(parts, signals, whole.runs[0].sample_rate)
    write(made, tmp_path / "parts")
    code, found = at_the_command_line("silverbox", tmp_path / "parts", tmp_path)
    assert code == 1
    assert found["verdict"] == "missing_physics"
    assert [item["physics"] for item in found["missing"]] == ["cubic_stiffness"]
    assert [(p["block"], p["port"]) for p in found["where"]] == [("oscillator", "force")]
    spread = parts[1][0]["y"].std()
    assert found["fit"]["before"]["hold_out"] * spread > 5e-3
    assert found["fit"]["after"]["hold_out"] * spread <= 0.35e-3


@pytest.mark.slow
@pytest.mark.skipif(not (SHARED / "emps").exists(), reason="the shared recordings are not here")
def test_emps(tmp_path):
    """Published: M = 95.1 kg, F_v = 203.5 N s/m, F_c = 20.4 N, offset -3.2 N (Janot, Gautier & Brunot 2019)."""
    whole = load_recording(SHARED / "emps")
    half = {key: array[:7000] for key, array in whole.runs[0].values.items()}
    rest = {key: array[7000:] for key, array in whole.runs[0].values.items()}
    signals = {c: (channel.signal, channel.unit) for c, channel in whole.channels.items()}
    made = machines.recording([(half, "identify"), (rest, "hold_out")], signals, 1000.0)
    write(made, tmp_path / "parts")
    code, found = at_the_command_line("emps", tmp_path / "parts", tmp_path)
    assert code == 1
    assert [item["physics"] for item in found["missing"]] == ["coulomb_friction"]
    assert [p["block"] for p in found["where"]] == ["carriage"]
    after = found["parameters"]["after"]
    published = {
        "carriage.mass": 95.1,
        "carriage.viscous_friction": 203.5,
        "coulomb_friction.friction": 20.4,
        "coulomb_friction.offset": -3.2,
    }
    for name, value in published.items():
        assert abs(after[name]["value"] - value) < 3 * after[name]["std"]
        assert after[name]["std"] < 0.12 * abs(value)
    ports = [found["fit"][key]["ports"]["carriage.displacement"] for key in ("before", "after")]
    assert ports[0] > 3 * ports[1]


def test_a_time_constant_that_goes_to_zero_is_no_noise():
    """FAULT: where steps were not refined there, the noise was taken for 13 times its variance, and hid faults."""
    random = np.random.default_rng(3)
    wanted = np.repeat(random.uniform(-1, 1, 50), 20)
    speed = np.zeros(len(wanted))
    for k, u in enumerate(wanted[:-1]):  # exact from sample to sample: the input is held
        speed[k + 1] = u / 2 + (speed[k] - u / 2) * np.exp(-2.0 * 0.01)
    values = {"u": wanted, "y": speed + 1e-3 * random.normal(size=len(speed))}
    made = machines.recording([(values, "identify")], {"u": ("drive.output", "1"), "y": ("speed.output", "1")}, 100.0)
    document = {
        "schema_version": 1,
        "name": "drive",
        "blocks": {
            "drive": {"type": "recorded", "parameters": {"interpolation": "hold"}},
            "amplifier": {"type": "lag", "parameters": {"time_constant": "20 ms"}},
            "sum": {"type": "sum", "parameters": {"signs": "+-"}},
            "speed": {"type": "integrator"},
            "damper": {"type": "gain", "parameters": {"gain": 2.0}},
        },
        "wires": [
            ["drive.output", "amplifier.input"],
            ["amplifier.output", "sum.input1"],
            ["damper.output", "sum.input2"],
            ["sum.output", "speed.input"],
            ["speed.output", "damper.input"],
        ],
        "solver": {"method": "rk4", "step": "1 ms", "stop": "1 s"},
        "record": ["speed.output"],
        "identify": {"amplifier.time_constant": {}, "damper.gain": {"low": 0.0}},
    }
    evidence = waveform_evidence(load(document), made)
    assert evidence.near["amplifier.time_constant"] < 1e-3  # the machine has none
    [variance] = evidence.variance.values()
    assert variance == pytest.approx(1e-6, rel=3 * np.sqrt(2 / len(speed)))
