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
    "SPACES",
    "component",
    "connectors",
    "document",
    "entry",
    "fmu_bytes",
    "fmu_text",
    "imported",
    "linear",
    "mapping",
    "parameter_set",
    "ports",
    "refusal",
    "system",
    "table",
    "typed_fmu",
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


def typed_fmu(folder: Path) -> bytes:
    """Return an FMU with values that are no numbers, and a flag in and out."""
    rows = [
        ("flag", "parameter", "fixed", 'Boolean start="false"'),
        ("count", "parameter", "fixed", 'Integer start="1"'),
        ("mode", "parameter", "fixed", 'Enumeration declaredType="Mode" start="1"'),
        ("word", "parameter", "fixed", 'String start="none"'),
        ("on", "input", "discrete", 'Boolean start="false"'),
        ("lit", "output", "discrete", "Boolean"),
    ]
    more = "".join(
        f'<ScalarVariable name="{n}" valueReference="{k}" causality="{c}" variability="{v}"><{t}/></ScalarVariable>'
        for k, (n, c, v, t) in enumerate(rows, start=20)
    )
    items = "".join(f'<Item name="{n}" value="{k}"/>' for k, n in enumerate(("slow", "fast"), start=1))
    types = (
        f'<TypeDefinitions><SimpleType name="Mode"><Enumeration>{items}</Enumeration></SimpleType></TypeDefinitions>'
    )
    text = fmu_text("typed").replace("<ModelVariables>", f"{types}<ModelVariables>")
    text = text.replace("</ModelVariables>", f"{more}</ModelVariables>")
    text = text.replace("</Outputs>", '<Unknown index="15"/></Outputs>')
    return fmu_bytes(folder, text)


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


def ports(**kinds: str) -> str:
    """Return connectors of a system: name="kind", or "kind unit"."""
    found = ""
    for name, text in kinds.items():
        kind, _, unit = text.partition(" ")
        shown = f' unit="{unit}"' if unit else ""
        found += f'<ssd:Connector name="{name}" kind="{kind}"><ssc:Real{shown}/></ssd:Connector>'
    return f"<ssd:Connectors>{found}</ssd:Connectors>"


def parameter_set(*pairs: tuple[str, Any], unit: str = "", units: str = "", kind: str = "Real", more: str = "") -> str:
    shown = f' unit="{unit}"' if unit else ""
    inside = "".join(f'<ssv:Parameter name="{n}"><ssv:{kind} value="{v}"{shown}/></ssv:Parameter>' for n, v in pairs)
    return (
        f'<ssv:ParameterSet version="1.0" name="p"{more}>'
        f"<ssv:Parameters>{inside}</ssv:Parameters>{units}</ssv:ParameterSet>"
    )


def values(*pairs: tuple[str, Any], map: str = "", prefix: str = "", **more: str) -> str:
    """Return a binding. map: of its names to others."""
    start = f'<ssd:ParameterBinding prefix="{prefix}">' if prefix else "<ssd:ParameterBinding>"
    inline = f"<ssd:ParameterValues>{parameter_set(*pairs, **more)}</ssd:ParameterValues>"
    mapped = f"<ssd:ParameterMapping>{map}</ssd:ParameterMapping>" if map else ""
    return f"<ssd:ParameterBindings>{start}{inline}{mapped}</ssd:ParameterBinding></ssd:ParameterBindings>"


def mapping(*entries: str, more: str = "") -> str:
    return f'<ssm:ParameterMapping version="1.0"{more}>{"".join(entries)}</ssm:ParameterMapping>'


def entry(source: str, target: str, inside: str = "", **more: str) -> str:
    extra = "".join(f' {key}="{value}"' for key, value in more.items())
    return f'<ssm:MappingEntry source="{source}" target="{target}"{extra}>{inside}</ssm:MappingEntry>'


def linear(factor: float = 1.0, offset: float = 0.0) -> str:
    return f'<ssc:LinearTransformation factor="{factor}" offset="{offset}"/>'


def table(kind: str, *pairs: tuple[str, str]) -> str:
    inside = "".join(f'<ssc:MapEntry source="{a}" target="{b}"/>' for a, b in pairs)
    return f"<ssc:{kind}MappingTransformation>{inside}</ssc:{kind}MappingTransformation>"


SPACES = {"ssd": "Description", "ssc": "Common", "ssv": "ParameterValues", "ssm": "ParameterMapping"}
MM = '<ssc:Unit name="mm"><ssc:BaseUnit m="1" factor="0.001"/></ssc:Unit>'


def system(elements: str, connections: str = "", *, before: str = "", units: str = "", version: str = "1.0") -> str:
    spaces = " ".join(
        f'xmlns:{short}="http://ssp-standard.org/SSP1/SystemStructure{long}"' for short, long in SPACES.items()
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


def refusal(folder: Path, text: str, **more: bytes) -> str:
    """Return all that is said against a system; nothing may be left behind."""
    file = written(folder, text, **more)
    with pytest.raises(RotorsimError) as caught:
        import_ssp(file, folder / "out")
    assert not (folder / "out").exists()
    assert {path.name for path in folder.iterdir()} <= {"one.fmu", "made.ssp"}
    return "\n".join(str(problem) for problem in caught.value.problems)


def document(done: ImportedSsp) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(done.file.read_text())
    return found
