"""modelDescription.xml of FMI 2.0 and 3.0, and buildDescription.xml of FMI 3.0."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from xml.etree.ElementTree import Element, SubElement

from rotorsim.fmi.description.xml_writer import plain_text, write_base_unit, xml_bytes
from rotorsim.fmi.export.dependencies import CONSTANT, DEPENDENT, FIXED, TUNABLE
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
from rotorsim.units import BASES, parse_unit

_DISPLAY = {"rad/s": ("rpm", "Hz"), "rad": ("deg",), "m": ("mm", "um")}
_LOG_CATEGORIES = {
    "logAll": "everything",
    "logStatusError": "what was refused, and why",
    "logStatusWarning": "what is odd",
    "logEvents": "sample hits and events",
}
_TAGS3 = {
    "Output": "outputs",
    "ContinuousStateDerivative": "derivatives",
    "InitialUnknown": "initial",
    "EventIndicator": "events",
}
_WEAKER = (CONSTANT, FIXED, TUNABLE, DEPENDENT)
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
    _variables(SubElement(root, "ModelVariables"), interface, version)
    _structure(SubElement(root, "ModelStructure"), interface, version)
    return xml_bytes(root)


def build_description(interface: Interface, sources: Sequence[str], options: str) -> bytes:
    """Return sources/buildDescription.xml of FMI 3.0."""
    root = Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = SubElement(root, "BuildConfiguration", modelIdentifier=interface.identifier)
    files = SubElement(configuration, "SourceFileSet", language="C99", compilerOptions=options)
    for name in sources:
        SubElement(files, "SourceFile", name=name)
    SubElement(configuration, "Library", name="m", description="C mathematics (not on Windows)", external="true")
    if interface.nested:
        SubElement(configuration, "Library", name="dl", description="dlopen (Linux)", external="true")
    return xml_bytes(root)


def _text(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return value if isinstance(value, str) else repr(float(value))  # type: ignore[arg-type]


def _root(interface: Interface, version: str, token: str) -> Element:
    from rotorsim import __version__

    part = interface.part
    whole = set(part.blocks) == set(part.diagram.nodes)
    name = part.diagram.name or "diagram"
    words = part.diagram.document.get("description")
    two = version == "2.0"
    given = {
        "fmiVersion": version,
        "modelName": name if whole else f"{name}: {', '.join(part.blocks)}",
        "guid" if two else "instantiationToken": token,
        "description": plain_text(words) if isinstance(words, str) and words else None,
        "generationTool": f"rotorsim {__version__}",
        "variableNamingConvention": "structured",
        "numberOfEventIndicators": str(interface.count(EVENT)) if two else None,
    }
    return Element("fmiModelDescription", {key: text for key, text in given.items() if text is not None})


def _kinds(root: Element, interface: Interface, version: str, sources: Sequence[str]) -> None:
    two = version == "2.0"
    state = "FMUstate" if two else "FMUState"
    alone = _text(not interface.nested)  # derivatives and serialised states of FMUs inside are not passed on
    saves = all(one.kind.can_get_set_state for one in interface.nested)
    more = (
        {"canNotUseMemoryManagementFunctions": "true", "providesDirectionalDerivative": alone}
        if two
        else {"providesDirectionalDerivatives": alone, "providesAdjointDerivatives": alone}
    )
    common = {
        "modelIdentifier": interface.identifier,
        "canBeInstantiatedOnlyOncePerProcess": _text(any(one.kind.once_per_process for one in interface.nested)),
        f"canGetAndSet{state}": _text(saves),
        f"canSerialize{state}": alone,
        **more,
    }
    order = "0" if interface.nested else "1"
    varies = {"canHandleVariableCommunicationStepSize": "true", "maxOutputDerivativeOrder": order}
    internal = {"fixedInternalStepSize": _text(interface.part.diagram.solver.step)}
    own = {
        "ModelExchange": _steps(interface, two),
        "CoSimulation": varies | ({"canInterpolateInputs": "true"} if two else internal),
    }
    for tag, given in own.items():
        kind = SubElement(root, tag, common | given)
        files = SubElement(kind, "SourceFiles") if two else kind
        for name in sources if two else ():
            SubElement(files, "File", name=name)


def _steps(interface: Interface, two: bool) -> dict[str, str]:
    """Return whether completed steps have to be told."""
    needed = any(one.reports for one in interface.nested)
    if two:
        return {"completedIntegratorStepNotNeeded": _text(not needed)}
    return {"needsCompletedIntegratorStep": "true"} if needed else {}


# ---- units ----


def _units(root: Element, interface: Interface) -> None:
    definitions = SubElement(root, "UnitDefinitions") if interface.units else root
    for name in interface.units:
        unit = parse_unit(name)
        element = SubElement(definitions, "Unit", name=name)
        write_base_unit(element, "BaseUnit", dict(zip(BASES, unit.dimension, strict=True)), unit.factor)
        for shown in _DISPLAY.get(name, ()):
            SubElement(element, "DisplayUnit", name=shown, factor=_text(unit.factor / parse_unit(shown).factor))


# ---- variables ----


def _variables(parent: Element, interface: Interface, version: str) -> None:
    """Add time and variables: FMI 2.0 has the type inside, FMI 3.0 the type as the element, and event indicators."""
    two = version == "2.0"
    index = _indices(interface)
    tag = "ScalarVariable" if two else "Float64"
    time = SubElement(parent, tag, name="time", valueReference="0", description="simulation time")
    time.attrib |= {"causality": "independent", "variability": "continuous"}
    typed = SubElement(time, "Real") if two else time
    typed.attrib |= {"unit": "s"} if "s" in interface.units else {}
    for variable in interface.variables:
        if two and variable.role == EVENT:
            continue
        entries = [(variable.name, variable.reference, 0)] if interface.arrays else variable.entries()
        for name, reference, k in entries:
            element = SubElement(parent, tag, name=name, valueReference=str(reference))
            if variable.description:
                element.set("description", plain_text(variable.description))
            element.set("causality", _CAUSALITY.get(variable.role, "local"))
            element.set("variability", variable.variability)
            if variable.initial and (two or variable.role != INPUT):
                element.set("initial", variable.initial)
            typed = SubElement(element, "Real") if two else element
            typed.attrib |= _real(variable)
            if variable.start is not None:
                values = variable.start if interface.arrays else [variable.start[k]]
                typed.set("start", " ".join(_text(value) for value in values))
            if variable.of is not None:
                state = variable.of + k
                typed.set("derivative", str(index[state] if two else state))
            for size in variable.shape if interface.arrays else ():
                SubElement(element, "Dimension", start=str(size))


def _real(variable: Variable) -> dict[str, str]:
    rpm = variable.unit == "rad/s" and variable.role == PARAMETER
    found = {"unit": variable.unit or "", "displayUnit": "rpm" if rpm else ""}
    bounds = {
        "min": variable.low,
        "max": variable.high,
        "nominal": math.inf if variable.nominal is None else variable.nominal,
    }
    found |= {key: _text(value) for key, value in bounds.items() if math.isfinite(value)}
    return {key: text for key, text in found.items() if text}


def _indices(interface: Interface) -> dict[int, int]:
    """Value reference -> index in ModelVariables of FMI 2, counted from 1."""
    references = [r for v in interface.variables if v.role != EVENT for _, r, _ in v.entries()]
    return {0: 1} | {reference: k for k, reference in enumerate(references, 2)}


# ---- model structure ----


def _unknowns(interface: Interface, version: str) -> dict[str, list[tuple[int, dict[int, str]]]]:
    """Return outputs, derivatives, initial unknowns and events: reference, and those it depends on with their kind.

    The indicators of FMUs inside depend on all that may move: nothing more is told of them.
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

    moving = [
        {known(c): kinds.get(c, DEPENDENT) for c in columns}
        for columns, kinds in zip(found.by_column, found.kinds, strict=True)
    ]
    if version == "3.0":
        moving = [row | dict.fromkeys(set_by(p), DEPENDENT) for row, p in zip(moving, found.by_parameter, strict=True)]
    every = dict.fromkeys(map(known, range(n_x + n_u + 1)), DEPENDENT)
    moving += [every] * (n_x + n_y + interface.count(EVENT) - len(moving))
    calculated = [k for k in range(n_x) if not interface.x_exact[k]]
    return {
        "outputs": [(at[OUTPUT] + k, moving[n_x + k]) for k in range(n_y)],
        "derivatives": [(at[DERIVATIVE] + k, moving[k]) for k in range(n_x)],
        "events": [(at[EVENT] + k, moving[n_x + n_y + k]) for k in range(interface.count(EVENT))],
        "initial": [
            *((at[OUTPUT] + k, dict.fromkeys(at_start(n_x + k), DEPENDENT)) for k in range(n_y)),
            *((at[STATE] + k, dict.fromkeys(at_start(n_x + n_y + k), DEPENDENT)) for k in calculated),
            *((at[DERIVATIVE] + k, dict.fromkeys(at_start(k), DEPENDENT)) for k in range(n_x)),
        ],
    }


