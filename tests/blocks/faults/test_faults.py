"""What every fault of the library declares, and that each can be wired into a diagram and run."""

from __future__ import annotations

import copy
import json
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest

from rotorsim.block import Block
from rotorsim.diagnosis.catalogue.finder import insertions
from rotorsim.diagnosis.catalogue.insertion import LONGEST, fixed_of, sizes_at, starts_of
from rotorsim.diagram.parse.source import read_document
from rotorsim.diagram.resolve.registry import all_types
from rotorsim.diagram.resolve.resolution import shipped_diagrams
from rotorsim.fault import Course, Dominant, Fault, Lines, Longest, Of, Onset, Sampled, Steps
from rotorsim.identification.waveform.driven.equations import driven_equations
from rotorsim.model.load import load
from rotorsim.simulation.run import simulate
from rotorsim.simulation.stable_step import stable_steps

# every effect that a rotor model commonly leaves out and that can be named
CATALOGUE = {
    "breathing_crack",
    "open_crack",
    "asymmetric_shaft",
    "crack_location",
    "second_crack",
    "residual_bow",
    "thermal_bow",
    "parallel_misalignment",
    "angular_misalignment",
    "anisotropic_support",
    "support_stiffness",
    "foundation_mode",
    "gyroscopic_error",
    "moment_unbalance",
    "unbalance_elsewhere",
    "internal_damping",
    "hysteretic_damping",
    "seal_cross_coupling",
    "rub",
    "clearance",
    "cubic_stiffness",
    "coulomb_friction",
    "magnetic_nonlinearity",
    "magnetic_saturation",
    "eddy_current_lag",
    "amb_cross_coupling",
    "amplifier_bandwidth",
    "control_delay",
    "controller_gain_error",
    "current_clipping",
    "current_sensor_gain",
    "sensor_gain",
    "sensor_gain_mismatch",
    "sensor_rotation",
    "non_collocation",
    "runout",
    "sensor_offset",
    "quantisation",
    "base_excitation",
    "speed_fluctuation",
    "torsion_coupling",
    "blade_pass",
    "magnetic_pull",
    "mass_error",
    "disc_rotary_inertia",
}
# what may happen to any signal of a diagram in which nothing turns
SIGNALS = {
    "asymmetry",
    "cross_talk",
    "dead_zone",
    "delay",
    "drift",
    "dry_friction",
    "gain_drift",
    "gain_error",
    "hysteresis",
    "integrator_leak",
    "integrator_limit",
    "lag",
    "missing_mode",
    "nonlinear_coupling",
    "offset",
    "one_sided_stop",
    "periodic_disturbance",
    "play",
    "position_ripple",
    "rate_limit",
    "saturation",
    "signal_dependent_gain",
    "static_nonlinearity",
    "step_disturbance",
    "unmeasured_disturbance",
}
# what reads like an effect without being one: parameters of the model, and noise
OTHERS = {"viscous_damping", "force_displacement_factor", "force_current_factor", "sag", "noise"}
FAULTS = [(cls, fault) for cls in all_types().values() for fault in cls.faults]
IDS = [f"{fault.physics}-{cls.type_name}-{cls.faults.index(fault)}" for cls, fault in FAULTS]
every_fault = pytest.mark.parametrize(("cls", "fault"), FAULTS, ids=IDS)


def test_every_effect_of_the_catalogue_is_offered_and_no_other() -> None:
    assert {fault.physics for _, fault in FAULTS} == CATALOGUE | SIGNALS


@every_fault
def test_a_fault_says_what_it_looks_like(cls: type[Block], fault: Fault) -> None:
    assert fault.law.strip()
    assert fault.told_apart_by.strip()
    assert fault.confused_with
    assert set(fault.confused_with) <= (CATALOGUE | SIGNALS | OTHERS) - {fault.physics}


@every_fault
def test_the_names_of_a_fault_are_declared(cls: type[Block], fault: Fault) -> None:
    assert fault.free.keys() | fault.fixed.keys() <= cls.parameters.keys()
    assert not fault.free.keys() & fault.fixed.keys()
    assert {name.rpartition(".")[2] for name in fault.inherits} <= cls.parameters.keys() | cls.options.keys()
    assert set(fault.most) | set(fault.sizes) | set(fault.simpler) <= fault.free.keys()
    assert set(fault.special_cases) <= (CATALOGUE | SIGNALS) - {fault.physics}
    assert fault.options.keys() | fault.finer.keys() <= cls.options.keys()
    for name, value in fault.options.items():
        option = cls.options[name]
        assert option.choices is None or value in option.choices
    for start in [start for starts in fault.free.values() for start in starts] + list(fault.fixed.values()):
        assert not isinstance(start, Of) or start.input in {**cls.inputs, **cls.outputs}


