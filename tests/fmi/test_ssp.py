"""Systems of FMUs (SSP): diagrams out, systems in, hostile archives; judged by the schema, libcosim and FMPy."""

from __future__ import annotations

import json
import re
import zipfile
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from lxml import etree  # type: ignore[import-untyped]

from rotorsim.compile.toolchain import find_compiler
from rotorsim.diagram.diagram import Diagram
from rotorsim.diagram.load import load
from rotorsim.errors import RotorsimError
from rotorsim.fmi.archive import Limits
from rotorsim.fmi.cosimulation import cosimulate_diagram
from rotorsim.fmi.ssp import ExportedSsp, export_ssp
from rotorsim.fmi.ssp_import import ImportedSsp, import_ssp
from tests.fmi.plant import make_fmu

SCHEMA = Path(fmpy.__file__).parent / "ssp" / "schema"
H, N = 1e-4, 200
needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="FMUs are built by a C compiler")


# ---- systems made by hand ----


def fmu_text(name: str, unit: str = "m", factor: float = 1.0) -> str:
    """Return a model description: u[1], u[2] and s in, y[1], y[2] and q out, parameters k[1], k[2] and c."""
    rows = [
        ("u[1]", "input", f'start="0" unit="{unit}"'), ("u[2]", "input", f'start="0" unit="{unit}"'),
        ("s", "input", 'start="0"'), ("y[1]", "output", f'unit="{unit}"'), ("y[2]", "output", f'unit="{unit}"'),
        ("q", "output", ""), ("k[1]", "parameter", f'start="1" unit="{unit}"'),
        ("k[2]", "parameter", f'start="2" unit="{unit}"'), ("c", "parameter", 'start="5"'),
    ]  # fmt: skip
    variables = "".join(
        f'<ScalarVariable name="{n}" valueReference="{k}" causality="{c}"'
        f"{' variability=' + chr(34) + 'fixed' + chr(34) if c == 'parameter' else ''}><Real {more}/></ScalarVariable>"
        for k, (n, c, more) in enumerate(rows)
    )
    outputs = "".join(f'<Unknown index="{k}"/>' for k in (4, 5, 6))
    base = f'<UnitDefinitions><Unit name="{unit}"><BaseUnit m="1" factor="{factor!r}"/></Unit></UnitDefinitions>'
    return (
        f'<fmiModelDescription fmiVersion="2.0" modelName="{name}" guid="{name}">'
        f'<CoSimulation modelIdentifier="{name}"/>{base}<ModelVariables>{variables}</ModelVariables>'
        f"<ModelStructure><Outputs>{outputs}</Outputs></ModelStructure></fmiModelDescription>"
    )


def fmu_bytes(folder: Path, text: str) -> bytes:
    with zipfile.ZipFile(folder / "one.fmu", "w") as archive:
        archive.writestr("modelDescription.xml", text)
    return (folder / "one.fmu").read_bytes()


def connectors(*, unit: str = "") -> str:
    shown = f' unit="{unit}"' if unit else ""
    kinds = {"u[1]": "input", "u[2]": "input", "s": "input", "y[1]": "output", "y[2]": "output", "q": "output"}
    inside = "".join(
        f'<ssd:Connector name="{n}" kind="{k}"><ssc:Real{shown if n[0] in "uy" else ""}/></ssd:Connector>'
        for n, k in kinds.items()
    )
    return f"<ssd:Connectors>{inside}</ssd:Connectors>"


def component(name: str, more: str = "", source: str = "resources/m.fmu", unit: str = "") -> str:
    return f'<ssd:Component name="{name}" source="{source}">{connectors(unit=unit)}{more}</ssd:Component>'


def wire(start: str, end: str, inside: str = "", **more: str) -> str:
    ends = []
    for which, text in (("start", start), ("end", end)):
        element, _, name = text.rpartition(".")
        ends.append((f'{which}Element="{element}" ' if element else "") + f'{which}Connector="{name}"')
    extra = " ".join(f'{key}="{value}"' for key, value in more.items())
    return f"<ssd:Connection {' '.join(ends)} {extra}>{inside}</ssd:Connection>"


