"""modelDescription.xml of FMI 2.0 and 3.0, and buildDescription.xml of FMI 3.0."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from rotorsim.fmi.export.variables import (
    DERIVATIVE,
    DISCRETE,
    EVENT,
    INPUT,
    OUTPUT,
    PARAMETER,
    STATE,
    Interface,
    Variable,
)
from rotorsim.units import BASES, Unit, parse_unit

__all__ = ["build_description", "model_description"]

_DISPLAY = {"rad/s": ("rpm", "Hz"), "rad": ("deg",), "m": ("mm", "um")}
_LOG_CATEGORIES = {
    "logAll": "everything",
    "logStatusError": "what was refused, and why",
    "logStatusWarning": "what is odd",
    "logEvents": "sample hits and events",
}
_CAUSALITY = {PARAMETER: "parameter", INPUT: "input", OUTPUT: "output"}


def model_description(interface: Interface, version: str, token: str, sources: Sequence[str]) -> bytes:
    """Return modelDescription.xml. sources: the files to be compiled (FMI 2)."""
    root = _root(interface, version, token)
    _kinds(root, interface, version, sources)
    _units(root, interface)
    categories = SubElement(root, "LogCategories")
    for name, text in _LOG_CATEGORIES.items():
        SubElement(categories, "Category", name=name, description=text)
    solver = interface.part.diagram.solver
    experiment = {"startTime": "0.0", "stopTime": solver.stop, "tolerance": solver.rtol, "stepSize": solver.step}
    SubElement(root, "DefaultExperiment", {name: _text(value) for name, value in experiment.items()})
    variables = SubElement(root, "ModelVariables")
    if version == "2.0":
        _variables2(variables, interface)
        _structure2(SubElement(root, "ModelStructure"), interface)
    else:
        _variables3(variables, interface)
        _structure3(SubElement(root, "ModelStructure"), interface)
    return _bytes(root)


def build_description(interface: Interface, sources: Sequence[str], options: str) -> bytes:
    """Return sources/buildDescription.xml of FMI 3.0."""
    root = Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = SubElement(root, "BuildConfiguration", modelIdentifier=interface.identifier)
    files = SubElement(configuration, "SourceFileSet", language="C99", compilerOptions=options)
    for name in sources:
        SubElement(files, "SourceFile", name=name)
    SubElement(configuration, "Library", name="m", description="C mathematics (not on Windows)", external="true")
    return _bytes(root)


def _bytes(root: Element) -> bytes:
    ElementTree.indent(root)
    text = ElementTree.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'.encode()


def _text(value: object) -> str:
    return value if isinstance(value, str) else repr(float(value))  # type: ignore[arg-type]


def _root(interface: Interface, version: str, token: str) -> Element:
    from rotorsim import __version__

    part = interface.part
    whole = set(part.blocks) == set(part.diagram.nodes)
    name = part.diagram.name or "diagram"
    words = part.diagram.document.get("description")
    root = Element("fmiModelDescription", fmiVersion=version)
    root.set("modelName", name if whole else f"{name}: {', '.join(part.blocks)}")
    root.set("guid" if version == "2.0" else "instantiationToken", token)
    if isinstance(words, str) and words:
        root.set("description", _plain(words))
    root.set("generationTool", f"rotorsim {__version__}")
    root.set("variableNamingConvention", "structured")
    if version == "2.0":
        root.set("numberOfEventIndicators", str(interface.count(EVENT)))
    return root


def _plain(text: str) -> str:
    """Return a text without characters that XML cannot hold."""
    return "".join(c if c.isprintable() else " " for c in text)


def _kinds(root: Element, interface: Interface, version: str, sources: Sequence[str]) -> None:
    two = version == "2.0"
    common = {
        "modelIdentifier": interface.identifier,
        "canBeInstantiatedOnlyOncePerProcess": "false",
        "canGetAndSetFMUstate" if two else "canGetAndSetFMUState": "true",
        "canSerializeFMUstate" if two else "canSerializeFMUState": "true",
    }
    if two:
        common |= {"canNotUseMemoryManagementFunctions": "true", "providesDirectionalDerivative": "true"}
    else:
        common |= {"providesDirectionalDerivatives": "true", "providesAdjointDerivatives": "true"}
    exchange = SubElement(root, "ModelExchange", common)
    stepping = SubElement(root, "CoSimulation", common)
    stepping.set("canHandleVariableCommunicationStepSize", "true")
    stepping.set("maxOutputDerivativeOrder", "1")
    if two:
        exchange.set("completedIntegratorStepNotNeeded", "true")
        stepping.set("canInterpolateInputs", "true")
        for kind in (exchange, stepping):
            files = SubElement(kind, "SourceFiles")
            for name in sources:
                SubElement(files, "File", name=name)
    else:
        stepping.set("fixedInternalStepSize", _text(interface.part.diagram.solver.step))


# ---- units ----


def _units(root: Element, interface: Interface) -> None:
    if not interface.units:
        return
    definitions = SubElement(root, "UnitDefinitions")
    for name in interface.units:
        unit = parse_unit(name)
        element = SubElement(definitions, "Unit", name=name)
        _base_unit(element, unit)
        for shown in _DISPLAY.get(name, ()):
            factor = unit.factor / parse_unit(shown).factor
            SubElement(element, "DisplayUnit", name=shown, factor=_text(factor))


def _base_unit(parent: Element, unit: Unit) -> None:
    powers = dict(zip(BASES, unit.dimension, strict=True))
    element = SubElement(parent, "BaseUnit")
    for base in ("kg", "m", "s", "A", "K", "mol", "cd", "rad"):
        if powers[base]:
            element.set(base, str(powers[base]))
    if unit.factor != 1.0:
        element.set("factor", _text(unit.factor))


# ---- variables ----


def _variables2(parent: Element, interface: Interface) -> None:
    index = _indices(interface)
    for variable in interface.variables:
        if variable.role == EVENT:
            continue
        for name, reference, k in variable.entries():
            scalar = SubElement(parent, "ScalarVariable", name=name, valueReference=str(reference))
            if variable.description:
                scalar.set("description", _plain(variable.description))
            scalar.set("causality", _CAUSALITY.get(variable.role, "local"))
            scalar.set("variability", variable.variability)
            if variable.initial:
                scalar.set("initial", variable.initial)
            real = SubElement(scalar, "Real", _real(variable))
            if variable.start is not None:
                real.set("start", _text(variable.start[k]))
            if variable.of is not None:
                real.set("derivative", str(index[variable.of + k]))


def _variables3(parent: Element, interface: Interface) -> None:
    time = SubElement(parent, "Float64", name="time", valueReference="0", causality="independent")
    time.set("variability", "continuous")
    time.set("description", "simulation time")
    if "s" in interface.units:
        time.set("unit", "s")
    for variable in interface.variables:
        entries = list(variable.entries())
        if interface.arrays:
            entries = [(variable.name, variable.reference, 0)]
        for name, reference, k in entries:
            element = SubElement(parent, "Float64", name=name, valueReference=str(reference))
            if variable.description:
                element.set("description", _plain(variable.description))
            element.set("causality", _CAUSALITY.get(variable.role, "local"))
            element.set("variability", variable.variability)
            if variable.initial and variable.role != INPUT:
                element.set("initial", variable.initial)
            for key, value in _real(variable).items():
                element.set(key, value)
            if variable.start is not None:
                values = variable.start if interface.arrays else [variable.start[k]]
                element.set("start", " ".join(_text(value) for value in values))
            if variable.of is not None:
                element.set("derivative", str(variable.of + k))
            if interface.arrays:
                for size in variable.shape:
                    SubElement(element, "Dimension", start=str(size))


def _real(variable: Variable) -> dict[str, str]:
    found = {}
    if variable.unit:
        found["unit"] = variable.unit
    if variable.unit == "rad/s" and variable.role == PARAMETER:
        found["displayUnit"] = "rpm"
    for key, value in (("min", variable.low), ("max", variable.high)):
        if math.isfinite(value):
            found[key] = _text(value)
    if variable.nominal is not None:
        found["nominal"] = _text(variable.nominal)
    return found


def _indices(interface: Interface) -> dict[int, int]:
    """Value reference -> index in ModelVariables of FMI 2, counted from 1."""
    references = [r for v in interface.variables if v.role != EVENT for _, r, _ in v.entries()]
    return {reference: k for k, reference in enumerate(references, 1)}


# ---- model structure ----


def _unknowns(interface: Interface, version: str) -> dict[str, list[tuple[int, list[int]]]]:
    """Return outputs, derivatives, initial unknowns and events: reference, and the references it depends on.

    Parameters are knowns at the start; in FMI 3.0 always, and what is not listed has derivative zero (2.4.8).
    """
    found = interface.dependencies
    n_x, n_y = interface.part.n_x, interface.count(OUTPUT)
    at = {role: interface.first(role) for role in (PARAMETER, INPUT, OUTPUT, STATE, DERIVATIVE, DISCRETE, EVENT)}
    n_u = interface.count(INPUT)

    def known(column: int) -> int:
        if column < n_x:
            return at[STATE] + column
        return at[INPUT] + column - n_x if column < n_x + n_u else 0

    setting: dict[int, list[int]] = {}
    for k, parameter in enumerate(interface.parameters):
        for place in parameter.follow:
            setting.setdefault(place, []).append(at[PARAMETER] + k)

    def at_start(row: int) -> list[int]:
        exact = [at[STATE] + c for c in found.initial_x[row] if interface.x_exact[c]]
        exact += [at[DISCRETE] + c for c in found.initial_z[row] if interface.z_exact[c]]
        inputs = [at[INPUT] + c for c in found.initial_u[row]]
        return [*([0] if found.initial_t[row] else ()), *set_by(found.initial_p[row]), *inputs, *exact]

    def set_by(places: Iterable[int]) -> list[int]:
        return [reference for place in places for reference in setting.get(place, ())]

    moving = [sorted(known(c) for c in columns) for columns in found.by_column]
    if version == "3.0":
        moving = [sorted({*row, *set_by(p)}) for row, p in zip(moving, found.by_parameter, strict=True)]
    calculated = [k for k in range(n_x) if not interface.x_exact[k]]
    return {
        "outputs": [(at[OUTPUT] + k, moving[n_x + k]) for k in range(n_y)],
        "derivatives": [(at[DERIVATIVE] + k, moving[k]) for k in range(n_x)],
        "events": [(at[EVENT] + k, moving[n_x + n_y + k]) for k in range(interface.count(EVENT))],
        "initial": [
            *((at[OUTPUT] + k, sorted(set(at_start(n_x + k)))) for k in range(n_y)),
            *((at[STATE] + k, sorted(set(at_start(n_x + n_y + k)))) for k in calculated),
            *((at[DERIVATIVE] + k, sorted(set(at_start(k)))) for k in range(n_x)),
        ],
    }


def _structure2(parent: Element, interface: Interface) -> None:
    index = _indices(interface)
    unknowns = _unknowns(interface, "2.0")
    for tag, key in (("Outputs", "outputs"), ("Derivatives", "derivatives"), ("InitialUnknowns", "initial")):
        if not unknowns[key]:
            continue
        group = SubElement(parent, tag)
        for reference, knowns in unknowns[key]:
            dependencies = " ".join(str(index[k]) for k in knowns if k)
            SubElement(group, "Unknown", index=str(index[reference]), dependencies=dependencies)


def _structure3(parent: Element, interface: Interface) -> None:
    owner = _owners(interface)
    unknowns = _unknowns(interface, "3.0")
    for tag, key in (
        ("Output", "outputs"),
        ("ContinuousStateDerivative", "derivatives"),
        ("InitialUnknown", "initial"),
        ("EventIndicator", "events"),
    ):
        joined: dict[int, set[int]] = {}
        for reference, knowns in unknowns[key]:
            joined.setdefault(owner[reference], set()).update(owner[k] for k in knowns)
        for reference, known in joined.items():
            dependencies = " ".join(map(str, sorted(known)))
            SubElement(parent, tag, valueReference=str(reference), dependencies=dependencies)


def _owners(interface: Interface) -> dict[int, int]:
    """Return the reference of the variable that every scalar belongs to."""
    owner = {0: 0}
    for variable in interface.variables:
        for k in range(variable.size):
            owner[variable.reference + k] = variable.reference if interface.arrays else variable.reference + k
    return owner
