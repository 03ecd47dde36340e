"""Which places of a diagram the data cannot tell apart: where an effect passes blocks unchanged but for its numbers."""

from __future__ import annotations

from typing import Any

PASSES = {
    "static": {"gain"},
    "linear": {"gain", "integrator", "transfer_function", "derivative", "delay"},
    "added": {"gain", "sum"},
    "added_dynamic": {"gain", "sum", "integrator", "transfer_function"},
}


def accepted(document: dict[str, Any], location: str, moves: str, argument: str | None = None) -> list[str]:
    """Return the ports where an effect may be said to be: location itself, the ends of its wire, equivalent places.

    From an input on, through a block, to its output, and back; an output is its wire where it goes to one input and
    is not recorded. For what is added, all inputs of a sum are its output. The argument of a force is accepted too.
    """
    types = {name: block["type"] for name, block in document["blocks"].items()}
    source = {to: out for out, to in document["wires"]}
    goes_to: dict[str, list[str]] = {}
    for out, to in document["wires"]:
        goes_to.setdefault(out, []).append(to)
    inputs: dict[str, list[str]] = {}
    for to in source:
        inputs.setdefault(to.split(".")[0], []).append(to)
    seen = {port for port in document["record"] if types[port.split(".")[0]] != "recorded"}

    def alone(out: str) -> bool:
        return len(goes_to.get(out, [])) == 1 and out not in seen

    def beside(port: str) -> list[str]:
        block, name = port.split(".")
        found = []
        passes = types[block] in PASSES[moves]
        if name.startswith("output"):
            found += goes_to[port] if alone(port) else []
            found += inputs.get(block, []) if passes else []
        else:
            found += [source[port]] if alone(source[port]) else []
            if passes:
                found += [f"{block}.output", *inputs[block]]
        return found

    reached, waiting = {location}, [location]
    while waiting:
        for port in beside(waiting.pop()):
            if port not in reached:
                reached.add(port)
                waiting.append(port)
    ends = {source[location]} if location in source else set()
    ends |= {argument} if argument else set()
    return [location, *sorted((reached | ends) - {location})]


def wire(document: dict[str, Any], location: str) -> str:
    """Return where a place is, in words."""
    for out, to in document["wires"]:
        if to == location:
            return f"{out} -> {to}"
    return f"{location}, for all that it goes to"