def values(*pairs: tuple[str, Any], unit: str = "", units: str = "") -> str:
    shown = f' unit="{unit}"' if unit else ""
    inside = "".join(f'<ssv:Parameter name="{n}"><ssv:Real value="{v}"{shown}/></ssv:Parameter>' for n, v in pairs)
    return (
        '<ssd:ParameterBindings><ssd:ParameterBinding><ssd:ParameterValues><ssv:ParameterSet version="1.0" name="p">'
        f"<ssv:Parameters>{inside}</ssv:Parameters>{units}</ssv:ParameterSet></ssd:ParameterValues>"
        "</ssd:ParameterBinding></ssd:ParameterBindings>"
    )


MM = '<ssc:Unit name="mm"><ssc:BaseUnit m="1" factor="0.001"/></ssc:Unit>'


def system(elements: str, connections: str = "", *, before: str = "", units: str = "", version: str = "1.0") -> str:
    spaces = " ".join(
        f'xmlns:{short}="http://ssp-standard.org/SSP1/SystemStructure{long}"'
        for short, long in (("ssd", "Description"), ("ssc", "Common"), ("ssv", "ParameterValues"))
    )
    joined = f"<ssd:Connections>{connections}</ssd:Connections>" if connections else ""
    return (
        f'<ssd:SystemStructureDescription {spaces} version="{version}" name="made">'
        f'<ssd:System name="root">{before}<ssd:Elements>{elements}</ssd:Elements>{joined}</ssd:System>'
        f'{f"<ssd:Units>{units}</ssd:Units>" if units else ""}<ssd:DefaultExperiment startTime="0" stopTime="2"/>'
        "</ssd:SystemStructureDescription>"
    )


