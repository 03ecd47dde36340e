"""Read SystemStructure.ssd of SSP 1.0 and 2.0 out of an archive, within limits.

What would change the meaning of a system and is not supported is refused by name; geometry, annotations and metadata
are left out.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

from rotorsim.errors import Problem, RotorsimError, near_miss
from rotorsim.fmi.description.archive import Archive
from rotorsim.fmi.description.xml_reader import Element
from rotorsim.ssp.document import VALUE_TYPES, Document, child_elements, open_document
from rotorsim.ssp.parameters import Bindings, read_transformation, source_of
from rotorsim.ssp.structure import (
    FMU,
    INTERFACES,
    STRUCTURE_FILE,
    Component,
    Connection,
    Connector,
    End,
    Structure,
    System,
)

_SHOWN = 50
_IMPLEMENTATIONS = {"any": ""} | {words: name for name, words in INTERFACES.items()}
_KINDS = ("input", "output", "parameter", "calculatedParameter", "structuralParameter", "constant", "local", "inout")


def read_structure(archive: Archive) -> Structure:
    """Return the system that an archive describes. Raises RotorsimError with every mistake."""
    document = open_document(archive, STRUCTURE_FILE, "SystemStructureDescription", [], {})
    root, mistakes = document.root, document.mistakes
    version = root.get("version")
    if not re.fullmatch(r"[12]\.\d+(-.*)?", version):
        what = f"SSP {version[:20]} is not supported" if version else "the attribute version is missing"
        raise RotorsimError(Problem(what, place=mistakes.place(root), hint="SSP 1.0 and 2.0 are"))
    system, experiment = root.first("System"), root.first("DefaultExperiment")
    if system is None:
        raise RotorsimError(Problem("there is no System in it", place=mistakes.place(root)))
    made = _Reader(archive, document).system(system)
    times = mistakes.attributes(experiment, "DefaultExperiment") if experiment else None
    start, stop = (times.number(name, None) if times else None for name in ("startTime", "stopTime"))
    mistakes.refuse(_SHOWN, archive.place)
    odd = tuple(document.warnings.values())
    return Structure(root.get("name"), version[:3], made, start, stop, root.get("description"), odd)


class _Reader:
    """Reads systems and what is in them."""

    def __init__(self, archive: Archive, document: Document) -> None:
        self.archive, self.document, self.bindings = archive, document, Bindings(archive)
        self.wrong, self.read = document.mistakes.wrong, document.mistakes.attributes
        self.place = document.mistakes.place

    def system(self, element: Element) -> System:
        inside = [child for group in element.all("Elements") for child in group.children]
        seen: set[str] = set()
        for child in inside:
            name = self.read(child, child.tag).text("name", needed=True)
            if name in seen:
                self.wrong(child, "is the name of two elements of a system", name)
            seen.add(name)
            if child.tag not in ("Component", "System"):
                self.wrong(child, f"{child.tag} is not supported", name, "components and systems are")
        return System(
            element.get("name"),
            self.connectors(element),
            self.bindings.settings(element, self.document),
            tuple(self.component(child) for child in inside if child.tag == "Component"),
            tuple(self.system(child) for child in inside if child.tag == "System"),
            tuple(c for child in child_elements(element, "Connection") for c in self.connection(child)),
            self.place(element),
        )

    def component(self, element: Element) -> Component:
        name, kind = element.get("name"), element.get("type", FMU)
        if kind != FMU:
            hint = "import a package by itself; what it holds can be put into this system"
            self.wrong(element, f"components of type {kind[:80]} are not supported: only FMUs", name, hint)
        implementation = element.get("implementation", "any")
        if implementation not in _IMPLEMENTATIONS:
            hint = near_miss(implementation[:40], _IMPLEMENTATIONS)
            self.wrong(element, f'implementation="{implementation[:40]}" is not supported', name, hint)
        return Component(
            name,
            source_of(element, self.archive, name, self.document),
            self.connectors(element),
            self.bindings.settings(element, self.document),
            _IMPLEMENTATIONS.get(implementation, ""),
            self.place(element),
        )

    def connectors(self, element: Element) -> tuple[Connector, ...]:
        found: dict[str, Connector] = {}
        for child in child_elements(element, "Connector"):
            read = self.read(child, child.get("name"))
            name, kind = read.text("name", needed=True), read.choice("kind", _KINDS, "input")
            if name in found:
                self.wrong(child, "is the name of two connectors", name)
            typed = next(child.all(*VALUE_TYPES), None)
            unit = self.document.unit(typed) if typed else None
            sizes = [self.read(d, name).whole("size", 0, most=1_000_000) for d in child.all("Dimension")]
            found[name] = Connector(name, kind, VALUE_TYPES[typed.tag] if typed else "", unit, tuple(sizes))
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
            element_name = element.get(f"{which}Element")  # "" is written for the system itself, too
            ends.append(End(element_name or None, name, indices if given else None))
        made = read_transformation(element, subject, self.document)
        factor, offset, table = made.factor, made.offset, made.table
        if table is not None and made.types == ("Boolean",):  # of the numbers 0 and 1 it is a straight line
            low, high = table.get(False, False), table.get(True, True)
            factor, offset, table = float(high) - float(low), float(low), None
        suppress = read.flag("suppressUnitConversion")
        yield Connection(ends[0], ends[1], factor, offset, suppress, self.place(element), made.types, table)
