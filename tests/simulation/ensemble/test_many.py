"""Ensembles as users ask for them: values, workers, stores, files, refusals."""

from __future__ import annotations

import csv
import json
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from rotorsim.errors import Problem, RotorsimError
from rotorsim.model.load import load
from rotorsim.simulation.ensemble.files import save_ensemble
from rotorsim.simulation.ensemble.many import simulate_many
from rotorsim.simulation.ensemble.result import Ensemble
from rotorsim.simulation.result import Result
from rotorsim.simulation.run import simulate
from tests.systems.shipped import document, load_document, variant

SIGNAL = "rotor.displacement"


@pytest.fixture(scope="module")
def few() -> Ensemble:
    parameters = {"speed": ["1200 rpm", "1500 rpm", "1800 rpm"], "controller.KP": [12200.0, -1e9, 13000.0]}
    kinds = ["peak", "rms", "harmonics=2", "poincare"]
    return simulate_many(load("jeffcott"), parameters, stop=0.3, reduce=kinds)


def test_values_in_si_and_of_one_run_for_all() -> None:
    found = simulate_many(load("jeffcott"), {"speed": ["1200 rpm", "1500 rpm"], "controller.KP": "13000 A/m"}, stop=0.1)
    assert found.parameters["speed"] == pytest.approx(np.array([1200, 1500]) * np.pi / 30)
    assert found.parameters["controller.KP"].tolist() == [13000.0, 13000.0]
    assert (found.units["speed"], found.units["controller.KP"], found.units[SIGNAL]) == ("rad/s", "A/m", "m")
    assert len(found) == 2


def test_without_parameters_it_is_one_run() -> None:
    assert len(simulate_many(load("jeffcott"), stop=0.1)) == 1


def test_how_they_ended(few: Ensemble) -> None:
    assert few.counts == {"finished": 2, "diverged": 1}
    assert few.finished.tolist() == [True, False, True]
    assert few.message[1].startswith("diverged at t = ")
    assert repr(few) == "Ensemble(jeffcott: 3 runs, 2 finished, 1 diverged; peak, rms, harmonics, poincare)"
    assert np.isnan(few["peak", SIGNAL][1]).all()
    assert few.provenance["varied"] == ["speed", "controller.KP"]


def test_what_was_not_kept_is_said(few: Ensemble) -> None:
    for key, said in {
        ("mean", SIGNAL): "error: mean: this was not kept of the runs",
        ("peak", "rotor.velocity"): "error: rotor.velocity: no peak of this signal was kept",
    }.items():
        with pytest.raises(RotorsimError) as error:
            few[key]
        assert str(error.value).splitlines()[0] == said


@pytest.mark.slow
def test_workers_give_the_same_and_a_store_resumes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rotorsim.simulation.ensemble.many.STEPS_OF_A_JOB", 1.0)
    monkeypatch.setattr("rotorsim.simulation.ensemble.many.STEPS_HERE", 0.0)
    diagram, store = load("jeffcott"), tmp_path / "runs.jsonl"
    options: dict[str, Any] = {"stop": 0.05, "reduce": ["peak", "poincare"]}
    parameters = {"speed": np.linspace(300.0, 600.0, 20)}
    here = simulate_many(diagram, parameters, workers=1, **options)
    told: list[float] = []
    there = simulate_many(diagram, parameters, workers=2, store=store, progress=told.append, **options)
    lines = store.read_text().splitlines()
    assert len(lines) == 3  # 8 runs a job
    assert told[-1] == 1.0
    store.write_text("\n".join(lines[:2]) + "\n")
    again = simulate_many(diagram, parameters, workers=1, store=store, **options)
    for other in (there, again):
        for kind in ("peak", "poincare"):
            assert np.array_equal(here[kind, SIGNAL], other[kind, SIGNAL], equal_nan=True)
        assert other.status.tolist() == here.status.tolist()
    assert len(store.read_text().splitlines()) == 3
    with pytest.raises(RotorsimError, match="this store belongs to another function or other settings"):
        simulate_many(diagram, parameters, workers=1, store=store, stop=0.06, reduce=["peak"])