@every_fault
def test_the_ends_of_a_fault_fit(cls: type[Block], fault: Fault) -> None:
    if fault.enters in ("force", "shaft"):
        assert {"force", "moment"} & cls.outputs.keys()
    if fault.enters in ("wire", "reading", "signal"):
        assert fault.through
        assert not fault.argument or (fault.enters == "signal" and cls.inputs[fault.argument].unit is None)
        assert not fault.own or (fault.argument and fault.own in SIGNALS)
        for inside, outside in fault.through.items():
            assert cls.inputs[inside].shape == cls.outputs[outside].shape
            assert cls.inputs[inside].unit == cls.outputs[outside].unit
    if fault.enters in ("replace", "move"):
        assert fault.of
        assert set(fault.of) <= all_types().keys()
    if fault.enters == "move":
        assert cls.type_name in fault.of


@every_fault
def test_starts_are_small_not_zero_and_within_bounds(cls: type[Block], fault: Fault) -> None:
    for name, starts in fault.free.items():
        declared = cls.parameters[name]
        assert declared.shape == (), "a free parameter is one number"
        assert starts
        for start in starts:
            if isinstance(start, (Of, Longest, Sampled)):
                assert start.factor != 0
                continue
            if isinstance(start, Dominant):
                assert declared.unit == "rad/s"
                continue
            if isinstance(start, Onset):
                assert declared.unit == "s"
                continue
            assert start != 0 or declared.unit == "rad", name
            assert declared.low is None or start >= declared.low
            assert declared.high is None or start <= declared.high
            assert declared.above is None or start > declared.above


@pytest.mark.parametrize(("cls", "fault"), [pair for pair in FAULTS if pair[1].enters == "signal"], ids=str)
def test_what_only_adds_to_a_signal_is_declared_so(cls: type[Block], fault: Fault) -> None:
    """What it adds, and how fast its states move, does not depend on the signal."""
    names = [*fault.through, *([fault.argument] if fault.argument else [])]
    blocks = {name: {"type": "recorded", "parameters": {"interpolation": "hold"}} for name in names}
    document = {
        "schema_version": 1,
        "name": "alone",
        "blocks": {**blocks, "law": {"type": cls.type_name, "parameters": dict(fault.options)}},
        "wires": [[f"{name}.output", f"law.{name}"] for name in names],
    }
    [output] = fault.through.values()
    equations = driven_equations(load(document), [f"law.{output}"], [f"{name}.output" for name in names], [])
    signal = equations.arguments[2][0]
    moved = ca.vertcat(ca.simplify(equations.g - signal), equations.f)
    assert fault.adds == (not ca.depends_on(moved, signal))


def test_variants_of_one_effect_differ() -> None:
    said = [
        (cls.type_name, f.physics, f.enters, f.recorded, str(f.options), str(f.fixed), sorted(f.free))
        for cls, f in FAULTS
    ]
    assert all(said.count(entry) == 1 for entry in said)


def test_a_fault_that_enters_nowhere_is_refused() -> None:
    with pytest.raises(ValueError) as caught:
        Fault(physics="rub", enters="torque")
    assert str(caught.value) == "enters must be one of force, shaft, wire, reading, signal, replace, move, not 'torque'"


# --- in a diagram -------------------------------------------------------------------------------------------------


def diagram_of(fault: Fault) -> dict[str, Any]:
    """A rotor whose disc tilts; one of several nodes for what acts at another place."""
    beam = "rotor_fe" in fault.of
    name = "fe_rigid" if fault.enters in ("move", "shaft") or beam else "offset_disc"
    document = copy.deepcopy(dict(read_document(shipped_diagrams()[name]).data))
    document["wires"] = [list(wire) for wire in document["wires"]]
    if beam:  # what the fault changes is not so before
        rotor = next(block for block in document["blocks"].values() if block["type"] == "rotor_fe")
        rotor["parameters"] |= {name: not value for name, value in fault.options.items()}
    return document


