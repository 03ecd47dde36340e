"""SystemStructure.ssd and parameter sets (.ssv) of SSP 1.0 and 2.0."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from xml.etree.ElementTree import Element, SubElement

from rotorsim.fmi.description.model import FmuUnit, Value
from rotorsim.fmi.description.xml_writer import plain_text, write_base_unit, xml_bytes
from rotorsim.ssp.structure import (
    FMU,
    INTERFACES,
    NAMESPACES,
    Component,
    Connection,
    Connector,
    Structure,
    System,
    same_unit,
)

_TYPES1 = {"Float64": "Real", "Float32": "Real", "Boolean": "Boolean", "String": "String"}


class _Units:
    """The units that a file uses, under names of their own."""

    def __init__(self, version: str) -> None:
        self.version = version
        self.used: dict[str, FmuUnit] = {}

    def name(self, unit: FmuUnit) -> str:
        """Return the name of a unit; units of one name that mean different things are told apart."""
        name = unit.name
        while name in self.used and not same_unit(self.used[name], unit):
            name += "'"
        self.used[name] = unit
        return name

    def write(self, parent: Element, space: str) -> None:
        """Add the units that were used."""
        units = SubElement(parent, f"{space}:Units") if self.used else parent
        for name, unit in sorted(self.used.items()):
            element = SubElement(units, "ssc:Unit", name=name)
            write_base_unit(element, "ssc:BaseUnit", unit.powers, unit.factor, unit.offset)

    def typed(self, parent: Element, space: str, kind: str, unit: FmuUnit | None, **more: str) -> None:
        """Add the element that says the type of a connector or a value."""
        tag = kind if self.version == "2.0" else _TYPES1.get(kind, "Integer")
        element = SubElement(parent, f"{space}:{tag}", more)
        if unit is not None and kind.startswith("Float"):
            element.set("unit", self.name(unit))

    def dimensions(self, parent: Element, sizes: Sequence[int]) -> None:
        for size in sizes:
            SubElement(parent, "ssc:Dimension", size=str(size))


def system_description(structure: Structure) -> bytes:
    """Return SystemStructure.ssd."""
    root = _root("ssd:SystemStructureDescription", structure.version, structure.name, ("ssd", "ssc"))
    if structure.description:
        root.set("description", plain_text(structure.description))
    units = _Units(structure.version)
    _system(root, structure.system, units)
    units.write(root, "ssd")
    experiment = {"startTime": structure.start, "stopTime": structure.stop}
    given = {name: repr(float(value)) for name, value in experiment.items() if value is not None}
    if given:
        SubElement(root, "ssd:DefaultExperiment", given)
    return xml_bytes(root)


def values_description(component: Component, version: str) -> bytes:
    """Return the parameter set of a component."""
    root = _root("ssv:ParameterSet", version, component.name, ("ssv", "ssc"))
    units = _Units(version)
    parameters = SubElement(root, "ssv:Parameters")
    for setting in component.settings:
        element = SubElement(parameters, "ssv:Parameter", name=setting.name)
        units.typed(element, "ssv", setting.type, setting.unit, value=" ".join(_text(v) for v in setting.values))
        units.dimensions(element, setting.dimensions)
    units.write(root, "ssv")
    return xml_bytes(root)


def _system(parent: Element, system: System, units: _Units) -> None:
    element = SubElement(parent, "ssd:System", name=system.name)
    _connectors(element, system.connectors, units)
    elements = SubElement(element, "ssd:Elements")
    for component in system.components:
        _component(elements, component, units)
    if system.connections:
        connections = SubElement(element, "ssd:Connections")
        for connection in system.connections:
            _connection(connections, connection)


def _connectors(parent: Element, connectors: Iterable[Connector], units: _Units) -> None:
    listed = list(connectors)
    group = SubElement(parent, "ssd:Connectors") if listed else parent
    for connector in listed:
        element = SubElement(group, "ssd:Connector", name=connector.name, kind=connector.kind)
        if connector.type:
            units.typed(element, "ssc", connector.type, connector.unit)
        units.dimensions(element, connector.dimensions)


def _component(parent: Element, component: Component, units: _Units) -> None:
    element = SubElement(parent, "ssd:Component", name=component.name, type=FMU, source=component.source)
    if component.interface:
        element.set("implementation", INTERFACES[component.interface])
    _connectors(element, component.connectors, units)
    if component.settings:
        bindings = SubElement(element, "ssd:ParameterBindings")
        SubElement(bindings, "ssd:ParameterBinding", source=f"resources/{component.name}.ssv")


def _connection(parent: Element, connection: Connection) -> None:
    element = SubElement(parent, "ssd:Connection")
    for which, end in (("start", connection.start), ("end", connection.end)):
        if end.element is not None:
            element.set(f"{which}Element", end.element)
        element.set(f"{which}Connector", end.connector)
        if end.indices is not None:
            element.set(f"{which}Indices", " ".join(map(str, end.indices)))


def _root(tag: str, version: str, name: str, spaces: Iterable[str]) -> Element:
    from rotorsim import __version__

    names = {f"xmlns:{space}": NAMESPACES[space] for space in spaces}
    return Element(tag, names, version=version, name=name, generationTool=f"rotorsim {__version__}")


def _text(value: Value) -> str:
    return ("true" if value else "false") if isinstance(value, bool) else str(value)
