"""The rotor of every thesis diagram as an FMU: valid, and in FMPy the rotor that a run in process has."""

from __future__ import annotations

import json
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu

from rotorsim.cosim.compiled_participant import CompiledParticipant
from rotorsim.diagram.diagram import Diagram
from rotorsim.model.load import load
from rotorsim.model.part import open_part
from rotorsim.simulation.run import simulate
from tests.cli.conftest import Run
from tests.fmi.opened import opened

N = 200
CHEAP = [("jeffcott", "2.0"), ("offset_disc", "3.0")]
LONG = [
    ("fe_rigid", "3.0"),
    ("jeffcott", "3.0"),
    ("offset_disc", "2.0"),
    ("fe_rigid", "2.0"),
    ("fe_flexible", "2.0"),
    ("fe_flexible", "3.0"),
]
both = pytest.mark.parametrize(
    ("name", "version"), [*CHEAP, *(pytest.param(*each, marks=pytest.mark.slow) for each in LONG)]
)


def names_of(file: Path, causality: str) -> list[str]:
    return [v.name for v in fmpy.read_model_description(str(file)).modelVariables if v.causality == causality]


def rotor_alone(name: str, held: bool) -> Diagram:
    """Return the rotor with sources at the inputs that its diagram feeds: sampled sines, or constants."""
    diagram, rng = load(name), np.random.default_rng(7)
    step, node = diagram.solver.step, diagram.nodes["rotor"]
    blocks: dict[str, object] = {"rotor": diagram.document["blocks"]["rotor"]}
    wires = []
    for port in dict.fromkeys(wire.target.port for wire in diagram.wires if wire.target.block == "rotor"):
        shape = node.inputs[port].shape
        value = 150.0 if port == "speed" else rng.uniform(0.5, 1.0, shape).tolist()
        if held and port != "speed":
            wave = {"amplitude": value, "phase": rng.uniform(0.0, 6.0, shape).tolist(), "frequency": 800.0}
            blocks[f"{port}_wave"] = {"type": "sine", "parameters": wave}
            blocks[port] = {"type": "sample_hold", "parameters": {"sample_time": step}}
            wires.append([f"{port}_wave.output", f"{port}.input"])
        else:
            blocks[port] = {"type": "constant", "parameters": {"value": value}}
        wires.append([f"{port}.output", f"rotor.{port}"])
    text = json.dumps(blocks)
    used = {key: value for key, value in diagram.document.get("parameters", {}).items() if f'"${key}"' in text}
    return load(
        {
            "schema_version": 1,
            "name": name,
            "parameters": used,
            "blocks": blocks,
            "wires": wires,
            "solver": {"step": step, "stop": N * step},
            "record": [
                *(f"rotor.{port}" for port in node.outputs),
                *(w[0] for w in wires if w[1].startswith("rotor.")),
            ],
        }
    )


def source_of(entry: str) -> str:
    """Return the source of an input of the rotor: rotor.force[2] -> force.output[2]."""
    port, bracket, index = entry.removeprefix("rotor.").partition("[")
    return f"{port}.output{bracket}{index}"


@pytest.mark.parametrize(("name", "version"), [*CHEAP, *(pytest.param(*each, marks=pytest.mark.slow) for each in LONG)])
def test_it_is_valid(fmu, run: Run, name: str, version: str) -> None:
    file = fmu(name, version, blocks=["rotor"])
    done = run("fmu", "validate", "--load", "--no-fmpy", str(file))
    assert (done.exit_code, done.output) == (0, f"{file}: no mistakes\n")
    assert validate_fmu(str(file)) == []


@both
def test_its_co_simulation_is_the_rotor_of_a_run(fmu, name: str, version: str) -> None:
    """Forces held over each step: the compiled part to the last bit, the run of a diagram, summed in another order."""
    file = fmu(name, version, blocks=["rotor"])
    diagram, inputs, outputs = rotor_alone(name, held=True), names_of(file, "input"), names_of(file, "output")
    h = diagram.solver.step
    whole = dict(simulate(diagram, record_every=1).columns())
    u = np.column_stack([whole[source_of(entry)] for entry in inputs])
    assert np.ptp(u, axis=0)[[not entry.endswith("speed") for entry in inputs]].min() > 0.1
    part = open_part(load(name), ["rotor"])
    ports = list(dict.fromkeys(entry.partition("[")[0] for entry in outputs))
    alone = CompiledParticipant("rotor", part, ports, part.p0, h)
    assert (sorted(alone.inputs), list(alone.outputs)) == (sorted(inputs), outputs)
    to = [inputs.index(entry) for entry in alone.inputs]
    alone.initialise(0.0, u[0, to])
    alone.start(0.0, u[0, to])
    right = [alone.output(0.0, u[0, to]).copy()]
    with opened(file, "cs") as slave:
        slave.enter()
        slave.put(inputs, u[0])
        slave.leave()
        found = [slave.get(*outputs)]
        for k in range(N):
            slave.put(inputs, u[k])
            slave.step(k * h, h)
            found.append(slave.get(*outputs))
            right.append(alone.step(k * h, h, lambda _, k=k: u[k, to]).copy())
    assert np.array_equal(found, right)
    for entry, values in zip(outputs, np.array(found).T, strict=True):
        assert np.abs(values - whole[entry]).max() <= 1e-12 * np.abs(whole[entry]).max()


@both
def test_its_model_exchange_is_the_rotor_of_a_run(fmu, name: str, version: str) -> None:
    """Constant forces, by CVode of FMPy: the error falls with the tolerance."""
    file = fmu(name, version, blocks=["rotor"])
    diagram, outputs = rotor_alone(name, held=False), names_of(file, "output")
    h = diagram.solver.step
    whole = dict(simulate(diagram, record_every=1, method="dop853").columns())
    start = {entry: whole[source_of(entry)][0] for entry in names_of(file, "input")}
    errors = []
    for tolerance in (1e-5, 1e-9):
        solved = fmpy.simulate_fmu(
            str(file),
            fmi_type="ModelExchange",
            relative_tolerance=tolerance,
            stop_time=N * h,
            output_interval=h,
            start_values=start,
            output=outputs,
        )
        moving = [entry for entry in outputs if whole[entry].any()]
        assert len(moving) >= 0.8 * len(outputs)  # pinned nodes stay
        errors.append(max(np.abs(solved[entry] - whole[entry]).max() / np.abs(whole[entry]).max() for entry in moving))
    assert errors[1] < 1e-2 * errors[0]
    assert errors[1] < 1e-5
