"""Diagnoses before and after a change, beside each other; and compacted."""

import copy
import json
from typing import Any

import pytest

from benchmarks.concealed.__main__ import main
from benchmarks.concealed.scores.compact import compact, read_diagnoses

DIAGNOSIS: dict[str, Any] = {
    "verdict": "missing_physics",
    "where": [{"block": "rotor", "port": "displacement", "node": 4, "axis": None, "probability": 0.93}],
    "missing": [
        {
            "physics": "rub",
            "class": ["rub", "clearance"],
            "probability": 0.9,
            "parameters": {"gap": {"value": 1e-5, "std": 1e-6, "interval90": [8e-6, 1.2e-5], "unit": "m"}},
        }
    ],
    "rejected": [{"physics": "runout", "why": "explains the data less well"}],
    "parameters": {
        "before": {},
        "after": {"crack_phase": {"value": 1e-9, "std": 0.1, "interval90": [-0.16, 0.16], "unit": "rad"}},
    },
    "fit": {"before": {"hold_out": 0.2}, "after": {"hold_out": 0.0123456789012}, "noise_floor": 0.012},
    "statement": "A rub.",
    "counts": {"fits": 7},
}


def _changed(*path: Any, to: Any) -> dict[str, Any]:
    changed = copy.deepcopy(DIAGNOSIS)
    holder: Any = changed
    for key in path[:-1]:
        holder = holder[key]
    holder[path[-1]] = to
    return changed


def _write(folder: Any, **cases: Any) -> str:
    for case, data in cases.items():
        (folder / case).mkdir(parents=True)
        (folder / case / "diagnosis.json").write_text(data if isinstance(data, str) else json.dumps(data))
    return str(folder)


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("statement",), "Something rubs."),
        (("counts", "fits"), 9),
        (("rejected", 0, "why"), "lies"),
        (("fit", "after", "hold_out"), 0.0123456799),  # 8e-8
        (("where", 0, "probability"), 0.9300005),
        (("parameters", "after", "crack_phase", "value"), 2e-9),  # of a standard deviation of 0.1
        (("missing", 0, "class"), ["clearance", "rub"]),
    ],
)
def test_prose_and_rounding_are_no_difference(tmp_path, path, value):
    before, after = _write(tmp_path / "a", x=DIAGNOSIS), _write(tmp_path / "b", x=_changed(*path, to=value))
    assert main(["compare", before, after]) == 0


@pytest.mark.parametrize(
    ("path", "value", "line"),
    [
        (("verdict",), "consistent", "x: verdict: missing_physics -> consistent"),
        (("missing", 0, "class"), ["rub"], "x: names: rub (clearance) -> rub"),
        (("where", 0, "node"), 3, "x: places: rotor.displacement.4 -> rotor.displacement.3"),
        (("where", 0, "probability"), 0.92, "x: probability of rotor.displacement.4: 0.93 -> 0.92  (0.01)"),
        (("missing", 0, "parameters", "gap", "value"), 1.1e-5, "x: rub, gap, value: 1e-05 -> 1.1e-05  (0.091)"),
        (("fit", "before", "hold_out"), 0.3, "x: fit, before, hold_out: 0.2 -> 0.3  (0.33)"),
        (("fit", "before", "hold_out"), None, "x: fit, before, hold_out: 0.2 -> -"),
        (("rejected",), [], "x: rejected: runout -> "),
    ],
)
def test_a_difference_is_listed_with_both_values(tmp_path, capsys, path, value, line):
    before, after = _write(tmp_path / "a", x=DIAGNOSIS), _write(tmp_path / "b", x=_changed(*path, to=value))
    assert main(["compare", before, after]) == 1
    assert line in capsys.readouterr().out.splitlines()


def test_cases_that_one_side_lacks_or_cannot_be_read_are_differences(tmp_path, capsys):
    before, after = _write(tmp_path / "a", x=DIAGNOSIS, y=DIAGNOSIS), _write(tmp_path / "b", x=DIAGNOSIS)
    assert main(["compare", before, after]) == 1
    assert f"not in {after}: y" in capsys.readouterr().out
    assert main(["compare", before, after, "--common", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert (result["same"], result["cases"][0]["largest"]) == (True, 0.0)
    _write(tmp_path / "b", y='{"verdict"')
    assert main(["compare", before, after]) == 1
    assert "y: file: - -> unreadable" in capsys.readouterr().out
    assert main(["compare", before, str(tmp_path / "c")]) == 2


def test_a_compacted_diagnosis_is_the_same_to_compare_and_to_score(tmp_path, capsys):
    full = _write(tmp_path / "a", x=DIAGNOSIS)
    assert main(["compact", full, str(tmp_path / "b" / "diagnoses.jsonl")]) == 0
    assert main(["compare", full, str(tmp_path / "b")]) == 0
    [line] = (tmp_path / "b" / "diagnoses.jsonl").read_text().splitlines()
    assert len(line) < 700
    (tmp_path / "set" / "truth").mkdir(parents=True)
    truth = {
        "case": "x",
        "kind": "one",
        "machine": "jeffcott",
        "missing": ["rub"],
        "effect": {"gap": 1e-5},
        "class": {"rub": ["rub"]},
        "nodes": {},
        "blocks": {},
        "parameters": {"crack_phase": 0.0},
    }
    (tmp_path / "set" / "truth" / "x.json").write_text(json.dumps(truth))
    capsys.readouterr()
    pages = []
    for folder in (full, str(tmp_path / "b")):
        assert main(["score", str(tmp_path / "set"), folder]) == 0
        pages.append(capsys.readouterr().out)
    assert pages[0] == pages[1]
    assert "| effects named exactly | 1/1 = 100 %" in pages[0]
    found = read_diagnoses(tmp_path / "b")["x"]
    assert found is not None
    assert compact(found) == {key: value for key, value in found.items() if key != "case"}


def test_times_are_scored_and_not_compared_and_what_ran_out_of_time_is_not_named(tmp_path, capsys):
    """FAULT: folders of the same diagnoses differed by the seconds that they took."""
    full = _write(tmp_path / "a", x=DIAGNOSIS)
    _write(tmp_path / "b", x=DIAGNOSIS)
    lines = ({"case": "x", "exit": 1, "cpu_s": 17.2}, {"case": "y", "exit": -9, "cpu_s": 60.0})
    (tmp_path / "a" / "times.jsonl").write_text("".join(f"{json.dumps(line)}\n" for line in lines))
    assert main(["compare", full, str(tmp_path / "b"), "--common"]) == 0
    found = read_diagnoses(tmp_path / "a")
    assert (found["x"]["cpu_s"], found["y"]) == (17.2, {"verdict": "stopped", "cpu_s": 60.0})
    assert main(["compact", full, str(tmp_path / "c" / "diagnoses.jsonl")]) == 0
    assert {case: data["cpu_s"] for case, data in read_diagnoses(tmp_path / "c").items()} == {"x": 17.2, "y": 60.0}
    truth = {"kind": "one", "machine": "jeffcott", "missing": ["rub"], "effect": {}, "nodes": {}, "parameters": {}}
    (tmp_path / "set" / "truth").mkdir(parents=True)
    for case in "xy":
        (tmp_path / "set" / "truth" / f"{case}.json").write_text(json.dumps(truth | {"case": case}))
    capsys.readouterr()
    assert main(["score", str(tmp_path / "set"), full]) == 0
    page = capsys.readouterr().out
    assert "1 of 2 cases diagnosed." in page
    assert "| effects named, with credit for the class | 1/2 = 50 %" in page
    assert "| CPU seconds a case, one | median 38.6, 90 % below 60 (2) |" in page
