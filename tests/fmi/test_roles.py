"""An FMU in the place of a block: its ports by other names, and what is tried in the wires around it."""

from __future__ import annotations

import copy
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rotorsim.block import Block, In, Out
from rotorsim.diagnosis.catalogue.finder import insertions
from rotorsim.diagnosis.diagnosis import parts_without_role
from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import RotorsimError
from rotorsim.model.load import load
from rotorsim.simulation.run import simulate
from tests.cli.conftest import Run
from tests.fmi.conftest import Make
from tests.fmi.plant import make_fmu
from tests.fmi.test_equations import BOTH, of_plant, with_fmu
from tests.fmi.test_linear import rewritten

RECORDED = ("rotor.displacement", "controller.current")
PORTS = {"force": ["F_x", "F_y"], "displacement": ["s_x", "s_y"], "velocity": ["v.x", "v.y"]}


def test_a_part_without_a_role_is_told(fmu: Make, tmp_path: Path) -> None:
    assert parts_without_role(with_fmu(fmu, "rotor")) == []
    make_fmu(tmp_path / "plant2.fmu")
    assert [str(one) for one in parts_without_role(of_plant(tmp_path))] == [
        "warning: it: its ports do not say what it is: faults of rotors, bearings and controllers are not "
        'tried there\n\nhint: "ports" among its parameters names them: displacement, velocity, current, force'
    ]


def places(diagram: Diagram) -> set[tuple[str, int, str]]:
    """Return physics, variant and place of all candidates."""
    return {(item.physics, item.variant, str(item.spot)) for item in insertions(diagram, RECORDED)}


@pytest.mark.slow
@BOTH
@pytest.mark.parametrize("block", ["rotor", "controller", "amb"])
def test_the_same_candidates_as_around_plain_blocks(fmu: Make, block: str, version: str) -> None:
    """But for other laws of a magnetic bearing, which would take the place of what is inside."""
    lost = places(load("jeffcott")) - places(with_fmu(fmu, block, version))
    assert {physics for physics, _, _ in lost} == (
        {"magnetic_nonlinearity", "magnetic_saturation"} if block == "amb" else set()
    )
    assert places(with_fmu(fmu, block, version)) <= places(load("jeffcott"))


@pytest.mark.parametrize(
    ("ins", "outs", "roles"),
    [
        (["force"], ["displacement", "velocity"], {"rotor"}),
        (["current"], ["displacement"], {"rotor", "bearing"}),
        (["displacement", "velocity"], ["current"], {"controller"}),
        (["displacement", "current"], ["force"], {"bearing"}),
        (["displacement"], ["force"], {"bearing"}),
        (["force"], ["temperature"], set()),
        (["input"], ["output"], set()),
    ],
)
def test_what_a_block_is_in_a_machine(ins: Iterable[str], outs: Iterable[str], roles: set[str]) -> None:
    ports = {f"i_{name}": In(name=name) for name in ins} | {f"o_{name}": Out(name=name) for name in outs}
    assert type("Mine", (Block,), dict(ports)).roles == roles | {"elementary"}
    assert type("Law", (Block,), {**ports, "category": "fault"}).roles == {"fault"}


