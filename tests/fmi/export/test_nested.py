"""Exported diagrams that hold FMUs: the numbers of `rotorsim run`, wherever they lie, or a refusal by name."""

from __future__ import annotations

import json
import re
import shutil
import zipfile
from importlib import resources
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu

from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import RotorsimError
from rotorsim.fmi.export.export import export_fmu
from rotorsim.fmi.validate import validate_fmu as validate_here
from rotorsim.model.load import load
from rotorsim.simulation import event_steps, switching
from rotorsim.simulation.run import simulate
from tests.fmi.conftest import Make
from tests.fmi.events import alone, events_fmu
from tests.fmi.opened import opened
from tests.fmi.plant import FAULTS, description2, make_fmu
from tests.fmi.test_equations import of_plant, with_fmu

PAIRS = [(inner, outer) for inner in ("2.0", "3.0") for outer in ("2.0", "3.0")]


def pairs(fast: tuple[str, str]) -> pytest.MarkDecorator:
    """Try versions inside and outside; at first one pair: the two tests together have both versions at both places."""
    given = [pair if pair == fast else pytest.param(*pair, marks=pytest.mark.slow) for pair in PAIRS]
    return pytest.mark.parametrize(("inner", "outer"), given)


H = 1e-2


def exported(diagram: Diagram, file: Path, version: str = "2.0", **options: Any) -> Path:
    export_fmu(diagram, file, version=version, **options)
    return file


def columns(diagram: Diagram, **options: Any) -> dict[str, np.ndarray]:
    return dict(simulate(diagram, record_every=1, **options).columns())


@pytest.mark.slow
@pairs(("3.0", "2.0"))
def test_a_loop_with_its_rotor_as_an_fmu_is_the_plain_loop_wherever_it_lies(
    fmu: Make, tmp_path: Path, inner: str, outer: str
) -> None:
    """Co-simulation: the same steps of the same equations, 1e-9; model exchange: as the plain export is tested."""
    file = exported(with_fmu(fmu, "rotor", inner), tmp_path / "loop.fmu", outer)
    assert validate_fmu(str(file)) == []
    assert validate_here(file, load=True, fmpy=False) == []
    plain, stop = load("jeffcott"), 0.03
    folder = tmp_path / "ein Ordner für 100 %"
    with zipfile.ZipFile(file) as archive:
        archive.extractall(folder)
    file.unlink()
    told = {"stop_time": stop, "output_interval": plain.solver.step}
    stepped = fmpy.simulate_fmu(str(folder), fmi_type="CoSimulation", **told)
    solved = fmpy.simulate_fmu(str(folder), fmi_type="ModelExchange", relative_tolerance=1e-9, **told)
    exact = columns(plain, stop=stop, method="dop853")
    for name, values in columns(plain, stop=stop).items():
        largest = np.abs(values).max()
        np.testing.assert_allclose(stepped[name], values, rtol=0, atol=1e-9 * largest)
        np.testing.assert_allclose(solved[name][: len(values)], exact[name], rtol=0, atol=1e-5 * largest)


def test_instances_side_by_side_have_parameters_of_their_own(fmu: Make, tmp_path: Path) -> None:
    diagram = with_fmu(fmu, "rotor")
    file, n, h, y = exported(diagram, tmp_path / "loop.fmu"), 20, diagram.solver.step, "rotor.displacement[1]"
    given = ({}, {"rotor.mass": 3.0})
    rows: list[list[np.ndarray]] = [[], []]
    with opened(file, "cs", "cs") as both:
        for instance, values in zip(both, given, strict=True):
            instance.put(list(values), list(values.values()))
            instance.begin()
        for k in range(n):
            for instance, own in zip(both, rows, strict=True):
                own.append(instance.walk([y], 1, h, k)[1])
    for own, values in zip(rows, given, strict=True):
        right = columns(load("jeffcott"), stop=n * h, parameters=values)[y]
        np.testing.assert_allclose(np.ravel(own), right[1:], rtol=0, atol=1e-9 * np.abs(right).max())


# ---- events ----


