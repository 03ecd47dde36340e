"""A converter coarser than the noise, on data of the second program (benchmarks/concealed)."""

import pytest

from benchmarks.concealed.generator import make_case
from benchmarks.concealed.writing import write_case
from rotorsim.diagnosis.diagnosis import diagnose
from rotorsim.diagnosis.files import save_diagnosis
from rotorsim.identification.identification import identify
from rotorsim.model.load import load
from rotorsim.recordings.loading import load_recording
from rotorsim.signals.converters import before_converters, stated_steps
from rotorsim.signals.harmonics import harmonics_of
from rotorsim.signals.quantisation import find_steps

SEED = (77, 1)


@pytest.mark.slow
def test_the_step_of_a_converter_is_read_off_the_recording(tmp_path):
    """It is named with its size, the repaired diagram explains the recording, and both are taken into account again."""
    case = make_case("case", "one", "jeffcott", SEED, 0, ("quantisation",))
    write_case(case, tmp_path, SEED)
    recording, hold_out = load_recording(tmp_path / "case"), load_recording(tmp_path / "hold_out" / "case")
    found = diagnose(load("jeffcott"), recording, hold_out=hold_out, workers=1, physics=["quantisation", "runout"])
    assert (found.verdict, [effect.physics for effect in found.effects]) == ("missing_physics", ["quantisation"])
    assert [str(spot) for spot in found.spots] == ["rotor.displacement"]
    assert found.before.goodness < 1e-4 < found.after.goodness
    size, std, unit = found.measured(found.effects[0])["interval"]
    assert unit == "m"
    assert size == pytest.approx(case.truth()["effect"]["lsb"], abs=4 * std)
    assert "Missing physics: quantisation at rotor.displacement (interval " in found.statement
    save_diagnosis(found, tmp_path / "out")
    again = diagnose(load(tmp_path / "out" / "diagram.json"), recording, workers=1, physics=["quantisation", "runout"])
    assert (again.verdict, again.effects) == ("consistent", ())


@pytest.mark.slow
def test_usual_converters_are_not_named(tmp_path):
    write_case(make_case("case", "nothing", "jeffcott", SEED, 1), tmp_path, SEED)
    recording = load_recording(tmp_path / "case")
    assert find_steps(recording, harmonics_of(recording)) == {}


def with_converter(document: dict, interval: str, **parameters: str) -> dict:
    """Return the diagram with a converter in front of the recording of its displacement."""
    block = {"type": "quantisation", "parameters": {"interval": interval, **parameters}}
    return {
        **document,
        "blocks": {**document["blocks"], "converter": block},
        "wires": [*document["wires"], ["rotor.displacement", "converter.displacement"]],
        "measured": {"rotor.displacement": "converter.sensed_displacement"},
    }


def test_a_stated_step_is_believed_only_where_readings_show_it(tmp_path):
    write_case(make_case("case", "nothing", "jeffcott", SEED, 1), tmp_path, SEED)
    recording = load_recording(tmp_path / "case")
    stated = load(with_converter(load("jeffcott").document, "1 um"))
    steps, problems = stated_steps(stated, recording)
    assert steps == {}
    what = "readings of rotor.displacement[{}] do not have the step of 1 um that is stated"
    hint = "hint: state the step of the converter that made this recording, or leave it out"
    assert [str(problem) for problem in problems] == [
        f"warning: converter.interval: {what.format(k)}\n\n{hint}" for k in (1, 2)
    ]


@pytest.mark.slow
def test_identification_takes_the_converter_of_a_diagram_out_of_readings(tmp_path):
    """With it noise explains what is left over; without, steps are taken for the motion."""
    case = make_case("case", "one", "jeffcott", SEED, 0, ("quantisation",))
    write_case(case, tmp_path, SEED)
    recording = load_recording(tmp_path / "case")
    document = load("jeffcott").document
    found = identify(load(with_converter(document, f"{case.truth()['effect']['lsb']!r} m")), recording, profile=False)
    plain = identify(load("jeffcott"), recording, profile=False)
    assert found.adequate
    assert not plain.adequate
    assert plain.excess > 2 * found.excess


def test_only_a_converter_that_steps_is_looked_through():
    document = load("jeffcott").document
    exact = load(with_converter(document, "1 um"))
    smooth = load(with_converter(document, "1 um", law="smooth"))
    assert before_converters(exact).as_measured("rotor.displacement[2]") == "rotor.displacement[2]"
    assert exact.as_measured("rotor.displacement[2]") == "converter.sensed_displacement[2]"
    assert before_converters(smooth) is smooth
