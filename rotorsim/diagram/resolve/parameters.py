"""Diagram parameters in the units of the block parameters that follow them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from rotorsim.diagram.parse.document import Parameter, RawBlock
from rotorsim.diagram.resolve.values import ValueProblem, numeric
from rotorsim.errors import Problems, near_miss
from rotorsim.units import UnitError, compatible, parse_unit, split_quantity


def referred_name(value: Any) -> str:
    """Return the name in ``"$name"``, "" of any other value."""
    return value[1:] if isinstance(value, str) and value.startswith("$") else ""


def referred(raw: RawBlock, name: str) -> Parameter:
    """Return the diagram parameter that a name means in a block; raise ValueProblem."""
    parameter = raw.scope.parameters.get(name)
    if parameter is None:
        raise ValueProblem(f"no diagram parameter '{name}'", near_miss(name, raw.scope.parameters))
    parameter.used = True
    return parameter


class DiagramParameters:
    """The diagram parameters that blocks follow. units: name -> unit, that of the first follower."""

    def __init__(self, problems: Problems) -> None:
        self.problems = problems
        self.units: dict[str, str] = {}
        self._converted: dict[tuple[int, str | None], np.ndarray | None] = {}

    def value(self, parameter: Parameter, unit: str | None, user: str) -> np.ndarray | None:
        """Return the value of a parameter for one that follows it, None where its mistake has been said."""
        key = (id(parameter), unit)
        if key not in self._converted:
            self._converted[key] = self._convert(parameter, unit, user)
        value = self._converted[key]
        if value is not None:
            parameter.users.append(user)
        return value

    def _convert(self, parameter: Parameter, unit: str | None, user: str) -> np.ndarray | None:
        try:
            known = self.units.get(parameter.name)
            if compatible(known, unit) not in ("same", "angle"):
                raise ValueProblem(
                    f"is used in {known} by {parameter.users[0]} and in {unit} by {user}", "use two diagram parameters"
                )
            if referred_name(parameter.value):
                raise ValueProblem(
                    f"'{parameter.value}' is no diagram parameter",
                    "a value for a sub-diagram may name a parameter of the outer diagram",
                )
            value = numeric(parameter.value, unit, bare=parameter.place.file == "--set")
        except ValueProblem as problem:
            place = parameter.place.part(*problem.path)
            self.problems.error(problem.what, parameter.name, place, problem.hint or f"it is used by {user}")
            return None
        if unit is not None:
            self.units.setdefault(parameter.name, unit)
        return value

    def values(self, parameters: Mapping[str, Parameter]) -> dict[str, np.ndarray]:
        """Return every numeric parameter as an SI array; warn of those that nothing uses."""
        result: dict[str, np.ndarray] = {}
        followed: dict[int, list[np.ndarray | None]] = {}
        for (key, _), value in self._converted.items():
            followed.setdefault(key, []).append(value)
        for name, parameter in parameters.items():
            if not parameter.used:
                self.problems.warning(
                    "diagram parameter is not used",
                    name,
                    parameter.place,
                    f'refer to it as "${name.rpartition("/")[2]}"',
                )
            if id(parameter) not in followed:
                try:
                    value = numeric(parameter.value, self.units.get(name), bare=parameter.place.file == "--set")
                except ValueProblem as problem:
                    if not parameter.used:  # what only options follow may be a text
                        self.problems.error(problem.what, name, parameter.place, problem.hint)
                    continue
                followed[id(parameter)] = [value]
            values = [value for value in followed[id(parameter)] if value is not None]
            if values:
                result[name] = values[0]
            if any(not np.array_equal(value, values[0]) for value in values[1:]):  # one in rad/s, one in Hz
                self.problems.error(
                    "is used by blocks that take it in different units",
                    name,
                    parameter.place,
                    "use two diagram parameters",
                )
            self.units.setdefault(name, _unit_of(parameter.value))
        return result


def _unit_of(value: Any) -> str:
    while isinstance(value, list) and value:
        value = value[0]
    try:
        return parse_unit(split_quantity(value)[1]).si if isinstance(value, str) else "1"
    except UnitError:
        return "1"