@pytest.mark.slow
@pairs(("2.0", "3.0"))
def test_events_are_carried_out_in_steps_and_for_a_solver(tmp_path: Path, inner: str, outer: str) -> None:
    """Two balls of one file, a lag behind one: RK4 from bounce to bounce as `run` does it, and CVode of FMPy.

    Within steps both locate a bounce to 1e-12 of a step; the speed there is below 10 m/s, and H = 1e-2 s.
    """
    file = events_fmu(tmp_path, inner, reports=inner == "3.0")
    other = {"interface": "me", "in_process": True, "model": 0, "x0": 0.5}
    blocks = {
        "other": {"type": "fmu", "file": file.name, "parameters": other},
        "lag": {"type": "lag", "parameters": {"time_constant": 0.3}},
    }
    diagram = alone(file, "ball", step=H, stop=1.5, blocks=blocks, wires=[["it.x", "lag.input"]])
    made = exported(diagram, tmp_path / "balls.fmu", outer, outputs=["it.x", "it.count", "other.x", "lag.output"])
    assert validate_fmu(str(made)) == []
    with zipfile.ZipFile(made) as archive:
        assert sum(name.endswith("/plant.so") for name in archive.namelist()) == 1
    found = simulate(diagram, record=["it.x", "it.count", "other.x", "lag.output"], record_every=1)
    assert found["it.count"][-1] == 2.0
    for kind, atol in (("CoSimulation", 1e-12), ("ModelExchange", 1e-6)):
        told = {"stop_time": 1.5, "output_interval": H, "relative_tolerance": 1e-9}
        rows = fmpy.simulate_fmu(str(made), fmi_type=kind, record_events=False, **told)
        for name in ("it.x", "it.count", "other.x", "lag.output"):
            np.testing.assert_allclose(rows[name], found[name], rtol=0, atol=atol)


@pytest.mark.slow
def test_a_relay_in_a_loop_and_a_clock(tmp_path: Path) -> None:
    """State events on what the diagram feeds back; time events, met exactly."""
    file = events_fmu(tmp_path)
    blocks = {"lag": {"type": "lag", "parameters": {"time_constant": 0.3}}}
    fed = alone(file, "relay", step=H, stop=3.0, blocks=blocks, wires=[["it.x", "lag.input"], ["lag.output", "it.u"]])
    for diagram in (fed, alone(file, "clock", step=H, stop=1.0, tick=0.13)):
        stop = diagram.solver.stop
        made, right = exported(diagram, tmp_path / "it.fmu"), columns(diagram)
        rows = fmpy.simulate_fmu(str(made), fmi_type="CoSimulation", stop_time=stop, output_interval=H)
        assert right["it.count"][-1] > 2.0
        for name, values in right.items():
            np.testing.assert_allclose(rows[name], values, rtol=0, atol=1e-12)


@pytest.mark.parametrize("outer", ["2.0", "3.0"])
@pytest.mark.slow
def test_the_end_that_an_fmu_asks_for_ends_the_outer_one(
    tmp_path: Path, outer: str, capsys: pytest.CaptureFixture[str]
) -> None:
    diagram = alone(events_fmu(tmp_path), "clock", step=H, stop=2.0, stop_at=3.0)
    made = exported(diagram, tmp_path / "it.fmu", outer)
    for kind in ("CoSimulation", "ModelExchange"):
        rows = fmpy.simulate_fmu(str(made), fmi_type=kind, stop_time=2.0, output_interval=H)
        assert rows["time"][-1] == 0.75
    assert capsys.readouterr().out.count("it asks for the end of the simulation (t = 0.75 s)") == 2


@pytest.mark.slow
def test_events_that_accumulate_are_an_error(tmp_path: Path) -> None:
    made = exported(alone(events_fmu(tmp_path), "chatter", step=H, stop=2.0), tmp_path / "it.fmu")
    with opened(made, "cs") as one:
        one.begin()
        with pytest.raises(Exception, match="DoStep failed with status 3"):
            one.walk(["it.x"], 200, H)
        assert [text for status, _, text in one.messages if status == 3] == [
            "an event indicator crosses zero again and again (t = 1 s): events accumulate: a contact that comes to "
            "rest, or a relay without hysteresis"
        ]


@pytest.mark.parametrize("outer", ["2.0", "3.0"])
@pytest.mark.slow
def test_a_saved_state_is_come_back_to_over_events(tmp_path: Path, outer: str) -> None:
    """The state of the FMU inside comes back too: bounces are counted again, not on."""
    names = ["it.x", "it.count"]
    made = exported(alone(events_fmu(tmp_path), "ball", step=H, stop=2.0), tmp_path / "it.fmu", outer, outputs=names)
    with opened(made, "cs") as one:
        one.begin()
        one.walk(names, 40, H)
        state = one.fmu.getFMUState()
        first = one.walk(names, 80, H, first=40)
        assert first[-1, 1] - first[0, 1] == 2.0
        one.fmu.setFMUState(state)
        assert np.array_equal(one.walk(names, 80, H, first=40), first)
        one.fmu.freeFMUState(state)
    unsaved = exported(alone(events_fmu(tmp_path, saves=False), "ball", step=H, stop=2.0), tmp_path / "no.fmu", outer)
    assert not fmpy.read_model_description(str(unsaved)).coSimulation.canGetAndSetFMUstate
    with opened(unsaved, "cs") as one:
        one.begin()
        with pytest.raises(Exception, match="failed with status 3"):
            one.fmu.getFMUState()
        assert one.messages[-1][2] == "GetFMUState: not offered: this FMU holds other FMUs"


