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
from rotorsim.fmi.description.attributes import Mistakes
from rotorsim.fmi.description.model import FmuUnit
from rotorsim.fmi.description.xml_reader import Element
from rotorsim.ssp.parameters import TYPES, child_elements, open_document, read_parameters, read_units, unit_named
from rotorsim.ssp.structure import (
    FMU,
    INTERFACES,
    MAIN,
    Component,
    Connection,
    Connector,
    End,
    Setting,
    Structure,
    System,
)

__all__ = ["read_structure"]

MAX_SETTINGS = 1_000_000  # of all components together; a file may be bound many times
_SHOWN = 50
_SET = "application/x-ssp-parameter-set"
_IMPLEMENTATIONS = {"any": ""} | {words: name for name, words in INTERFACES.items()}
_KINDS = ("input", "output", "parameter", "calculatedParameter", "structuralParameter", "constant", "local", "inout")
_TRANSFORMATIONS = ("BooleanMappingTransformation", "IntegerMappingTransformation", "EnumerationMappingTransformation")


def read_structure(archive: Archive) -> Structure:
    """Return the system that an archive describes. Raises RotorsimError with every mistake."""
    root, mistakes = open_document(archive, MAIN, "SystemStructureDescription", [])
    version = root.get("version")
    if not re.fullmatch(r"[12]\.\d+(-.*)?", version):
        what = f"SSP {version[:20]} is not supported" if version else "the attribute version is missing"
        raise RotorsimError(Problem(what, place=mistakes.place(root), hint="SSP 1.0 and 2.0 are"))
    system, experiment = root.first("System"), root.first("DefaultExperiment")
    if system is None:
        raise RotorsimError(Problem("there is no System in it", place=mistakes.place(root)))
    made = _Reader(archive, mistakes, read_units(root, mistakes)).system(system)
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
            tuple(c for child in child_elements(element, "Connection") for c in self.connection(child)),
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
        why = "it is not relative" if re.match(r"[A-Za-z][\w+.-]*:|/", uri) else check_name(name)
        if "#" in uri or "?" in uri:
            why = "a part of a document is not supported"
        if not why and name not in self.archive:
            why = "there is no such file in the archive"
        if why:
            self.wrong(element, f"source '{uri[:80]}': {why}", subject)
        return "" if why else name

    def connectors(self, element: Element) -> tuple[Connector, ...]:
        found: dict[str, Connector] = {}
        for child in child_elements(element, "Connector"):
            read = self.read(child, child.get("name"))
            name, kind = read.text("name", needed=True), read.choice("kind", _KINDS, "input")
            if name in found:
                self.wrong(child, "is the name of two connectors", name)
            typed = next(child.all(*TYPES), None)
            unit = unit_named(typed, self.units, self.mistakes, name) if typed else None
            sizes = [self.read(d, name).whole("size", 0, most=1_000_000) for d in child.all("Dimension")]
            found[name] = Connector(name, kind, TYPES[typed.tag] if typed else "", unit, tuple(sizes))
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
        for binding in child_elements(element, "ParameterBinding"):
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
            return read_parameters(inner, self.mistakes) if inner else []
        name = self.source(binding, subject)
        if name and name not in self.sets:
            self.sets[name] = read_parameters(
                *open_document(self.archive, name, "ParameterSet", self.mistakes.problems)
            )
        return self.sets.get(name, [])
