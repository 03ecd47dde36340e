"""The XML files of an SSP, opened within limits: elements without prefixes, units, and what is wrong or odd in them."""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Mapping, MutableMapping
from dataclasses import dataclass, replace

from rotorsim.errors import Problem, RotorsimError
from rotorsim.fmi.description.archive import Archive
from rotorsim.fmi.description.attributes import Mistakes
from rotorsim.fmi.description.model import FLOATS, INTEGERS, FmuUnit
from rotorsim.fmi.description.xml_reader import Element, XmlLimits, read_xml
from rotorsim.ssp.structure import NAMESPACES

MAX_XML_BYTES = 16 << 20  # of one XML file
_LIMITS = XmlLimits(bytes=MAX_XML_BYTES, elements=300_000)
VALUE_TYPES = {"Real": "Float64", "Integer": "Int32"} | {
    name: name for name in (*FLOATS, *INTEGERS, "Boolean", "String", "Binary")
}


@dataclass(frozen=True)
class Document:
    """A file, or what stands in one as a file would: its root, its units; where mistakes and oddities are noted."""

    root: Element
    units: MutableMapping[str, FmuUnit]
    mistakes: Mistakes
    warnings: dict[tuple[str, str, str], Problem]  # by file, subject and what is odd: each once

    def within(self, root: Element) -> Document:
        """Return what stands inside this file; the units of the file count there, too."""
        own = _units(root, self.mistakes)
        return replace(self, root=root, units=ChainMap(own, self.units) if own else self.units)

    def warn(self, element: Element, what: str, subject: str = "", hint: str = "") -> None:
        """Note what is odd at an element."""
        odd = Problem(what, subject[:200], self.mistakes.place(element), hint, "warning")
        self.warnings.setdefault((self.mistakes.file, odd.subject, what), odd)

    def unit(self, typed: Element) -> FmuUnit | None:
        """Return the unit that the type of a connector or a value names, None where it names none.

        Every unit must be among the Units of its file (SSP 2.0, "Units"). One that is not means what its name says,
        as in an FMU; a name that nobody knows counts as no unit.
        """
        name = typed.get("unit")
        if not name or name in self.units:
            return self.units.get(name)
        unit = FmuUnit(name, defined=False)
        meaning = "it is taken by its name" if unit.known else "nor known: it is taken as it is and fits all"
        joined = ":" if unit.known else ","
        self.warn(typed, f"the unit '{name[:80]}' is not among the Units of the file{joined} {meaning}")
        return unit if unit.known else None


def open_document(
    archive: Archive, name: str, tag: str, problems: list[Problem], warnings: dict[tuple[str, str, str], Problem]
) -> Document:
    """Return a file of an archive whose root is ``tag``. Raises RotorsimError where it is not such a file."""
    mistakes = Mistakes(f"{archive.path}/{name}", problems)
    read = read_xml(archive.read(name, MAX_XML_BYTES), mistakes.file, limits=_LIMITS)
    root = _without_prefixes(read, {}) or replace(read, tag="", children=[])
    if root.tag != tag:
        raise RotorsimError(Problem(f"the document is no {tag} of SSP", place=mistakes.place(root)))
    return Document(root, _units(root, mistakes), mistakes, warnings)


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


def _units(root: Element, mistakes: Mistakes) -> dict[str, FmuUnit]:
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
