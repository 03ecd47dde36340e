"""Read SystemStructure.ssd and parameter sets of SSP 1.0 and 2.0 out of an archive, within limits.

What would change the meaning of a system and is not supported is refused by name; geometry, annotations and metadata
are left out.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from urllib.parse import unquote

from rotorsim.errors import Place, Problem, RotorsimError
from rotorsim.fmi.description.archive import Archive, check_name
from rotorsim.fmi.description.attributes import Attributes, to_float
from rotorsim.fmi.description.model import FLOATS, INTEGERS, FmuUnit, Value
from rotorsim.fmi.description.xml_reader import Element, XmlLimits, read_xml
from rotorsim.ssp.structure import MAIN, NAMESPACES, Component, Connection, Connector, End, Setting, Structure, System

__all__ = ["read_structure"]

MAX_BYTES = 16 << 20  # of one XML file
MAX_SETTINGS = 1_000_000  # of all components together; a file may be bound many times
_SHOWN = 50
_LIMITS = XmlLimits(bytes=MAX_BYTES, elements=300_000)
_TYPES = {"Real": "Float64", "Integer": "Int32", "Binary": "Binary"} | {
    name: name for name in (*FLOATS, *INTEGERS, "Boolean", "String")
}
_FMU = "application/x-fmu-sharedlibrary"
_SET = "application/x-ssp-parameter-set"
_INTERFACES = {"any": "", "CoSimulation": "cs", "ModelExchange": "me"}
_KINDS = ("input", "output", "parameter", "calculatedParameter", "structuralParameter", "constant", "local", "inout")
_TRANSFORMATIONS = ("BooleanMappingTransformation", "IntegerMappingTransformation", "EnumerationMappingTransformation")


def read_structure(archive: Archive) -> Structure:
    """Return the system that an archive describes. Raises RotorsimError with every mistake."""
    reader = _Reader(archive)
    structure = reader.structure()
    if reader.problems:
        shown = reader.problems[:_SHOWN]
        if len(reader.problems) > _SHOWN:
            shown.append(Problem(f"... and {len(reader.problems) - _SHOWN} more mistakes", place=archive.place))
        raise RotorsimError(*shown)
    return structure


def _local(root: Element) -> Element:
    """Return a document with the prefixes of its names resolved; elements of other namespaces are left out."""
    known = set(NAMESPACES.values())

    def resolved(element: Element, spaces: dict[str, str]) -> Element | None:
        own = {name: value for name, value in element.attributes.items() if name.partition(":")[0] == "xmlns"}
        if own:
            spaces = spaces | {name.partition(":")[2]: value for name, value in own.items()}
        prefix, colon, tag = element.tag.rpartition(":")
        if spaces.get(prefix if colon else "") not in known:
            return None
        children = [found for child in element.children if (found := resolved(child, spaces)) is not None]
        return replace(element, tag=tag, children=children)

    found = resolved(root, {})
    return found if found is not None else replace(root, tag="", children=[])


class _Reader:
    def __init__(self, archive: Archive) -> None:
        self.archive = archive
        self.problems: list[Problem] = []
        self.file = MAIN
        self.units: dict[str, FmuUnit] = {}
        self.sets: dict[str, list[Setting]] = {}  # of the files read
        self.count = 0

    # -- mistakes ------------------------------------------------------------------------------------------------------

    def place(self, element: Element) -> Place:
        return Place(f"{self.archive.path}/{self.file}", element.line, element.column)

    def wrong(self, element: Element, what: str, subject: str = "", hint: str = "") -> None:
        self.problems.append(Problem(what, subject[:200], self.place(element), hint))

    def read(self, element: Element, subject: str) -> Attributes:
        return Attributes(element, subject, self.wrong)

    def root(self, name: str, tag: str) -> Element:
        """Return the root of a file in the archive."""
        self.file = name
        shown = f"{self.archive.path}/{name}"
        found = _local(read_xml(self.archive.read(name, MAX_BYTES), shown, limits=_LIMITS))
        if found.tag != tag:
            raise RotorsimError(Problem(f"the document is no {tag} of SSP", place=self.place(found)))
        return found

    # -- structure -----------------------------------------------------------------------------------------------------

    def structure(self) -> Structure:
        if MAIN not in self.archive:
            self.archive.read(MAIN, MAX_BYTES)  # says what is in there
        root = self.root(MAIN, "SystemStructureDescription")
        version = root.get("version")
        if not re.fullmatch(r"[12]\.\d+(-.*)?", version):
            what = f"SSP {version[:20]} is not supported" if version else "the attribute version is missing"
            raise RotorsimError(Problem(what, place=self.place(root), hint="SSP 1.0 and 2.0 are"))
        self.units = self.read_units(root)
        system = root.first("System")
        if system is None:
            raise RotorsimError(Problem("there is no System in it", place=self.place(root)))
        experiment = root.first("DefaultExperiment")
        times = self.read(experiment, "DefaultExperiment") if experiment else None
        start, stop = (times.number(name) if times else None for name in ("startTime", "stopTime"))
        return Structure(root.get("name"), version[:3], self.system(system), start, stop, root.get("description"))

    def read_units(self, root: Element) -> dict[str, FmuUnit]:
        units: dict[str, FmuUnit] = {}
        for element in (unit for group in root.all("Units") for unit in group.all("Unit")):
            name = element.get("name")
            base = element.first("BaseUnit")
            if base is None or name in units:
                self.wrong(element, "is defined twice" if base else "has no BaseUnit", f"unit {name[:80]}")
                continue
            read = self.read(base, f"unit {name[:80]}")
            powers: dict[str, int] = {
                key: read.whole(key, 0, least=-99, most=99)
                for key in ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
                if key in base.attributes
            }
            units[name] = FmuUnit(name, read.number("factor", 1.0), read.number("offset", 0.0), powers)
            if not units[name].factor:
                self.wrong(base, "the factor is zero", f"unit {name[:80]}")
        return units

    def system(self, element: Element) -> System:
        name = element.get("name")
        inside = [child for group in element.all("Elements") for child in group.children]
        components, systems = [], []
        seen: set[str] = set()
        for child in inside:
            own = self.read(child, child.tag).text("name", needed=True)
            if own in seen:
                self.wrong(child, "is the name of two elements of a system", own)
            seen.add(own)
            if child.tag == "Component":
                components.append(self.component(child))
            elif child.tag == "System":
                systems.append(self.system(child))
            else:
                self.wrong(child, f"{child.tag} is not supported", own)
        return System(
            name,
            self.connectors(element),
            self.settings(element),
            tuple(components),
            tuple(systems),
            tuple(
                c
                for group in element.all("Connections")
                for child in group.all("Connection")
                for c in self.connection(child)
            ),
            self.place(element),
        )

    def component(self, element: Element) -> Component:
        name = element.get("name")
        source = self.source(element, name)
        kind = element.get("type", _FMU)
        if kind != _FMU:
            self.wrong(element, f"components of type {kind[:80]} are not supported: only FMUs", name)
        implementation = element.get("implementation", "any")
        if implementation not in _INTERFACES:
            self.wrong(element, f'implementation="{implementation[:40]}" is not supported', name)
        return Component(
            name,
            source,
            self.connectors(element),
            self.settings(element),
            _INTERFACES.get(implementation, ""),
            self.place(element),
        )

    def source(self, element: Element, subject: str) -> str:
        """Return the file in the archive that a relative URI names."""
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
            return ""
        return name

    def connectors(self, element: Element) -> tuple[Connector, ...]:
        found: dict[str, Connector] = {}
        for child in (c for group in element.all("Connectors") for c in group.all("Connector")):
            read = self.read(child, child.get("name"))
            name, kind = read.text("name", needed=True), read.choice("kind", _KINDS, "input")
            if name in found:
                self.wrong(child, "is the name of two connectors", name)
            typed = next(child.all(*_TYPES), None)
            unit = None
            if typed is not None and typed.get("unit"):
                unit = self.unit(typed, name)
            sizes = [self.read(d, name).whole("size", 0, most=1_000_000) for d in child.all("Dimension")]
            found[name] = Connector(name, kind, _TYPES.get(typed.tag, "") if typed else "", unit, tuple(sizes))
        return tuple(found.values())

    def unit(self, element: Element, subject: str) -> FmuUnit | None:
        name = element.get("unit")
        if name not in self.units:
            self.wrong(element, f"the unit '{name[:80]}' is not among the Units of the file", subject)
        return self.units.get(name)

    def connection(self, element: Element) -> Iterator[Connection]:
        subject = f"{element.get('startConnector')[:80]} -> {element.get('endConnector')[:80]}"
        read = self.read(element, subject)
        ends = []
        for which in ("start", "end"):
            text = element.attributes.get(f"{which}Indices")
            indices = None
            if text is not None:
                indices = tuple(int(word) for word in text.split() if re.fullmatch(r"\d{1,7}", word))
                if len(indices) != len(text.split()) or not indices or 0 in indices:
                    self.wrong(element, f"{which}Indices are not whole numbers from 1", subject)
                    return
            name = read.text(f"{which}Connector", needed=True)
            ends.append(End(element.attributes.get(f"{which}Element"), name, indices))
        for kind in element.all(*_TRANSFORMATIONS):
            self.wrong(kind, f"{kind.tag} is not supported", subject)
        linear = element.first("LinearTransformation")
        scale = self.read(linear, subject) if linear else None
        factor, offset = (scale.number("factor", 1.0), scale.number("offset", 0.0)) if scale else (1.0, 0.0)
        suppress = read.flag("suppressUnitConversion")
        yield Connection(ends[0], ends[1], factor, offset, suppress, self.place(element))

    # -- parameters ----------------------------------------------------------------------------------------------------

    def settings(self, element: Element) -> tuple[Setting, ...]:
        """Return the values of all bindings, the later ones last."""
        found: list[Setting] = []
        for binding in (b for group in element.all("ParameterBindings") for b in group.all("ParameterBinding")):
            subject = element.get("name")
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
                    raise RotorsimError(Problem(what, subject, self.place(binding)))
                found += [replace(setting, name=prefix + setting.name) for setting in values] if prefix else values
        return tuple(found)

    def values(self, binding: Element, subject: str) -> list[Setting]:
        inline = binding.first("ParameterValues")
        if inline is not None:
            inner = inline.first("ParameterSet")
            if inner is None:
                self.wrong(inline, "there is no ParameterSet in it", subject)
            return self.parameter_set(inner) if inner else []
        name = self.source(binding, subject)
        if name and name not in self.sets:
            before = self.file
            self.sets[name] = self.parameter_set(self.root(name, "ParameterSet"))
            self.file = before
        return self.sets.get(name, [])

    def parameter_set(self, root: Element) -> list[Setting]:
        before, self.units = self.units, self.read_units(root)
        try:
            elements = [child for group in root.all("Parameters") for child in group.all("Parameter")]
            return [setting for child in elements for setting in self.parameter(child)]
        finally:
            self.units = before

    def parameter(self, element: Element) -> Iterator[Setting]:
        name = self.read(element, element.get("name")).text("name", needed=True)
        typed = next(element.all(*_TYPES), None)
        if typed is None:
            self.wrong(element, "has no type that we know", name)
            return
        kind = _TYPES[typed.tag]
        sizes = tuple(self.read(d, name).whole("size", 1, most=1_000_000) for d in element.all("Dimension"))
        text = typed.attributes.get("value")
        words = [value.text for value in typed.all("Value")] if text is None else text.split() if sizes else [text]
        values = [_value(word, kind) for word in words]
        if not values or any(value is None for value in values):
            self.wrong(typed, f'value="{(text or "")[:80]}" is not of type {typed.tag}', name)
            return
        unit = self.unit(typed, name) if typed.get("unit") else None
        yield Setting(name, kind, tuple(v for v in values if v is not None), unit, sizes, self.place(element))


def _value(text: str, kind: str) -> Value | None:
    """Return a value as XML writes it, or None."""
    plain = text.strip()
    if kind in FLOATS:
        return to_float(plain)
    if kind == "Boolean":
        return {"true": True, "1": True, "false": False, "0": False}.get(plain)
    if kind in INTEGERS and kind != "Enumeration":
        return int(plain) if re.fullmatch(r"[+-]?\d{1,20}", plain) else None
    return text
