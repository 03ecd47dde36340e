"""An FMU for Co-Simulation, made of tests/fmi/c/gauge2.c, that hands inputs of every type on to outputs.

y = scale u, nb = not b, i2 = 2 i, said = text, mode_out = mode; steps: how many it was told to take; last: its time;
told_stop, told_tolerance, told_start: what it was told of the experiment (-1: nothing). From end_at on it asks for the
end. talk: 1 prints, 2 warns, 4 logs, 8 logs 1200 times at every step.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rotorsim.diagram.diagram import Diagram
from rotorsim.model.load import load
from tests.fmi.plant import library, make_fmu

__all__ = ["description", "gauge_fmu", "with_gauge"]

_FIXED = 'causality="parameter" variability="fixed"'
_DISCRETE_IN, _DISCRETE_OUT = ('causality="input" variability="discrete"', 'causality="output" variability="discrete"')


def description(
    units: str = "",
    u: str = "",
    y: str = "",
    scale: str = "",
    *,
    varies: str = "true",
    more: str = "",
    real: bool = False,
    talks: bool = False,
) -> str:
    """Return the model description. units: <Unit> elements; u, y, scale: attributes of these; real: Real alone
    (and talk, with talks)."""
    rows = [
        (1, "u", 'causality="input"', "Real", f'start="0" {u}'),
        (2, "y", 'causality="output"', "Real", y),
        (3, "told_stop", "", "Real", ""),
        (4, "told_tolerance", "", "Real", ""),
        (5, "told_start", "", "Real", ""),
        (6, "end_at", _FIXED, "Real", 'start="1e9"'),
        (7, "scale", _FIXED, "Real", f'start="1" {scale}'),
        (8, "last", "", "Real", ""),
        (1, "steps", _DISCRETE_OUT, "Integer", ""),
        (2, "i", _DISCRETE_IN, "Integer", 'start="0"'),
        (10, "i2", _DISCRETE_OUT, "Integer", ""),
        (3, "mode", _FIXED, "Enumeration", 'start="1" declaredType="Mode"'),
        (11, "mode_out", _DISCRETE_OUT, "Enumeration", 'declaredType="Mode"'),
        (4, "talk", _FIXED, "Integer", 'start="0"'),
        (5, "b", _DISCRETE_IN, "Boolean", 'start="false"'),
        (9, "nb", _DISCRETE_OUT, "Boolean", ""),
        (6, "flag", _FIXED, "Boolean", 'start="false"'),
        (6, "flag_out", 'causality="local" variability="discrete"', "Boolean", ""),
        (1, "text", _FIXED, "String", 'start="none"'),
        (2, "said", _DISCRETE_OUT, "String", ""),
    ]
    rows = [row for row in rows if row[3] == "Real" or not real or (talks and row[1] == "talk")]
    variables = "".join(
        f'<ScalarVariable name="{name}" valueReference="{r}" {how}><{kind} {rest}/></ScalarVariable>'
        for r, name, how, kind, rest in rows
    )
    outputs = "".join(
        f'<Unknown index="{k}" {"" if name == "y" else "dependencies=" + chr(34) * 2}/>'
        for k, (_, name, how, *_) in enumerate(rows, 1)
        if "output" in how
    )
    items = '<Item name="slow" value="1"/><Item name="fast" value="4"/>'
    return (
        '<fmiModelDescription fmiVersion="2.0" modelName="gauge" guid="gauge">'
        f'<CoSimulation modelIdentifier="plant" canHandleVariableCommunicationStepSize="{varies}"/>'
        f"<UnitDefinitions>{units}</UnitDefinitions>"
        f'<TypeDefinitions><SimpleType name="Mode"><Enumeration>{items}</Enumeration></SimpleType></TypeDefinitions>'
        '<LogCategories><Category name="logEvents"/><Category name="logStatusWarning"/></LogCategories>'
        f"{more}<ModelVariables>{variables}</ModelVariables>"
        f"<ModelStructure><Outputs>{outputs}</Outputs></ModelStructure></fmiModelDescription>"
    )


def gauge_fmu(folder: Path, text: str | bytes = "", name: str = "gauge.fmu") -> Path:
    """Write the FMU, with another model description if one is given."""
    return make_fmu(folder / name, description=text or description(), library_bytes=library("2.0", "gauge"))


def with_gauge(
    file: Path,
    source: str = "constant",
    *,
    wires: Any = (["in.output", "it.u"],),
    record: Any = ("it.y",),
    blocks: Any = None,
    step: float = 0.1,
    stop: float = 1.0,
    more: Any = None,
    **values: Any,
) -> Diagram:
    """Return a diagram of the FMU "it" and a constant 1 "in" (or other blocks)."""
    document = {
        "name": "gauge",
        "blocks": {
            "it": {"type": "fmu", "file": file.name, "parameters": {"in_process": True, **values}},
            **(blocks if blocks is not None else {"in": {"type": source, "parameters": more or {"value": 1.0}}}),
        },
        "wires": list(wires),
        "solver": {"step": step, "stop": stop},
        "record": list(record),
    }
    return load(document, folder=file.parent, trust_blocks=True)