def started(cls: type[Block], fault: Fault) -> dict[str, Any]:
    """Parameters of the block at the first starts of a fault, where displacements are about 10 um."""
    scale = {"displacement": 1e-5, "velocity": 1e-3, "current": 0.05}

    def number(value: float | Of | Lines | Steps | Course) -> float:
        if isinstance(value, Course):
            return 1.0
        if isinstance(value, (Lines, Steps)):
            return 100.0 if isinstance(value, Lines) else 2e-6
        if isinstance(value, Longest):  # of a run of one second
            return value.factor
        return value.factor * scale[value.input] ** value.power if isinstance(value, Of) else value

    free = {name: number(starts[0]) for name, starts in fault.free.items()}
    return {**fault.options, **free, **{name: number(value) for name, value in fault.fixed.items()}}


def put_in(document: dict[str, Any], cls: type[Block], fault: Fault) -> list[str]:
    """Wire a fault by hand; return what to record beside the displacement."""
    wires, parameters = document["wires"], started(cls, fault)
    sources = {"theta": "clock", "speed": "clock", "current": "controller"}
    if fault.enters == "replace":
        block = next(b for b in document["blocks"].values() if b["type"] in fault.of)
        kept = {k: v for k, v in block["parameters"].items() if k in {**cls.parameters, **cls.options}}
        block.update(type=cls.type_name, parameters={**kept, **parameters})
        return []
    if fault.enters == "move":
        [moved] = [wire for wire in wires if wire[0] == "crack.force"]
        moved[1] = "rotor.force[2]"
        return []
    document["blocks"]["fault"] = {"type": cls.type_name, "parameters": parameters}
    for port, declared in cls.inputs.items():
        if declared.optional and port not in ("speed", "velocity"):
            continue
        source = f"{sources.get(port, 'rotor')}.{port}"
        if port in fault.through and fault.enters == "wire":
            for wire in wires:
                kind = document["blocks"][wire[1].split(".")[0]]["type"]
                if wire[0] == source and fault.between[1] in ("*", all_types()[kind].category):
                    wire[0] = f"fault.{fault.through[port]}"
        wires.append([source, f"fault.{port}"])
    if fault.enters in ("force", "shaft"):
        wires += [[f"fault.{port}", f"rotor.{port}"] for port in ("force", "moment") if port in cls.outputs]
    return [f"fault.{port}" for port in cls.outputs]


def run(
    document: dict[str, Any], record: list[str], use_compiler: bool = False, steps: dict[str, Any] | None = None
) -> Any:
    document["record"] = ["rotor.displacement", *record]
    step = document["solver"]["step"].replace("0.1 ms", "50 us")  # RK4 bears a delay T up to 0.81 T: here 81 us
    document["solver"] = {**document["solver"], "step": step, "stop": "50 ms" if use_compiler else "10 ms"}
    document.pop("layout", None)
    document.pop("identify", None)
    document["solver"] |= stable_steps(load(document)) if steps is None else steps
    result = simulate(load(document), use_compiler=use_compiler)
    assert result.status == "finished"
    return result


@cache
def base_of(text: str, compiled: bool, step: Any, every: int) -> np.ndarray:
    steps = {"step": step, "record_every": every}
    return np.asarray(run(json.loads(text), [], compiled, steps)["rotor.displacement"])


@pytest.mark.parametrize(  # every way of a fault in; compiled the first of its block
    ("cls", "fault", "compiled"),
    [
        pytest.param(
            *each,
            compiled,
            id=f"{name}-{compiled}",
            marks=pytest.mark.slow if compiled or each[1] is not each[0].faults[0] else (),
        )
        for each, name in zip(FAULTS, IDS, strict=True)
        if each[1].physics not in SIGNALS and each[1].enters != "signal"
        for compiled in (False, True)
        if not compiled or each[1] is each[0].faults[0]
    ],
)
def test_a_fault_runs_in_a_diagram_and_changes_it(cls: type[Block], fault: Fault, compiled: bool) -> None:
    document = diagram_of(fault)
    text, extra = json.dumps(document), put_in(document, cls, fault)
    result, solver = run(document, extra, compiled), document["solver"]
    base = base_of(text, compiled, solver["step"], solver.get("record_every", 1))
    for name in ("rotor.displacement", *extra):
        assert np.isfinite(result[name]).all(), name
    if fault.enters == "reading":
        assert np.abs(result[extra[0]]).max() > 0
    else:
        assert not np.array_equal(result["rotor.displacement"], base)


