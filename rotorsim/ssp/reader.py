"""Read SystemStructure.ssd of SSP 1.0 and 2.0 out of an archive, within limits.

What would change the meaning of a system and is not supported is refused by name; geometry, annotations and metadata
are left out.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from urllib.parse import unquote

from rotorsim.errors import Problem, RotorsimError
from rotorsim.fmi.description.archive import Archive, check_name
from rotorsim.fmi.description.attributes import Mistakes, parse_value
from rotorsim.fmi.description.model import FLOATS, INTEGERS, FmuUnit
from rotorsim.fmi.description.xml_reader import Element, XmlLimits, read_xml
from rotorsim.ssp.structure import (
    FMU,
    INTERFACES,
    NAMESPACES,
    STRUCTURE_FILE,
    Component,
    Connection,
    Connector,
    End,
    Setting,
    Structure,
    System,
)

MAX_XML_BYTES = 16 << 20  # of one XML file
_LIMITS = XmlLimits(bytes=MAX_XML_BYTES, elements=300_000)
_TYPES = {"Real": "Float64", "Integer": "Int32"} | {
    name: name for name in (*FLOATS, *INTEGERS, "Boolean", "String", "Binary")
}
MAX_SETTINGS = 1_000_000  # of all components together; a file may be bound many times
_SHOWN = 50
_SET = "application/x-ssp-parameter-set"
_IMPLEMENTATIONS = {"any": ""} | {words: name for name, words in INTERFACES.items()}
_KINDS = ("input", "output", "parameter", "calculatedParameter", "structuralParameter", "constant", "local", "inout")
_TRANSFORMATIONS = ("BooleanMappingTransformation", "IntegerMappingTransformation", "EnumerationMappingTransformation")


def read_structure(archive: Archive) -> Structure:
    """Return the system that an archive describes. Raises RotorsimError with every mistake."""
    root, mistakes = _open_document(archive, STRUCTURE_FILE, "SystemStructureDescription", [])
    version = root.get("version")
    if not re.fullmatch(r"[12]\.\d+(-.*)?", version):
        what = f"SSP {version[:20]} is not supported" if version else "the attribute version is missing"
        raise RotorsimError(Problem(what, place=mistakes.place(root), hint="SSP 1.0 and 2.0 are"))
    system, experiment = root.first("System"), root.first("DefaultExperiment")
    if system is None:
        raise RotorsimError(Problem("there is no System in it", place=mistakes.place(root)))
    made = _Reader(archive, mistakes, _units(root, mistakes)).system(system)
    times = mistakes.attributes(experiment, "DefaultExperiment") if experiment else None
    start, stop = (times.number(name, None) if times else None for name in ("startTime", "stopTime"))
    mistakes.refuse(_SHOWN, archive.place)
    return Structure(root.get("name"), version[:3], made, start, stop, root.get("description"))


class _Reader:
    """Reads systems and what is in them. units: of the file."""

    def __init__(self, archive: Archive, mistakes: Mistakes, units: Mapping[str, FmuUnit]) -> None:
        self.archive, self.mistakes, self.units = archive, mistakes, units
        self.wrong, self.read = mistakes.wrong, mistakes.attributes
        self.sets: dict[str, list[Setting]] = {}  # of the files read
        self.count = 0

    def system(self, element: Element) -> System:
        inside = [child for group in element.all("Elements") for child in group.children]
        seen: set[str] = set()
        for child in inside:
            name = self.read(child, child.tag).text("name", needed=True)
            if name in seen:
                self.wrong(child, "is the name of two elements of a system", name)
            seen.add(name)
            if child.tag not in ("Component", "System"):
                self.wrong(child, f"{child.tag} is not supported", name)
        return System(
            element.get("name"),
            self.connectors(element),
            self.settings(element),
            tuple(self.component(child) for child in inside if child.tag == "Component"),
            tuple(self.system(child) for child in inside if child.tag == "System"),
            tuple(c for child in _child_elements(element, "Connection") for c in self.connection(child)),
            self.mistakes.place(element),
        )

    def component(self, element: Element) -> Component:
        name, kind = element.get("name"), element.get("type", FMU)
        if kind != FMU:
            self.wrong(element, f"components of type {kind[:80]} are not supported: only FMUs", name)
        implementation = element.get("implementation", "any")
        if implementation not in _IMPLEMENTATIONS:
            self.wrong(element, f'implementation="{implementation[:40]}" is not supported', name)
        return Component(
            name,
            self.source(element, name),
            self.connectors(element),
            self.settings(element),
            _IMPLEMENTATIONS.get(implementation, ""),
            self.mistakes.place(element),
        )

    def source(self, element: Element, subject: str) -> str:
        """Return the file in the archive that a relative URI names, "" where it is wrong."""
        uri = element.attributes.get("source")
        if uri is None:
            self.wrong(element, "has no source: nothing implements it", subject)
            return ""
        name = unquote(uri, errors="replace").removeprefix("./")
        reasons = {
            "a part of a document is not supported": "#" in uri or "?" in uri,
            "it is not relative": re.match(r"[A-Za-z][\w+.-]*:|/", uri),
            check_name(name): True,
            "there is no such file in the archive": name not in self.archive,
        }
        why = next((why for why, is_so in reasons.items() if why and is_so), "")
        if why:
            self.wrong(element, f"source '{uri[:80]}': {why}", subject)
        return "" if why else name

    def connectors(self, element: Element) -> tuple[Connector, ...]:
        found: dict[str, Connector] = {}
        for child in _child_elements(element, "Connector"):
            read = self.read(child, child.get("name"))
            name, kind = read.text("name", needed=True), read.choice("kind", _KINDS, "input")
            if name in found:
                self.wrong(child, "is the name of two connectors", name)
            typed = next(child.all(*_TYPES), None)
            unit = _unit_named(typed, self.units, self.mistakes, name) if typed else None
            sizes = [self.read(d, name).whole("size", 0, most=1_000_000) for d in child.all("Dimension")]
            found[name] = Connector(name, kind, _TYPES[typed.tag] if typed else "", unit, tuple(sizes))
        return tuple(found.values())

    def connection(self, element: Element) -> Iterator[Connection]:
        subject = f"{element.get('startConnector')[:80]} -> {element.get('endConnector')[:80]}"
        read = self.read(element, subject)
        ends = []
        for which in ("start", "end"):
            words = element.get(f"{which}Indices").split()
            indices = tuple(int(word) for word in words if re.fullmatch(r"\d{1,7}", word))
            given = f"{which}Indices" in element.attributes
            if given and (len(indices) != len(words) or not indices or 0 in indices):
                self.wrong(element, f"{which}Indices are not whole numbers from 1", subject)
                return
            name = read.text(f"{which}Connector", needed=True)
            ends.append(End(element.attributes.get(f"{which}Element"), name, indices if given else None))
        for kind in element.all(*_TRANSFORMATIONS):
            self.wrong(kind, f"{kind.tag} is not supported", subject)
        linear = element.first("LinearTransformation")
        scale = self.read(linear, subject) if linear else None
        factor, offset = (scale.number("factor", 1.0), scale.number("offset", 0.0)) if scale else (1.0, 0.0)
        suppress = read.flag("suppressUnitConversion")
        yield Connection(ends[0], ends[1], factor, offset, suppress, self.mistakes.place(element))

    def settings(self, element: Element) -> tuple[Setting, ...]:
        """Return the values of all bindings, the later ones last."""
        found: list[Setting] = []
        subject = element.get("name")
        for binding in _child_elements(element, "ParameterBinding"):
            if binding.first("ParameterMapping") is not None:
                self.wrong(binding, "a ParameterMapping is not supported", subject)
            elif binding.get("type", _SET) != _SET:
                self.wrong(binding, f"parameters of type {binding.get('type')[:80]} are not supported", subject)
            elif binding.get("sourceBase", "SSD") != "SSD":
                self.wrong(binding, "parameters inside a component are not supported", subject)
            else:
                prefix, values = binding.get("prefix"), self.values(binding, subject)
                self.count += len(values)
                if self.count > MAX_SETTINGS:
                    what = f"more than {MAX_SETTINGS} values of parameters"
                    raise RotorsimError(Problem(what, subject, self.mistakes.place(binding)))
                found += [replace(setting, name=prefix + setting.name) for setting in values] if prefix else values
        return tuple(found)

    def values(self, binding: Element, subject: str) -> list[Setting]:
        """Return the values of a binding: written in it, or in a file of the archive."""
        inline = binding.first("ParameterValues")
        if inline is not None:
            inner = inline.first("ParameterSet")
            if inner is None:
                self.wrong(inline, "there is no ParameterSet in it", subject)
            return _parameters(inner, self.mistakes) if inner else []
        name = self.source(binding, subject)
        if name and name not in self.sets:
            self.sets[name] = _parameters(*_open_document(self.archive, name, "ParameterSet", self.mistakes.problems))
        return self.sets.get(name, [])


def _open_document(archive: Archive, name: str, tag: str, problems: list[Problem]) -> tuple[Element, Mistakes]:
    """Return the root of a file in the archive, and where its mistakes go: among problems."""
    mistakes = Mistakes(f"{archive.path}/{name}", problems)
    document = read_xml(archive.read(name, MAX_XML_BYTES), mistakes.file, limits=_LIMITS)
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


def _child_elements(element: Element, tag: str) -> list[Element]:
    """Return the elements of a group: <Units> holds <Unit>, <Connectors> holds <Connector>, ..."""
    return [child for group in element.all(f"{tag}s") for child in group.all(tag)]


def _units(root: Element, mistakes: Mistakes) -> dict[str, FmuUnit]:
    """Return the units of a file."""
    units: dict[str, FmuUnit] = {}
    for element in _child_elements(root, "Unit"):
        unit = mistakes.unit(element)
        if unit.name in units or not unit.defined:
            what = "is defined twice" if unit.defined else "has no BaseUnit"
            mistakes.wrong(element, what, f"unit {unit.name[:80]}")
        else:
            units[unit.name] = unit
    return units


def _unit_named(typed: Element, units: Mapping[str, FmuUnit], mistakes: Mistakes, subject: str) -> FmuUnit | None:
    """Return the unit that an element names, None where it names none, or one that is not defined."""
    name = typed.get("unit")
    if name and name not in units:
        mistakes.wrong(typed, f"the unit '{name[:80]}' is not among the Units of the file", subject)
    return units.get(name)


def _parameters(root: Element, mistakes: Mistakes) -> list[Setting]:
    """Return the values of a set of parameters."""
    units = _units(root, mistakes)
    return [setting for child in _child_elements(root, "Parameter") for setting in _parameter(child, units, mistakes)]


def _parameter(element: Element, units: Mapping[str, FmuUnit], mistakes: Mistakes) -> Iterator[Setting]:
    name = mistakes.attributes(element, element.get("name")).text("name", needed=True)
    typed = next(element.all(*_TYPES), None)
    if typed is None:
        mistakes.wrong(element, "has no type that we know", name)
        return
    kind = _TYPES[typed.tag]
    sizes = [mistakes.attributes(d, name).whole("size", 1, most=1_000_000) for d in element.all("Dimension")]
    text = typed.attributes.get("value")
    words = [value.text for value in typed.all("Value")] if text is None else text.split() if sizes else [text]
    plain = "String" if kind == "Enumeration" else kind  # given by the name of an item
    values = tuple(value for word in words if (value := parse_value(word, plain)) is not None)
    if not values or len(values) != len(words):
        mistakes.wrong(typed, f'value="{(text or "")[:80]}" is not of type {typed.tag}', name)
        return
    yield Setting(name, kind, values, _unit_named(typed, units, mistakes, name), tuple(sizes), mistakes.place(element))