def written(folder: Path, text: str, **more: bytes) -> Path:
    """Write a system; m.fmu is in metres, mm.fmu in millimetres."""
    with zipfile.ZipFile(folder / "made.ssp", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("SystemStructure.ssd", text)
        archive.writestr("resources/m.fmu", fmu_bytes(folder, fmu_text("plant")))
        archive.writestr("resources/mm.fmu", fmu_bytes(folder, fmu_text("gauge", "mm", 1e-3)))
        for name, data in more.items():
            archive.writestr(f"resources/{name.replace('__', '.')}", data)
    return folder / "made.ssp"


def imported(folder: Path, text: str, **more: bytes) -> ImportedSsp:
    return import_ssp(written(folder, text, **more), folder / "out")


def refusal(folder: Path, text: str) -> str:
    """Return all that is said against a system; nothing may be left behind."""
    file = written(folder, text)
    with pytest.raises(RotorsimError) as caught:
        import_ssp(file, folder / "out")
    assert not (folder / "out").exists()
    assert {path.name for path in folder.iterdir()} <= {"one.fmu", "made.ssp"}
    return "\n".join(str(problem) for problem in caught.value.problems)


def document(done: ImportedSsp) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(done.file.read_text())
    return found


def test_components_wires_and_solver(tmp_path: Path) -> None:
    pair = component("a") + component("b.c")
    joined = wire("a.y[1]", "b.c.u[1]") + wire("a.y[2]", "b.c.u[2]") + wire("b.c.s", "a.q") + wire("b.c.y[2]", "a.u[1]")
    found = document(imported(tmp_path, system(pair, joined)))
    assert found["blocks"] == {
        "a": {"type": "fmu", "file": "resources/m.fmu", "parameters": {}},
        "b_c": {"type": "fmu", "file": "resources/m.fmu", "parameters": {}},
    }
    # whole ports where every entry goes to its own; start and end say nothing of the direction
    assert sorted(found["wires"]) == [["a.q", "b_c.s"], ["a.y", "b_c.u"], ["b_c.y[2]", "a.u[1]"]]
    assert found["solver"]["stop"] == 2.0
    assert (tmp_path / "out" / "resources" / "m.fmu").is_file()
    assert not (tmp_path / "out" / "resources" / "mm.fmu").exists()  # nothing refers to it


def test_units_are_converted_by_gains(tmp_path: Path) -> None:
    pair = component("a") + component("b", source="resources/mm.fmu", unit="mm")
    joined = wire("a.y[1]", "b.u[1]") + wire("a.y[2]", "b.u[2]") + wire("b.y[1]", "a.u[2]")
    found = document(imported(tmp_path, system(pair, joined, units=MM)))
    gains = {name: block["parameters"]["gain"] for name, block in found["blocks"].items() if block["type"] == "gain"}
    assert gains == {"b_u_gain": pytest.approx(1000.0, rel=1e-15), "a_u_gain": 1e-3}
    assert ["a.y", "b_u_gain.input"] in found["wires"]
    assert ["a_u_gain.output", "a.u[2]"] in found["wires"]


@pytest.mark.parametrize(
    ("suppress", "factor", "gain"),
    [("false", "2", 2000.0), ("true", "1000", 1000.0), ("true", "1", 1.0), ("false", "0.001", 1.0)],
)
def test_factors_come_after_units(tmp_path: Path, suppress: str, factor: str, gain: float) -> None:
    pair = component("a") + component("b", source="resources/mm.fmu")
    linear = f'<ssc:LinearTransformation factor="{factor}"/>'
    joined = wire("a.y[1]", "b.u[1]", linear, suppressUnitConversion=suppress)
    found = document(imported(tmp_path, system(pair, joined)))
    assert found["blocks"]["b_u_gain"]["parameters"]["gain"] == pytest.approx(gain, rel=1e-15)


def test_nested_systems_are_flattened_and_outer_values_win(tmp_path: Path) -> None:
    ports = (
        '<ssd:Connectors><ssd:Connector name="in" kind="input"><ssc:Real/></ssd:Connector>'
        '<ssd:Connector name="out" kind="output"/><ssd:Connector name="gain" kind="parameter"/></ssd:Connectors>'
    )
    own = '<ssd:Connectors><ssd:Connector name="s" kind="input"/><ssd:Connector name="q" kind="output"/>'
    own += '<ssd:Connector name="c" kind="parameter"/></ssd:Connectors>'
    deep = f'<ssd:Component name="a" source="resources/m.fmu">{own}{values(("k[2]", 7), ("k[1]", 8))}</ssd:Component>'
    joined = wire("in", "a.s") + wire("a.q", "out") + wire("gain", "a.c")
    sub = (
        f'<ssd:System name="left">{ports}{values(("a.k[1]", 9))}<ssd:Elements>{deep}</ssd:Elements>'
        f"<ssd:Connections>{joined}</ssd:Connections></ssd:System>"
    )
    top = '<ssd:Connectors><ssd:Connector name="result" kind="output"/><ssd:Connector name="free" kind="input"/>'
    top += "</ssd:Connectors>" + values(("left.gain", 3), ("nobody", 1))
    outer = wire("left.out", "b.s") + wire("b.q", "left.in") + wire("left.out", "result") + wire("free", "b.u[1]")
    done = imported(tmp_path, system(sub + component("b"), outer, before=top))
    found = document(done)
    assert found["blocks"]["left_a"]["parameters"] == {"c": 3.0, "k": [9.0, 7.0]}
    assert sorted(found["wires"]) == [["b.q", "left_a.s"], ["left_a.q", "b.s"]]
    assert found["record"] == ["left_a.q"]  # what leaves the system
    said = "\n".join(str(warning) for warning in done.warnings)
    assert "nobody" in said
    assert "inputs of the whole system, which nothing feeds: free" in said


def test_values_are_in_the_units_that_they_state(tmp_path: Path) -> None:
    given = values(("k[2]", 4000), unit="mm", units=f"<ssv:Units>{MM}</ssv:Units>")
    done = imported(tmp_path, system(component("a", given) + component("b", values(("u[2]", 3)))))
    blocks = document(done)["blocks"]
    assert blocks["a"]["parameters"] == {"k": [1.0, 4.0]}
    assert blocks["b"]["parameters"] == {"u": [0.0, 3.0]}  # nothing feeds it: its start value


def test_arrays_of_ssp_2(tmp_path: Path) -> None:
    """Connectors of FMI 3.0 are arrays: whole, or entry by entry."""
    make_fmu(tmp_path / "plant.fmu", "3.0", library_bytes=b"none")
    plant = (tmp_path / "plant.fmu").read_bytes()
    (tmp_path / "plant.fmu").unlink()
    ports = "".join(
        f'<ssd:Connector name="{n}" kind="{k}"><ssc:Float64/><ssc:Dimension size="2"/></ssd:Connector>'
        for n, k in (("u", "input"), ("y", "output"))
    )
    both = "".join(
        f'<ssd:Component name="{n}" source="resources/p.fmu"><ssd:Connectors>{ports}</ssd:Connectors></ssd:Component>'
        for n in "ab"
    )
    plain = wire("a.y", "b.u", suppressUnitConversion="true")
    crossed = wire("b.y", "a.u", suppressUnitConversion="true", startIndices="2", endIndices="1")
    with pytest.raises(RotorsimError, match=re.escape("units do not fit: m into N")):
        imported(tmp_path, system(both, wire("a.y", "b.u"), version="2.0"), p__fmu=plant)
    linear = '<ssc:LinearTransformation factor="3"/>'
    joined = plain.replace("></ssd", f">{linear}</ssd") + crossed.replace("></ssd", f">{linear}</ssd")
    found = document(imported(tmp_path, system(both, joined, version="2.0"), p__fmu=plant))
    assert ["a.y", "b_u_gain.input"] in found["wires"]
    assert ["b.y[2]", "a_u_gain.input"] in found["wires"]
    assert ["a_u_gain.output", "a.u[1]"] in found["wires"]


@pytest.mark.parametrize(
    ("elements", "joined", "what"),
    [
        (component("a"), wire("a.y[1]", "a.nothing"), "element 'a' has no connector 'nothing'"),
        (component("a"), wire("a.y[1]", "b.s"), "element 'b' has no connector 's'"),
        (component("a"), wire("a.y[1]", "a.s") + wire("a.q", "a.s"), "is fed by two connections"),
        (component("a"), wire("a.y[1]", "a.q"), "two sources are connected"),
        (component("a"), wire("a.q", "a.s", '<ssc:LinearTransformation offset="1"/>'), "with an offset (1)"),
        (component("a"), wire("a.q", "a.s", "<ssc:BooleanMappingTransformation/>"), "BooleanMapping"),
        (component("a", source="../m.fmu"), "", "the name leaves its folder"),
        (component("a", source="file:///etc/passwd"), "", "it is not relative"),
        (component("a", source="http://x/m.fmu"), "", "it is not relative"),
        (component("a", source="resources/%2e%2e/%2e%2e/m.fmu"), "", "the name leaves its folder"),
        (component("a", source="resources/none.fmu"), "", "there is no such file"),
        (component("a", source="#other"), "", "a part of a document is not supported"),
        (component("a") + component("a"), "", "is the name of two elements"),
        ('<ssd:SignalDictionaryReference name="d" dictionary="x"/>', "", "SignalDictionaryReference is not supported"),
        (component("a", values(("c", "five"))), "", "is not of type Real"),
        (component("a", values(("q", 1))), "", "cannot be set"),
        (component("a", values(("c", 1), unit="mm")), "", "the unit 'mm' is not among the Units"),
        (component("a", unit="mm"), "", "the unit 'mm' is not among the Units"),
        (component("a").replace('source="', 'type="application/x-ssp-package" source="'), "", "only FMUs"),
        (component("a").replace('source="', 'implementation="ScheduledExecution" source="'), "", "not supported"),
        (component("a").replace('name="q" kind="output"', 'name="q" kind="input"'), "", "is of kind input"),
        (component("a").replace('name="q"', 'name="zz"'), "", "the FMU has no variable of this name"),
    ],
)  # fmt: skip
def test_what_is_wrong_or_not_supported_is_named(tmp_path: Path, elements: str, joined: str, what: str) -> None:
    assert what in refusal(tmp_path, system(elements, joined))


def test_systems_that_feed_themselves(tmp_path: Path) -> None:
    ports = '<ssd:Connectors><ssd:Connector name="i" kind="input"/><ssd:Connector name="o" kind="output"/>'
    ports += "</ssd:Connectors>"
    sub = f'<ssd:System name="s">{ports}<ssd:Connections>{wire("i", "o")}</ssd:Connections></ssd:System>'
    joined = wire("s.o", "s.i") + wire("s.o", "a.s")
    assert "in a circle" in refusal(tmp_path, system(sub + component("a"), joined))


# ---- hostile archives ----


def test_a_document_type_is_refused(tmp_path: Path) -> None:
    text = '<!DOCTYPE x [<!ENTITY a "b">]>' + system(component("a"))
    assert "a document type" in refusal(tmp_path, text)


@pytest.mark.parametrize("name", ["../evil", "/evil", "a/../../evil", "C:/evil", "..\\evil"])
def test_names_that_leave_the_folder_are_refused(tmp_path: Path, name: str) -> None:
    file = written(tmp_path, system(component("a")))
    with zipfile.ZipFile(file, "a") as archive:
        entry = zipfile.ZipInfo("x")
        entry.filename = entry.orig_filename = name
        archive.writestr(entry, b"evil")
    with pytest.raises(RotorsimError, match="the name"):
        import_ssp(file, tmp_path / "out")
    assert not list(tmp_path.rglob("evil"))
    assert not (tmp_path / "out").exists()


def test_a_bomb_is_refused(tmp_path: Path) -> None:
    file = written(tmp_path, system(component("a")), zeros__bin=bytes(1 << 20))
    with pytest.raises(RotorsimError, match="bomb"):
        import_ssp(file, tmp_path / "out", limits=Limits(ratio=2.0, free=1 << 16))
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "text", ["", "<x/>", "<ssd:SystemStructureDescription/>", "<a>" * 40, system("", version="3.0"), system("")]
)
def test_what_is_no_system_is_refused(tmp_path: Path, text: str) -> None:
    assert refusal(tmp_path, text)


