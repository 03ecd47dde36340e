"""First stage: the class, the options and the given values of every block of a document."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from rotorsim.block import Block, Option, Param
from rotorsim.diagram.parse.document import FlatDocument, RawBlock
from rotorsim.diagram.resolve.draft import Draft
from rotorsim.diagram.resolve.parameters import DiagramParameters, referred, referred_name
from rotorsim.diagram.resolve.registry import Registry
from rotorsim.diagram.resolve.template import Templates
from rotorsim.diagram.resolve.values import ValueProblem, bounds_problem, numeric, option_value
from rotorsim.errors import Place, Problem, Problems, RotorsimError, near_miss

# block types whose ports a file describes -> the module that reads it (rooms above this one: imported when needed)
FROM_FILE = {"fmu": "rotorsim.fmi.block"}


def report_value(problems: Problems, raw: RawBlock, name: str, problem: ValueProblem) -> None:
    """Add what is wrong with the value of a parameter or option, where the value is written."""
    followed = raw.scope.parameters.get(referred_name(raw.parameters.get(name)))
    place = raw.place("parameters", name, *problem.path)
    if followed is not None:
        place = followed.place
    elif name in raw.overrides:
        place = Place("--set")
    problems.error(problem.what, f"{raw.name}.{name}", place, problem.hint)


class Drafter:
    """Makes a `Draft` of every raw block."""

    def __init__(self, flat: FlatDocument, registry: Registry, templates: Templates, folder: Path | None) -> None:
        self.flat, self.registry, self.templates, self.folder = flat, registry, templates, folder
        self.problems = flat.problems
        self.parameters = DiagramParameters(flat.problems)
        self.structural: dict[str, str] = {}  # diagram parameter -> an option that follows it

    def drafts(self, raws: Iterable[RawBlock]) -> dict[str, Draft]:
        """Return the drafts of blocks by name, without those whose type or options are wrong."""
        drafts = {raw.name: self._draft(raw) for raw in raws}
        return {name: draft for name, draft in drafts.items() if draft is not None}

    def _draft(self, raw: RawBlock) -> Draft | None:
        cls = self._from_file(raw) if raw.type_name in FROM_FILE else self._registered(raw)
        if cls is None:
            return None
        options = {name: value for name, value in raw.parameters.items() if name in cls.options}
        given: dict[str, np.ndarray] = {}
        references: dict[str, str] = {}
        for name, value in raw.parameters.items():
            if name == "file" and raw.type_name in FROM_FILE:
                self.problems.error(
                    "the file is a key of the block, no parameter",
                    raw.name,
                    raw.place_of(name, key=True),
                    f"it has the block's ports: rotorsim swap DIAGRAM {raw.name} {raw.type_name} --set file=FILE",
                )
            elif name in cls.parameters:
                array = self._value(raw, name, value, cls.parameters[name], references)
                if array is not None:
                    given[name] = array
            elif name not in cls.options:
                self.problems.error(
                    f"unknown parameter '{name}'",
                    raw.name,
                    raw.place_of(name, key=True),
                    near_miss(name, [*cls.parameters, *cls.options]) or f"type '{cls.type_name}' has no parameters",
                )
        for name, declared in cls.parameters.items():
            if declared.default is None and name not in raw.parameters:
                self.problems.error(
                    f"parameter '{name}' is missing",
                    raw.name,
                    raw.place(key=True),
                    f'write "{name}": {_expected(declared)}',
                )
        if raw.file is not None and "file" in cls.options:
            options.setdefault("file", raw.file)
        elif raw.file is not None:
            self.problems.error(
                "unknown key 'file'",
                raw.name,
                raw.place("file", key=True),
                "only sub-diagrams and blocks that read a file have it",
            )
        before = len(self.problems)
        for name, option in cls.options.items():
            self._check_option(raw, name, option, options)
        if len(self.problems) > before:
            return None
        try:
            template = self.templates.of(cls, options)
        except Exception as error:  # the code of the block is foreign
            self.problems.error(
                f"block type '{cls.type_name}' fails with these options: {type(error).__name__}: {error}",
                raw.name,
                raw.place(),
                f"see `rotorsim blocks {cls.type_name}`",
            )
            return None
        for name in template.bad_names:
            self.problems.error(
                f"'{name}' cannot be the name of a port",
                raw.name,
                raw.place("parameters"),
                "each name once; letters, digits and _, not a digit first",
            )
        unread = {name: np.array(np.nan) for name in raw.parameters if name in cls.parameters and name not in given}
        try:
            mistakes = template.block.check_given({**given, **unread})
        except Exception as error:  # the code of the block is foreign
            what = f"check of block type '{cls.type_name}' fails: {type(error).__name__}: {error}"
            self.problems.error(what, raw.name, raw.place(), f"see `rotorsim blocks {cls.type_name}`")
            mistakes = []
        for name, path, what, hint in mistakes:
            report_value(self.problems, raw, name, ValueProblem(what, hint, path))
        return Draft(raw, cls, options, template, given, references)

    def _registered(self, raw: RawBlock) -> type[Block] | None:
        cls = self.registry.find(raw.type_name)
        if cls is None:
            hint = self.registry.hint(raw.type_name)
            if self.flat.data.get("block_folders") and not self.registry.folders:
                hint += ' If it is in "block_folders", add --trust-blocks'
            self.problems.error(f"unknown block type '{raw.type_name}'", raw.name, raw.place("type"), hint)
        return cls

    def _from_file(self, raw: RawBlock) -> type[Block] | None:
        """Return the class that a block's file describes (an FMU), or None when its mistakes have been said."""
        if raw.file is None:
            self.problems.error(
                "key 'file' is missing", raw.name, raw.place(key=True), '"type": "fmu", "file": "plant.fmu"'
            )
            return None
        base = raw.scope.source.path
        folder = base.parent if base is not None else self.folder
        followed = {name: raw.scope.parameters.get(referred_name(value)) for name, value in raw.parameters.items()}
        given = {name: value if (p := followed[name]) is None else p.value for name, value in raw.parameters.items()}
        wanted = frozenset(self._signals.get(raw.name, ()))
        try:
            module = import_module(FROM_FILE[raw.type_name])
            cls: type[Block] = module.block_class((folder or Path()) / raw.file, given, wanted, raw.name)
        except RotorsimError as error:
            for problem in error.problems:
                if problem.subject == "ports":  # an option that names them
                    place = raw.place_of("ports")
                    self.problems.error(problem.what, f"{raw.name}.ports", place, problem.hint)
                    continue
                self.problems.error(
                    problem.what if raw.file in problem.what else f"{raw.file}: {problem.what}",
                    raw.name,
                    raw.place("file"),
                    problem.hint,
                )
            return None
        said = {(problem.what, problem.subject) for problem in self.problems}
        for warning in cls.fmu_warnings:  # type: ignore[attr-defined]
            what = ": ".join(text for text in (raw.file, warning.subject, warning.what) if text)
            if (what, raw.name) not in said:
                self.problems.append(Problem(what, raw.name, raw.place("file"), warning.hint, "warning"))
        return cls

    @cached_property
    def _signals(self) -> dict[str, set[str]]:
        """Outputs that are wired or recorded: flat block name -> names of ports."""
        signals: dict[str, set[str]] = {}
        for end in (*(wire.source for wire in self.flat.wires), *(end for end, _ in self.flat.record or ())):
            signals.setdefault(end.block, set()).add(end.port)
        return signals

    def _check_option(self, raw: RawBlock, name: str, declared: Option, options: dict[str, Any]) -> None:
        """Put the checked value of an option in the place of the given one."""
        if name not in options:
            if declared.default is None and declared.kind is not None:
                self.problems.error(f"parameter '{name}' is missing", raw.name, raw.place(key=True), declared.doc)
            return
        try:
            followed = referred_name(options[name])
            value, bare = options[name], name in raw.overrides
            if followed:
                parameter = referred(raw, followed)
                value, bare = parameter.value, parameter.place.file == "--set"
                self.structural.setdefault(parameter.name, f"{raw.name}.{name}")
            options[name] = option_value(value, declared, bare=bare)
        except ValueProblem as problem:
            report_value(self.problems, raw, name, problem)

    def _value(
        self, raw: RawBlock, name: str, value: Any, declared: Param, references: dict[str, str]
    ) -> np.ndarray | None:
        """Return the SI value of a parameter, None where its mistake has been said; note what it follows."""
        try:
            followed = referred_name(value)
            if followed:
                parameter = referred(raw, followed)
                array = self.parameters.value(parameter, declared.unit, f"{raw.name}.{name}")
                if array is None:
                    return None
                references[name] = parameter.name
            else:
                array = numeric(value, declared.unit, bare=name in raw.overrides)
            outside = bounds_problem(array, declared)
            if outside is not None:
                raise outside
        except ValueProblem as problem:
            report_value(self.problems, raw, name, problem)
            return None
        return array


def _expected(declared: Param) -> str:
    rank = len(declared.shape) if isinstance(declared.shape, tuple) else int(isinstance(declared.shape, int))
    kind = ("a number", "a list [...]", "a list of rows [[...], ...]")[min(rank, 2)]
    return kind if declared.unit in (None, "1") else f"{kind} in {declared.unit}"
