"""Diagrams with FMUs: the rotor or the controller outside, against the whole run; what coupling costs."""

from __future__ import annotations

import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rotorsim.cosim.cosimulation import cosimulate_diagram, couple
from rotorsim.cosim.fmu_participant import FmuParticipant
from rotorsim.cosim.stability import coupling_stability
from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import RotorsimError
from rotorsim.fmi.export.export import export_fmu
from rotorsim.model.emit.toolchain import find_compiler
from rotorsim.model.load import load
from rotorsim.simulation.result import Result
from rotorsim.simulation.run import simulate
from tests.fmi.gauge import description, gauge_fmu, with_gauge

pytestmark = pytest.mark.skipif(find_compiler() is None, reason="FMUs are built by a C compiler")
INNER, STOP = 4e-6, 0.02


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("fmus")
    diagram = load("jeffcott", set={"solver.step": INNER, "solver.stop": STOP})
    for block in ("controller", "rotor"):
        for version in ("2.0", "3.0"):
            export_fmu(diagram, path / f"{block}{version[0]}.fmu", blocks=[block], version=version)
    return path


@pytest.fixture(scope="module")
def whole() -> Result:
    return simulate(load("jeffcott", set={"solver.step": INNER, "solver.stop": STOP}))


def with_fmu(folder: Path, block: str, file: str, whole: Diagram | None = None, **options: Any) -> Diagram:
    given = whole or load("jeffcott", set={"solver.step": INNER, "solver.stop": STOP})
    document = json.loads(json.dumps(given.document))
    document.pop("identify")
    document["blocks"][block] = {"type": "fmu", "file": file, "parameters": options}
    return load(document, folder=folder, trust_blocks=True)


def off(found: Result, whole: Result) -> float:
    every = round(float(found.time[1] / whole.time[1]))
    right = whole["rotor.displacement"][::every][: len(found.time)]
    return float(np.abs(found["rotor.displacement"] - right).max() / np.abs(right).max())


@pytest.mark.parametrize(
    ("block", "interface", "version"),
    [
        ("controller", "cs", "2"),
        *(
            pytest.param(*each, marks=pytest.mark.slow)
            for each in itertools.product(("controller", "rotor"), ("cs", "me"), ("2", "3"))
            if each != ("controller", "cs", "2")
        ),
    ],
)
def test_an_fmu_in_the_place_of_a_block(folder: Path, whole: Result, block: str, interface: str, version: str) -> None:
    """The error falls with the order of the master; iterative at 1 ms is better than extrapolation at 0.08 ms."""
    diagram = with_fmu(folder, block, f"{block}{version}.fmu", interface=interface, in_process=True)
    coarse, fine = (off(cosimulate_diagram(diagram, step=h, order=1), whole) for h in (1.6e-4, 8e-5))
    assert np.log2(coarse / fine) == pytest.approx(2, abs=0.05)
    assert off(cosimulate_diagram(diagram, step=1e-3, master="iterative"), whole) < fine


def test_the_ports_of_an_fmu_are_those_of_the_block(folder: Path) -> None:
    node = with_fmu(folder, "controller", "controller2.fmu").nodes["controller"]
    assert {name: port.shape for name, port in node.inputs.items()} == {"displacement": (2,), "velocity": (2,)}
    assert {name: port.unit for name, port in node.outputs.items()} == {"current": "A"}
    assert {"KP", "KI", "KD"} <= set(node.values)


def test_parameters_reach_the_fmu(folder: Path, whole: Result) -> None:
    other = simulate(load("jeffcott", set={"solver.step": INNER, "solver.stop": STOP, "controller.KP": 9000.0}))
    diagram = with_fmu(folder, "controller", "controller2.fmu", in_process=True, KP=9000.0)
    found = cosimulate_diagram(diagram, step=1e-4, order=2)
    assert off(found, other) < 1e-3
    assert off(found, whole) > 1e-2


@pytest.mark.slow
def test_the_iterative_master_keeps_the_damping() -> None:
    """At 1 ms, 0.76 rad of the rotor's own motion: within 1 % of the whole loop's damping."""
    coupling = couple(load("jeffcott"), [["controller"]])
    found = coupling_stability(coupling, 1e-3, master="iterative")
    assert found is not None
    assert found.kept == pytest.approx(1.0, abs=0.01)
    assert found.largest_step > 2e-3


def test_held_inputs_cost_damping() -> None:
    """A delay of h/2 in the current takes k_i K_P h / 2 of the damping c + k_i K_D."""
    coupling = couple(load("jeffcott"), [["controller"]])
    found = coupling_stability(coupling, 1e-4, master="jacobi", order=0)
    assert found is not None
    assert found.kept == pytest.approx(1 - 42.1 * 12200 * 0.5e-4 / (76 + 42.1 * 3), abs=0.01)


