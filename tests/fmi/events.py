"""FMUs for Model Exchange with events, made of tests/fmi/c/events*.c, and diagrams of one of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rotorsim.diagram.diagram import Diagram
from rotorsim.model.load import load
from tests.fmi.plant import library, make_fmu

__all__ = ["MODELS", "alone", "description2", "events_fmu"]

MODELS = ("ball", "relay", "clock", "chatter", "signal", "late", "stages", "two")
PARAMETERS = {
    9: ("gravity", 9.81),
    10: ("restitution", 0.8),
    11: ("low", 0.5),
    12: ("high", 1.5),
    13: ("time_constant", 1.0),
    14: ("tick", 0.25),
    15: ("stop_at", 1e9),
    16: ("x0", 1.0),
    17: ("v0", 0.0),
}


def events_fmu(folder: Path, version: str = "2.0", *, saves: bool = True, reports: bool = True) -> Path:
    """Write the FMU. saves: its state can be saved; reports: it wants to be told of completed steps."""
    text = {"1.0": _description1, "2.0": description2, "3.0": _description3}[version](saves, reports)
    file = folder / f"events{version[0]}{'' if saves else 'n'}{'' if reports else 'q'}.fmu"
    return make_fmu(file, version, description=text, library_bytes=library(version, "events"))


def alone(
    file: Path, model: str, *, step: float, stop: float, wires: Any = (), blocks: Any = None, **values: Any
) -> Diagram:
    """Return a diagram of the FMU alone (or of more blocks), with the solver's own step and stop time."""
    parameters = {"interface": "me", "in_process": True, "model": MODELS.index(model), **values}
    document = {
        "name": model,
        "blocks": {"it": {"type": "fmu", "file": file.name, "parameters": parameters}, **(blocks or {})},
        "wires": list(wires),
        "solver": {"step": step, "stop": stop},
        "record": ["it.x", "it.count", "it.when"],
    }
    return load(document, folder=file.parent, trust_blocks=True)


def _description1(_saves: bool, _reports: bool) -> str:
    rows = [
        (1, "x", 'causality="output"', '<Real start="1"/><DirectDependency/>'),
        (2, "v", "", '<Real start="0"/>'),
        (3, "der(x)", "", "<Real/>"),
        (4, "der(v)", "", "<Real/>"),
        (5, "u", 'causality="input"', '<Real start="0"/>'),
        (6, "level", 'causality="input" variability="discrete"', '<Real start="0"/>'),
        (7, "count", 'causality="output" variability="discrete"', "<Real/><DirectDependency/>"),
        (8, "when", 'causality="output" variability="discrete"', "<Real/><DirectDependency/>"),
        *(
            (r, name, 'variability="parameter"', f'<Real start="{start!r}"/>')
            for r, (name, start) in PARAMETERS.items()
        ),
        (20, "model", 'variability="parameter"', '<Integer start="0"/>'),
    ]
    variables = "".join(
        f'<ScalarVariable name="{name}" valueReference="{r}" {how}>{inner}</ScalarVariable>'
        for r, name, how, inner in rows
    )
    return (
        '<fmiModelDescription fmiVersion="1.0" modelName="events" modelIdentifier="plant" guid="events" '
        f'numberOfContinuousStates="2" numberOfEventIndicators="1"><ModelVariables>{variables}</ModelVariables>'
        "</fmiModelDescription>"
    )


def description2(saves: bool, reports: bool) -> str:
    """Return the model description of FMI 2.0."""
    rows = [
        (0, "time", 'causality="independent"', "Real", ""),
        (1, "x", 'causality="output" initial="exact"', "Real", 'start="1"'),
        (2, "v", 'initial="exact"', "Real", 'start="0"'),
        (3, "der(x)", "", "Real", 'derivative="2"'),
        (4, "der(v)", "", "Real", 'derivative="3"'),
        (5, "u", 'causality="input"', "Real", 'start="0"'),
        (6, "level", 'causality="input" variability="discrete"', "Real", 'start="0"'),
        (7, "count", 'causality="output" variability="discrete"', "Real", ""),
        (8, "when", 'causality="output" variability="discrete"', "Real", ""),
        *(
            (r, name, 'causality="parameter" variability="fixed"', "Real", f'start="{start!r}"')
            for r, (name, start) in PARAMETERS.items()
        ),
        (20, "model", 'causality="parameter" variability="fixed"', "Integer", 'start="0"'),
    ]
    variables = "".join(
        f'<ScalarVariable name="{name}" valueReference="{r}" {how}><{kind} {more}/></ScalarVariable>'
        for r, name, how, kind, more in rows
    )
    flags = f'canGetAndSetFMUstate="{str(saves).lower()}" completedIntegratorStepNotNeeded="{str(not reports).lower()}"'
    outputs = "".join(f'<Unknown index="{k}" dependencies=""/>' for k in (2, 8, 9))
    derivatives = '<Unknown index="4"/><Unknown index="5"/>'
    return (
        '<fmiModelDescription fmiVersion="2.0" modelName="events" guid="events" numberOfEventIndicators="1">'
        f'<ModelExchange modelIdentifier="plant" {flags}/><ModelVariables>{variables}</ModelVariables><ModelStructure>'
        f"<Outputs>{outputs}</Outputs><Derivatives>{derivatives}</Derivatives></ModelStructure></fmiModelDescription>"
    )


def _description3(saves: bool, reports: bool) -> str:
    rows = [
        ("Float64", 0, "time", 'causality="independent" variability="continuous"'),
        ("Float64", 1, "x", 'causality="output" initial="exact" start="1"'),
        ("Float64", 2, "v", 'initial="exact" start="0"'),
        ("Float64", 3, "der(x)", 'derivative="1"'),
        ("Float64", 4, "der(v)", 'derivative="2"'),
        ("Float64", 5, "u", 'causality="input" start="0"'),
        ("Float64", 6, "level", 'causality="input" variability="discrete" start="0"'),
        ("Float64", 7, "count", 'causality="output" variability="discrete"'),
        ("Float64", 8, "when", 'causality="output" variability="discrete"'),
        *(
            ("Float64", r, name, f'causality="parameter" variability="fixed" start="{start!r}"')
            for r, (name, start) in PARAMETERS.items()
        ),
        ("Int32", 20, "model", 'causality="parameter" variability="fixed" start="0"'),
        ("Float64", 30, "z", 'causality="local"'),
    ]
    variables = "".join(f'<{kind} name="{name}" valueReference="{r}" {how}/>' for kind, r, name, how in rows)
    flags = f'canGetAndSetFMUState="{str(saves).lower()}" needsCompletedIntegratorStep="{str(reports).lower()}"'
    outputs = "".join(f'<Output valueReference="{r}" dependencies=""/>' for r in (1, 7, 8))
    rates = '<ContinuousStateDerivative valueReference="3"/><ContinuousStateDerivative valueReference="4"/>'
    return (
        '<fmiModelDescription fmiVersion="3.0" modelName="events" instantiationToken="events">'
        f'<ModelExchange modelIdentifier="plant" {flags}/><ModelVariables>{variables}</ModelVariables><ModelStructure>'
        f'{outputs}{rates}<EventIndicator valueReference="30"/></ModelStructure></fmiModelDescription>'
    )
