"""Plain steps of the masters, in Python and in C, against the general ones: the same numbers, ends and failures."""

from __future__ import annotations

import json
import os
import signal
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rotorsim.cosim.cosimulation import cosimulate, cosimulate_diagram
from rotorsim.cosim.cut import open_coupling
from rotorsim.cosim.fmu_participant import FmuParticipant
from rotorsim.cosim.inputs import Held
from rotorsim.cosim.loop import FastLoop
from rotorsim.cosim.masters.explicit import ExplicitMaster
from rotorsim.diagram.diagram import Diagram
from rotorsim.fmi.export.export import export_fmu
from rotorsim.fmi.runtime.process import RemoteWorker
from rotorsim.fmi.runtime.slave import open_fmu
from rotorsim.model.emit.toolchain import find_compiler
from rotorsim.model.load import load
from rotorsim.simulation.result import Result
from tests.fmi.plant import FAULTS, floats_only, make_fmu

pytestmark = pytest.mark.skipif(find_compiler() is None, reason="FMUs are built by a C compiler")
H, STOP = 1e-4, 6e-3


@pytest.fixture(scope="module")
def cut(tmp_path_factory: pytest.TempPathFactory) -> Diagram:
    """Return the cracked rotor with the rotor as an FMU; an output of the controller follows its inputs at once."""
    folder = tmp_path_factory.mktemp("fmus")
    diagram = load("jeffcott", set={"solver.step": 2e-5, "solver.stop": STOP})
    export_fmu(diagram, folder / "rotor.fmu", blocks=["rotor"])
    document = json.loads(json.dumps(diagram.document))
    document.pop("identify")
    document["blocks"]["rotor"] = {"type": "fmu", "file": "rotor.fmu", "parameters": {"in_process": True}}
    return load(document, folder=folder, trust_blocks=True)