def test_a_folder_in_use_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine").write_text("kept")
    with pytest.raises(RotorsimError, match="not empty"):
        import_ssp(written(tmp_path, system(component("a"))), tmp_path / "out")
    assert (tmp_path / "out" / "mine").read_text() == "kept"


# ---- diagrams out ----


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
        "rotor.crack_force", "rotor.unbalance_force", "rotor.amb_force"
    }  # fmt: skip


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
    diagram: Diagram = load(folder / "diagram.json", set=inside)
    found = cosimulate_diagram(diagram, step=H, stop=N * H, master="jacobi", order=0, fast=True)
    return np.asarray(found["rest.rotor_displacement"])


@needs_compiler
def test_there_and_back(jeffcott: ExportedSsp, right: np.ndarray, tmp_path: Path) -> None:
    done = import_ssp(jeffcott.file, tmp_path / "back")
    assert done.warnings == ()
    assert [str(w.source) for w in done.diagram.wires] == [
        "rest.rotor_displacement", "rest.rotor_velocity", "controller.controller_current"
    ]  # fmt: skip
    assert done.diagram.solver.stop == load("jeffcott").solver.stop
    assert np.abs(run_imported(tmp_path / "back") - right).max() <= 1e-12 * np.abs(right).max()


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
        "controller": ["controller.KP"], "rest": []
    }  # fmt: skip
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
    text["wires"][2:] = [
        ["controller.controller_current", "half.input"], ["half.output", "rest.controller_current"]
    ]  # fmt: skip
    done = export_ssp(load(text, folder=tmp_path / "back"), tmp_path / "mixed.ssp", {"half": ["half"]})
    assert done.blocks == {"half": ("half",), "controller": ("controller",), "rest": ("rest",)}
    joined = {(f"{c.start.element}.{c.start.connector}", f"{c.end.element}.{c.end.connector}")
              for c in done.structure.system.connections}  # fmt: skip
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


@needs_compiler
def test_command_line(run: Any, tmp_path: Path) -> None:
    out = run("ssp", "export", "jeffcott", "--part", "controller=controller", "-o", "j.ssp")
    assert out.exit_code == 0, out.output
    assert "SSP 1.0, 6 connections" in out.output
    out = run("ssp", "import", "j.ssp", "-o", "j", "--json")
    assert out.exit_code == 0, out.output
    assert json.loads(out.stdout)["blocks"] == {"controller": "fmu", "rest": "fmu"}
    out = run("cosim", "j/diagram.json", "--step", "0.1 ms", "--stop", "0.01 s", "--json")
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
