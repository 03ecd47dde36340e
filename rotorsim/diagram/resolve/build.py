"""Blocks of a diagram from their JSON: type, options, parameter values, and shapes found for all of them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from rotorsim.block import Block, Declaration, Option, Param, Shape
from rotorsim.diagram.diagram import Node, Port
from rotorsim.diagram.parse.document import FlatDocument, Parameter, RawBlock
from rotorsim.diagram.parse.source import LazyPlace
from rotorsim.diagram.resolve.registry import Registry
from rotorsim.diagram.resolve.shapes import Unifier, text_of
from rotorsim.diagram.resolve.template import Template, Work, filled
from rotorsim.diagram.resolve.values import ValueProblem, bounds_problem, numeric, option_value
from rotorsim.errors import Place, Problem, RotorsimError, near_miss
from rotorsim.units import UnitError, compatible, parse_unit, split_quantity

__all__ = ["Builder"]

# block types whose ports a file describes -> the module that reads it (rooms above this one: imported when needed)
FROM_FILE = {"fmu": "rotorsim.fmi.block"}


class Builder:
    """Makes `Work` of raw blocks and `Node` of work; mistakes go to ``problems``."""

    def __init__(self, flat: FlatDocument, registry: Registry, folder: Path | None = None) -> None:
        self.flat, self.registry, self.problems, self.folder = flat, registry, flat.problems, folder
        self.templates: dict[Any, Template] = {}
        self.unifier = Unifier()
        self.converted: dict[tuple[int, str | None], np.ndarray | ValueProblem] = {}
        self.parameter_units: dict[str, str] = {}
        self.misfits: set[str] = set()  # blocks whose defaults do not fit, so that their values mean nothing

    def error(self, what: str, subject: str, place: Place, hint: str = "") -> None:
        self.problems.append(Problem(what, subject=subject, place=place, hint=hint))

    def template(self, cls: type[Block], options: Mapping[str, Any], key: Any, wired: frozenset[str]) -> Template:
        """Return the shared template; raises whatever the code of the block raises."""
        found = self.templates.get((cls, key, wired))
        if found is None:
            found = self.templates[cls, key, wired] = Template(cls, options, wired)
        return found

    def start(self, raw: RawBlock) -> Work | None:
        """Find the class and options of a block and read the parameters given to it."""
        cls = self._from_file(raw) if raw.type_name in FROM_FILE else self.registry.find(raw.type_name)
        if cls is None and raw.type_name in FROM_FILE:
            return None
        if cls is None:
            hint = self.registry.hint(raw.type_name)
            if self.flat.data.get("block_folders") and not self.registry.folders:
                hint += ' If it is in "block_folders", add --trust-blocks'
            self.error(f"unknown block type '{raw.type_name}'", raw.name, raw.place("type"), hint)
            return None
        options: dict[str, Any] = {}
        given: dict[str, np.ndarray] = {}
        references: dict[str, str] = {}
        for name, value in raw.parameters.items():
            if name == "file" and raw.type_name in FROM_FILE:
                hint = f"it has the block's ports: rotorsim swap DIAGRAM {raw.name} {raw.type_name} --set file=FILE"
                self.error("the file is a key of the block, no parameter", raw.name, raw.place_of(name, key=True), hint)
            elif name in cls.options:
                options[name] = value
            elif name in cls.parameters:
                array = self.parameter(raw, name, value, cls.parameters[name], references)
                if array is not None:
                    given[name] = array
            else:
                self.unknown_parameter(raw, name, cls)
        for name, declared in cls.parameters.items():
            if declared.default is None and name not in raw.parameters:
                hint = f'write "{name}": {_expected(declared)}'
                self.error(f"parameter '{name}' is missing", raw.name, raw.place(key=True), hint)
        if raw.file is not None:
            if "file" in cls.options:
                options.setdefault("file", raw.file)
            else:
                hint = "only sub-diagrams and blocks that read a file have it"
                self.error("unknown key 'file'", raw.name, raw.place("file", key=True), hint)
        before = len(self.problems)
        for name, option in cls.options.items():
            self.option(raw, name, option, options)
        if len(self.problems) > before:
            return None
        return self.work(raw, cls, options, given, references)

    def _from_file(self, raw: RawBlock) -> type[Block] | None:
        """Return the class that a block's file describes (an FMU), or None when its mistakes have been said."""
        if raw.file is None:
            hint = '"type": "fmu", "file": "plant.fmu"'
            self.error("key 'file' is missing", raw.name, raw.place(key=True), hint)
            return None
        base = raw.scope.source.path
        folder = base.parent if base is not None else self.folder
        path = (folder or Path()) / raw.file
        try:
            given = {name: self._plain(raw, value) for name, value in raw.parameters.items()}
            wanted = frozenset(self.signals.get(raw.name, ()))
            found: type[Block] = import_module(FROM_FILE[raw.type_name]).block_class(path, given, wanted)
        except RotorsimError as error:
            for problem in error.problems:
                what = problem.what if raw.file in problem.what else f"{raw.file}: {problem.what}"
                self.error(what, raw.name, raw.place("file"), problem.hint)
            return None
        said = {(problem.what, problem.subject) for problem in self.problems}
        for warning in found.fmu_warnings:  # type: ignore[attr-defined]
            what = ": ".join(text for text in (raw.file, warning.subject, warning.what) if text)
            if (what, raw.name) not in said:
                self.problems.append(Problem(what, raw.name, raw.place("file"), warning.hint, "warning"))
        return found

    @cached_property
    def signals(self) -> dict[str, set[str]]:
        """Outputs that are wired or recorded: flat block name -> names of ports."""
        found: dict[str, set[str]] = {}
        for end in (*(wire.source for wire in self.flat.wires), *(end for end, _ in self.flat.record or ())):
            found.setdefault(end.block, set()).add(end.port)
        return found

    @staticmethod
    def _plain(raw: RawBlock, value: Any) -> Any:
        """Return a value, or that of the diagram parameter that it follows."""
        followed = raw.scope.parameters.get(value[1:]) if isinstance(value, str) and value[:1] == "$" else None
        return value if followed is None else followed.value

    def work(
        self,
        raw: RawBlock,
        cls: type[Block],
        options: dict[str, Any],
        given: dict[str, np.ndarray],
        references: dict[str, str],
    ) -> Work | None:
        key = tuple((name, freeze(value)) for name, value in options.items()) if options else ()
        try:
            template = self.template(cls, options, key, frozenset())
        except Exception as error:  # the code of the block is foreign
            what = f"block type '{cls.type_name}' fails with these options: {type(error).__name__}: {error}"
            self.error(what, raw.name, raw.place(), f"see `rotorsim blocks {cls.type_name}`")
            return None
        for name in template.bad_names:
            self.error(
                f"'{name}' cannot be the name of a port",
                raw.name,
                raw.place("parameters"),
                "each name once; letters, digits and _, not a digit first",
            )
        return Work(raw, cls, options, key, template, given, references)

    def unknown_parameter(self, raw: RawBlock, name: str, cls: type[Block]) -> None:
        known = [*cls.parameters, *cls.options]
        hint = near_miss(name, known) or f"type '{cls.type_name}' has no parameters"
        self.error(f"unknown parameter '{name}'", raw.name, raw.place_of(name, key=True), hint)

    def option(self, raw: RawBlock, name: str, declared: Option, options: dict[str, Any]) -> None:
        if name not in options:
            if declared.default is None and declared.kind is not None:
                self.error(f"parameter '{name}' is missing", raw.name, raw.place(key=True), declared.doc)
            return
        value = options[name]
        try:
            if isinstance(value, str) and value.startswith("$"):
                value = self.referred(raw, name, value).value
            options[name] = option_value(value, declared)
        except ValueProblem as problem:
            self.value_problem(raw, name, problem)

    def referred(self, raw: RawBlock, name: str, text: str) -> Parameter:
        found = raw.scope.parameters.get(text[1:])
        if found is None:
            raise ValueProblem(f"no diagram parameter '{text[1:]}'", near_miss(text[1:], raw.scope.parameters))
        found.used = True
        return found

    def value_problem(self, raw: RawBlock, name: str, problem: ValueProblem) -> None:
        place: Place = raw.place("parameters", name, *problem.path)
        value = raw.parameters.get(name)
        followed = raw.scope.parameters.get(value[1:]) if isinstance(value, str) and value[:1] == "$" else None
        if followed is not None:
            place = followed.place  # the number is written there
        elif name in raw.overrides:
            place = Place("--set")
        self.error(problem.what, f"{raw.name}.{name}", place, problem.hint)

    def parameter(
        self, raw: RawBlock, name: str, value: Any, declared: Param, references: dict[str, str]
    ) -> np.ndarray | None:
        try:
            if isinstance(value, str) and value.startswith("$"):
                parameter = self.referred(raw, name, value)
                array = self.follow(parameter, declared, (raw.name, name))
                references[name] = parameter.name
            else:
                array = numeric(value, declared.unit, bare=name in raw.overrides)
            if declared.low is not None or declared.above is not None or declared.high is not None:
                outside = bounds_problem(array, declared)
                if outside is not None:
                    raise outside
        except ValueProblem as problem:
            if problem.what:
                self.value_problem(raw, name, problem)
            return None
        return array

    def follow(self, parameter: Parameter, declared: Param, user: tuple[str, str]) -> np.ndarray:
        """Return the value of a diagram parameter in the unit of the block parameter that follows it."""
        key = (id(parameter), declared.unit)
        if key not in self.converted:
            self.converted[key] = self.convert(parameter, declared.unit, user)
        result = self.converted[key]
        if isinstance(result, ValueProblem):
            raise ValueProblem("")  # reported where it was found first
        parameter.users.append(user)
        return result

    def convert(self, parameter: Parameter, unit: str | None, user: tuple[str, str]) -> np.ndarray | ValueProblem:
        name = ".".join(user)
        try:
            known = self.parameter_units.get(parameter.name)
            fit = compatible(known, unit)
            if fit not in ("same", "angle"):
                other = ".".join(parameter.users[0])
                raise ValueProblem(
                    f"is used in {known} by {other} and in {unit} by {name}", "use two diagram parameters"
                )
            bare = parameter.place.file == "--set"
            if isinstance(parameter.value, str) and parameter.value.startswith("$"):
                hint = "a value for a sub-diagram may name a parameter of the outer diagram"
                raise ValueProblem(f"'{parameter.value}' is no diagram parameter", hint)
            value = numeric(parameter.value, unit, bare=bare)
        except ValueProblem as problem:
            hint = problem.hint or f"it is used by {name}"
            place = parameter.place
            if problem.path and isinstance(place, LazyPlace):
                place = place.part(*problem.path)
            self.error(problem.what, parameter.name, place, hint)
            return problem
        if unit is not None:
            self.parameter_units.setdefault(parameter.name, unit)
        return value

    def diagram_parameters(self) -> dict[str, np.ndarray]:
        """Return every numeric diagram parameter as an SI array; warn of those that nothing uses."""
        result: dict[str, np.ndarray] = {}
        following: dict[int, list[np.ndarray | ValueProblem]] = {}
        for (key, _), value in self.converted.items():
            following.setdefault(key, []).append(value)
        for name, parameter in self.flat.parameters.items():
            if not parameter.used:
                what = "diagram parameter is not used"
                hint = f'refer to it as "${name.rpartition("/")[2]}"'
                self.problems.append(Problem(what, name, parameter.place, hint, "warning"))
            found = following.get(id(parameter))
            if found is None:
                try:
                    bare = parameter.place.file == "--set"
                    found = [numeric(parameter.value, self.parameter_units.get(name), bare=bare)]
                except ValueProblem as problem:
                    if not parameter.used:  # what only options follow may be a text
                        self.error(problem.what, name, parameter.place, problem.hint)
                    continue
            values = [value for value in found if isinstance(value, np.ndarray)]
            if values:
                result[name] = values[0]
            if any(not np.array_equal(value, values[0]) for value in values[1:]):  # one in rad/s, one in Hz
                what = "is used by blocks that take it in different units"
                self.error(what, name, parameter.place, "use two diagram parameters")
            self.parameter_units.setdefault(name, _unit_of(parameter.value))
        return result

    # --- shapes -----------------------------------------------------------------------------------

    def bind_given(self, works: Iterable[Work]) -> None:
        """Let given lists fix the dimensions of their blocks, and say where they do not fit."""
        for work in works:
            shapes = work.template.parameter_shapes
            for name, value in work.given.items():
                if value.ndim or shapes[name] != ():
                    self._bind(work, name, value, "")

    def _bind(self, work: Work, name: str, value: np.ndarray, origin: str) -> None:
        if value.ndim == 0:
            return
        term = work.term(work.template.parameter_shapes[name], self.unifier)
        wanted = text_of(term, self.unifier)
        fits = value.ndim == len(term) if isinstance(term, tuple) else True
        if not fits or not self.unifier.unify(term, value.shape):
            hint = "write one number" if wanted == "scalar" else _list_hint(wanted)
            what = f"{origin}shape is {text_of(value.shape)}, expected {wanted}"
            self.value_problem(work.raw, name, ValueProblem(what, hint))
            work.given[name] = np.array(value.flat[0])

    def bind_defaults(self, works: Iterable[Work]) -> None:
        """Let default lists fix what wires and given values left open."""
        for work in works:
            if work.template.words:
                for name, value in work.template.defaults.items():
                    if value.ndim and name not in work.given:
                        term = work.term(work.template.parameter_shapes[name], self.unifier)
                        if self.unifier.resolved(term) is None:
                            self._bind(work, name, value, "default ")

    def bind_rest(self, works: Iterable[Work]) -> None:
        """Take whole shapes that are still unknown as scalars, and dimensions of given scalars as 1."""
        for work in works:
            if not work.variables:
                continue
            for key, variable in work.variables.items():
                if not key.startswith("#") and isinstance(self.unifier.shape(variable), int):
                    self.unifier.unify(variable, ())
            for name in work.given:
                term = work.term(work.template.parameter_shapes[name], self.unifier)
                if isinstance(term, tuple) and self.unifier.resolved(term) is None:
                    for dimension in term:
                        self.unifier.unify_dimension(dimension, 1)
            for key, variable in work.variables.items():
                if key.startswith("#") and self.unifier.dimension(variable) < 0:
                    self.unifier.unify_dimension(variable, 1)
                    if any(
                        name not in work.given and name not in work.template.defaults for name in work.cls.parameters
                    ):
                        continue  # a parameter that is missing or wrong would tell the size
                    shapes = {
                        **work.template.input_shapes,
                        **work.template.output_shapes,
                        **work.template.parameter_shapes,
                    }
                    of = [n for n, s in shapes.items() if isinstance(s, tuple) and key[1:] in s]
                    what = f"size '{key[1:]}' of {', '.join(of)} is not known"
                    self.error(
                        what, work.raw.name, work.raw.place(key=True), "wire it, or give a parameter that has this size"
                    )

    def shape(self, work: Work, declared: Any) -> Shape:
        """Return a resolved shape."""
        if not work.template.words:
            return declared  # type: ignore[no-any-return]
        found = self.unifier.resolved(work.term(declared, self.unifier))
        return found if found is not None else ()

    def node(self, work: Work) -> Node:
        """Return the finished block."""
        template, name, fixed = work.template, work.raw.name, not work.template.words
        values: dict[str, np.ndarray] = {}
        for key, declared in template.parameter_shapes.items():
            if key in work.given:
                shape = self.shape(work, declared)
                value = work.given[key]
                values[key] = filled(value, shape) if value.ndim == 0 else value
            elif fixed and key in template.fixed:
                values[key] = template.fixed[key]
            elif key in template.defaults:
                values[key] = self.default(work, key, self.shape(work, declared))
        ports: list[dict[str, Port]] = []
        for declarations, shapes in (
            (template.inputs, template.input_shapes),
            (template.outputs, template.output_shapes),
        ):
            group: Mapping[str, Declaration] = declarations
            ports.append(
                {
                    n: Port(name, n, shapes[n] if fixed else self.shape(work, shapes[n]), d.unit, d)  # type: ignore[arg-type]
                    for n, d in group.items()
                }
            )
        states, randoms = template.state_shapes, template.random_shapes
        if not fixed:
            states = {n: self.shape(work, s) for n, s in states.items()}
            randoms = {n: self.shape(work, s) for n, s in randoms.items()}
        place = work.raw.place(key=True)
        return Node(name, template.block, values, work.references, ports[0], ports[1], states, randoms, place)

    def default(self, work: Work, name: str, shape: Shape) -> np.ndarray:
        value = work.template.defaults[name]
        if value.ndim and value.shape != shape:
            what = f"default of '{name}' has shape {text_of(value.shape)}, but {text_of(shape)} is needed here"
            self.error(what, work.raw.name, work.raw.place(key=True), f'give "{name}"')
            self.misfits.add(work.raw.name)
            return np.zeros(shape)
        return filled(value, shape)


def _expected(declared: Param) -> str:
    rank = len(declared.shape) if isinstance(declared.shape, tuple) else int(isinstance(declared.shape, int))
    kind = ("a number", "a list [...]", "a list of rows [[...], ...]")[min(rank, 2)]
    return kind if declared.unit in (None, "1") else f"{kind} in {declared.unit}"


def _list_hint(wanted: str) -> str:
    return (
        "write a list of rows [[...], ...]" if wanted.count(",") > 1 or wanted.endswith("?)") else "write a list [...]"
    )


def freeze(value: Any) -> Any:
    """Return an option value as something that can be a key."""
    if isinstance(value, list | tuple):
        return tuple(freeze(item) for item in value)
    if isinstance(value, dict):
        return tuple((key, freeze(item)) for key, item in value.items())
    return (type(value).__name__, value)


def _unit_of(value: Any) -> str:
    while isinstance(value, list) and value:
        value = value[0]
    try:
        return parse_unit(split_quantity(value)[1]).si if isinstance(value, str) else "1"
    except UnitError:
        return "1"
