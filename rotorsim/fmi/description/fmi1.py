"""Model descriptions of FMI 1.0 in the terms of FMI 2.0, so that one reader reads both.

Elements keep their places. What FMI 1.0 does not say: names of states and derivatives, definitions of units.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from rotorsim.fmi.description.attributes import Mistakes
from rotorsim.fmi.description.model import FmuVariable
from rotorsim.fmi.description.xml_reader import Element

MAX_STATES = 100_000
UNDEFINED = 2**32 - 1  # the value reference of nothing (fmiUndefinedValueReference)
_CAUSALITIES = ("input", "output", "internal", "none")
_VARIABILITIES = ("constant", "parameter", "discrete", "continuous")
_ALIASES = ("noAlias", "alias", "negatedAlias")


def in_terms_of_2(root: Element, mistakes: Mistakes) -> Element:
    """Return a model description as FMI 2.0 would have it (FMI 1.0 for Co-Simulation, chapter 4)."""
    kept = [*root.all("DefaultExperiment")]
    for group in root.all("UnitDefinitions"):
        kept.append(replace(group, children=[_unit(base) for base in group.all("BaseUnit")]))
    for group in root.all("TypeDefinitions"):
        kept.append(replace(group, children=[_type(declared) for declared in group.all("Type")]))
    for group in root.all("ModelVariables"):
        elements = [*group.all("ScalarVariable")]
        outputs = replace(group, tag="Outputs", attributes={}, children=[*_outputs(elements, mistakes)])
        kept.append(replace(group, children=[_variable(element, mistakes) for element in elements]))
        kept.append(replace(group, tag="ModelStructure", attributes={}, children=[outputs]))
    return replace(root, children=[_kind(root, mistakes), *kept])


def unnamed_states(count: int) -> dict[str, Any]:
    """Return what `ModelDescription` takes of states that are counted and have no names."""
    if not count:
        return {}
    states, rates = (
        FmuVariable(name, UNDEFINED, "Float64", dimensions=(count,))
        for name in ("continuous state", "derivative of continuous state")
    )
    return {"states": tuple(states.names()), "derivatives": tuple(rates.names()), "unlisted": (states, rates)}


def _kind(root: Element, mistakes: Mistakes) -> Element:
    """Return what an FMU offers: Model Exchange unless it has an <Implementation>, which is of Co-Simulation."""
    own = {name: root.get(name) for name in ("modelIdentifier",) if name in root.attributes}
    implementation = root.first("Implementation")
    if implementation is None:
        return replace(root, tag="ModelExchange", attributes=own, children=[])
    alone, tool = implementation.first("CoSimulation_StandAlone"), implementation.first("CoSimulation_Tool")
    holder = alone or tool
    if holder is None:
        mistakes.wrong(implementation, "holds neither <CoSimulation_StandAlone> nor <CoSimulation_Tool>")
        holder = implementation
    capabilities = holder.first("Capabilities") or replace(holder, attributes={})
    said = {**capabilities.attributes, **own, "needsExecutionTool": "false" if alone else "true"}
    return replace(capabilities, tag="CoSimulation", attributes=said, children=[])


def _unit(base: Element) -> Element:
    names = {"displayUnit": "name", "gain": "factor", "offset": "offset"}
    shown = [
        replace(
            element, tag="DisplayUnit", attributes={names[k]: v for k, v in element.attributes.items() if k in names}
        )
        for element in base.all("DisplayUnitDefinition")
    ]
    return replace(base, tag="Unit", attributes={"name": base.get("unit")}, children=shown)


def _type(declared: Element) -> Element:
    """Return a type; the items of one that enumerates count from 1."""
    inner = [replace(element, tag=element.tag.removesuffix("Type")) for element in declared.children]
    for element in inner:
        items = enumerate(element.all("Item"), 1)
        element.children = [replace(item, attributes={**item.attributes, "value": str(k)}) for k, item in items]
    return replace(declared, tag="SimpleType", children=inner)


def _variable(element: Element, mistakes: Mistakes) -> Element:
    read = mistakes.attributes(element, element.get("name"))
    causality = read.choice("causality", _CAUSALITIES, "internal")
    variability = read.choice("variability", _VARIABILITIES, "continuous")
    read.choice("alias", _ALIASES, "noAlias")
    inner = next((child for child in element.children if child.tag != "DirectDependency"), element)
    begins = "start" in inner.attributes
    exact = begins and ("fixed" not in inner.attributes or mistakes.attributes(inner, read.subject).flag("fixed"))
    moves = "continuous" if inner.tag == "Real" and variability == "continuous" else "discrete"
    initial = "exact" if exact else "approx" if begins else "calculated"
    if variability == "constant":
        causality, moves, initial = "output" if causality == "output" else "local", "constant", "exact"
    elif variability == "parameter" and causality != "output":  # without a value of its own it follows from others
        causality, moves = "parameter" if exact else "calculatedParameter", "fixed"
    elif causality == "input":
        initial = "exact"
    elif causality != "output":
        causality = "local"
    own = {"causality": causality, "variability": moves, "initial": initial}
    return replace(element, attributes={**element.attributes, **own})


def _outputs(elements: list[Element], mistakes: Mistakes) -> Iterator[Element]:
    """Yield the outputs as a model structure lists them; variables count from 1."""
    places = {element.get("name"): str(k) for k, element in enumerate(elements, 1)}
    for element in elements:
        if element.get("causality") != "output":
            continue
        attributes = {"index": places[element.get("name")]}
        direct = element.first("DirectDependency")
        if direct is not None:  # else it may depend on every input
            named = [(name, name.text.strip()) for name in direct.all("Name")]
            for name, text in named:
                if text not in places:
                    what = f"depends on '{text[:80]}', which is not a variable"
                    mistakes.wrong(name, what, element.get("name"))
            attributes["dependencies"] = " ".join(places[text] for _, text in named if text in places)
        yield replace(element, tag="Unknown", attributes=attributes, children=[])