def test_csv(few: Ensemble, tmp_path: Path) -> None:
    table = Ensemble(**{**vars(few), "values": {k: v for k, v in few.values.items() if k != "poincare"}})
    save_ensemble(table, tmp_path / "a.csv")
    rows = list(csv.reader((tmp_path / "a.csv").read_text().splitlines()))
    assert rows[0][:5] == [
        "speed [rad/s]",
        "controller.KP [A/m]",
        "status",
        "peak rotor.displacement[1] [m]",
        "peak rotor.displacement[2] [m]",
    ]
    assert "1X phase controller.current[2] [deg]" in rows[0]
    assert float(rows[1][3]) == few["peak", SIGNAL][0, 0]
    assert rows[2][2:4] == ["diverged", "nan"]
    with pytest.raises(RotorsimError) as error:
        save_ensemble(few, tmp_path / "b.csv")
    assert "poincare: many numbers for each entry and run have no place in a table" in str(error.value)
    assert not (tmp_path / "b.csv").exists()


@pytest.mark.parametrize("suffix", [".h5", ".npz"])
def test_everything_in_a_file(few: Ensemble, tmp_path: Path, suffix: str) -> None:
    file = tmp_path / f"a{suffix}"
    save_ensemble(few, file)
    if suffix == ".h5":
        with h5py.File(file) as kept:
            points, status = kept["values/poincare/rotor.displacement"][()], kept["status"].asstr()[()].tolist()
            assert kept["values/peak/rotor.displacement"].attrs["unit"] == "m"
            meta = json.loads(kept.attrs["meta"])
    else:
        with np.load(file) as archive:
            points, status = archive["values/poincare/rotor.displacement"], archive["status"].tolist()
            meta = json.loads(str(archive["meta"]))
    assert np.array_equal(points, few["poincare", SIGNAL], equal_nan=True)
    assert status == ["finished", "diverged", "finished"]
    assert meta["provenance"]["diagram"] == "jeffcott"


def test_it_travels_between_processes(few: Ensemble) -> None:
    again = pickle.loads(pickle.dumps(few))
    assert np.array_equal(again["rms", SIGNAL], few["rms", SIGNAL], equal_nan=True)


