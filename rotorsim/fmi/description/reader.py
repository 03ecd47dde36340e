"""Reading modelDescription.xml of FMI 1.0, 2.0 and 3.0: all mistakes at once, each with line and column."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from rotorsim.errors import Place, Problem, RotorsimError
from rotorsim.fmi.description.attributes import Mistakes
from rotorsim.fmi.description.fmi1 import MAX_STATES, in_terms_of_2, unnamed_states
from rotorsim.fmi.description.model import FMU_KINDS, Experiment, FmuUnit, Kind, ModelDescription
from rotorsim.fmi.description.variables import VariableReader, reference_in
from rotorsim.fmi.description.xml_reader import Element, XmlLimits, read_xml

MAX_EVENTS = 100_000
_SHOWN = 20  # mistakes
_IDENTIFIER = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,199}")
_GROUPS = {  # of the model structure: in FMI 2.0, in FMI 3.0
    "outputs": ("Outputs", "Output"),
    "derivatives": ("Derivatives", "ContinuousStateDerivative"),
    "initial_unknowns": ("InitialUnknowns", "InitialUnknown"),
}
_DEPENDENCY_KINDS = {"constant": True, "fixed": True, "tunable": True, "discrete": False, "dependent": False}
_SKIP = frozenset({"Annotations", "VendorAnnotations", "Tool"})


def read_description(
    data: bytes, file: str, *, limits: XmlLimits | None = None, sizes: Mapping[str, int] | None = None
) -> ModelDescription:
    """Return the model description. file: the name to be shown; sizes: values of structural parameters (FMI 3.0).

    Raises RotorsimError with every mistake.
    """
    root, mistakes, place = read_xml(data, file, skip=_SKIP, limits=limits), Mistakes(file), Place(file)
    version = _version(root, mistakes)
    one, two = version == "1.0", version != "3.0"
    root = in_terms_of_2(root, mistakes) if one else root
    head = mistakes.attributes(root)
    name = head.text("modelName", needed=True)
    token = head.text("guid" if two else "instantiationToken", needed=True)
    kinds = _kinds(root, two, mistakes)
    units = _units(root, two, mistakes)
    types = _types(root, two)
    items = {name: _items(name, element, mistakes) for name, element in types.items() if element.first("Item")}
    n_events = head.whole("numberOfEventIndicators", 0, most=MAX_EVENTS) if two else 0
    reader = VariableReader(mistakes, version, types, sizes or {})
    groups = {tag: root.first(tag) or _missing(root, tag, mistakes) for tag in ("ModelVariables", "ModelStructure")}
    reader.read(groups["ModelVariables"])
    resized = reader.resized(place)
    structure: dict[str, Any] = _model_structure(groups["ModelStructure"], reader, mistakes)
    structure |= unnamed_states(head.whole("numberOfContinuousStates", 0, most=MAX_STATES) if one else 0)
    log = root.first("LogCategories")
    experiment = _experiment(root, mistakes)
    mistakes.refuse(_SHOWN, place)
    return ModelDescription(
        version=version,
        name=name,
        token=token,
        variables=reader.variables,
        kinds=kinds,
        units=units,
        experiment=experiment,
        description=root.get("description"),
        author=root.get("author"),
        tool=root.get("generationTool"),
        date=root.get("generationDateAndTime"),
        naming=root.get("variableNamingConvention", "flat"),
        place=place,
        log_categories=tuple(c.get("name") for c in log.all("Category")) if log else (),
        items=items,
        sizes=resized,
        **(structure | {"n_events": structure["n_events"] + n_events}),
    )


def _missing(root: Element, tag: str, mistakes: Mistakes) -> Element:
    """Note that an element is missing; return an empty one in its place."""
    mistakes.wrong(root, f"<{tag}> is missing")
    return replace(root, tag=tag, attributes={}, children=[])


def _version(root: Element, mistakes: Mistakes) -> str:
    """Return "1.0", "2.0" or "3.0". Raises RotorsimError for anything else."""
    version, hint = root.get("fmiVersion"), ""
    if root.tag != "fmiModelDescription":
        what = f"the document is <{root.tag[:80]}>, not <fmiModelDescription>"
    elif version in ("1.0", "2.0") or re.fullmatch(r"3\.0(\.\d+)?(-.*)?", version):
        return version[:3]
    else:
        what = f"FMI {version[:20]} is not supported" if version else "the attribute fmiVersion is missing"
        hint = "FMI 1.0, 2.0 and 3.0 are"
    raise RotorsimError(Problem(what, place=mistakes.place(root), hint=hint))


def _kinds(root: Element, two: bool, mistakes: Mistakes) -> dict[str, Kind]:
    found = {name: root.first(re.sub(r"\W", "", words)) for name, words in FMU_KINDS.items() if name != "se" or not two}
    kinds = {name: _kind(name, element, two, mistakes) for name, element in found.items() if element}
    if not kinds:
        mistakes.wrong(root, "offers neither Co-Simulation nor Model Exchange")
    return kinds


def _kind(name: str, element: Element, two: bool, mistakes: Mistakes) -> Kind:
    read = mistakes.attributes(element, element.tag)
    identifier = read.text("modelIdentifier", needed=True)
    if identifier and not _IDENTIFIER.fullmatch(identifier):
        hint = "it names a file: letters, digits and _ only, not starting with a digit"
        mistakes.wrong(element, f"modelIdentifier '{identifier[:80]}' is not an identifier", element.tag, hint)
    state, derivatives = ("FMUstate", "Derivative") if two else ("FMUState", "Derivatives")
    needed = not read.flag("completedIntegratorStepNotNeeded") if two else read.flag("needsCompletedIntegratorStep")
    return Kind(
        name,
        identifier,
        can_get_set_state=read.flag(f"canGetAndSet{state}"),
        can_serialise_state=read.flag(f"canSerialize{state}"),
        directional_derivatives=read.flag(f"providesDirectional{derivatives}"),
        adjoint_derivatives=not two and read.flag("providesAdjointDerivatives"),
        once_per_process=read.flag("canBeInstantiatedOnlyOncePerProcess"),
        needs_tool=read.flag("needsExecutionTool"),
        can_vary_step=read.flag("canHandleVariableCommunicationStepSize"),
        can_interpolate_inputs=two and read.flag("canInterpolateInputs"),
        max_output_derivative_order=read.whole("maxOutputDerivativeOrder", 0, most=100),
        fixed_step=None if two else read.number("fixedInternalStepSize", None),
        completed_step_needed=needed,
    )


def _experiment(root: Element, mistakes: Mistakes) -> Experiment:
    element = root.first("DefaultExperiment")
    if element is None:
        return Experiment()
    read = mistakes.attributes(element, "DefaultExperiment")
    return Experiment(*(read.number(name, None) for name in ("startTime", "stopTime", "tolerance", "stepSize")))


def _units(root: Element, two: bool, mistakes: Mistakes) -> dict[str, FmuUnit]:
    units: dict[str, FmuUnit] = {}
    for element in (unit for group in root.all("UnitDefinitions") for unit in group.all("Unit")):
        name = element.get("name")
        if name in units:
            mistakes.wrong(element, "is defined twice", f"unit {name[:80]}")
        display = {}
        for shown in element.all("DisplayUnit"):
            read = mistakes.attributes(shown, f"unit {name[:80]}")
            inverse = not two and read.flag("inverse")
            display[shown.get("name")] = (read.factor(), read.number("offset", 0.0), inverse)
        units[name] = replace(mistakes.unit(element), display=display)
    return units


def _types(root: Element, two: bool) -> dict[str, Element]:
    """Return type name -> the element with its attributes."""
    declared = [element for group in root.all("TypeDefinitions") for element in group.children]
    if two:
        return {e.get("name"): e.children[0] for e in declared if e.tag == "SimpleType" and e.children}
    return {element.get("name"): element for element in declared}


def _items(name: str, element: Element, mistakes: Mistakes) -> dict[str, int]:
    """Return the names of the values of a type that enumerates."""
    reads = [mistakes.attributes(item, f"type {name[:80]}") for item in element.all("Item")]
    low, high = -(2**63), 2**63 - 1
    return {read.text("name", needed=True): read.whole("value", None, least=low, most=high) for read in reads}


def _model_structure(group: Element, reader: VariableReader, mistakes: Mistakes) -> dict[str, Any]:
    """Return what `ModelDescription` takes of <ModelStructure>: names of unknowns, states, dependencies, n_events."""
    listed: dict[str, tuple[str, ...]] = {}
    dependencies: dict[str, tuple[str, ...] | None] = {}
    factors: dict[str, frozenset[str]] = {}
    for key, (old, new) in _GROUPS.items():
        elements = group.all(new) if reader.three else (u for e in group.all(old) for u in e.all("Unknown"))
        unknowns = [(element, _unknown(element, reader, mistakes)) for element in elements]
        listed[key] = tuple(name for _, name in unknowns if name)
        if key != "initial_unknowns":
            found = {name: _dependencies(e, name, reader, mistakes) for e, name in unknowns if name}
            dependencies |= {name: None if known is None else tuple(known) for name, known in found.items()}
            factors |= {name: frozenset(k for k, own in (known or {}).items() if own) for name, known in found.items()}
    rates = [reader.variables[name] for name in listed["derivatives"]]
    states = []
    for rate in rates:
        state = rate.derivative_of
        if state and reader.variables[state].size == rate.size:
            states.append(reader.variables[state])
        elif rate.name not in reader.stray:
            what = f"has not the shape of its state {state}" if state else "does not say of which state it is"
            mistakes.problems.append(Problem(f"is listed as a derivative but {what}", rate.name, rate.place))
    events = (reader.at(reference_in(e.get("valueReference"))) for e in group.all("EventIndicator"))
    return {
        **listed,
        "dependencies": dependencies,
        "factors": factors,
        "states": tuple(name for state in states for name in state.names()),
        "derivatives": tuple(name for rate in rates for name in rate.names()),
        "n_events": sum(variable.size for variable in events if variable is not None),
    }


def _unknown(element: Element, reader: VariableReader, mistakes: Mistakes) -> str:
    """Return the name of an unknown of the model structure, "" where there is no such variable."""
    key = "valueReference" if reader.three else "index"
    variable = reader.at(mistakes.attributes(element, element.tag).whole(key, -1, most=2**32 - 1))
    if variable is None:
        mistakes.wrong(element, f'{key}="{element.get(key)[:40]}" is not a variable', "ModelStructure")
    return variable.name if variable else ""


def _dependencies(element: Element, subject: str, reader: VariableReader, mistakes: Mistakes) -> dict[str, bool] | None:
    """Return the variables that an unknown depends on, and whether by a factor that does not move; None: not said."""
    if "dependencies" not in element.attributes:
        return None
    words = element.get("dependencies").split()
    known = {word: reader.at(reference_in(word)) for word in words}
    kinds = element.get("dependenciesKind").split() or ["dependent"] * len(words)
    odd = next((kind for kind in kinds if kind not in _DEPENDENCY_KINDS), None)
    if odd is not None or len(kinds) != len(words):
        what = f"'{odd[:40]}' is not one" if odd is not None else f"{len(kinds)} for {len(words)} dependencies"
        mistakes.wrong(element, f"dependenciesKind: {what}", subject)
        return None
    wrong = next((word for word, variable in known.items() if variable is None), None)
    if wrong is not None:
        mistakes.wrong(element, f"depends on '{wrong[:40]}', which is not a variable", subject)
        return None
    constant = {word for word, kind in zip(words, kinds, strict=True) if _DEPENDENCY_KINDS[kind]}
    return {variable.name: word in constant for word, variable in known.items() if variable}