def _structure(parent: Element, interface: Interface, version: str) -> None:
    """Add the model structure: lists of indices (FMI 2.0), or elements with value references (FMI 3.0)."""
    unknowns = _unknowns(interface, version)
    if version == "2.0":
        index = _indices(interface)
        for tag, key in (("Outputs", "outputs"), ("Derivatives", "derivatives"), ("InitialUnknowns", "initial")):
            group = SubElement(parent, tag) if unknowns[key] else parent
            for reference, knowns in unknowns[key]:
                listed = {index[k]: kind for k, kind in knowns.items()}
                SubElement(group, "Unknown", {"index": str(index[reference]), **_listed(listed)})
        return
    owner = _owners(interface)
    for tag, key in _TAGS3.items():
        joined: dict[int, dict[int, set[str]]] = {}
        for reference, knowns in unknowns[key]:
            row = joined.setdefault(owner[reference], {})
            for k, kind in knowns.items():
                row.setdefault(owner[k], set()).add(kind)
        for reference, known in joined.items():
            weakest = {k: max(kinds, key=_WEAKER.index) for k, kinds in known.items()}
            SubElement(parent, tag, {"valueReference": str(reference), **_listed(weakest)})


def _listed(knowns: Mapping[int, str]) -> dict[str, str]:
    """Return the attributes that list what an unknown depends on; no kinds where nothing is known of any."""
    places = sorted(knowns)
    kinds = [knowns[k] for k in places]
    listed = {"dependencies": " ".join(map(str, places))}
    return listed | ({"dependenciesKind": " ".join(kinds)} if {*kinds} - {DEPENDENT} else {})


def _owners(interface: Interface) -> dict[int, int]:
    """Return the reference of the variable that every scalar belongs to."""
    inside = [(v.reference, k) for v in interface.variables for k in range(v.size)]
    return {0: 0} | {first + k: first if interface.arrays else first + k for first, k in inside}
