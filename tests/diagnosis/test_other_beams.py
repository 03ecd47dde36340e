"""Beams that another program made on another mesh, with its own equations (shared recordings)."""

import json
from math import pi, remainder
from pathlib import Path

import pytest

from benchmarks.concealed import sets
from rotorsim.diagnosis.diagnosis import diagnose
from rotorsim.model.load import load
from rotorsim.recordings.orders import load_any

LINES = ("base_excitation", "speed_fluctuation", "torsion_coupling", "residual_bow")
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


def _hidden(folder, row, physics=LINES):
    """Return the numbers of an effect in a machine of seed 5, and its diagnosis by some laws, those of lines."""
    sets.make(sets.plan(folder, 1, 5, "one", "fe_flexible", (row,)), 1)
    [case] = [file.parent for file in folder.glob("*/recording.json")]
    truth = json.loads((folder / "truth" / f"{case.name}.json").read_text())["effect"]
    held = load_any(folder / "hold_out" / case.name)
    return truth, diagnose(load("fe_flexible"), load_any(case), hold_out=held, physics=physics, workers=2)


@pytest.mark.slow
def test_the_twist_of_a_disc_is_named_on_a_beam_and_measured(tmp_path):
    """FAULT: no swing of a beam was fitted: lines at 56 Hz were found, and called outside the catalogue."""
    truth, found = _hidden(tmp_path, "torsion_coupling")
    [effect] = found.effects
    assert set(effect.members) == {"speed_fluctuation", "torsion_coupling"}
    assert found.score_after.total < 1.05 * found.score_after.noise < found.score_before.total
    j = [item.name for item in found.after.free].index(f"{effect.physics}.amplitude")
    assert abs(found.after.theta[j] - truth["phi"]) < 4 * found.after.std(j)


@pytest.mark.slow
def test_ground_that_shakes_a_whole_beam_is_named_and_measured(tmp_path):
    """FAULT: the ground was told to shake one node of a beam, which explains little of what it does to all of them."""
    truth, found = _hidden(tmp_path, "base_excitation")
    [effect] = found.effects
    assert (effect.physics, effect.candidate.insertion.spot.node) == ("base_excitation", None)
    assert found.score_after.total < 1.05 * found.score_after.noise < found.score_before.total
    names, theta = [item.name for item in found.after.free], found.after.theta
    off = {
        "acceleration": lambda size: size - truth["acceleration"],
        "direction": lambda angle: remainder(angle - truth["direction"], pi),  # the opposite one is the same
    }
    for key, of in off.items():
        j = names.index(f"base_excitation.{key}")
        assert abs(of(theta[j])) < 4 * found.after.std(j)


@pytest.mark.slow
def test_a_mass_is_one_up_to_the_highest_mode_and_a_support_is_found_again(tmp_path):
    """FAULT: it fell short by 4 % at 640 Hz, and supports stayed rigid: hold-out runs disproved the right law."""
    truth, found = _hidden(tmp_path, "mass_error", ("mass_error", "support_stiffness", "sensor_gain"))
    [effect] = found.effects
    assert (effect.physics, found.proof.status) == ("mass_error", "proved")
    j = [item.name for item in found.after.free].index("mass_error.mass")
    assert abs(found.after.theta[j] - truth["dm"]) < 4 * found.after.std(j)
    assert found.score_after.total < 1.05 * found.score_after.noise
    stiff = [value for name, value in found.after.values.items() if name.startswith("support_")]
    assert max(stiff) < 1e10
