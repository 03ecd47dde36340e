"""How often an FMU for Co-Simulation is stepped: as often as it allows, and never in silence."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from rotorsim.cosim.cosimulation import cosimulate_diagram
from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import RotorsimError
from tests.cli.conftest import Run
from tests.fmi.gauge import description, gauge_fmu, with_gauge


def ramped(folder: Path, varies: str, **more: Any) -> Diagram:
    file = gauge_fmu(folder, description(varies=varies))
    return with_gauge(file, "ramp", record=["it.steps", "it.y"], step=0.01, more={"slope": 1.0}, **more)


@pytest.mark.parametrize("master", ["jacobi", "gauss_seidel", "waveform"])
@pytest.mark.parametrize("varies", ["false", "0"])
def test_a_step_is_one_step_where_steps_cannot_vary(tmp_path: Path, master: str, varies: str) -> None:
    found = cosimulate_diagram(ramped(tmp_path, varies), step=0.2, master=master)
    assert found["it.steps"][-1] % 5 == 0
    assert found.provenance["fmus"]["it"]["most_parts"] == 1
    if master != "waveform":
        assert found["it.steps"].tolist() == [0, 1, 2, 3, 4, 5]


def test_absent_means_that_steps_cannot_vary(tmp_path: Path) -> None:
    text = description().replace('canHandleVariableCommunicationStepSize="true"', "")
    diagram = with_gauge(gauge_fmu(tmp_path, text), "ramp", record=["it.steps"], step=0.01, more={"slope": 1.0})
    assert cosimulate_diagram(diagram, step=0.2, order=1)["it.steps"].tolist() == [0, 1, 2, 3, 4, 5]


def test_steps_in_parts_are_said(tmp_path: Path, run: Run) -> None:
    diagram = ramped(tmp_path, "true")
    found = cosimulate_diagram(diagram, step=0.2, order=1)
    assert found["it.steps"][-1] == 100  # five in 20 parts
    assert found.provenance["fmus"]["it"] | {"do_steps": 100, "most_parts": 20} == found.provenance["fmus"]["it"]
    (tmp_path / "d.json").write_text(json.dumps(dict(diagram.document)))
    text = run("cosim", "--trust-blocks", str(tmp_path / "d.json"), "--step", "0.2 s", "--order", "1").stdout
    assert "it: its inputs move within a step: taken in up to 20 parts, 100 calls of doStep\n" in text


@pytest.mark.parametrize(
    ("step", "options", "what", "hint"),
    [
        (
            0.3,
            {},
            "cannot vary its communication step: its steps of 0.3 s do not divide the stop time 1 s",
            "such as --step '0.333333333333333 s'",
        ),
        (
            0.1,
            {"rates": {"it": 3}},
            "cannot vary its communication step: its steps of 0.3 s do not divide the stop time 1 s",
            "such as --step '0.111111111111111 s'",
        ),
    ],
)
def test_steps_that_do_not_divide_the_run(
    tmp_path: Path, step: float, options: dict[str, Any], what: str, hint: str
) -> None:
    with pytest.raises(RotorsimError) as caught:
        cosimulate_diagram(ramped(tmp_path, "false"), step=step, **options)
    problem = caught.value.problems[0]
    assert (problem.subject, problem.what, problem.hint) == ("it", what, hint)


def test_the_step_of_the_hint_fits(tmp_path: Path) -> None:
    found = cosimulate_diagram(ramped(tmp_path, "false"), step=0.333333333333333)
    assert (found.status, found["it.steps"].tolist()) == ("finished", [0, 1, 2, 3])


def test_the_fast_loop_takes_whole_steps(tmp_path: Path) -> None:
    """It rounded: 1.05 s of 1 s."""
    diagram = with_gauge(gauge_fmu(tmp_path, description(real=True)), stop=1.0)
    with pytest.raises(RotorsimError) as caught:
        cosimulate_diagram(diagram, step=0.35, fast=True)
    problem = caught.value.problems[0]
    assert problem.what == "takes whole steps: 0.35 s does not divide 1 s"
    assert problem.hint == "such as --step '0.333333333333333 s'"


def test_sample_hits_between_equal_steps(tmp_path: Path) -> None:
    """A sampled block whose hits (0.25 s) are no communication points (0.1 s) would cut a step."""
    blocks = {
        "in": {"type": "ramp", "parameters": {"slope": 1.0}},
        "held": {"type": "sample_hold", "parameters": {"sample_time": "0.25 s"}},
    }
    wires = [["in.output", "held.input"], ["held.output", "it.u"]]
    diagram = with_gauge(gauge_fmu(tmp_path, description(varies="false")), wires=wires, blocks=blocks)
    found = cosimulate_diagram(diagram, step=0.1)
    assert found.status == "stopped"
    assert "it: cannot vary its communication step: the first was 0.1 s, this would be one of 0.05 s" in found.message
    assert "that divide the stop time and the sample times of the others" in found.message
    assert cosimulate_diagram(diagram, step=0.05).status == "finished"
