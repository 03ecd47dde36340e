"""The model structure of a model description: outputs, derivatives, initial unknowns, what depends on what."""

from __future__ import annotations

from typing import Any

from rotorsim.errors import Problem
from rotorsim.fmi.description.attributes import Mistakes
from rotorsim.fmi.description.variables import VariableReader, reference_in
from rotorsim.fmi.description.xml_reader import Element

__all__ = ["read_model_structure"]

_GROUPS = {
    "outputs": ("Outputs", "Output"),
    "derivatives": ("Derivatives", "ContinuousStateDerivative"),
    "initial_unknowns": ("InitialUnknowns", "InitialUnknown"),
}


def read_model_structure(group: Element, reader: VariableReader, mistakes: Mistakes) -> dict[str, Any]:
    """Return what `ModelDescription` takes of <ModelStructure>: names of unknowns, states, dependencies, n_events."""
    listed: dict[str, tuple[str, ...]] = {}
    dependencies: dict[str, tuple[str, ...] | None] = {}
    for key, (old, new) in _GROUPS.items():
        elements = group.all(new) if reader.three else (u for e in group.all(old) for u in e.all("Unknown"))
        unknowns = [(element, _unknown(element, reader, mistakes)) for element in elements]
        listed[key] = tuple(name for _, name in unknowns if name)
        if key != "initial_unknowns":
            dependencies |= {name: _dependencies(e, name, reader, mistakes) for e, name in unknowns if name}
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


def _dependencies(element: Element, subject: str, reader: VariableReader, mistakes: Mistakes) -> tuple[str, ...] | None:
    """Return the variables that an unknown depends on, None: not said."""
    if "dependencies" not in element.attributes:
        return None
    known = {word: reader.at(reference_in(word)) for word in element.get("dependencies").split()}
    wrong = next((word for word, variable in known.items() if variable is None), None)
    if wrong is not None:
        mistakes.wrong(element, f"depends on '{wrong[:40]}', which is not a variable", subject)
        return None
    return tuple(variable.name for variable in known.values() if variable)
