"""Values of parameters: sets (.ssv), what maps them to names of a system (.ssm), and the bindings that apply them."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TypeVar
from urllib.parse import unquote

from rotorsim.errors import Place, Problem, RotorsimError
from rotorsim.fmi.description.archive import Archive, check_name
from rotorsim.fmi.description.attributes import parse_value
from rotorsim.fmi.description.model import FLOATS, INTEGERS, Value
from rotorsim.fmi.description.xml_reader import Element
from rotorsim.ssp.document import VALUE_TYPES, Document, child_elements, open_document
from rotorsim.ssp.structure import Setting

MAX_SETTINGS = 1_000_000  # of all components together; a file may be bound many times
_SET, _MAPPING = "application/x-ssp-parameter-set", "application/x-ssp-parameter-mapping"
_WHOLE = tuple(name for name in INTEGERS if name != "Enumeration")
_TRANSFORMED = {  # what each transformation is for
    "LinearTransformation": FLOATS,
    "BooleanMappingTransformation": ("Boolean",),
    "IntegerMappingTransformation": _WHOLE,
    "EnumerationMappingTransformation": ("Enumeration",),
}
_Read = TypeVar("_Read")


@dataclass(frozen=True)
class Transformation:
    """What a connection or a mapping makes of a value of some types: factor * value + offset, or another by a table."""

    name: str = ""
    types: tuple[str, ...] = ()  # () for all
    factor: float = 1.0
    offset: float = 0.0
    table: Mapping[Value, Value] | None = None


@dataclass(frozen=True)
class _Entry:
    """An entry of a mapping: the parameter ``source`` is applied as ``target``."""

    source: str
    target: str
    transformation: Transformation
    suppress: bool
    place: Place


class Bindings:
    """Reads the values that bindings give to components and systems; files of an archive are read once."""

    def __init__(self, archive: Archive) -> None:
        self.archive = archive
        self.sets: dict[str, list[Setting]] = {}
        self.mappings: dict[str, list[_Entry]] = {}
        self.count = 0

    def settings(self, element: Element, document: Document) -> tuple[Setting, ...]:
        """Return the values of all bindings of a component or system, the later ones last, which win.

        With a mapping only what it names is applied, under the names that it gives, and prefixes come before it
        (SSP 2.0, "ParameterBindings").
        """
        found: list[Setting] = []
        subject = element.get("name")
        for binding in child_elements(element, "ParameterBinding"):
            if not self._supported(binding, subject, document, _SET):
                continue
            prefix, values = binding.get("prefix"), self._values(binding, subject, document)
            if prefix:
                values = [replace(setting, name=prefix + setting.name) for setting in values]
            mapping = binding.first("ParameterMapping")
            entries = self._entries(mapping, subject, document) if mapping else []
            self.count += len(values) + len(entries)
            if self.count > MAX_SETTINGS:
                what = f"more than {MAX_SETTINGS} values of parameters and entries of mappings"
                raise RotorsimError(Problem(what, subject, document.mistakes.place(binding)))
            found += _mapped(values, entries, mapping, subject, document) if mapping else values
        return tuple(found)

    def _supported(self, element: Element, subject: str, document: Document, kind: str) -> bool:
        """Return whether a binding or a mapping is of the only kind that SSP defines, and in the archive."""
        if element.get("type", kind) != kind:
            what = f"parameters of type {element.get('type')[:80]} are not supported"
            document.mistakes.wrong(element, what, subject, f"{kind} is")
        elif element.get("sourceBase", "SSD") != "SSD":
            what, hint = "parameters inside a component are not supported", "write them to a file of the archive"
            document.mistakes.wrong(element, what, subject, hint)
        else:
            return True
        return False

    def _values(self, binding: Element, subject: str, document: Document) -> list[Setting]:
        """Return the values of a binding: written in it, or in a file of the archive."""
        inline = binding.first("ParameterValues")
        if inline is None:
            return self._file(binding, subject, document, "ParameterSet", self.sets, _parameters)
        inner = inline.first("ParameterSet")
        if inner is None:
            document.mistakes.wrong(inline, "there is no ParameterSet in it", subject)
        return _parameters(document.within(inner)) if inner else []

    def _entries(self, mapping: Element, subject: str, document: Document) -> list[_Entry]:
        """Return the entries of a mapping: written in it, or in a file of the archive."""
        if not self._supported(mapping, subject, document, _MAPPING):
            return []
        inner = mapping.first("ParameterMapping")
        if inner is None:
            return self._file(mapping, subject, document, "ParameterMapping", self.mappings, _entries)
        return _entries(document.within(inner))

    def _file(
        self,
        element: Element,
        subject: str,
        document: Document,
        tag: str,
        known: dict[str, list[_Read]],
        read: Callable[[Document], list[_Read]],
    ) -> list[_Read]:
        """Return what a file holds that an element refers to."""
        name = source_of(element, self.archive, subject, document)
        if name and name not in known:
            opened = open_document(self.archive, name, tag, document.mistakes.problems, document.warnings)
            known[name] = read(opened)
        return known.get(name, [])


def source_of(element: Element, archive: Archive, subject: str, document: Document) -> str:
    """Return the file in the archive that a relative URI names, "" where it is wrong."""
    uri = element.attributes.get("source")
    if uri is None:
        hint = 'a file of the archive: source="resources/NAME"'
        document.mistakes.wrong(element, "has no source", subject, hint)
        return ""
    name = unquote(uri, errors="replace").removeprefix("./")
    reasons = {
        "a part of a document is not supported": "#" in uri or "?" in uri,
        "it is not relative": re.match(r"[A-Za-z][\w+.-]*:|/", uri),
        check_name(name): True,
        "there is no such file in the archive": name not in archive,
    }
    why = next((why for why, is_so in reasons.items() if why and is_so), "")
    if why:
        hint = "files of the archive are named from its root: resources/NAME"
        document.mistakes.wrong(element, f"source '{uri[:80]}': {why}", subject, hint)
    return "" if why else name


# ---- sets of parameters ----


def _parameters(document: Document) -> list[Setting]:
    """Return the values of a set of parameters."""
    elements = child_elements(document.root, "Parameter")
    return [setting for child in elements for setting in _parameter(child, document)]


def _parameter(element: Element, document: Document) -> Iterator[Setting]:
    mistakes = document.mistakes
    name = mistakes.attributes(element, element.get("name")).text("name", needed=True)
    typed = next(element.all(*VALUE_TYPES), None)
    if typed is None:
        mistakes.wrong(element, "has no type that we know", name)
        return
    kind = VALUE_TYPES[typed.tag]
    sizes = [mistakes.attributes(d, name).whole("size", 1, most=1_000_000) for d in element.all("Dimension")]
    text = typed.attributes.get("value")
    words = [value.text for value in typed.all("Value")] if text is None else text.split() if sizes else [text]
    plain = "String" if kind == "Enumeration" else kind  # given by the name of an item
    values = tuple(value for word in words if (value := parse_value(word, plain)) is not None)
    if not values or len(values) != len(words):
        mistakes.wrong(typed, f'value="{(text or "")[:80]}" is not of type {typed.tag}', name)
        return
    yield Setting(name, kind, values, document.unit(typed), tuple(sizes), mistakes.place(element))


# ---- mappings ----


def read_transformation(element: Element, subject: str, document: Document) -> Transformation:
    """Return what an element makes of values, that is nothing without a transformation.

    Linear: target = factor source + offset, where the source is in the unit of the target already. Others: by a table;
    what is not in it stays as it is. Source: SSP 2.0, "Transformation Choice".
    """
    mistakes, found = document.mistakes, list(element.all(*_TRANSFORMED))
    for more in found[1:]:
        mistakes.wrong(more, f"a second transformation: {more.tag}", subject, "one is allowed")
    if not found:
        return Transformation()
    tag, types = found[0].tag, _TRANSFORMED[found[0].tag]
    if tag == "LinearTransformation":
        read = mistakes.attributes(found[0], subject)
        factor, offset = read.number("factor", 1.0), read.number("offset", 0.0)
        for name, number in (("factor", factor), ("offset", offset)):
            if not math.isfinite(number):
                read.wrong(name, "is not finite")
        return Transformation(tag, types, factor, offset)
    table: dict[Value, Value] = {}
    kind = "Boolean" if "Boolean" in types else "Int64" if "Int64" in types else "String"
    for entry in found[0].all("MapEntry"):
        read = mistakes.attributes(entry, subject)
        given, wanted = (read.value(end, kind, read.text(end, needed=True)) for end in ("source", "target"))
        if given is None or wanted is None:
            continue
        if given in table:
            mistakes.wrong(entry, f'source="{entry.get("source")[:80]}" has a second entry', subject, "one is allowed")
        table[given] = wanted
    return Transformation(tag, types, table=table)


def _entries(document: Document) -> list[_Entry]:
    """Return the entries of a mapping."""
    return [_entry(element, document) for element in document.root.all("MappingEntry")]


def _entry(element: Element, document: Document) -> _Entry:
    source = element.get("source")  # "" maps nothing
    subject = f"{source[:80]} -> {element.get('target')[:80]}"
    read = document.mistakes.attributes(element, subject)
    target, suppress = read.text("target", needed=True), read.flag("suppressUnitConversion")
    transformation = read_transformation(element, subject, document)
    return _Entry(source, target, transformation, suppress, document.mistakes.place(element))


def _mapped(
    values: list[Setting], entries: list[_Entry], mapping: Element, subject: str, document: Document
) -> Iterator[Setting]:
    """Yield the values that entries name, under their new names (SSP 2.0, "ParameterMapping" and "MappingEntry")."""
    named = {setting.name: setting for setting in values}
    taken: dict[str, str] = {}
    missing = []
    for entry in entries:
        setting = named.get(entry.source)
        if setting is None:
            missing.append(entry)
            continue
        change, ends = entry.transformation, f"{entry.source[:80]} -> {entry.target[:80]}"
        wrong = hint = ""
        if entry.target in taken:
            wrong = f"'{entry.target[:80]}' is the target of '{taken[entry.target][:80]}', too"
            hint = "a name can be mapped to once"
        elif change.types and setting.type not in change.types:
            wrong = f"{change.name} of a parameter of type {setting.type}"
            hint = f"it is for {', '.join(change.types)}"
        if wrong:
            document.mistakes.problems.append(Problem(wrong, ends, entry.place, hint))
        taken[entry.target] = entry.source
        yield replace(
            setting,
            name=entry.target,
            values=tuple((change.table or {}).get(value, value) for value in setting.values),
            factor=change.factor,
            offset=change.offset,
            suppress=entry.suppress,
        )
    if missing:
        names = list(dict.fromkeys(f"'{entry.source[:80]}'" for entry in missing))
        shown = ", ".join(names[:3]) + (", ..." if len(names) > 3 else "")
        what = f"{len(missing)} of {len(entries)} entries map what is not among the parameters: {shown}"
        document.warn(mapping, what, subject, "what they name keeps its value")