# ---- values ----


@pytest.mark.parametrize("version", ["2.0", "3.0"])
@pytest.mark.slow
def test_values_of_every_type_reach_it(tmp_path: Path, version: str) -> None:
    """Whole numbers, flags, texts and arrays are set before its initialisation, as `run` sets them."""
    make_fmu(tmp_path / f"plant{version[0]}.fmu", version)
    diagram = of_plant(tmp_path, version, stiffness=64.0, damping=0.25, gain=0.5, tick=0.07, wall=0.3, label="mine")
    made = exported(diagram, tmp_path / "it.fmu", version)
    right = columns(diagram)
    rows = fmpy.simulate_fmu(str(made), fmi_type="CoSimulation", stop_time=0.5, output_interval=1e-3)
    for name, values in right.items():
        np.testing.assert_allclose(rows[name], values, rtol=0, atol=1e-9)
    told = {v.name: v for v in fmpy.read_model_description(str(made)).modelVariables}
    assert (told["it.stiffness"].variability, float(told["it.stiffness"].start)) == ("fixed", 64.0)


# ---- failures ----


def messages_of(made: Path, steps: int = 0, **values: float) -> list[str]:
    """Return what an instance says that fails in its steps."""
    with opened(made, "cs") as one:
        one.put(list(values), list(values.values()))
        one.begin()
        with pytest.raises(Exception, match="failed with status 3"):
            one.walk(["it.y"], steps, 1e-3)
        return [text for status, _, text in one.messages if status >= 2]


@pytest.mark.slow
def test_what_fails_inside_is_told_with_its_name(tmp_path: Path) -> None:
    make_fmu(tmp_path / "plant2.fmu")
    for fault, text in (
        ("fail", "it: fmi2GetDerivatives returned fmi2Error"),
        ("nan", "it: gives a derivative that is not finite"),
    ):
        diagram = of_plant(tmp_path, fault=FAULTS.index(fault), fault_time=0.1)
        said = messages_of(exported(diagram, tmp_path / "it.fmu"), 200)
        assert said[-1].startswith(text)
        assert said[-1].endswith(" (t = 0.1 s)")


def test_without_its_resources_there_is_no_instance(fmu: Make, tmp_path: Path) -> None:
    made = exported(with_fmu(fmu, "rotor"), tmp_path / "loop.fmu")
    folder = Path(fmpy.extract(str(made), str(tmp_path / "here")))
    shutil.rmtree(folder / "resources")
    said: list[str] = []
    with pytest.raises(Exception, match="Failed to instantiate"):
        fmpy.simulate_fmu(str(folder), logger=lambda *told: said.append(told[-1].decode()))
    assert re.match(r"rotor: its library cannot be loaded: .*No such file", said[0])


def refused(diagram: Diagram, file: Path, **options: Any) -> str:
    with pytest.raises(RotorsimError) as caught:
        export_fmu(diagram, file, **options)
    assert not file.exists()
    return str(caught.value)


def plant(folder: Path, text: str, version: str = "2.0", **values: Any) -> Diagram:
    make_fmu(folder / f"plant{version[0]}.fmu", version, description=text)
    return of_plant(folder, version, **values)


def test_what_is_not_carried_is_refused_by_name(tmp_path: Path) -> None:
    out = tmp_path / "out.fmu"
    hint = "export the others by --block: what comes from it becomes an input"
    old = alone(events_fmu(tmp_path, "1.0"), "ball", step=H, stop=1.0)
    assert refused(old, out) == (
        "error: it: is an FMU of FMI 1.0, which is not carried inside another\n\n"
        f"hint: get it as FMI 2.0 or 3.0, or {hint}"
    )
    tool = description2().replace(
        '<ModelExchange modelIdentifier="plant"', '<ModelExchange needsExecutionTool="true" modelIdentifier="plant"'
    )
    assert refused(plant(tmp_path, tool), out) == (
        f"error: it: needs the tool that made it (needsExecutionTool), which is not carried\n\nhint: {hint}"
    )
    whole = plant(tmp_path, description2())
    assert refused(whole, out, outputs=["it.count"]) == (
        "error: it.count: is of type Int32: of an FMU inside another, Float64 alone is read\n\n"
        "hint: leave out what uses it, --output others"
    )
    assert refused(whole, out, platforms=["win64"]) == (
        "error: it: holds no library for x86_64-windows, which the exported FMU would need\n\n"
        "hint: it holds x86_64-linux: --platform names these"
    )


