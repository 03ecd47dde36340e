"""recording.json of kind "injection": read, refused with every mistake, written."""

import json
from importlib import resources

import jsonschema
import numpy as np
import pytest

from rotorsim.errors import RotorsimError
from rotorsim.recordings import injection
from rotorsim.recordings.injection import load_injection
from rotorsim.recordings.loading import load_recording
from tests.signals.injection.machine import write

TIME = np.arange(10) / 100.0
SIGNALS = {role: np.outer(TIME, [k + 1.0, k + 2.0]) for k, role in enumerate(("test", "before", "after"))}


@pytest.fixture
def folder(tmp_path):
    return write(tmp_path / "r", 100.0, {"x": SIGNALS})


def changed(folder, change):
    file = folder / "recording.json"
    document = json.loads(file.read_text())
    change(document)
    file.write_text(json.dumps(document, indent=1))
    return folder


def problems(folder):
    with pytest.raises(RotorsimError) as caught:
        load_injection(folder)
    return [(problem.subject, problem.what, problem.hint) for problem in caught.value.problems]


def test_loops_by_the_port_at_which_they_are_injected(folder):
    recording = load_injection(folder)
    assert recording.loops == {
        f"controller.displacement[{k}]": {role: f"{role} {axis}" for role in ("test", "before", "after")}
        for k, axis in ((1, "x"), (2, "y"))
    }
    np.testing.assert_allclose(recording.runs[0].values["after y"], 4.0 * TIME, rtol=1e-14)


def test_a_shaft_angle_may_be_recorded_too(folder):
    changed(folder, lambda d: d["channels"].update(theta={"signal": "clock.theta", "unit": "rad"}))
    columns = dict(np.load(folder / "x.npz"))
    np.savez(folder / "x.npz", theta=TIME, **columns)
    assert load_injection(folder).loops.keys() == {"controller.displacement[1]", "controller.displacement[2]"}


def test_every_mistake_at_once(folder):
    def spoil(document):
        channels = document["channels"]
        channels["test x"]["injection"] = "tset"
        del channels["before x"]["injection"]
        channels["after x"]["direction"] = "45 deg"
        channels["theta"] = {"signal": "clock.theta", "unit": "rad", "injection": "test"}

    assert problems(changed(folder, spoil)) == [
        ("channel test x", "injection 'tset' is not known", "did you mean 'test'?"),
        (
            "channel before x",
            "key 'injection' is missing",
            '"test": what is injected; "before" and "after": the signal that it is added to, and the sum',
        ),
        ("channel after x", "unknown key 'direction'", "did you mean 'injection'?"),
        ("channel theta", "nothing is injected into 'clock.theta'", ""),
    ]


def test_a_signal_needs_a_second_one_of_its_unit(folder):
    def spoil(document):
        for axis, role in (("x", "before"), ("x", "after")):
            del document["channels"][f"{role} {axis}"]
        document["channels"]["after y"]["unit"] = "A"

    assert problems(changed(folder, spoil)) == [
        (
            "channels",
            "only one channel at controller.displacement[1]",
            "two of 'test', 'before' and 'after' are needed; the third is their difference",
        ),
        ("channel after y", "'A' does not fit 'um' of 'test y', to which it is added", "give both in one unit"),
    ]


def test_other_kinds_are_told_apart(folder):
    with pytest.raises(RotorsimError) as caught:
        load_recording(folder)
    [problem] = caught.value.problems
    assert problem.what == "a test signal was injected into this machine"
    assert problem.hint == "'margins' and 'check' take such a recording"
    changed(folder, lambda document: document.pop("kind"))
    [(_, what, hint)] = problems(folder)
    assert what == "nothing says where a test signal was injected"
    assert hint == 'a recording of "kind": "injection" does; see docs/margins.md'


def test_the_schema_names_the_keys_that_are_read(folder):
    schema = json.loads((resources.files("rotorsim.recordings") / "injection.schema.json").read_text(encoding="utf-8"))
    jsonschema.Draft202012Validator.check_schema(schema)
    assert set(schema["properties"]) == set(injection.INJECTION_KEYS["recording"])
    assert set(schema["$defs"]["channel"]["properties"]) == set(injection.INJECTION_KEYS["channel"])
    assert set(schema["$defs"]["run"]["properties"]) == set(injection.INJECTION_KEYS["run"])
    jsonschema.Draft202012Validator(schema).validate(json.loads((folder / "recording.json").read_text()))