def test_a_step_that_must_diverge_is_refused(folder: Path) -> None:
    diagram = with_fmu(folder, "controller", "controller2.fmu")
    with pytest.raises(RotorsimError, match=r"coupled loop is unstable; the largest stable step is 0\.000788 s"):
        cosimulate_diagram(diagram, step=1e-3, master="jacobi", order=0, check=True)


def test_files_that_are_no_fmu(tmp_path: Path) -> None:
    (tmp_path / "no.fmu").write_text("no")
    document = json.loads(json.dumps(load("jeffcott").document))
    document.pop("identify")
    for block, text in (
        ({"type": "fmu"}, "controller: key 'file' is missing"),
        ({"type": "fmu", "file": "none.fmu"}, "controller: cannot read none.fmu: no such file"),
        ({"type": "fmu", "file": "no.fmu"}, "controller: no.fmu: not a readable archive"),
    ):
        document["blocks"]["controller"] = block
        with pytest.raises(RotorsimError, match=text):
            load(document, folder=tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("interface", ["cs", "me"])
def test_waveforms_are_repeated_until_they_agree(tmp_path: Path, interface: str) -> None:
    """For FMUs that cannot step back; cubic waveforms: better than extrapolation at a quarter of the step."""
    coarse = load("jeffcott", set={"solver.step": 2e-5, "solver.stop": STOP})
    export_fmu(coarse, tmp_path / "rotor2.fmu", blocks=["rotor"])
    diagram = with_fmu(tmp_path, "rotor", "rotor2.fmu", coarse, interface=interface, in_process=True)
    whole = simulate(coarse)
    found = cosimulate_diagram(diagram, step=4e-4, master="waveform")
    explicit = cosimulate_diagram(diagram, step=1e-4, master="gauss_seidel", order=1)
    assert off(found, whole) < off(explicit, whole) / 2
    assert found.counters["iterations"] > 2


def test_inputs_that_nothing_feeds_keep_their_value(folder: Path) -> None:
    document = {
        "name": "alone",
        "blocks": {"rotor": {"type": "fmu", "file": "rotor2.fmu", "parameters": {"force": [10.0, 0.0]}}},
        "wires": [],
        "solver": {"step": INNER, "stop": 0.2},
        "record": ["rotor.displacement"],
    }
    found = cosimulate_diagram(load(document, folder=folder, trust_blocks=True), step=1e-2)
    mass, damping, stiffness = 2.0, 76.0, 7.6e5
    omega, ratio = np.sqrt(stiffness / mass), damping / (2 * np.sqrt(mass * stiffness))
    damped = omega * np.sqrt(1 - ratio**2)
    t = found.time
    swing = np.exp(-ratio * omega * t) * (np.cos(damped * t) + ratio * omega / damped * np.sin(damped * t))
    allowed = (omega * INNER) ** 4 * omega * t[-1] / 120 * 10.0 / stiffness  # of RK4
    assert np.abs(found["rotor.displacement"][:, 0] - 10.0 / stiffness * (1 - swing)).max() < allowed + 1e-18
    assert not found["rotor.displacement"][:, 1].any()


@pytest.mark.parametrize(("order", "ratio"), [(0, 2), pytest.param(1, 4, marks=pytest.mark.slow)])
def test_the_error_of_the_coupling_is_recorded(folder: Path, order: int, ratio: int) -> None:
    """By how much inputs were foreseen wrongly: it falls with the order of the extrapolation."""
    diagram = with_fmu(folder, "controller", "controller2.fmu", in_process=True)
    steps = (8e-5, 4e-5)
    coarse, fine = (np.median(cosimulate_diagram(diagram, step=h, order=order)["coupling.error"]) for h in steps)
    assert coarse / fine == pytest.approx(ratio, rel=0.03)
    agreed = cosimulate_diagram(diagram, step=2e-4, master="iterative")["coupling.error"]
    assert agreed.max() < 1e-8


def test_part_of_a_signal_is_recorded(folder: Path) -> None:
    document = {**load("jeffcott").document, "record": ["rotor.displacement[2]"]}
    whole, part = (cosimulate_diagram(load(d), [["controller"]], step=1e-4, stop=0.01) for d in ("jeffcott", document))
    np.testing.assert_array_equal(part["rotor.displacement[2]"], whole["rotor.displacement"][:, 1])


def test_an_fmu_begins_with_the_start_values_of_its_inputs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Zero may be no value for it, such as of a pressure: until the others have outputs it keeps its own."""
    seen: list[float] = []
    old = FmuParticipant.initialise

    def initialise(self: FmuParticipant, t: float, u: np.ndarray) -> None:
        seen.append(float(u[0]))
        old(self, t, u)

    monkeypatch.setattr(FmuParticipant, "initialise", initialise)
    text = description().replace('<Real start="0" />', '<Real start="101325"/>', 1)
    found = cosimulate_diagram(with_gauge(gauge_fmu(tmp_path, text), more={"value": 3.0}), step=0.1, stop=0.5)
    assert seen == [101325.0]
    assert found["it.y"].tolist() == [3.0] * 6
