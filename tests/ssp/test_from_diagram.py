"""Diagrams out as systems of FMUs (SSP), and in again; judged by the schema, libcosim and FMPy."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from lxml import etree  # type: ignore[import-untyped]

from rotorsim.cosim.cosimulation import cosimulate_diagram
from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import RotorsimError
from rotorsim.model.emit.toolchain import find_compiler
from rotorsim.model.load import load
from rotorsim.ssp.from_diagram import ExportedSsp, export_ssp
from rotorsim.ssp.to_diagram import import_ssp
from tests.ssp.systems import document

SCHEMA = Path(fmpy.__file__).parent / "ssp" / "schema"
H, N = 1e-4, 200
needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="FMUs are built by a C compiler")


@pytest.fixture(scope="module")
def jeffcott(tmp_path_factory: pytest.TempPathFactory) -> ExportedSsp:
    folder = tmp_path_factory.mktemp("ssp")
    return export_ssp(load("jeffcott"), folder / "jeffcott.ssp", {"controller": ["controller"]})


@pytest.fixture(scope="module")
def right() -> np.ndarray:
    """Return the displacement in a plain loop that holds inputs and gets outputs right after each step."""
    diagram = load("jeffcott")
    found = cosimulate_diagram(diagram, [["controller"]], step=H, stop=N * H, master="jacobi", order=0, fast=True)
    return np.asarray(found["rotor.displacement"])


def with_values(file: Path, target: Path, member: str, old: str, new: str) -> Path:
    """Write a system again with another text in one of its files."""
    with zipfile.ZipFile(file) as source, zipfile.ZipFile(target, "w") as archive:
        for name in source.namelist():
            data = source.read(name)
            if name == member:
                assert old.encode() in data
                data = data.replace(old.encode(), new.encode())
            archive.writestr(name, data)
    return target


@pytest.mark.slow
@needs_compiler
def test_files_are_valid_by_the_schema(jeffcott: ExportedSsp) -> None:
    described = etree.XMLSchema(etree.parse(str(SCHEMA / "SystemStructureDescription.xsd")))
    parameters = etree.XMLSchema(etree.parse(str(SCHEMA / "SystemStructureParameterValues.xsd")))
    with zipfile.ZipFile(jeffcott.file) as archive:
        described.assertValid(etree.fromstring(archive.read("SystemStructure.ssd")))
        sets = [name for name in archive.namelist() if name.endswith(".ssv")]
        for name in sets:
            parameters.assertValid(etree.fromstring(archive.read(name)))
    assert len(sets) == 2


@needs_compiler
def test_every_input_has_one_connection(tmp_path: Path) -> None:
    """Forces of the crack, the unbalance and the bearing come to the rotor one by one."""
    parts = {"rotor": ["rotor"], "amb": ["amb", "controller"]}
    done = export_ssp(load("jeffcott"), tmp_path / "three.ssp", parts, platforms=())
    connections = done.structure.system.connections
    ends = [(c.end.element, c.end.connector) for c in connections]
    rotor = {name for element, name in ends if element == "rotor"}
    assert len(ends) == len(set(ends))
    assert rotor == {f"{block}.force[{k}]" for block in ("crack", "unbalance", "amb") for k in (1, 2)}
    inputs = {(c.name, x.name) for c in done.structure.system.components for x in c.connectors if x.kind == "input"}
    assert inputs == set(ends)
    found = import_ssp(done.file, tmp_path / "out").diagram
    assert {str(w.target) for w in found.wires if w.target.block == "rotor"} == {
        "rotor.crack_force",
        "rotor.unbalance_force",
        "rotor.amb_force",
    }


@needs_compiler
def test_libcosim_runs_it_as_our_plain_loop(jeffcott: ExportedSsp, right: np.ndarray) -> None:
    found = in_libcosim(jeffcott.file)
    assert np.abs(found - right[1:]).max() <= 1e-12 * np.abs(right).max()


@needs_compiler
def test_libcosim_applies_the_parameter_set(jeffcott: ExportedSsp, tmp_path: Path) -> None:
    member = "resources/controller.ssv"
    file = with_values(jeffcott.file, tmp_path / "a.ssp", member, 'value="12200.0"', 'value="15000.0"')
    diagram = load("jeffcott", set={"controller.KP": 15000.0})
    wanted = cosimulate_diagram(diagram, [["controller"]], step=H, stop=N * H, master="jacobi", order=0, fast=True)
    expected = wanted["rotor.displacement"][1:]
    assert np.abs(in_libcosim(file) - expected).max() <= 1e-12 * np.abs(expected).max()


def in_libcosim(file: Path) -> np.ndarray:
    execution_of = pytest.importorskip("libcosimpy.CosimExecution").CosimExecution
    observer_of = pytest.importorskip("libcosimpy.CosimObserver").CosimObserver
    execution = execution_of.from_ssp_file(str(file), step_size=round(H * 1e9))
    observer = observer_of.create_last_value()
    execution.add_observer(observer)
    index = execution.slave_index_from_instance_name("rest")
    references = {variable.name.decode(): variable.reference for variable in execution.slave_variables(index)}
    rows = []
    for _ in range(N):
        assert execution.step()
        rows.append(observer.last_real_values(index, [references[f"rotor.displacement[{k}]"] for k in (1, 2)]))
    return np.array(rows)


@needs_compiler
def test_fmpy_runs_it_as_our_plain_loop(jeffcott: ExportedSsp, right: np.ndarray) -> None:
    from fmpy.ssp.simulation import simulate_ssp

    rows = simulate_ssp(str(jeffcott.file), stop_time=(N - 0.5) * H, step_size=H)
    found = np.array([rows[f"rest.rotor.displacement[{k}]"] for k in (1, 2)]).T[:N]
    assert np.abs(found - right[1:]).max() <= 1e-12 * np.abs(right).max()


def run_imported(folder: Path) -> np.ndarray:
    inside = {"controller.in_process": True, "rest.in_process": True}
    diagram: Diagram = load(folder / "diagram.json", set=inside, trust_blocks=True)
    found = cosimulate_diagram(diagram, step=H, stop=N * H, master="jacobi", order=0, fast=True)
    return np.asarray(found["rest.rotor_displacement"])


@needs_compiler
def test_there_and_back(jeffcott: ExportedSsp, right: np.ndarray, tmp_path: Path) -> None:
    done = import_ssp(jeffcott.file, tmp_path / "back")
    assert done.warnings == ()
    assert [str(w.source) for w in done.diagram.wires] == [
        "rest.rotor_displacement",
        "rest.rotor_velocity",
        "controller.controller_current",
    ]
    assert done.diagram.solver.stop == load("jeffcott").solver.stop
    (tmp_path / "usual").mkdir()
    (tmp_path / "usual" / "file").touch()
    folders, files = ({p.stat().st_mode for p in tmp_path.rglob("*") if p.is_dir() == kind} for kind in (True, False))
    assert (len(folders), len(files)) == (1, 1)  # all as the umask wants it
    assert np.abs(run_imported(tmp_path / "back") - right).max() <= 1e-12 * np.abs(right).max()


@pytest.mark.slow
@needs_compiler
def test_fmi_3_makes_it_ssp_2(right: np.ndarray, tmp_path: Path) -> None:
    done = export_ssp(load("jeffcott"), tmp_path / "two.ssp", {"controller": ["controller"]}, version="3.0")
    assert done.structure.version == "2.0"
    with zipfile.ZipFile(done.file) as archive:
        assert b"ssc:Float64" in archive.read("SystemStructure.ssd")
    import_ssp(done.file, tmp_path / "back")
    assert np.abs(run_imported(tmp_path / "back") - right).max() <= 1e-12 * np.abs(right).max()


@needs_compiler
def test_a_diagram_of_fmus_goes_as_it_is(jeffcott: ExportedSsp, right: np.ndarray, tmp_path: Path) -> None:
    """Import, change a parameter, export, import: the same diagram again."""
    first = import_ssp(jeffcott.file, tmp_path / "first")
    diagram = load(first.file, set={"controller.controller_KP": 15000.0})
    again = export_ssp(diagram, tmp_path / "again.ssp")
    assert {c.name: [s.name for s in c.settings] for c in again.structure.system.components} == {
        "controller": ["controller.KP"],
        "rest": [],
    }
    assert again.structure.version == "1.0"
    ends = {(c.start, c.end) for c in jeffcott.structure.system.connections}
    assert {(c.start, c.end) for c in again.structure.system.connections} == ends
    second = import_ssp(again.file, tmp_path / "second")
    expected = json.loads(first.file.read_text())
    expected["blocks"]["controller"]["parameters"] = {"controller_KP": 15000.0}
    expected.pop("description", None)
    found = document(second)
    found.pop("description", None)
    assert sorted(found.pop("wires")) == sorted(expected.pop("wires"))
    assert found == expected


@needs_compiler
def test_fmus_beside_blocks(jeffcott: ExportedSsp, tmp_path: Path) -> None:
    """A gain between two FMUs is a part; two outputs that add up at an FMU are refused."""
    import_ssp(jeffcott.file, tmp_path / "back")
    text = json.loads((tmp_path / "back" / "diagram.json").read_text())
    text["blocks"]["half"] = {"type": "gain", "parameters": {"gain": 0.5}}
    text["wires"][2:] = [["controller.controller_current", "half.input"], ["half.output", "rest.controller_current"]]
    done = export_ssp(load(text, folder=tmp_path / "back"), tmp_path / "mixed.ssp", {"half": ["half"]})
    assert done.blocks == {"half": ("half",), "controller": ("controller",), "rest": ("rest",)}
    joined = {
        (f"{c.start.element}.{c.start.connector}", f"{c.end.element}.{c.end.connector}")
        for c in done.structure.system.connections
    }
    assert ("controller.controller.current[1]", "half.controller.controller_current[1]") in joined
    assert ("half.half.output[2]", "rest.controller.current[2]") in joined
    text["wires"].append(["controller.controller_current", "rest.controller_current"])
    with pytest.raises(RotorsimError, match="2 outputs add up here"):
        export_ssp(load(text, folder=tmp_path / "back"), tmp_path / "no.ssp", {"half": ["half"]})
    assert not (tmp_path / "no.ssp").exists()


@pytest.mark.parametrize(
    ("parts", "what"),
    [
        ({"a": ["controler"]}, "no such block"),
        ({"a": ["rotor"], "b": ["rotor"]}, "is in the parts twice"),
        ({"a b": ["rotor"]}, "is not a name"),
        ({"../a": ["rotor"]}, "is not a name"),
        ({"rest": ["rotor"]}, "take another name"),
        ({"a": []}, "has no blocks"),
    ],
)
def test_parts_that_do_not_fit(tmp_path: Path, parts: dict[str, list[str]], what: str) -> None:
    with pytest.raises(RotorsimError) as caught:
        export_ssp(load("jeffcott"), tmp_path / "a.ssp", parts)
    assert what in "\n".join(str(problem) for problem in caught.value.problems)
    assert not list(tmp_path.iterdir())


# ---- command line ----


@pytest.mark.slow
@needs_compiler
def test_command_line(run: Any, tmp_path: Path) -> None:
    out = run("ssp", "export", "jeffcott", "--part", "controller=controller", "-o", "j.ssp")
    assert out.exit_code == 0, out.output
    assert "SSP 1.0, 6 connections" in out.output
    out = run("ssp", "import", "j.ssp", "-o", "j", "--json")
    assert out.exit_code == 0, out.output
    assert json.loads(out.stdout)["blocks"] == {"controller": "fmu", "rest": "fmu"}
    out = run("cosim", "j/diagram.json", "--trust-blocks", "--step", "0.1 ms", "--stop", "0.01 s", "--json")
    assert out.exit_code == 0, out.output


@pytest.mark.parametrize(
    "arguments",
    [
        ("export", "jeffcott", "--part", "controller", "-o", "j.ssp"),
        ("export", "jeffcott", "--part", "a=rotor", "--part", "a=amb", "-o", "j.ssp"),
        ("export", "jeffcott", "-o", "j.zip"),
        ("import", "none.ssp", "-o", "j"),
        ("exprt", "jeffcott"),
    ],
)
def test_misuse_is_said(run: Any, tmp_path: Path, arguments: tuple[str, ...]) -> None:
    out = run("ssp", *arguments)
    assert out.exit_code not in (0, None)
    assert "Traceback" not in out.output
    assert not list(tmp_path.iterdir())
