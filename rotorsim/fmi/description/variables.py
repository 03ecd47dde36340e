"""The variables of a model description: names, types, start values, shapes of arrays, derivatives."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from math import prod

from rotorsim.errors import Place, Problem, near_miss
from rotorsim.fmi.description.attributes import Attributes, Mistakes
from rotorsim.fmi.description.model import FLOATS, INTEGERS, FmuVariable, Value
from rotorsim.fmi.description.xml_reader import Element

MAX_SCALARS = 1_000_000  # of all variables together
_TYPES2 = {"Real": "Float64", "Integer": "Int32"} | {name: name for name in ("Boolean", "String", "Enumeration")}
_TYPES3 = {name: name for name in (*FLOATS, *INTEGERS, "Boolean", "String", "Binary", "Clock")}
_CAUSALITIES = ("parameter", "calculatedParameter", "structuralParameter", "input", "output", "local", "independent")
_VARIABILITIES = ("constant", "fixed", "tunable", "discrete", "continuous")


class VariableReader:
    """Reads <ModelVariables>. variables: by name; stray: names of derivatives of nothing, which are reported.

    sizes: values of structural parameters (FMI 3.0), by name.
    """

    def __init__(
        self, mistakes: Mistakes, version: str, types: Mapping[str, Element], sizes: Mapping[str, int]
    ) -> None:
        self.mistakes, self.three, self.types, self.sizes = mistakes, version == "3.0", types, sizes
        self.variables: dict[str, FmuVariable] = {}
        self.stray: set[str] = set()
        self._order: list[str] = []  # FMI 2.0 counts variables from 1
        self._by_reference: dict[int, str] = {}
        self._scalars = 0

    def read(self, group: Element) -> None:
        """Read all variables."""
        known = _TYPES3 if self.three else _TYPES2
        elements = list(group.all(*_TYPES3) if self.three else group.all("ScalarVariable"))
        derivatives: list[tuple[str, Element, int]] = []
        for element in elements:
            inner = element if self.three else next(element.all(*_TYPES2), None)
            if inner is None:
                self.mistakes.wrong(element, "has no type: one of " + ", ".join(known), element.get("name"))
                continue
            variable = self._variable(element, inner, known[inner.tag])
            state = self.mistakes.attributes(inner, variable.name).whole("derivative", -1, most=2**32 - 1)
            if state >= 0:
                derivatives.append((variable.name, inner, state))
            self._add(element, variable)
            for alias in self._aliases(element):
                name, shown = alias.get("name"), alias.get("displayUnit", variable.display_unit)
                same = replace(variable, name=name, display_unit=shown, description=alias.get("description"))
                self._add(alias, replace(same, alias=True, place=self.mistakes.place(alias)))
        if self.three:
            self._set_shapes(elements)
        for name, inner, state in derivatives:
            of = self.at(state)
            if of is None:
                self.stray.add(name)
                self.mistakes.wrong(inner, f'derivative="{state}" is not a variable', name)
            elif name in self.variables:
                self.variables[name] = replace(self.variables[name], derivative_of=of.name)

    def at(self, number: int) -> FmuVariable | None:
        """Return the variable that the structure means: by place from 1 (FMI 2.0) or by value reference (3.0)."""
        if self.three:
            return self.variables.get(self._by_reference.get(number, ""))
        return self.variables.get(self._order[number - 1]) if 1 <= number <= len(self._order) else None

    def resized(self, place: Place) -> dict[str, int]:
        """Return the structural parameters that have other values than their start values."""
        wrong = [name for name in self.sizes if not self._is_structural(self.variables.get(name))]
        self.mistakes.problems += [Problem("is no structural parameter", name[:200], place) for name in wrong]
        return {name: n for name, n in self.sizes.items() if name not in wrong and self.variables[name].start != n}

    @staticmethod
    def _is_structural(variable: FmuVariable | None) -> bool:
        return variable is not None and variable.causality == "structuralParameter"

    def _aliases(self, element: Element) -> Iterator[Element]:
        return element.all(*(["Alias"] if self.three else []))

    def _variable(self, element: Element, inner: Element, kind: str) -> FmuVariable:
        read = self.mistakes.attributes(element, element.get("name"))
        name, declared = read.text("name", needed=True), inner.get("declaredType")
        if declared and declared not in self.types:
            hint = near_miss(declared, self.types, list_all=False)
            self.mistakes.wrong(inner, f"declaredType '{declared[:80]}' is not defined", name, hint)
        values = self.mistakes.attributes(inner, name, self.types.get(declared))
        causality = read.choice("causality", _CAUSALITIES, "local")
        usual = "fixed" if causality.endswith("arameter") else "continuous" if kind in FLOATS else "discrete"
        variability = read.choice("variability", _VARIABILITIES, usual)
        initial = read.choice("initial", ("exact", "approx", "calculated"), _initial(causality, variability))
        return FmuVariable(
            name,
            read.whole("valueReference", None, most=2**32 - 1),
            kind,
            causality,
            variability,
            initial,
            self._start(inner, values, kind),
            values.text("unit"),
            values.text("displayUnit"),
            element.get("description"),
            values.number("min", None),
            values.number("max", None),
            values.number("nominal", None),
            declared_type=declared,
            clocked=bool(element.get("clocks")),
            relative=values.flag("relativeQuantity"),
            negated=element.get("alias") == "negatedAlias",
            place=self.mistakes.place(element),
        )

    def _start(self, element: Element, values: Attributes, kind: str) -> Value | tuple[Value, ...] | None:
        """Return the start value; a tuple in FMI 3.0, where the shape is not known yet."""
        if self.three and kind in ("String", "Binary"):
            return tuple(child.get("value") for child in element.all("Start")) or None
        text = element.attributes.get("start")
        if text is None or kind == "Clock":
            return None
        if not self.three:
            return values.value("start", kind, text)
        words = text.split()
        numbers = tuple(value for word in words if (value := values.value("start", kind, word)) is not None)
        return numbers if len(numbers) == len(words) else None

    def _add(self, element: Element, variable: FmuVariable) -> None:
        name = variable.name
        if not variable.alias:
            self._order.append(name)
            self._by_reference.setdefault(variable.reference, name)
        if name in self.variables:
            first = self.variables[name].place.line
            self.mistakes.wrong(element, f"the name is there twice, first in line {first}", name)
            return
        self.variables[name] = variable
        self._scalars += 1
        if self._scalars == MAX_SCALARS + 1:
            self.mistakes.wrong(element, f"more than {MAX_SCALARS} variables")

    def _set_shapes(self, elements: Iterable[Element]) -> None:
        """Give arrays their shapes and all variables their start values."""
        for element in elements:
            own, dimensions = element.get("name"), list(element.all("Dimension"))
            shape = tuple(self._extent(dimension, own) for dimension in dimensions)
            self._scalars += prod(shape) if shape else 0
            if self._scalars > MAX_SCALARS:
                what = f"shape {list(shape)}: more than {MAX_SCALARS} entries in all"
                self.mistakes.wrong(element, what, own)
                return
            sizing = [self.at(reference_in(dimension.get("valueReference"))) for dimension in dimensions]
            resized = any(parameter is not None and parameter.name in self.sizes for parameter in sizing)
            for name in (own, *(alias.get("name") for alias in self._aliases(element))):
                if name in self.variables:
                    variable = self.variables[name]
                    start = self._start_of(variable, shape, resized)
                    self.variables[name] = replace(variable, dimensions=shape, start=start)

    def _start_of(
        self, variable: FmuVariable, shape: tuple[int, ...], resized: bool
    ) -> Value | tuple[Value, ...] | None:
        """Return the start value of a shape; one value may stand for all entries."""
        start, size = variable.start, prod(shape)
        if not isinstance(start, tuple):
            return start
        if len(start) not in (1, size):
            if resized:
                return None
            of = f"shape {list(shape)}" if shape else "a scalar"
            what = f"{len(start)} start values for {of}"
            self.mistakes.problems.append(Problem(what, variable.name[:200], variable.place))
        if not shape:
            return start[0] if start else None
        return start * size if len(start) == 1 else start

    def _extent(self, dimension: Element, subject: str) -> int:
        """Return the size of an array: a number, or the value of a structural parameter."""
        read = self.mistakes.attributes(dimension, subject)
        if "start" in dimension.attributes:
            return read.whole("start", 1, least=1, most=2**63)
        parameter = self.at(read.whole("valueReference", -1, most=2**32 - 1))
        if parameter is None or not self._is_structural(parameter):
            what = "the size of the array is neither a number nor a structural parameter"
        elif parameter.name in self.sizes:
            return self.sizes[parameter.name]
        else:
            value = parameter.start[0] if isinstance(parameter.start, tuple) and parameter.start else parameter.start
            if isinstance(value, int) and value >= 1:
                return value
            what = f"the size of the array, {parameter.name[:80]}, has no start value above 0"
        self.mistakes.wrong(dimension, what, subject)
        return 1


def reference_in(text: str) -> int:
    """Return the number that a text is, -1 where it is none."""
    return int(text) if re.fullmatch(r"[0-9]{1,10}", text) else -1


def _initial(causality: str, variability: str) -> str:
    """Return the default of ``initial`` (FMI 2.0.4 table in 2.2.7; FMI 3.0.1 table 22)."""
    if causality == "independent":
        return ""
    exact = causality in ("parameter", "structuralParameter", "input") or variability == "constant"
    return "exact" if exact else "calculated"
