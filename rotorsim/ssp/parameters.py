"""Read XML documents of SSP: sets of parameters (.ssv), their types and units."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

from rotorsim.errors import Problem, RotorsimError
from rotorsim.fmi.description.archive import Archive
from rotorsim.fmi.description.attributes import Mistakes, parse_value
from rotorsim.fmi.description.model import FLOATS, INTEGERS, FmuUnit
from rotorsim.fmi.description.xml_reader import Element, XmlLimits, read_xml
from rotorsim.ssp.structure import NAMESPACES, Setting

__all__ = ["TYPES", "child_elements", "open_document", "read_parameters", "read_units", "unit_named"]

MAX_BYTES = 16 << 20  # of one XML file
_LIMITS = XmlLimits(bytes=MAX_BYTES, elements=300_000)
TYPES = {"Real": "Float64", "Integer": "Int32"} | {
    name: name for name in (*FLOATS, *INTEGERS, "Boolean", "String", "Binary")
}


def open_document(archive: Archive, name: str, tag: str, problems: list[Problem]) -> tuple[Element, Mistakes]:
    """Return the root of a file in the archive, and where its mistakes go: among problems."""
    mistakes = Mistakes(f"{archive.path}/{name}", problems)
    document = read_xml(archive.read(name, MAX_BYTES), mistakes.file, limits=_LIMITS)
    root = _without_prefixes(document, {}) or replace(document, tag="", children=[])
    if root.tag != tag:
        raise RotorsimError(Problem(f"the document is no {tag} of SSP", place=mistakes.place(root)))
    return root, mistakes


def _without_prefixes(element: Element, spaces: Mapping[str, str]) -> Element | None:
    """Return an element with the prefixes of all names resolved; None where it is not of SSP."""
    own = {name.partition(":")[2]: uri for name, uri in element.attributes.items() if name.partition(":")[0] == "xmlns"}
    spaces = {**spaces, **own} if own else spaces
    prefix, colon, tag = element.tag.rpartition(":")
    if spaces.get(prefix if colon else "") not in NAMESPACES.values():
        return None
    children = [found for child in element.children if (found := _without_prefixes(child, spaces)) is not None]
    return replace(element, tag=tag, children=children)


def child_elements(element: Element, tag: str) -> list[Element]:
    """Return the elements of a group: <Units> holds <Unit>, <Connectors> holds <Connector>, ..."""
    return [child for group in element.all(f"{tag}s") for child in group.all(tag)]


def read_units(root: Element, mistakes: Mistakes) -> dict[str, FmuUnit]:
    """Return the units of a file."""
    units: dict[str, FmuUnit] = {}
    for element in child_elements(root, "Unit"):
        unit = mistakes.unit(element)
        if unit.name in units or not unit.defined:
            what = "is defined twice" if unit.defined else "has no BaseUnit"
            mistakes.wrong(element, what, f"unit {unit.name[:80]}")
        else:
            units[unit.name] = unit
    return units


def unit_named(typed: Element, units: Mapping[str, FmuUnit], mistakes: Mistakes, subject: str) -> FmuUnit | None:
    """Return the unit that an element names, None where it names none, or one that is not defined."""
    name = typed.get("unit")
    if name and name not in units:
        mistakes.wrong(typed, f"the unit '{name[:80]}' is not among the Units of the file", subject)
    return units.get(name)


def read_parameters(root: Element, mistakes: Mistakes) -> list[Setting]:
    """Return the values of a set of parameters."""
    units = read_units(root, mistakes)
    return [setting for child in child_elements(root, "Parameter") for setting in _parameter(child, units, mistakes)]


def _parameter(element: Element, units: Mapping[str, FmuUnit], mistakes: Mistakes) -> Iterator[Setting]:
    name = mistakes.attributes(element, element.get("name")).text("name", needed=True)
    typed = next(element.all(*TYPES), None)
    if typed is None:
        mistakes.wrong(element, "has no type that we know", name)
        return
    kind = TYPES[typed.tag]
    sizes = [mistakes.attributes(d, name).whole("size", 1, most=1_000_000) for d in element.all("Dimension")]
    text = typed.attributes.get("value")
    words = [value.text for value in typed.all("Value")] if text is None else text.split() if sizes else [text]
    plain = "String" if kind == "Enumeration" else kind  # given by the name of an item
    values = tuple(value for word in words if (value := parse_value(word, plain)) is not None)
    if not values or len(values) != len(words):
        mistakes.wrong(typed, f'value="{(text or "")[:80]}" is not of type {typed.tag}', name)
        return
    yield Setting(name, kind, values, unit_named(typed, units, mistakes, name), tuple(sizes), mistakes.place(element))
