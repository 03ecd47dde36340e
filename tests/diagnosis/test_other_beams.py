"""Beams that another program made on another mesh, with its own equations (shared recordings)."""

from pathlib import Path

import pytest

from rotorsim.diagnosis.diagnosis import diagnose
from rotorsim.model.load import load
from rotorsim.recordings.orders import load_any

SHARED = Path(__file__).parents[3] / "shared" / "recordings"


@pytest.mark.slow
@pytest.mark.skipif(not (SHARED / "concealed_fe_development").exists(), reason="the shared recordings are not here")
@pytest.mark.parametrize(
    ("case", "named"),
    [
        ("fe_dev01_nothing", []),
        ("fe_dev02_unbalance", [("unbalance_elsewhere", "rotor.force[4]")]),
        ("fe_dev03_crack", [("crack_location", "rotor.force[5]")]),
    ],
)
def test_what_is_missing_is_named_and_nothing_where_nothing_is(case, named):
    """FAULT: where meshes were wrong by what finer ones change, a mass of -1.6 g was named in a healthy machine.

    Finer meshes change 8 of the misfit of 2952 equations, and what differs between the two programs 100. A crack that
    has moved was called a second one.
    """
    measured, held = (load_any(SHARED / f"concealed_fe_development{which}" / case) for which in ("", "_hold_out"))
    found = diagnose(load("fe_rigid"), measured, hold_out=held, workers=2)
    assert [(effect.physics, str(effect.candidate.insertion.spot)) for effect in found.effects] == named
    assert found.verdict == ("missing_physics" if named else "consistent")