@pytest.mark.parametrize(
    "name",
    [
        "clearance",
        "cubic_stiffness",
        "coulomb_friction",
        "support_stiffness",
        "hysteretic_damping",
        "foundation_mode",
        "magnetic_pull",
        "mass_error",
    ],
)
def test_a_force_on_what_moves_in_a_line_runs(name: str) -> None:
    """An oscillator of gains and integrators, whose displacement is one number."""
    cls = all_types()[name]
    blocks = {
        "drive": {"type": "sine", "parameters": {"frequency": "20 Hz", "amplitude": 5.0}},
        "total": {"type": "sum", "parameters": {"signs": "++-"}},
        "acceleration": {"type": "gain", "parameters": {"gain": 0.5}},
        "velocity": {"type": "integrator"},
        "displacement": {"type": "integrator"},
        "spring": {"type": "gain", "parameters": {"gain": 1e5}},
        "fault": {"type": name, "parameters": {"gap": 1e-6} if name == "clearance" else {}},
    }
    wires = [["drive.output", "total.input1"], ["fault.force", "total.input2"], ["spring.output", "total.input3"]]
    wires += [["total.output", "acceleration.input"], ["acceleration.output", "velocity.input"]]
    wires += [["velocity.output", "displacement.input"], ["displacement.output", "spring.input"]]
    wires += [[f"{port}.output", f"fault.{port}"] for port in ("displacement", "velocity") if port in cls.inputs]
    solver = {"method": "rk4", "step": "0.1 ms", "stop": "50 ms"}
    document = {"schema_version": 1, "name": "line", "blocks": blocks, "wires": wires, "solver": solver}
    document["solver"] = {**solver, **stable_steps(load(document))}
    result = simulate(load({**document, "record": ["displacement.output", "fault.force"]}))
    assert result.status == "finished"
    assert np.shape(result["displacement.output"]) == (501,)
    assert np.isfinite(result["fault.force"]).all()
    assert np.abs(result["fault.force"]).max() > 0


LOOP = {  # a servo of one integrator, whose sensor is recorded
    "schema_version": 1,
    "name": "loop",
    "blocks": {
        "reference": {"type": "sine", "parameters": {"frequency": "2 Hz", "amplitude": 1.0}},
        "error": {"type": "sum", "parameters": {"signs": "+-"}},
        "controller": {"type": "gain", "parameters": {"gain": 8.0}},
        "plant": {"type": "integrator"},
        "sensor": {"type": "gain", "parameters": {"gain": 1.0}},
    },
    "wires": [
        ["reference.output", "error.input1"],
        ["sensor.output", "error.input2"],
        ["error.output", "controller.input"],
        ["controller.output", "plant.input"],
        ["plant.output", "sensor.input"],
    ],
    "solver": {"method": "rk4", "step": "0.5 ms", "stop": "1 s"},
    "record": ["sensor.output"],
}


@pytest.mark.slow
@pytest.mark.parametrize("physics", sorted(SIGNALS))
def test_a_law_of_a_signal_runs_wherever_it_is_offered_and_changes_what_is_recorded(physics: str) -> None:
    diagram = load(LOOP)
    given = simulate(diagram, record=[f"{block}.output" for block in LOOP["blocks"]])
    base = given["sensor.output"]
    offered = [item for item in insertions(diagram, ["sensor.output"]) if item.physics == physics]
    sides = {(str(item.spot), item.spot.side) for item in offered}
    if physics in ("integrator_leak", "integrator_limit"):
        assert sides == {("plant.output", "")}
    else:
        wires = {(f"{block}.output", "") for block in LOOP["blocks"]}
        if physics in ("cross_talk", "nonlinear_coupling"):  # at the sum, they are laws of what enters it
            wires = {("plant.output", "")}  # and behind a gain, but not where that is recorded
        assert sides == wires | {("sensor.output", "reading"), ("sensor.output", "both")}
    largest = {name: float(np.abs(values).max()) for name, values in given.signals.items()} | {LONGEST: 1.0}
    for item in offered:
        sizes = sizes_at(item, largest)
        changed = load(item.document(LOOP, {**fixed_of(item, sizes), **starts_of(item, sizes)[-1]}))
        result = simulate(changed, record=[changed.as_measured("sensor.output")])
        assert result.status == "finished", item.key
        there = result[changed.as_measured("sensor.output")]
        assert np.isfinite(there).all(), item.key
        if item.from_course:  # what nobody knows is not simulated
            np.testing.assert_array_equal(there, base)
        else:
            assert np.abs(there - base).max() > 1e-6, item.key


def test_no_law_of_a_signal_is_offered_where_a_shaft_turns() -> None:
    offered = insertions(load("jeffcott"), ["rotor.displacement[1]", "controller.current[1]"])
    assert not {item.physics for item in offered} & SIGNALS
