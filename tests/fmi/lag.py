"""An FMU of FMI 1.0 for Co-Simulation, made of tests/fmi/c/lag1.c: T y' = k u - y, exact for inputs that are held.

y in mm; first: a thousand times the input that it was initialised with; open: the input does not count; mime: what it
was told at its creation. From 0.5 s on `fault` is what goes wrong. Negated aliases: minus is y (the functions have -y),
opposite is -k, shut and closed are not open.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rotorsim.diagram.diagram import Diagram
from rotorsim.model.load import load
from tests.fmi.plant import library, make_fmu

__all__ = ["FAULTS", "lag_description", "lag_fmu", "with_lag"]

FAULTS = ("fine", "segv", "hang", "fail", "discard", "warn", "pending")
STAND_ALONE = (
    '<CoSimulation_StandAlone><Capabilities canHandleVariableCommunicationStepSize="true"/></CoSimulation_StandAlone>'
)
UNITS = (
    '<BaseUnit unit="mm"><DisplayUnitDefinition displayUnit="um" gain="1000"/></BaseUnit>'
    '<BaseUnit unit="ms"><DisplayUnitDefinition displayUnit="s" gain="0.001"/></BaseUnit>'
)


def lag_description(more: str = "", *, implementation: str = "", real: bool = False) -> str:
    """Return the model description. more: further variables; real: numbers with a point alone."""
    rows = [
        ("u", 1, 'causality="input"', '<Real start="0"/>'),
        ("y", 2, 'causality="output"', '<Real declaredType="Length" displayUnit="um"/><DirectDependency/>'),
        ("minus", 6, 'causality="output" alias="negatedAlias"', '<Real unit="mm"/><DirectDependency/>'),
        ("T", 3, 'variability="parameter"', '<Real start="0.5" min="0" unit="s"/>'),
        ("k", 4, 'variability="parameter"', '<Real start="1"/>'),
        ("y0", 5, 'variability="parameter" causality="input"', '<Real start="0" unit="mm"/>'),
        ("half", 7, 'variability="parameter"', "<Real/>"),
        ("steps", 1, 'causality="output" variability="discrete"', "<Integer/><DirectDependency/>"),
        ("fault", 2, 'variability="parameter"', '<Enumeration start="1" declaredType="Fault"/>'),
        ("first", 3, 'causality="output" variability="discrete"', "<Integer/><DirectDependency/>"),
        ("open", 1, 'variability="parameter"', '<Boolean start="false"/>'),
        ("opposite", 4, 'variability="parameter" alias="negatedAlias"', '<Real start="-1"/>'),
        ("shut", 1, 'variability="parameter" alias="negatedAlias"', '<Boolean start="true"/>'),
        (
            "closed",
            1,
            'causality="output" variability="discrete" alias="negatedAlias"',
            "<Boolean/><DirectDependency/>",
        ),
        ("mime", 1, 'causality="output" variability="discrete"', "<String/>"),
    ]
    rows = [row for row in rows if "<Real" in row[3] or not real]
    variables = "\n".join(
        f'<ScalarVariable name="{name}" valueReference="{r}" {how}>{inner}</ScalarVariable>'
        for name, r, how, inner in rows
    )
    items = "".join(f'<Item name="{name}"/>' for name in FAULTS)
    return (
        '<?xml version="1.0" encoding="ISO-8859-1"?>\n'
        '<fmiModelDescription fmiVersion="1.0" modelName="lag" modelIdentifier="plant" guid="{lag}"\n'
        ' numberOfContinuousStates="1" numberOfEventIndicators="0">\n'
        f"<UnitDefinitions>{UNITS}</UnitDefinitions>\n"
        f'<TypeDefinitions><Type name="Length"><RealType unit="mm"/></Type><Type name="Fault"><EnumerationType>{items}'
        "</EnumerationType></Type></TypeDefinitions>\n"
        '<DefaultExperiment startTime="0" stopTime="2" tolerance="1e-4"/>\n'
        f"<ModelVariables>\n{variables}\n{more}</ModelVariables>\n"
        f"<Implementation>{implementation or STAND_ALONE}</Implementation>\n"
        "</fmiModelDescription>\n"
    )


def lag_fmu(folder: Path, text: str = "", name: str = "lag.fmu") -> Path:
    """Write the FMU, with another model description if one is given."""
    text = text or lag_description()
    return make_fmu(folder / name, "1.0", description=text, library_bytes=library("1.0", "lag"))


def with_lag(file: Path, *, value: float = 2.0, record: Any = ("it.y",), stop: float = 1.0, **values: Any) -> Diagram:
    """Return a diagram of the FMU "it", fed by a constant."""
    document = {
        "name": "lag",
        "blocks": {
            "in": {"type": "constant", "parameters": {"value": value}},
            "it": {"type": "fmu", "file": file.name, "parameters": values},
        },
        "wires": [["in.output", "it.u"]],
        "solver": {"step": 0.01, "stop": stop},
        "record": list(record),
    }
    return load(document, folder=file.parent, trust_blocks=True)
