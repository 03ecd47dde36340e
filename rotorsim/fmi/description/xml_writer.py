"""Writing XML of FMI and SSP: texts, documents, units."""

from __future__ import annotations

from collections.abc import Mapping
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from rotorsim.fmi.description.model import BASE_UNITS


def plain_text(text: str) -> str:
    """Return a text without characters that XML cannot hold."""
    return "".join(c if c.isprintable() else " " for c in text)


def xml_bytes(root: Element) -> bytes:
    """Return a document of XML, indented."""
    ElementTree.indent(root)
    text = ElementTree.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'.encode()


def write_base_unit(
    parent: Element, tag: str, powers: Mapping[str, int], factor: float = 1.0, offset: float = 0.0
) -> None:
    """Add what a unit is made of: value in base units = factor * value + offset."""
    element = SubElement(parent, tag, {base: str(powers[base]) for base in BASE_UNITS if powers.get(base)})
    if factor != 1.0:
        element.set("factor", repr(float(factor)))
    if offset:
        element.set("offset", repr(float(offset)))
