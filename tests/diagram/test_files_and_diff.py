"""Files are replaced as a whole; diff compares meaning."""

import stat
from pathlib import Path

import pytest

from rotorsim.diagram.diff import diff
from rotorsim.diagram.parse.fmt import format_document
from rotorsim.errors import RotorsimError
from rotorsim.files import write_atomically


def test_a_force_wired_twice_is_another_diagram() -> None:
    wire = ["a.force", "b.force"]
    changes = diff({"wires": [wire]}, {"wires": [wire, wire]})
    assert [str(change) for change in changes] == ["+ wires: a.force -> b.force"]
    assert diff({"wires": [wire, wire]}, {"wires": [wire, wire]}) == []


def test_a_default_written_out_is_no_change() -> None:
    assert diff({"solver": {"method": "rk4"}}, {"solver": {}, "algebraic_loops": "refuse"}) == []


def test_units_that_measure_other_things_are_a_change() -> None:
    a, b = ({"blocks": {"g": {"type": "none", "parameters": {"v": v}}}} for v in ("2 kg", "2 m"))
    assert len(diff(a, b)) == 1


def test_a_file_that_is_replaced_keeps_its_permissions(tmp_path: Path) -> None:
    path = tmp_path / "diagram.json"
    path.write_text("old")
    path.chmod(0o640)
    write_atomically(path, "new")
    assert path.read_text() == "new"
    assert stat.S_IMODE(path.stat().st_mode) == 0o640


def test_what_json_cannot_hold_is_refused() -> None:
    with pytest.raises(RotorsimError, match="cannot be written as JSON"):
        format_document({"name": float("nan")})


def test_both_values_of_a_change_are_shown_in_one_unit():
    old = {"parameters": {"speed": "1500 rpm", "e": "24 um", "mass": "3 kg", "k": 2.0}}
    new = {"parameters": {"speed": 188.49555921538757, "e": "0.03 mm", "mass": "3 m", "k": 3.0}}
    assert [str(change) for change in diff(old, new)] == [
        "~ parameters.speed: 1500 rpm -> 1800 rpm",
        "~ parameters.e: 24 um -> 30 um",
        "~ parameters.mass: 3 kg -> 3 m",
        "~ parameters.k: 2.0 -> 3.0",
    ]
    assert str(diff(new, old)[0]) == "~ parameters.speed: 1800 rpm -> 1500 rpm"
