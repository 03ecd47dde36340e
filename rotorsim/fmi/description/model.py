"""What an FMU says about itself: kinds, variables, units, structure; the same classes for FMI 1.0, 2.0 and 3.0.

Types have the names of FMI 3.0 (Real is Float64, Integer is Int32). Arrays are seen as their entries too:
``v[2,3]`` counts from 1, the last index runs fastest.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
from math import prod

from rotorsim.errors import Place, Problem, RotorsimError, near_miss
from rotorsim.units import BASES, Unit, UnitError, parse_foreign_unit, parse_unit

FLOATS = ("Float64", "Float32")
INTEGERS = ("Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "Int64", "UInt64", "Enumeration")
NUMERIC = (*FLOATS, *INTEGERS, "Boolean")
FMU_KINDS = {"cs": "Co-Simulation", "me": "Model Exchange", "se": "Scheduled Execution"}
BASE_UNITS = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")  # attributes of <BaseUnit>, in the order of the schema

Value = float | int | bool | str


@dataclass(frozen=True)
class FmuUnit:
    """A unit: value in base units = factor * value + offset; powers of kg, m, s, A, K, mol, cd, rad.

    display: name -> (factor, offset, inverse) of display units: shown = factor * value + offset, or with inverse
    (FMI 3.0) factor / value.
    """

    name: str
    factor: float = 1.0
    offset: float = 0.0
    powers: Mapping[str, int] = field(default_factory=dict)
    display: Mapping[str, tuple[float, float, bool]] = field(default_factory=dict)
    defined: bool = True  # a unit without <BaseUnit> is only a name

    @property
    def unit(self) -> Unit | None:
        """The unit as `rotorsim.units` knows it, without its offset, or None: only a name that nobody knows."""
        found = self.known
        if found is None:
            return None
        return Unit(found.factor, tuple(found.powers.get(base, 0) for base in BASES))

    @cached_property
    def known(self) -> FmuUnit | None:
        """The unit with factor, offset and powers: as the FMU defines it, else as its name says; None: neither."""
        try:
            named, offset, _ = parse_foreign_unit(self.name)
        except UnitError:
            return self if self.defined else None
        powers = {base: power for base, power in zip(BASES, named.dimension, strict=True) if power}
        read = FmuUnit(self.name, named.factor, offset, powers, self.display)
        if not self.defined:
            return read
        return replace(self, powers=powers) if self._leaves_angle_out(read) else self

    def _leaves_angle_out(self, read: FmuUnit) -> bool:
        """Return whether a definition is what the name says but for the angle, which FMI allows to leave out."""
        own, named = (
            {base: power for base, power in unit.powers.items() if power and base != "rad"} for unit in (self, read)
        )
        alike = math.isclose(self.factor, read.factor, rel_tol=1e-6) and self.offset == read.offset
        return alike and own == named and not self.powers.get("rad")

    @cached_property
    def si(self) -> str | None:
        """The SI unit of its dimension, in its own spelling where that is one."""
        if self.unit is None:
            return None
        dimension = self.unit.dimension
        with contextlib.suppress(UnitError):
            spelling = parse_foreign_unit(self.name)[2]
            if parse_unit(spelling) == Unit(1.0, dimension):
                return spelling
        return next((name for name in _SI if parse_unit(name).dimension == dimension), Unit(1.0, dimension).si)


_SI = ("1", "N", "N/m", "N s/m", "Pa", "V", "W", "Ohm", "H", "T", "Wb", "F", "C", "rad/s")


@dataclass(frozen=True)
class FmuVariable:
    """A variable. dimensions: () for a scalar; start: one value, or a tuple with one for each entry, or None.

    derivative_of: name of the state whose derivative it is. clocked: it belongs to clocks.
    """

    name: str
    reference: int
    type: str
    causality: str = "local"
    variability: str = "continuous"
    initial: str = ""
    start: Value | tuple[Value, ...] | None = None
    unit: str = ""
    display_unit: str = ""
    description: str = ""
    minimum: float | None = None
    maximum: float | None = None
    nominal: float | None = None
    dimensions: tuple[int, ...] = ()
    derivative_of: str = ""
    declared_type: str = ""
    alias: bool = False
    clocked: bool = False
    relative: bool = False  # a difference: the offset of its unit does not count
    negated: bool = False  # FMI 1.0: what the FMU gives and takes has the other sign
    place: Place = field(default_factory=Place)

    @property
    def size(self) -> int:
        """How many scalars it is."""
        return prod(self.dimensions)

    def names(self) -> list[str]:
        """Return the names of its entries; of a scalar, its own."""
        if not self.dimensions:
            return [self.name]
        ranges = (range(1, n + 1) for n in self.dimensions)
        return [f"{self.name}[{','.join(map(str, index))}]" for index in product(*ranges)]


@dataclass(frozen=True)
class Entry:
    """A scalar: a variable, or one entry (counted from 0) of an array."""

    name: str
    variable: FmuVariable
    index: int = 0

    @property
    def indices(self) -> tuple[int, ...]:
        """Its place in the array, counted from 1; () for a scalar."""
        inside = self.name.removeprefix(self.variable.name).strip("[]")
        return tuple(map(int, inside.split(","))) if inside else ()

    @property
    def start(self) -> Value | None:
        """Its start value; one value may stand for all entries of an array."""
        start = self.variable.start
        if not isinstance(start, tuple):
            return start
        return start[self.index] if len(start) > 1 else start[0] if start else None


@dataclass(frozen=True)
class Kind:
    """What an FMU offers as Co-Simulation ("cs"), Model Exchange ("me") or Scheduled Execution ("se")."""

    name: str
    identifier: str
    can_get_set_state: bool = False
    can_serialise_state: bool = False
    directional_derivatives: bool = False
    adjoint_derivatives: bool = False  # FMI 3.0
    once_per_process: bool = False
    needs_tool: bool = False
    can_vary_step: bool = False  # cs
    can_interpolate_inputs: bool = False  # cs, FMI 1.0 and 2.0: derivatives of inputs can be set
    max_output_derivative_order: int = 0  # cs
    fixed_step: float | None = None  # cs, FMI 3.0: its internal step [s]
    completed_step_needed: bool = True  # me


@dataclass(frozen=True)
class Experiment:
    """The experiment that the FMU proposes [s]."""

    start: float | None = None
    stop: float | None = None
    tolerance: float | None = None
    step: float | None = None


@dataclass(frozen=True, eq=False)
class ModelDescription:
    """A model description that was read without a mistake.

    states, derivatives: names of the entries of x and of its derivative, in the order of the FMU. outputs: names as
    the model structure lists them. dependencies: output or derivative -> the variables it depends on directly
    (None: on all); factors: those of them that it is proportional to, by factors that change at events at most.
    platforms: folders with a library for the kind asked. items: names of the values of each type that enumerates.
    sizes: values of structural parameters that are not their start values; the arrays have their shapes. unlisted:
    arrays that the FMU has and does not name: the states of FMI 1.0 and their derivatives.
    """

    version: str  # "1.0", "2.0" or "3.0"
    name: str
    token: str  # guid or instantiation token
    variables: Mapping[str, FmuVariable]
    kinds: Mapping[str, Kind]
    states: tuple[str, ...] = ()
    derivatives: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    initial_unknowns: tuple[str, ...] = ()
    dependencies: Mapping[str, tuple[str, ...] | None] = field(default_factory=dict)
    factors: Mapping[str, frozenset[str]] = field(default_factory=dict)
    n_events: int = 0  # event indicators
    units: Mapping[str, FmuUnit] = field(default_factory=dict)
    experiment: Experiment = field(default_factory=Experiment)
    description: str = ""
    author: str = ""
    tool: str = ""
    date: str = ""
    naming: str = "flat"
    log_categories: tuple[str, ...] = ()
    platforms: tuple[str, ...] = ()
    place: Place = field(default_factory=Place)
    warnings: tuple[Problem, ...] = ()
    items: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    sizes: Mapping[str, int] = field(default_factory=dict)
    unlisted: tuple[FmuVariable, ...] = ()

    @property
    def is_tool_coupling(self) -> bool:
        """Whether a tool outside the FMU does its work (CoSimulation_Tool of FMI 1.0)."""
        return self.version == "1.0" and any(kind.needs_tool for kind in self.kinds.values())

    def by_causality(self, *causalities: str) -> list[FmuVariable]:
        """Return the variables of these causalities, in the order of the file."""
        return [variable for variable in self.variables.values() if variable.causality in causalities]

    def entries(self, name: str) -> list[Entry]:
        """Return the scalars that a name stands for: one, or all of an array; [] if there is no such variable."""
        variable = self.variables.get(name)
        if variable is not None:
            return [Entry(entry, variable, k) for k, entry in enumerate(variable.names())]
        return [self._array_entries[name]] if name in self._array_entries else []

    @cached_property
    def _array_entries(self) -> dict[str, Entry]:
        arrays = [variable for variable in (*self.variables.values(), *self.unlisted) if variable.dimensions]
        return {name: Entry(name, array, k) for array in arrays for k, name in enumerate(array.names())}

    def resolve(self, names: Iterable[str], what: str = "variable") -> list[Entry]:
        """Return the scalars that names stand for. Raises RotorsimError with every unknown name and a near miss."""
        found: list[Entry] = []
        problems = []
        for name in names:
            entries = self.entries(name)
            if not entries:
                array = self.variables.get(name.partition("[")[0])
                hint = f"its shape is {list(array.dimensions)}" if array else near_miss(name, self.variables)
                problems.append(Problem(f"no {what} '{name}'", self.name, self.place, hint))
            found += entries
        if problems:
            raise RotorsimError(*problems)
        return found

    def follows(self, unknown: str, name: str) -> bool:
        """Return whether an unknown follows a variable at once, as the model structure says (not said: it does).

        Of variables inside, which the structure does not list, nothing is said.
        """
        base = unknown.partition("[")[0]
        inside = self.resolve([unknown])[0].variable.causality == "local"
        known = self.dependencies.get(unknown, self.dependencies.get(base, None if inside else ()))
        return known is None or name in known or name.partition("[")[0] in known

    def is_affine(self, outputs: Iterable[str]) -> bool:
        """Return whether derivatives and outputs are said to be linear in states and inputs, with factors that rest.

        An FMU with event indicators, or that wants to be told of completed steps, may change its factors there.
        """
        if self.n_events or "me" not in self.kinds or self.kinds["me"].completed_step_needed:
            return False
        moving = {entry.variable.name for entry in self.resolve(self.states)}
        moving |= {variable.name for variable in self.by_causality("input")}
        for unknown in {entry.variable.name for entry in self.resolve([*self.derivatives, *outputs])}:
            known = self.dependencies.get(unknown)
            if known is None or not moving.intersection(known) <= self.factors[unknown]:
                return False
        return True

    def unit_of(self, variable: FmuVariable) -> FmuUnit | None:
        """Return the unit of a variable, or None where it has none, or one that is neither defined nor known.

        The definition of the FMU decides; where there is none, what the name says.
        """
        if not variable.unit:
            return None
        found = (self.units.get(variable.unit) or FmuUnit(variable.unit, defined=False)).known
        return replace(found, offset=0.0) if found is not None and variable.relative else found

    @cached_property
    def clocks(self) -> tuple[str, ...]:
        """Names of the clocks."""
        return tuple(name for name, variable in self.variables.items() if variable.type == "Clock")

    def kind(self, name: str) -> Kind:
        """Return a kind. Raises RotorsimError when the FMU does not offer it."""
        if name not in self.kinds:
            offered = " and ".join(FMU_KINDS[kind] for kind in self.kinds)
            what = f"does not offer {FMU_KINDS.get(name, name)}; it offers {offered}"
            raise RotorsimError(Problem(what, self.name, self.place))
        return self.kinds[name]
