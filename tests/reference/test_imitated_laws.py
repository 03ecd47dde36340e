"""A law that imitates another in the fitted runs, on data of the second program (benchmarks/concealed)."""

import re

import pytest

from benchmarks.concealed.generator import make_case
from benchmarks.concealed.writing import write_case
from rotorsim.diagnosis.diagnosis import diagnose
from rotorsim.model.load import load
from rotorsim.recordings.loading import load_recording

SEED = (77, 0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "law", "verdict"),
    [("outside", "hertz_contact", "outside_catalogue"), ("one", "clearance", "missing_physics")],
)
def test_runs_that_took_no_part_tell_a_law_from_its_imitation(tmp_path, kind, law, verdict):
    """With a clearance both leave noise in the fitted runs; it predicts the others only where there is one."""
    write_case(make_case("case", kind, "jeffcott", SEED, 0, (law,)), tmp_path, SEED)
    found = diagnose(
        load("jeffcott"),
        load_recording(tmp_path / "case"),
        workers=1,
        physics=["clearance"],
        hold_out=load_recording(tmp_path / "hold_out" / "case"),
    )
    assert found.selection.explained
    assert found.verdict == verdict
    assert found.proof.status == ("proved" if verdict == "missing_physics" else "disproved")
    said = f"; hold-out runs disprove it: {found.proof.reason}." in found.statement
    assert said == (verdict == "outside_catalogue")
    if verdict == "missing_physics":
        assert found.score_after.total < 1.1 * found.score_after.noise
    else:
        left = re.search(r"residual variance ([\d.e+]+) times the noise", found.proof.reason)
        assert float(left[1]) > 10