def test_an_algebraic_loop_through_it_is_refused(tmp_path: Path) -> None:
    make_fmu(tmp_path / "plant2.fmu", description=description2().replace('unit="N"', 'unit="m"'))
    values = {"interface": "me", "in_process": True, "gain": 0.5}
    document = {
        "name": "looped",
        "algebraic_loops": "solve",
        "blocks": {
            "it": {"type": "fmu", "file": "plant2.fmu", "parameters": values},
            "back": {"type": "gain", "parameters": {"gain": 0.5}},
        },
        "wires": [["it.y", "back.input"], ["back.output", "it.u"]],
        "solver": {"step": 1e-3, "stop": 0.5},
        "record": ["it.y"],
    }
    assert refused(load(document, folder=tmp_path, trust_blocks=True), tmp_path / "out.fmu") == (
        "error: it: is in an algebraic loop, which takes derivatives of its outputs: these are not carried\n\n"
        "hint: put a state into the loop (integrator, lag, delay)"
    )


def test_its_events_are_located_by_the_numbers_of_a_run() -> None:
    text = resources.files("rotorsim.fmi.export").joinpath("c/switching.h").read_text()
    own = {name: float(value) for name, value in re.findall(r"#define RF_(\w+) ([\d.e-]+)", text)}
    assert own == {
        "LOCATED": event_steps.LOCATED,
        "TOUCH": event_steps.TOUCH,
        "CHATTER": event_steps.CHATTER,
        "MOST_EVENTS": event_steps.MOST_EVENTS_PER_STEP,
        "MOST_ITERATIONS": switching.MOST_ITERATIONS,
    }


@pytest.mark.slow
def test_an_fmu_that_is_alone_in_its_process(tmp_path: Path) -> None:
    """Once per process: the outer one says so of itself, and two of them are refused."""
    make_fmu(tmp_path / "plant2.fmu", description=description2(once=True))
    made = exported(of_plant(tmp_path), tmp_path / "it.fmu", "3.0")
    assert fmpy.read_model_description(str(made)).modelExchange.canBeInstantiatedOnlyOncePerProcess
    twice = {"other": {"type": "fmu", "file": "plant2.fmu", "parameters": {"interface": "me"}}}
    assert refused(of_plant(tmp_path, blocks=twice, in_process=False), tmp_path / "no.fmu").startswith(
        "error: other: can be instantiated only once per process, and it is the same FMU"
    )


def test_it_is_foreign_code(fmu: Make, tmp_path: Path, run: Any) -> None:
    document = dict(with_fmu(fmu, "rotor", trust=False).document)
    Path("loop.json").write_text(json.dumps(document))
    done = run("fmu", "export", "loop.json", "-o", "loop.fmu")
    assert done.exit_code == 2
    assert "rotor: FMUs are programs; they are not run unless you say so" in done.stderr
    done = run("fmu", "export", "loop.json", "--trust-blocks", "-o", "loop.fmu")
    assert done.stdout.splitlines()[2] == "holds jeffcott_rotor for rotor: FMI 2.0, x86_64-linux"
    done = json.loads(run("fmu", "export", "loop.json", "--trust-blocks", "-o", "loop.fmu", "--json").stdout)
    assert done["fmus"] == [{"block": "rotor", "model": "jeffcott_rotor", "fmi": "2.0", "platforms": ["x86_64-linux"]}]


@pytest.mark.slow
def test_an_export_that_holds_one_is_held_again(fmu: Make, tmp_path: Path) -> None:
    """Three deep: the loop with its rotor inside is a block of a diagram that is exported."""
    inner = exported(with_fmu(fmu, "rotor"), tmp_path / "loop.fmu")
    document = {
        "name": "deep",
        "blocks": {"loop": {"type": "fmu", "file": str(inner), "parameters": {"in_process": True}}},
        "wires": [],
        "solver": {"step": 1e-4, "stop": 0.02},
        "record": ["loop.rotor_displacement"],
    }
    diagram = load(document, trust_blocks=True)
    made = exported(diagram, tmp_path / "deep.fmu", "3.0")
    rows = fmpy.simulate_fmu(str(made), fmi_type="CoSimulation", stop_time=0.02, output_interval=1e-4)
    right = columns(load("jeffcott"), stop=0.02)["rotor.displacement[1]"]
    np.testing.assert_allclose(rows["loop.rotor_displacement[1]"], right, rtol=0, atol=1e-9 * np.abs(right).max())
