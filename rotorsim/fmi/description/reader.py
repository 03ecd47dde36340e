"""Reading modelDescription.xml of FMI 2.0 and 3.0: all mistakes at once, each with line and column."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from math import prod
from typing import Any

from rotorsim.errors import Place, Problem, RotorsimError, near_miss
from rotorsim.fmi.description.attributes import Attributes, Values
from rotorsim.fmi.description.model import Experiment, FmuUnit, FmuVariable, Kind, ModelDescription
from rotorsim.fmi.description.xml_reader import Element, XmlLimits, read_xml

__all__ = ["MAX_SCALARS", "read_description"]

MAX_SCALARS = 1_000_000  # of all variables together
MAX_EVENTS = 100_000
_SHOWN = 20  # mistakes
_IDENTIFIER = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,199}")
_TYPES2 = {"Real": "Float64", "Integer": "Int32"} | {name: name for name in ("Boolean", "String", "Enumeration")}
_TYPES3 = (
    "Float32",
    "Float64",
    "Int8",
    "UInt8",
    "Int16",
    "UInt16",
    "Int32",
    "UInt32",
    "Int64",
    "UInt64",
    "Boolean",
    "String",
    "Binary",
    "Enumeration",
    "Clock",
)
_CAUSALITIES = ("parameter", "calculatedParameter", "structuralParameter", "input", "output", "local", "independent")
_VARIABILITIES = ("constant", "fixed", "tunable", "discrete", "continuous")
_SKIP = frozenset({"Annotations", "VendorAnnotations", "Tool"})


def read_description(
    data: bytes, file: str, *, limits: XmlLimits | None = None, sizes: Mapping[str, int] | None = None
) -> ModelDescription:
    """Return the model description. file: the name to be shown; sizes: values of structural parameters (FMI 3.0).

    Raises RotorsimError with every mistake.
    """
    return _Reader(read_xml(data, file, skip=_SKIP, limits=limits), file, sizes or {}).read()


class _Reader:
    def __init__(self, root: Element, file: str, sizes: Mapping[str, int]) -> None:
        self.root, self.file, self.sizes = root, file, dict(sizes)
        self.problems: list[Problem] = []
        self.warnings: list[Problem] = []
        self.version = ""
        self.variables: dict[str, FmuVariable] = {}
        self.order: list[FmuVariable] = []  # FMI 2.0 counts variables from 1
        self.by_reference: dict[int, FmuVariable] = {}
        self.stray: set[str] = set()  # derivatives of nothing, reported
        self.scalars = 0

    def place(self, element: Element) -> Place:
        return Place(self.file, element.line, element.column)

    def wrong(self, element: Element, what: str, subject: str = "", hint: str = "") -> None:
        self.problems.append(Problem(what, subject[:200], self.place(element), hint))

    def attributes(self, element: Element, subject: str = "") -> Attributes:
        return Attributes(element, subject, self.wrong)

    def read(self) -> ModelDescription:
        root = self.root
        self._check_version()
        head = self.attributes(root)
        name = head.text("modelName", needed=True)
        token = head.text("guid" if self.version == "2.0" else "instantiationToken", needed=True)
        kinds = self._kinds()
        units = self._units()
        types = self._types()
        items = {name: self._items(name, element) for name, element in types.items() if element.first("Item")}
        n_events = head.whole("numberOfEventIndicators", 0, most=MAX_EVENTS) if self.version == "2.0" else 0
        self._variables(types)
        sizes = self._changed()
        structure = self._structure()
        log = root.first("LogCategories")
        experiment = self._experiment()
        if self.problems:
            shown = self.problems[:_SHOWN]
            if len(self.problems) > _SHOWN:
                shown.append(Problem(f"... and {len(self.problems) - _SHOWN} more mistakes", place=Place(self.file)))
            raise RotorsimError(*shown)
        return ModelDescription(
            version=self.version,
            name=name,
            token=token,
            variables=self.variables,
            kinds=kinds,
            units=units,
            n_events=structure.pop("events") + n_events,
            experiment=experiment,
            description=root.get("description"),
            author=root.get("author"),
            tool=root.get("generationTool"),
            date=root.get("generationDateAndTime"),
            naming=root.get("variableNamingConvention", "flat"),
            place=Place(self.file),
            log_categories=tuple(c.get("name") for c in log.all("Category")) if log else (),
            warnings=tuple(self.warnings[:_SHOWN]),
            items=items,
            sizes=sizes,
            **structure,
        )

    def _check_version(self) -> None:
        root = self.root
        if root.tag != "fmiModelDescription":
            what = f"the document is <{root.tag[:80]}>, not <fmiModelDescription>"
            raise RotorsimError(Problem(what, place=self.place(root)))
        version = root.get("fmiVersion")
        if version != "2.0" and not re.fullmatch(r"3\.0(\.\d+)?(-.*)?", version):
            what = f"FMI {version[:20]} is not supported" if version else "the attribute fmiVersion is missing"
            raise RotorsimError(Problem(what, place=self.place(root), hint="FMI 2.0 and 3.0 are"))
        self.version = version[:3]

    # -- kinds ---------------------------------------------------------------------------------------------------------

    def _kinds(self) -> dict[str, Kind]:
        kinds = {}
        for name, tag in (("cs", "CoSimulation"), ("me", "ModelExchange"), ("se", "ScheduledExecution")):
            element = self.root.first(tag)
            if element is not None and (name != "se" or self.version == "3.0"):
                kinds[name] = self._kind(name, element)
        if not kinds:
            self.wrong(self.root, "offers neither Co-Simulation nor Model Exchange")
        return kinds

    def _kind(self, name: str, element: Element) -> Kind:
        read = self.attributes(element, element.tag)
        identifier = read.text("modelIdentifier", needed=True)
        if identifier and not _IDENTIFIER.fullmatch(identifier):
            hint = "it names a file: letters, digits and _ only, not starting with a digit"
            self.wrong(element, f"modelIdentifier '{identifier[:80]}' is not an identifier", element.tag, hint)
        two = self.version == "2.0"
        state = "FMUstate" if two else "FMUState"
        needed = (
            read.flag("completedIntegratorStepNotNeeded") is False if two else read.flag("needsCompletedIntegratorStep")
        )
        return Kind(
            name,
            identifier,
            can_get_set_state=read.flag(f"canGetAndSet{state}"),
            can_serialise_state=read.flag(f"canSerialize{state}"),
            directional_derivatives=read.flag(
                "providesDirectionalDerivative" if two else "providesDirectionalDerivatives"
            ),
            once_per_process=read.flag("canBeInstantiatedOnlyOncePerProcess"),
            needs_tool=read.flag("needsExecutionTool"),
            can_vary_step=read.flag("canHandleVariableCommunicationStepSize"),
            can_interpolate_inputs=two and read.flag("canInterpolateInputs"),
            max_output_derivative_order=read.whole("maxOutputDerivativeOrder", 0, most=100),
            fixed_step=None if two else read.number("fixedInternalStepSize"),
            completed_step_needed=needed,
        )

    def _experiment(self) -> Experiment:
        element = self.root.first("DefaultExperiment")
        if element is None:
            return Experiment()
        read = self.attributes(element, "DefaultExperiment")
        return Experiment(*(read.number(name) for name in ("startTime", "stopTime", "tolerance", "stepSize")))

    # -- units and types -----------------------------------------------------------------------------------------------

    def _units(self) -> dict[str, FmuUnit]:
        units: dict[str, FmuUnit] = {}
        group = self.root.first("UnitDefinitions")
        for element in group.all("Unit") if group else ():
            name = element.get("name")
            base = element.first("BaseUnit")
            read = self.attributes(base or element, f"unit {name[:80]}")
            display = {}
            for shown in element.all("DisplayUnit"):
                scale = self.attributes(shown, f"unit {name[:80]}")
                inverse = self.version == "3.0" and scale.flag("inverse")
                display[shown.get("name")] = (scale.number("factor", 1.0), scale.number("offset", 0.0), inverse)
                if not 0.0 < abs(display[shown.get("name")][0]) < math.inf:
                    scale.wrong("factor", "is no factor")
            if name in units:
                self.wrong(element, "is defined twice", f"unit {name[:80]}")
            powers: dict[str, int] = {
                key: read.whole(key, 0, least=-99, most=99)
                for key in ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
                if base and key in base.attributes
            }
            factor, offset = (read.number(key, default) for key, default in (("factor", 1.0), ("offset", 0.0)))
            if not 0.0 < abs(factor) < math.inf:
                read.wrong("factor", "is no factor")
            if not math.isfinite(offset):
                read.wrong("offset", "is not finite")
            units[name] = FmuUnit(name, factor, offset, powers, display, base is not None)
        return units

    def _types(self) -> dict[str, Element]:
        """Return type name -> the element with its attributes."""
        group = self.root.first("TypeDefinitions")
        if group is None:
            return {}
        if self.version == "3.0":
            return {element.get("name"): element for element in group.children}
        return {e.get("name"): e.children[0] for e in group.all("SimpleType") if e.children}

    def _items(self, name: str, element: Element) -> dict[str, int]:
        """Return the names of the values of a type that enumerates."""
        low, high = -(2**63), 2**63 - 1
        found = {}
        for item in element.all("Item"):
            read = self.attributes(item, f"type {name[:80]}")
            found[read.text("name", needed=True)] = read.whole("value", None, least=low, most=high)
        return found

    def _changed(self) -> dict[str, int]:
        """Return the structural parameters that have other values than their start values."""
        found = {}
        for name, size in self.sizes.items():
            variable = self.variables.get(name)
            if variable is None or variable.causality != "structuralParameter":
                self.problems.append(Problem("is no structural parameter", name[:200], Place(self.file)))
            elif variable.start != size:
                found[name] = size
        return found

    # -- variables -----------------------------------------------------------------------------------------------------

    def _variables(self, types: Mapping[str, Element]) -> None:
        group = self.root.first("ModelVariables")
        if group is None:
            self.wrong(self.root, "<ModelVariables> is missing")
            return
        derivatives: list[tuple[FmuVariable, Element, int]] = []
        elements = list(group.all("ScalarVariable") if self.version == "2.0" else group.all(*_TYPES3))
        for element in elements:
            inner = element if self.version == "3.0" else next(element.all(*_TYPES2), None)
            if inner is None:
                self.wrong(element, "has no type: one of " + ", ".join(_TYPES2), element.get("name"))
                continue
            variable, state = self._variable(element, inner, types)
            if state is not None:
                derivatives.append((variable, inner, state))
            self._add(element, variable)
            for alias in element.all("Alias") if self.version == "3.0" else ():
                shown = alias.get("displayUnit", variable.display_unit)
                self._add(
                    alias,
                    replace(
                        variable,
                        name=alias.get("name"),
                        description=alias.get("description"),
                        alias=True,
                        display_unit=shown,
                        place=self.place(alias),
                    ),
                )
        self._dimensions(elements)
        for variable, inner, state in derivatives:
            of = self._at(state)
            if of is None:
                self.stray.add(variable.name)
                self.wrong(inner, f'derivative="{state}" is not a variable', variable.name)
            elif variable.name in self.variables:
                self._replace(variable.name, derivative_of=of.name)

    def _variable(
        self, element: Element, inner: Element, types: Mapping[str, Element]
    ) -> tuple[FmuVariable, int | None]:
        """Return a variable and the number of the state whose derivative it is."""
        read = self.attributes(element, element.get("name"))
        name = read.text("name", needed=True)
        kind = inner.tag if self.version == "3.0" else _TYPES2[inner.tag]
        declared = inner.get("declaredType")
        if declared and declared not in types:
            hint = near_miss(declared, types, list_all=False)
            self.wrong(inner, f"declaredType '{declared[:80]}' is not defined", name, hint)
        values = Values(self.attributes(inner, name), types.get(declared), kind)
        causality = read.choice("causality", _CAUSALITIES, "local")
        usual = "continuous" if kind in ("Float64", "Float32") else "discrete"
        variability = read.choice("variability", _VARIABILITIES, "fixed" if causality.endswith("arameter") else usual)
        initial = read.choice("initial", ("exact", "approx", "calculated"), _initial(causality, variability))
        variable = FmuVariable(
            name,
            read.whole("valueReference", None, most=2**32 - 1),
            kind,
            causality,
            variability,
            initial,
            values.start(element),
            values.text("unit"),
            values.text("displayUnit"),
            element.get("description"),
            values.number("min"),
            values.number("max"),
            values.number("nominal"),
            (),
            "",
            declared,
            clocked=bool(element.get("clocks")),
            relative=values.flag("relativeQuantity"),
            place=self.place(element),
        )
        state = Attributes(inner, name, self.wrong).whole("derivative", -1, most=2**32 - 1)
        return variable, None if state < 0 else state

    def _add(self, element: Element, variable: FmuVariable) -> None:
        if not variable.alias:
            self.order.append(variable)
            self.by_reference.setdefault(variable.reference, variable)
        if variable.name in self.variables:
            first = self.variables[variable.name].place.line
            self.wrong(element, f"the name is there twice, first in line {first}", variable.name)
            return
        self.variables[variable.name] = variable
        self.scalars += 1
        if self.scalars == MAX_SCALARS + 1:
            self.wrong(element, f"more than {MAX_SCALARS} variables")

    def _replace(self, name: str, **changes: Any) -> None:
        old = self.variables[name]
        new = self.variables[name] = replace(old, **changes)
        if self.by_reference.get(old.reference) is old:
            self.by_reference[old.reference] = new

    def _at(self, number: int) -> FmuVariable | None:
        """Return the variable that the structure means: by place from 1 (FMI 2.0) or by value reference (3.0)."""
        if self.version == "3.0":
            return self.by_reference.get(number)
        found = self.order[number - 1] if 1 <= number <= len(self.order) else None
        return self.variables.get(found.name) if found else None

    def _dimensions(self, elements: Iterable[Element]) -> None:
        """Give arrays their shape: a number, or the start value of a structural parameter."""
        if self.version == "2.0":
            return
        for element in elements:
            shape = tuple(self._extent(d, element.get("name")) for d in element.all("Dimension"))
            if not shape:
                continue
            size = prod(shape)
            self.scalars += size
            if self.scalars > MAX_SCALARS:
                self.wrong(element, f"shape {list(shape)}: more than {MAX_SCALARS} entries in all", element.get("name"))
                return
            resized = any(self._resized(dimension) for dimension in element.all("Dimension"))
            for name in [element.get("name"), *(alias.get("name") for alias in element.all("Alias"))]:
                if name in self.variables:
                    start = self.variables[name].start
                    if isinstance(start, tuple) and len(start) not in (1, size):
                        if resized:
                            self._replace(name, dimensions=shape, start=None)
                            continue
                        self.wrong(element, f"{len(start)} start values for shape {list(shape)}", name)
                    if isinstance(start, tuple) and len(start) == 1:
                        start = start * size
                    self._replace(name, dimensions=shape, start=start)
        for name, variable in self.variables.items():
            if not variable.dimensions and isinstance(variable.start, tuple):
                if len(variable.start) != 1:
                    what = f"{len(variable.start)} start values for a scalar"
                    self.problems.append(Problem(what, name[:200], variable.place))
                self._replace(name, start=variable.start[0] if variable.start else None)

    def _extent(self, dimension: Element, subject: str) -> int:
        read = self.attributes(dimension, subject)
        if "start" in dimension.attributes:
            return read.whole("start", 1, least=1, most=2**63)
        number = read.whole("valueReference", -1, most=2**32 - 1)
        parameter = self.by_reference.get(number)
        if parameter is None or parameter.causality != "structuralParameter":
            self.wrong(dimension, "the size of the array is neither a number nor a structural parameter", subject)
            return 1
        if parameter.name in self.sizes:
            return self.sizes[parameter.name]
        value = parameter.start[0] if isinstance(parameter.start, tuple) and parameter.start else parameter.start
        if isinstance(value, int) and value >= 1:
            return value
        self.wrong(dimension, f"the size of the array, {parameter.name[:80]}, has no start value above 0", subject)
        return 1

    def _resized(self, dimension: Element) -> bool:
        parameter = self.by_reference.get(_int(dimension.get("valueReference")))
        return parameter is not None and parameter.name in self.sizes

    # -- structure -----------------------------------------------------------------------------------------------------

    def _structure(self) -> dict[str, Any]:
        found: dict[str, Any] = {
            "outputs": (),
            "derivatives": (),
            "states": (),
            "initial_unknowns": (),
            "events": 0,
            "dependencies": {},
        }
        group = self.root.first("ModelStructure")
        if group is None:
            self.wrong(self.root, "<ModelStructure> is missing")
            return found
        tags = {
            "outputs": ("Outputs", "Output"),
            "derivatives": ("Derivatives", "ContinuousStateDerivative"),
            "initial_unknowns": ("InitialUnknowns", "InitialUnknown"),
        }
        for key, (old, new) in tags.items():
            lists = group.all(old)
            unknowns = [u for e in lists for u in e.all("Unknown")] if self.version == "2.0" else list(group.all(new))
            names = [self._unknown(e, None if key == "initial_unknowns" else found["dependencies"]) for e in unknowns]
            found[key] = tuple(name for name in names if name)
        states = []
        for name in found["derivatives"]:
            state = self.variables[name].derivative_of
            if state and self.variables[state].size == self.variables[name].size:
                states.append(state)
            elif name not in self.stray:
                what = f"has not the shape of its state {state}" if state else "does not say of which state it is"
                self.problems.append(Problem(f"is listed as a derivative but {what}", name, self.variables[name].place))
        found["states"] = tuple(name for state in states for name in self.variables[state].names())
        found["derivatives"] = tuple(n for name in found["derivatives"] for n in self.variables[name].names())
        events = (self.by_reference.get(_int(e.get("valueReference"))) for e in group.all("EventIndicator"))
        found["events"] = sum(variable.size for variable in events if variable is not None)
        return found

    def _unknown(self, element: Element, dependencies: dict[str, tuple[str, ...] | None] | None) -> str:
        """Return the name of an unknown of the model structure; note what it depends on."""
        key = "index" if self.version == "2.0" else "valueReference"
        variable = self._at(self.attributes(element, element.tag).whole(key, -1, most=2**32 - 1))
        if variable is None:
            self.wrong(element, f'{key}="{element.get(key)[:40]}" is not a variable', "ModelStructure")
            return ""
        if dependencies is not None:
            dependencies[variable.name] = self._dependencies(element, variable.name)
        return variable.name

    def _dependencies(self, element: Element, subject: str) -> tuple[str, ...] | None:
        if "dependencies" not in element.attributes:
            return None
        found = []
        for word in element.get("dependencies").split():
            variable = self._at(_int(word))
            if variable is None:
                self.wrong(element, f"depends on '{word[:40]}', which is not a variable", subject)
                return None
            found.append(variable.name)
        return tuple(found)


def _initial(causality: str, variability: str) -> str:
    """Return the default of ``initial`` (FMI 2.0.4 table in 2.2.7; FMI 3.0.1 table 22)."""
    if causality == "independent":
        return ""
    if causality in ("parameter", "structuralParameter", "input") or variability == "constant":
        return "exact"
    return "calculated"


def _int(text: str) -> int:
    return int(text) if re.fullmatch(r"[0-9]{1,10}", text) else -1