@pytest.fixture(scope="module")
def supplied(fmu: Make, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the rotor of jeffcott with the names of a supplier."""

    def change(text: str) -> str:
        for name, members in PORTS.items():
            for k, member in enumerate(members, 1):
                text = text.replace(f'"rotor.{name}[{k}]"', f'"{member}"')
        return text

    return rewritten(fmu("jeffcott", blocks=["rotor"]), tmp_path_factory.mktemp("supplied") / "rotor.fmu", change)


def supplied_document(file: Path, **values: Any) -> dict[str, Any]:
    """Return jeffcott with that rotor."""
    document = copy.deepcopy(dict(load("jeffcott").document))
    document["blocks"]["rotor"] = {"type": "fmu", "file": file.name, "parameters": {"in_process": True, **values}}
    return document


def test_ports_by_other_names(supplied: Path) -> None:
    """The run is that of the plain diagram, and so are the candidates."""
    diagram = load(supplied_document(supplied, ports=PORTS), folder=supplied.parent, trust_blocks=True)
    assert {name: port.shape for name, port in diagram.nodes["rotor"].outputs.items()} == {
        "displacement": (2,),
        "velocity": (2,),
    }
    plain, found = (simulate(one, stop=0.05) for one in (load("jeffcott"), diagram))
    for name in plain.signals:
        np.testing.assert_allclose(found[name], plain[name], rtol=0, atol=1e-12 * np.abs(plain[name]).max())
    assert places(diagram) == places(load("jeffcott"))


def test_one_variable_and_a_whole_array_by_other_names(fmu: Make) -> None:
    ports = {"F": "rotor.force", "x": "rotor.displacement[1]", "y": ["rotor.displacement[2]"]}
    block = {"type": "fmu", "file": str(fmu("jeffcott", blocks=["rotor"])), "parameters": {"ports": ports}}
    node = load({"name": "it", "blocks": {"it": block}}).nodes["it"]
    assert {name: port.shape for name, port in (node.inputs | node.outputs).items()} == {
        "F": (2,),
        "x": (),
        "y": (1,),
        "velocity": (2,),
    }


def test_what_is_wrong_with_names_of_ports_is_said_where_they_are(fmu: Make, tmp_path: Path) -> None:
    file = fmu("jeffcott", blocks=["rotor"])

    def said(ports: Any) -> str:
        document = {"blocks": {"r": {"type": "fmu", "file": str(file), "parameters": {"ports": ports}}}, "name": "it"}
        path = tmp_path / "it.json"
        path.write_text(json.dumps(document, indent=1))
        with pytest.raises(RotorsimError) as caught:
            load(path)
        return str(caught.value).replace(str(path), "it.json")

    form = '{"displacement": ["x", "y"], "force": ["F_x", "F_y"]}: variables of the FMU, by the names of ports'
    assert said(["x"]) == f"it.json:7:14: error: r.ports: must be an object\n\nhint: {form}"
    twice = {"a b": "rotor.force", "y": 3, "x": ["rotor.velocity[1]"], "z": "rotor.velocity[1]"}
    assert said(twice) == (
        "it.json:7:14: error: r.ports: 'a b' cannot be the name of a port\n\n"
        "hint: letters, digits and _, not a digit first\n"
        f"it.json:7:14: error: r.ports: 'y' is no variable or list of variables\n\nhint: {form}\n"
        "it.json:7:14: error: r.ports: the variable 'rotor.velocity[1]' is named twice\n\nhint: each once"
    )
    entries = {"F": ["rotor.force"], "G": "rotor.velocity", "H": "rotor.velocity[1]"}
    assert said(entries) == (
        "it.json:7:14: error: r.ports: 'rotor.velocity' is an array, and one of its entries is named, too\n\n"
        "hint: the array or its entries\n"
        "it.json:7:14: error: r.ports: 'rotor.force' is an array\n\n"
        'hint: "F": "rotor.force", or its entries, rotor.force[1], ...'
    )
    assert said({"displacement": "rotor.force"}) == (
        "it.json:7:14: error: r.ports: 'displacement' is an input and an output\n\nhint: a name of its own for each"
    )
    assert said({"x": ["rotor.displacement[1]", "rotor.force[1]"], "y": "rotor.velocit"}) == (
        "it.json:7:14: error: r.ports: 'x' has inputs and outputs\n\nhint: a port is one or the other\n"
        "it.json:7:14: error: r.ports: the FMU has no input or output 'rotor.velocit'\n\n"
        "hint: did you mean 'rotor.velocity' or 'rotor.velocity[2]' or 'rotor.velocity[1]'?"
    )


def test_swap_gives_ports_their_names(run: Run, supplied: Path, tmp_path: Path) -> None:
    target = tmp_path / "mine.json"
    given = ["--set", f"file={supplied}", "-o", str(target)]
    bare = run("swap", "jeffcott", "rotor", "fmu", *given)
    assert bare.stderr.startswith(
        "error: rotor.force: block type 'fmu' has no input 'force'\n\n"
        'hint: known: F_x, F_y; "ports": {"force": ...} among its parameters gives its variables this name\n'
    )
    assert (bare.exit_code, target.exists()) == (2, False)
    run("swap", "jeffcott", "rotor", "fmu", *given, "--set", f"ports={json.dumps(PORTS)}")
    assert json.loads(target.read_text())["blocks"]["rotor"]["parameters"]["ports"] == PORTS
    assert run("check", str(target)).exit_code == 0