REFUSED: dict[str, tuple[dict[str, Any], dict[str, Any], str]] = {
    "unknown": ({"sped": [1.0]}, {}, "error: sped: no such parameter\n\nhint: did you mean 'speed'?"),
    "option": (
        {"clock.profile": ["ramp"]},
        {},
        "error: clock.profile: is an option: another value makes other equations, which are not those of one ensemble"
        "\n\nhint: one ensemble for each: load(..., set={'clock.profile': ...}), or --set clock.profile=...",
    ),
    "solver": (
        {"solver.step": [1e-4, 1e-5]},
        {},
        "error: solver.step: is the same for all runs of an ensemble\n\nhint: the arguments step, stop, method",
    ),
    "numbers": (
        {"speed": [1.0, 2.0, 3.0], "controller.KP": [1.0, 2.0]},
        {},
        "error: controller.KP: 2 values given, 3 expected\n\nhint: one for each run",
    ),
    "unit": ({"speed": ["5 kg"]}, {}, "error: speed: unit 'kg' does not fit 'rad/s'"),
    "bounds": ({"rotor.mass": [1.0, -1.0]}, {}, "error: rotor.mass: -1 kg must be greater than 0 kg"),
    "window": (
        {},
        {"window": (0.5, 2.0), "stop": 1.0},
        "error: window: 0.5 s to 2 s is no part of runs of 1 s\n\nhint: for example 0.5 to 1",
    ),
    "short window": (
        {},
        {"window": (0.5, 0.5005), "stop": 1.0},
        "error: window: 0.5 s to 0.5005 s holds 6 rows; at least 8\n\nhint: a longer one, or more recorded rows",
    ),
    "turns and stop": (
        {},
        {"turns": 3, "stop": 1.0},
        "error: turns: stop and turns exclude each other\n\nhint: give one of them",
    ),
    "at rest": ({"speed": [100.0, 0.0]}, {"turns": 3}, "error: turns: run 2 does not turn\n\nhint: use stop"),
    "initial": ({}, {"initial": np.zeros(3)}, "error: initial: has shape (3,); (6,) or (runs, 6) expected"),
    "angle": (
        {},
        {"reduce": ["poincare"], "angle": "rotor.displacement"},
        "error: angle: 'rotor.displacement' is no single angle\n\nhint: a scalar signal in rad",
    ),
    "memory": (
        {"speed": np.linspace(100.0, 200.0, 5000)},
        {"reduce": ["history"]},
        "error: reduce: the history of 5000 runs would take 5 GB, at most 1 GB\n\n"
        "hint: a shorter window, a larger record_every, fewer signals or runs",
    ),
    "two axes": (
        {},
        {"reduce": ["radius"], "record": ["clock.theta"]},
        "error: reduce: radius: no recorded signal has two axes\n\nhint: a signal whose last dimension is [x, y]",
    ),
    "envelope": (
        {},
        {"reduce": ["envelope"], "stop": 0.01},
        "error: reduce: envelope: 200 parts of runs of 101 recorded rows: some would hold none\n\nhint: envelope=101",
    ),
    "nothing": ({}, {"reduce": []}, "error: reduce: nothing is kept of the runs\n\nhint: one of peak, "),
    "twice": ({}, {"reduce": ["peak", "peak"]}, "error: reduce: 'peak' is named twice\n\nhint: name it once"),
    "no values": ({"speed": []}, {}, "error: speed: 0 values given, some expected\n\nhint: one for each run"),
    "no states": ({}, {"initial": np.zeros((0, 6))}, "error: initial: 0 values given, some expected"),
    "three dimensions": (
        {},
        {"initial": np.zeros((2, 3, 6))},
        "error: initial: has shape (2, 3, 6); (6,) or (runs, 6)",
    ),
    "words": ({}, {"initial": ["a"] * 6}, "error: initial: holds what is no finite number"),
    "window of three": (
        {},
        {"window": (0, 1, 2)},
        "error: window: (0, 1, 2): is no pair of numbers\n\nhint: (from, to)",
    ),
    "window of nothing": ({}, {"window": (0, None)}, "error: window: (0, None): is no pair of numbers"),
    "angle of no use": ({}, {"angle": "bogus"}, "error: bogus: no such signal"),
    "speed as angle": (
        {},
        {"reduce": ["poincare"], "angle": "clock.speed"},
        "error: angle: 'clock.speed' is no single angle\n\nhint: a scalar signal in rad",
    ),
    "signal": ({}, {"record": ["rotor.displacment"]}, "error: rotor.displacment: no such signal"),
    "workers": ({}, {"workers": 0}, "error: workers: 0 workers: at least one is needed"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_wrong_is_refused(case: str) -> None:
    parameters, options, said = REFUSED[case]
    with pytest.raises(RotorsimError) as error:
        simulate_many(load("jeffcott"), parameters, **options)
    assert str(error.value).startswith(said)


def test_turns_of_a_run_up_are_refused() -> None:
    with pytest.raises(RotorsimError) as error:
        simulate_many(load("jeffcott_runup"), turns=5)
    assert "turns: the speed is not constant: turns differ in length" in str(error.value)


def test_all_mistakes_at_once() -> None:
    with pytest.raises(RotorsimError) as error:
        simulate_many(load("jeffcott"), {"sped": [1.0], "clock.profile": ["ramp"], "rotor.mass": ["heavy"]})
    assert [problem.subject for problem in error.value.problems] == ["sped", "clock.profile", "rotor.mass"]


def test_no_shaft() -> None:
    with pytest.raises(RotorsimError) as error:
        simulate_many(load("rlc"), reduce=["harmonics"])
    assert str(error.value) == (
        "error: harmonics: needs the angle of a shaft; no single clock gives one\n\n"
        "hint: angle='clock.theta', a signal in rad"
    )


def test_names_and_values_that_are_no_mapping() -> None:
    with pytest.raises(RotorsimError, match="parameters: is no mapping of names to values"):
        simulate_many(load("jeffcott"), ["speed"])  # type: ignore[arg-type]


def test_a_parameter_that_nothing_follows() -> None:
    content = document("jeffcott") | {"parameters": document("jeffcott")["parameters"] | {"free": "3 kg"}}
    with pytest.raises(RotorsimError) as error:
        simulate_many(load_document(content), {"free": [1.0, 2.0]})
    assert str(error.value) == (
        "error: free: nothing in the diagram follows it: all runs would be the same\n\n"
        "hint: refer to it in a block: '$free'"
    )


def test_turns_of_a_speed_that_changes_late() -> None:
    clock = {"profile": "table", "times": [0.0, 4.0, 5.0], "speeds": [100.0, 100.0, 300.0]}
    diagram = variant("jeffcott", {"clock": {"type": "clock", "parameters": clock}})
    with pytest.raises(RotorsimError, match="turns: the speed is not constant"):
        simulate_many(diagram, turns=200)
    assert simulate_many(diagram, turns=50, step=1e-3).counts == {"finished": 1}  # it ends before


@pytest.mark.parametrize("use_compiler", [True, False])
def test_a_shaft_that_turns_back(use_compiler: bool) -> None:
    """From 200 to -200 rad/s in 2 s, 200 rad to and fro: 31 whole turns are passed, and the same ones again."""
    clock = {"profile": "table", "times": [0.0, 2.0], "speeds": [200.0, -200.0]}
    diagram = variant("jeffcott", {"clock": {"type": "clock", "parameters": clock}})
    options: dict[str, Any] = {"reduce": ["poincare"], "window": (0.001, 2.0), "use_compiler": use_compiler}
    found = simulate_many(diagram, stop=2.0, step=1e-3, **options)
    points = found["poincare", "clock.theta"][0] / (2 * np.pi)
    points = points[np.isfinite(points)]
    whole = int(100.0 / (2 * np.pi))
    assert points == pytest.approx([*range(1, whole + 1), *range(whole, 0, -1)], abs=1e-4)


def test_a_run_that_turns_too_fast_between_has_no_points_and_says_so() -> None:
    clock = {
        "profile": "table",
        "times": [0.0, 0.5003, 0.5006, 0.5009, 1.0],
        "speeds": [50.0, 50.0, 15000.0, 50.0, 50.0],
    }
    diagram = variant("jeffcott", {"clock": {"type": "clock", "parameters": clock}})
    found = simulate_many(diagram, stop=1.0, reduce=["poincare"], window=(0.1, 1.0))
    assert np.isnan(found["poincare", SIGNAL]).all()
    assert found.message == (
        "a turn of the shaft has fewer than 8 recorded rows somewhere: no Poincare points are kept",
    )


def test_an_angle_that_is_a_state() -> None:
    content = document("jeffcott")
    content["blocks"]["turned"] = {"type": "integrator"}
    content["wires"].append(["clock.speed", "turned.input"])
    with pytest.raises(RotorsimError, match=r"angle: 'turned\.output' "):
        simulate_many(load_document(content), reduce=["poincare"], angle="turned.output")


def test_ctrl_c_ends_the_ensemble(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A run that was interrupted never gets into a store."""
    stopped = simulate(load("jeffcott"), stop=0.05)
    stopped = Result(stopped.time, stopped.signals, stopped.units, "stopped", "interrupted at t = 0.02 s")
    monkeypatch.setattr("rotorsim.simulation.ensemble.batch.simulate", lambda *a, **o: stopped)
    store = tmp_path / "runs.jsonl"
    with pytest.raises(KeyboardInterrupt):
        simulate_many(load("jeffcott"), method="rk45", stop=0.05, store=store, workers=1)
    assert store.read_text() == ""


def test_a_run_that_is_refused_stops_no_other(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a second look at one run cannot have, such as room, is said of that run; of all runs it is an error."""
    parameters = {"controller.KP": [12200.0, -1e9, 13000.0]}

    def refusing(*given: Any, **options: Any) -> Result:
        raise RotorsimError(Problem("the recorded signals would take 2 GB", "record", hint="fewer signals"))

    monkeypatch.setattr("rotorsim.simulation.ensemble.batch.simulate", refusing)
    found = simulate_many(load("jeffcott"), parameters, stop=0.2)
    assert found.status.tolist() == ["finished", "stopped", "finished"]
    assert found.message[1].startswith("record: the recorded signals would take 2 GB")
    assert np.isnan(found["peak", SIGNAL][1]).all()
    assert np.isfinite(found["peak", SIGNAL][[0, 2]]).all()
    with pytest.raises(RotorsimError, match="the recorded signals would take 2 GB"):
        simulate_many(load("jeffcott"), {"controller.KP": [-1e9]}, stop=0.2)


@pytest.mark.slow
def test_a_store_is_not_resumed_with_other_code(tmp_path: Path) -> None:
    """A block of the user, a file that the document only names, has changed between two calls."""
    (tmp_path / "mine").mkdir()
    block = """from rotorsim.block import Block, Equations, In, Out


class Scaled(Block):
    \"\"\"Scale a number.

    y = FACTOR u
    \"\"\"

    u = In()
    y = Out()

    def equations(self, p, u, x, t):
        return Equations(outputs={"y": FACTOR * u.u})
"""
    content = {
        "schema_version": 1,
        "name": "scaled",
        "block_folders": ["mine"],
        "blocks": {"source": {"type": "constant", "parameters": {"value": 1.0}}, "scaled": {"type": "scaled"}},
        "wires": [["source.output", "scaled.u"]],
        "solver": {"step": 0.01, "stop": 1.0},
        "record": ["scaled.y"],
    }
    (tmp_path / "scaled.json").write_text(json.dumps(content))
    command = [
        sys.executable,
        "-m",
        "rotorsim",
        "sweep",
        "scaled.json",
        "--trust-blocks",
        "--vary",
        "source.value=1, 2",
    ]
    command += ["--store", "runs.jsonl", "--workers", "1"]
    ended = []
    for factor in ("2.0", "30.0", "2.0"):
        (tmp_path / "mine" / "scaled.py").write_text(block.replace("FACTOR", factor))
        ended.append(subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False))
    assert [one.returncode for one in ended] == [0, 2, 0], [one.stderr for one in ended]
    assert "this store belongs to another function or other settings" in ended[1].stderr
    assert ended[0].stdout == ended[2].stdout


def test_an_output_that_is_no_number() -> None:
    """sqrt of a sine below zero, which drives no state."""
    content = {
        "name": "root",
        "blocks": {
            "clock": {"type": "clock", "parameters": {"speed": 10.0}},
            "sine": {"type": "trigonometric"},
            "root": {"type": "math_function", "parameters": {"function": "sqrt"}},
        },
        "wires": [["clock.theta", "sine.input"], ["sine.output", "root.input"]],
        "solver": {"step": 0.01, "stop": 2.0},
        "record": ["root.output"],
    }
    found = simulate_many(load_document(content), {"clock.speed": [10.0, 11.0, 1.0]})
    assert found.status.tolist() == ["diverged", "diverged", "finished"]
    assert found.message[0] == "'root.output' is not a finite number in 93 of 201 rows, first at t = 0.32 s"
    alone = simulate(load_document(content))
    assert (alone.status, alone.message) == (found.status[0], found.message[0])
    assert np.isnan(found["peak", "root.output"]).tolist() == [True, True, False]
