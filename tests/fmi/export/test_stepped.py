"""Exported diagrams that hold FMUs for Co-Simulation: the numbers of `rotorsim run`, which co-simulates them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest

from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import RotorsimError
from rotorsim.fmi.export.export import export_fmu
from rotorsim.fmi.validate import validate_fmu
from rotorsim.model.load import load
from rotorsim.simulation.run import simulate
from tests.fmi.conftest import Make
from tests.fmi.export.test_nested import columns, exported, pairs
from tests.fmi.gauge import description, gauge_fmu, with_gauge
from tests.fmi.lag import lag_fmu, with_lag
from tests.fmi.opened import opened
from tests.fmi.plant import FAULTS, description2, make_fmu
from tests.fmi.test_equations import of_plant, with_fmu

STOP = 0.02
HINT = "export the others by --block: what comes from it becomes an input"


def stepped(file: Path, diagram: Diagram, kind: str = "CoSimulation", **more: Any) -> Any:
    told = {"stop_time": STOP, "output_interval": diagram.solver.step, **more}
    return fmpy.simulate_fmu(str(file), fmi_type=kind, **told)


@pytest.mark.slow
@pairs(("3.0", "2.0"))
def test_a_controller_is_stepped_as_run_does_it(fmu: Make, tmp_path: Path, inner: str, outer: str) -> None:
    """Gauss-Seidel with held inputs, the rest first: the same numbers; Model Exchange: as exact as its solver."""
    diagram = with_fmu(fmu, "controller", inner, interface="cs")
    file = exported(diagram, tmp_path / "loop.fmu", outer)
    assert validate_fmu(file, load=True) == []
    made = stepped(file, diagram)
    solved = stepped(file, diagram, "ModelExchange", relative_tolerance=1e-9)
    for name, values in columns(diagram, stop=STOP).items():
        largest = np.abs(values).max()
        np.testing.assert_allclose(made[name], values, rtol=0, atol=1e-12 * largest)
        at = np.interp(made["time"], solved["time"], solved[name])
        np.testing.assert_allclose(at, made[name], rtol=0, atol=1e-5 * largest)


def with_step(diagram: Diagram, h: float) -> Diagram:
    return replace(diagram, solver=replace(diagram.solver, step=h))


def falls(diagram: Diagram, plain: Diagram, folder: Path, part: int) -> tuple[float, list[float]]:
    """Return the rms error of a displacement, and by what it falls with steps smaller by ``part``, and once more."""
    name = "rotor.displacement[1]"
    exact, found = columns(plain, stop=STOP)[name], []
    for times in (1, part, part**2):
        finer = with_step(diagram, diagram.solver.step / times)
        made = stepped(exported(finer, folder / f"{times}.fmu"), finer)[name][::times]
        found.append(float(np.sqrt(np.mean((made - exact) ** 2) / np.mean(exact**2))))
    return found[0], [found[0] / found[1], found[1] / found[2]]


@pytest.mark.slow
def test_a_rotor_that_is_fed_what_follows_it_at_once_is_a_step_late(fmu: Make, tmp_path: Path) -> None:
    """Of first order: half the step, half the error, which is below that which `run` tells."""
    diagram = with_fmu(fmu, "rotor", interface="cs")
    error, ratios = falls(diagram, load("jeffcott"), tmp_path, 2)
    assert error < simulate(diagram, stop=STOP).counters["step_error"]
    assert ratios == pytest.approx([2, 2], abs=0.25)


@pytest.mark.slow
def test_its_parameters_are_those_of_the_outer_one_until_it_has_begun(fmu: Make, tmp_path: Path) -> None:
    diagram = with_fmu(fmu, "controller", interface="cs")
    file = exported(diagram, tmp_path / "loop.fmu")
    made = stepped(file, diagram, start_values={"controller.KD": 4.0})
    for name, values in columns(diagram, stop=STOP, parameters={"controller.KD": 4.0}).items():
        np.testing.assert_allclose(made[name], values, rtol=0, atol=1e-12 * np.abs(values).max())
    step = next(v for v in fmpy.read_model_description(str(file)).modelVariables if v.name.endswith("_step"))
    h = diagram.solver.step
    assert (step.name, float(step.min), float(step.max)) == ("controller.communication_step", h, h)


@pytest.mark.slow
def test_hits_of_other_blocks_are_no_steps_of_it(fmu: Make, tmp_path: Path) -> None:
    """A controller that samples at one and a half steps beside a rotor that steps: of first order as well.

    Of all steps every other hit is in the middle. The rotor refuses a step that does not follow on the one before.
    """
    sampled = {"type": "discrete_pid", "parameters": {"sample_time": "0.15 ms", "KP": 12200, "KI": 2000, "KD": 3}}
    plain, diagram = (
        load({**one.document, "blocks": {**one.document["blocks"], "controller": sampled}}, trust_blocks=True)
        for one in (load("jeffcott"), with_fmu(fmu, "rotor", interface="cs"))
    )
    assert falls(diagram, plain, tmp_path, 3)[1][1] == pytest.approx(3, abs=0.25)


def test_a_saved_state_comes_back_with_that_of_the_fmu_inside(fmu: Make, tmp_path: Path) -> None:
    diagram = with_fmu(fmu, "rotor", interface="cs")
    names, h = ["rotor.displacement[1]", "controller.current[1]"], diagram.solver.step
    with opened(exported(diagram, tmp_path / "loop.fmu"), "cs") as one:
        one.begin()
        one.walk(names, 20, h)
        state = one.fmu.getFMUState()
        first = one.walk(names, 20, h, first=20)
        one.fmu.setFMUState(state)
        assert np.array_equal(one.walk(names, 20, h, first=20), first)
        one.fmu.freeFMUState(state)


def test_values_are_in_the_units_of_the_fmu(tmp_path: Path) -> None:
    """y = 3 u, u in mm and y in km: 2 m are 2000 mm, 6000 km; the hit at zero gives what the FMU begins with."""
    sizes = {"mm": 1e-3, "km": 1e3}
    units = "".join(f'<Unit name="{name}"><BaseUnit m="1" factor="{size}"/></Unit>' for name, size in sizes.items())
    text = description(units, 'unit="mm"', 'unit="km"', real=True)
    diagram = with_gauge(gauge_fmu(tmp_path, text), more={"value": 2.0}, scale=3.0)
    made = stepped(exported(diagram, tmp_path / "out.fmu"), diagram, stop_time=0.5)
    assert made["it.y"].tolist() == pytest.approx([6e6] * 6)


@pytest.mark.slow
def test_two_exports_of_one_file_have_tables_of_their_own(tmp_path: Path) -> None:
    """One variable inside more is recorded: the time of the last step."""
    file = gauge_fmu(tmp_path, description(real=True))
    for record in (["it.y"], ["it.y", "it.last"]):
        diagram = with_gauge(file, record=record)
        made = stepped(exported(diagram, tmp_path / "out.fmu"), diagram, stop_time=0.5)
        for name, values in columns(diagram, stop=0.5).items():
            np.testing.assert_allclose(made[name], values, atol=1e-14)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["communication_step", "held", "taken"])
def test_names_of_the_fmu_stay_its_own(tmp_path: Path, name: str) -> None:
    file = gauge_fmu(tmp_path, description(real=True).replace('name="scale"', f'name="{name}"'))
    diagram = with_gauge(file, **{name: 3.0})
    made = stepped(exported(diagram, tmp_path / "out.fmu"), diagram, stop_time=0.5)
    assert made["it.y"].tolist() == [3.0] * 6


@pytest.mark.slow
def test_an_input_of_the_outer_one_reaches_it(tmp_path: Path) -> None:
    """One that nothing in the diagram feeds, and that it takes beside its own value."""
    diagram = with_gauge(gauge_fmu(tmp_path, description(real=True)), wires=[], blocks={}, u=1.0)
    file = exported(diagram, tmp_path / "out.fmu", inputs=["it.u"])
    given = np.array([(0.0, 4.0), (1.0, 4.0)], dtype=[("time", float), ("it.u", float)])
    assert stepped(file, diagram, stop_time=0.5, input=given)["it.y"][1:].tolist() == [5.0] * 5


@pytest.mark.parametrize("kind", ["cs", "me"])
def test_it_begins_and_steps_at_hits_alone(fmu: Make, tmp_path: Path, kind: str) -> None:
    """Fed by what follows time alone: outputs may be read, and parameters set, as often as one likes before."""
    source = {"type": "constant", "parameters": {"value": 1.0}}
    diagram = with_gauge(gauge_fmu(tmp_path, description(real=True)), blocks={"in": source}, scale=2.0)
    with opened(exported(diagram, tmp_path / "out.fmu"), kind) as one:
        one.enter()
        assert one.get("it.y").tolist() == [0.0]
        one.put(["it.scale"], [3.0])
        one.leave()
        if kind == "me":
            assert one.update() == (True, pytest.approx(0.1))
        assert one.get("it.y").tolist() == [3.0]


def test_the_end_that_one_asks_for_is_that_of_the_outer_one(tmp_path: Path) -> None:
    """FMI 2.0: a step is discarded, and fmi2Terminated is true."""
    diagram = with_gauge(gauge_fmu(tmp_path, description(real=True)), end_at=0.55)
    with opened(exported(diagram, tmp_path / "out.fmu"), "cs", log=True) as one:
        one.begin()
        one.walk(["it.y"], 5, 0.1)
        with pytest.raises(Exception, match=r"DoStep failed with status 2 \(discard\)"):
            one.step(0.5, 0.1)
        assert "it asks for the end of the simulation (t = 0.6 s)" in [text for _, _, text in one.messages]


@pytest.mark.slow
@pytest.mark.parametrize("outer", ["2.0", "3.0"])
def test_a_step_that_fails_is_told(tmp_path: Path, outer: str) -> None:
    make_fmu(tmp_path / "plant2.fmu")
    diagram = of_plant(tmp_path, interface="cs", fault=FAULTS.index("fail"), fault_time=0.1)
    h = diagram.solver.step
    with opened(exported(diagram, tmp_path / "out.fmu", outer), "cs", log=True) as one:
        one.begin()
        one.walk(["it.y"], round(0.1 / h), h)
        with pytest.raises(Exception, match=r"DoStep failed with status 3 \(error\)"):
            one.step(0.1, h)
        assert "it: fmi2DoStep returned fmi2Error (t = 0.1 s)" in [text for _, _, text in one.messages]


def test_the_export_says_what_it_costs(fmu: Make, tmp_path: Path) -> None:
    [said] = export_fmu(with_fmu(fmu, "rotor", interface="cs"), tmp_path / "out.fmu").warnings
    assert str(said) == (
        "warning: rotor: is stepped by 0.0001 s with held inputs, which costs accuracy\n\n"
        "hint: `rotorsim run` of the diagram tells how much; a smaller step of the diagram costs less"
    )


@pytest.mark.slow
def test_the_command_refuses_a_step_that_makes_the_loop_unstable(fmu: Make, run: Any) -> None:
    document = dict(with_fmu(fmu, "controller", interface="cs").document)
    for step in ("0.1 ms", "1 ms"):
        Path("loop.json").write_text(json.dumps({**document, "solver": {**document["solver"], "step": step}}))
        done = run("fmu", "export", "loop.json", "--trust-blocks", "-o", f"{step[0]}.fmu")
        assert (done.exit_code, Path(f"{step[0]}.fmu").exists()) == ((0, True) if step == "0.1 ms" else (1, False))
    assert done.stderr.endswith(
        "error: step 0.001 s, gauss_seidel: with this step the coupled loop is unstable; the largest stable step is "
        "0.000788 s\n\nhint: a smaller step, or another master (iterative bears the largest steps)\n"
    )


def refused(diagram: Diagram, file: Path) -> str:
    with pytest.raises(RotorsimError) as caught:
        export_fmu(diagram, file)
    assert not file.exists()
    return str(caught.value)


def test_what_cannot_be_stepped_is_refused_by_name(fmu: Make, tmp_path: Path) -> None:
    out = tmp_path / "out.fmu"
    fixed = with_step(with_fmu(fmu, "rotor", "3.0", interface="cs"), 1.5e-4)
    assert refused(fixed, out) == (
        "error: rotor: takes steps of 0.0001 s, of which that of the diagram, 0.00015 s, is no multiple\n\n"
        'hint: "solver": {"step": ...} of the diagram'
    )
    make_fmu(tmp_path / "plant2.fmu", description=description2())
    file = make_fmu(tmp_path / "other.fmu")
    other = {"other": {"type": "fmu", "file": file.name, "parameters": {"interface": "cs"}}}
    assert refused(of_plant(tmp_path, blocks=other, interface="me"), out) == (
        f"error: other: is an FMU for Co-Simulation, which cannot step back to the events of it\n\nhint: {HINT}"
    )
    old = with_lag(lag_fmu(tmp_path))
    assert refused(old, out).startswith("error: it: is an FMU of FMI 1.0, which is not carried inside another")