@pytest.fixture
def loops(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Return a list that gets the number of steps of every loop in C."""
    taken: list[int] = []
    run = FastLoop.run

    def noted(self: FastLoop, t0: float, h: float, steps: int, **more: Any) -> np.ndarray:
        taken.append(steps)
        return run(self, t0, h, steps, **more)

    monkeypatch.setattr(FastLoop, "run", noted)
    return taken


def all_ways(diagram: Diagram, monkeypatch: pytest.MonkeyPatch, **settings: Any) -> list[Result]:
    """Return a run in C, one of plain steps in Python, and one of general steps."""
    found = [cosimulate_diagram(diagram, **settings)]
    with monkeypatch.context() as patched:
        patched.setattr(ExplicitMaster, "may_be_in_c", lambda *_: False)
        found.append(cosimulate_diagram(diagram, **settings))
        patched.setattr(ExplicitMaster, "is_plain", lambda _: False)
        found.append(cosimulate_diagram(diagram, **settings))
    return found


@pytest.mark.parametrize("master", ["jacobi", "gauss_seidel"])
def test_they_give_the_same(cut: Diagram, monkeypatch: pytest.MonkeyPatch, loops: list[int], master: str) -> None:
    """Also where inputs and outputs are made to agree after a step, and how far they were from it."""
    *plain, general = all_ways(cut, monkeypatch, step=H, master=master)
    assert loops == [60]
    for found in plain:
        assert (found.status, found.signals.keys()) == ("finished", general.signals.keys())
        assert dict(found.counters) == dict(general.counters)
        assert found.time == pytest.approx(general.time, rel=1e-14)
        for name, values in general.signals.items():
            assert np.abs(found[name] - values).max() <= 1e-12 * np.abs(values).max(), name
    assert general["coupling.error"][1:].max() > 1e-3


def test_what_is_no_plain_step_takes_the_general_ones(cut: Diagram, loops: list[int]) -> None:
    for settings in (
        {"order": 1},
        {"adaptive": 1e-2},
        {"master": "iterative"},
        {"rates": {"rotor": 2}},
        {"step": 7e-5},
    ):
        found = cosimulate_diagram(cut, **{"step": H, "stop": 2e-3, **settings})
        assert found.time[-1] == pytest.approx(2e-3), (settings, found.message)
    assert loops == []


def alone(folder: Path, fault: str, version: str, *, floats: bool = False, **more: Any) -> Diagram:
    make_fmu(folder / "plant.fmu", version, description=floats_only(version) if floats else "")
    options = {"fault": FAULTS.index(fault), "fault_time": 0.01, "in_process": True, **more}
    block = {"type": "fmu", "file": "plant.fmu", "parameters": options}
    document = {
        "blocks": {"it": block, "in": {"type": "constant"}},
        "wires": [],
        "solver": {"step": 1e-3, "stop": 0.02},
    }
    return load({**document, "record": ["it.y"]}, folder=folder, trust_blocks=True)


@pytest.mark.parametrize(
    ("version", "floats", "here", "fault"),
    [
        ("2.0", True, True, "discard"),
        ("2.0", True, False, "nan"),
        ("2.0", True, False, "segv"),
        ("2.0", False, False, "fail"),
        ("3.0", True, False, "terminate"),
        *(
            pytest.param(*each, marks=pytest.mark.slow)
            for each in (
                *(("2.0", floats, True, fault) for floats in (True, False) for fault in ("fail", "nan")),
                *(("2.0", floats, False, fault) for floats in (True, False) for fault in ("discard", "leave", "hang")),
                *(("3.0", True, here, fault) for here in (True, False) for fault in ("fatal", "terminate")),
            )
        ),
    ],
)
def test_failures_are_told_alike(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    loops: list[int],
    version: str,
    floats: bool,
    here: bool,
    fault: str,
) -> None:
    """In C here, in C there, and in C here beside Python there, where not all are Float64."""
    if fault == "hang":
        monkeypatch.setitem(open_fmu.__kwdefaults__, "timeout", 0.5)  # s
    diagram = alone(tmp_path, fault, version, floats=floats, in_process=here)
    fast, plain, general = all_ways(diagram, monkeypatch, step=1e-3)
    assert loops == ([20] if floats or not here else [])
    assert [found.status for found in (fast, plain, general)] == ["stopped"] * 3
    assert fast.message == plain.message == general.message
    for found in (fast, plain):
        assert found.time == pytest.approx(general.time)
        assert found["it.y"] == pytest.approx(general["it.y"], rel=1e-12)


def pair(folder: Path, **other: Any) -> Diagram:
    """Return two plants in processes of their own, each driven by the other."""
    make_fmu(folder / "plant.fmu", description=floats_only())
    block = {"type": "fmu", "file": "plant.fmu", "parameters": {}}
    document = {
        "blocks": {"a": block, "b": {**block, "parameters": other}},
        "wires": [["a.y", "b.u"], ["b.y", "a.u"]],
        "solver": {"step": 1e-3, "stop": 0.02},
    }
    return load({**document, "record": ["a.y", "b.y"]}, folder=folder, trust_blocks=True)


@pytest.mark.slow
@pytest.mark.parametrize("master", ["jacobi", "gauss_seidel"])
def test_two_processes_give_what_they_give_in_python(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, loops: list[int], master: str
) -> None:
    fast, *others = all_ways(pair(tmp_path), monkeypatch, step=1e-3, master=master)
    assert loops == [20]
    for found in others:
        for name in ("a.y", "b.y", "coupling.error"):
            assert fast[name] == pytest.approx(found[name], rel=1e-12, abs=1e-15), name


@pytest.mark.slow
def test_processes_that_outlast_every_look_are_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, loops: list[int]
) -> None:
    """As those do whose step takes milliseconds: the loop is left at any place, and taken up there again."""
    diagram = pair(tmp_path)
    masters = ("jacobi", "gauss_seidel")
    quick = {master: cosimulate_diagram(diagram, step=1e-3, master=master) for master in masters}
    for looks in (0, 1):
        monkeypatch.setattr("rotorsim.fmi.runtime.channel.LOOKS", looks)
        for master in masters:
            slow = cosimulate_diagram(diagram, step=1e-3, master=master)
            assert np.array_equal(slow["b.y"], quick[master]["b.y"])
            assert (slow.status, slow.counters["steps"]) == ("finished", 20)
    assert loops == [20] * 6


def test_the_other_process_can_be_asked_again_after_a_failure(tmp_path: Path, loops: list[int]) -> None:
    """Both were at work when one failed; its messages are asked for afterwards."""
    diagram = pair(tmp_path, fault=FAULTS.index("fail"), fault_time=0.01)
    found = cosimulate_diagram(diagram, step=1e-3, master="jacobi")
    assert loops == [20]
    assert (found.status, len(found.time)) == ("stopped", 11)
    assert found.message.startswith("b: fmi2DoStep returned fmi2Error (t = 0.01 s)")
    assert {found.provenance["fmus"][name]["warnings"] for name in "ab"} == {0}


def test_a_held_step_of_a_process_of_its_own_is_one_exchange(tmp_path: Path) -> None:
    """It was two: the inputs were set once more after the step, to what they were."""
    coupling = open_coupling(alone(tmp_path, "ok", "2.0", in_process=False))
    try:
        fmu = next(p for p in coupling.participants if isinstance(p, FmuParticipant))
        worker, u = fmu.slave.worker, np.zeros(len(fmu.inputs))
        assert isinstance(worker, RemoteWorker)
        fmu.initialise(0.0, u)
        fmu.start(0.0, u)
        before = worker.count
        for k in range(5):
            fmu.step(k * 1e-3, 1e-3, Held(u))
        assert worker.count - before == 5
    finally:
        coupling.close()


def test_the_last_step_ends_at_the_stop_time(tmp_path: Path, loops: list[int]) -> None:
    """Three steps of 0.1 s end at 0.30000000000000004 s, where an FMU may refuse what is beyond its stop time."""
    found = cosimulate_diagram(alone(tmp_path, "ok", "2.0", floats=True), step=0.1, stop=0.3)
    assert loops == [3]
    assert found.time.tolist() == [0.0, 0.1, 0.2, 0.3]


def test_an_end_that_was_asked_for_is_forgotten_by_the_next_run(tmp_path: Path) -> None:
    diagram = alone(tmp_path, "terminate", "3.0", floats=True)
    coupling = open_coupling(diagram)
    try:
        first, second = (cosimulate(coupling, diagram, step=1e-3) for _ in range(2))
    finally:
        coupling.close()
    assert first.message == second.message
    assert first.time.tolist() == second.time.tolist()
    assert len(first.time) > 10


@pytest.mark.slow
def test_ctrl_c_in_c_does_not_wait_for_replies_that_have_come(tmp_path: Path) -> None:
    """It is raised when C returns, before the loop had noted how often it had asked: closing waited for 60 s."""
    diagram = pair(tmp_path)
    coupling = open_coupling(diagram)
    workers = [p.slave.worker for p in coupling.participants if isinstance(p, FmuParticipant)]
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in what a shell runs behind it
    threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT)).start()
    try:
        with pytest.raises(KeyboardInterrupt):
            cosimulate(coupling, diagram, step=1e-6, stop=60.0)
    finally:
        signal.signal(signal.SIGINT, before)
        for worker in workers:
            assert isinstance(worker, RemoteWorker)
            worker.limit = 5.0  # s
        coupling.close()
    assert [worker.process.returncode for worker in workers] == [0, 0]  # none was killed
