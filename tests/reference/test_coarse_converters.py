"""A converter coarser than the noise, on data of the second program (benchmarks/concealed)."""

import pytest

from benchmarks.concealed.generator import make_case
from benchmarks.concealed.writing import write_case
from rotorsim.diagnose.diagnosis import diagnose
from rotorsim.diagnose.files import save_diagnosis
from rotorsim.diagram import load
from rotorsim.recordings import load_recording
from rotorsim.recordings.converter_steps import find_steps
from rotorsim.recordings.harmonics import harmonics_of

SEED = (77, 1)


def test_the_step_of_a_converter_is_read_off_the_recording(tmp_path):
    """It is named with its size, the repaired diagram explains the recording, and both are taken into account again."""
    case = make_case("case", "one", "jeffcott", SEED, 0, ("quantisation",))
    write_case(case, tmp_path, SEED)
    recording, hold_out = load_recording(tmp_path / "case"), load_recording(tmp_path / "hold_out" / "case")
    found = diagnose(load("jeffcott"), recording, hold_out=hold_out, workers=1, physics=["quantisation", "runout"])
    assert (found.verdict, [effect.physics for effect in found.effects]) == ("missing_physics", ["quantisation"])
    assert [str(spot) for spot, _ in found.places] == ["rotor.displacement"]
    assert found.before.goodness < 1e-4 < found.after.goodness
    size, std, unit = found.taken(found.effects[0])["interval"]
    assert unit == "m"
    assert size == pytest.approx(case.truth()["effect"]["lsb"], abs=4 * std)
    assert "Missing is quantisation at rotor.displacement (interval " in found.statement
    save_diagnosis(found, tmp_path / "out")
    again = diagnose(load(tmp_path / "out" / "diagram.json"), recording, workers=1, physics=["quantisation", "runout"])
    assert (again.verdict, again.effects) == ("consistent", ())


def test_usual_converters_are_not_named(tmp_path):
    write_case(make_case("case", "nothing", "jeffcott", SEED, 1), tmp_path, SEED)
    recording = load_recording(tmp_path / "case")
    assert find_steps(recording, harmonics_of(recording)) == {}
