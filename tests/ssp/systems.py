"""Systems of FMUs (SSP) written by hand, for tests."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Any

import pytest

from rotorsim.errors import RotorsimError
from rotorsim.ssp.to_diagram import ImportedSsp, import_ssp

__all__ = [
    "MM",
    "component",
    "connectors",
    "document",
    "fmu_bytes",
    "fmu_text",
    "imported",
    "refusal",
    "system",
    "values",
    "wire",
    "written",
]


def fmu_text(name: str, unit: str = "m", factor: float = 1.0) -> str:
    """Return a model description: u[1], u[2] and s in, y[1], y[2] and q out, parameters k[1], k[2] and c."""
    rows = [
        ("u[1]", "input", f'start="0" unit="{unit}"'),
        ("u[2]", "input", f'start="0" unit="{unit}"'),
        ("s", "input", 'start="0"'),
        ("y[1]", "output", f'unit="{unit}"'),
        ("y[2]", "output", f'unit="{unit}"'),
        ("q", "output", ""),
        ("k[1]", "parameter", f'start="1" unit="{unit}"'),
        ("k[2]", "parameter", f'start="2" unit="{unit}"'),
        ("c", "parameter", 'start="5"'),
    ]
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
