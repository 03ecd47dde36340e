"""Third stage: the shapes that fit blocks, values and wires, and whether units fit; then the finished blocks."""

from __future__ import annotations

from typing import Any

import numpy as np

from rotorsim.block import Block, Shape
from rotorsim.diagram.diagram import Endpoint, Node, Port, Wire
from rotorsim.diagram.resolve.draft import Draft
from rotorsim.diagram.resolve.drafts import report_value
from rotorsim.diagram.resolve.shapes import ShapeTerm, Unifier, text_of
from rotorsim.diagram.resolve.template import filled
from rotorsim.diagram.resolve.values import ValueProblem
from rotorsim.diagram.resolve.wiring import UNFINISHED, Wiring
from rotorsim.errors import Place, Problem
from rotorsim.units import UnitError, compatible


class Fitting:
    """Unifies the shapes of connected drafts. misfits: blocks whose defaults do not fit: their values mean nothing."""

    def __init__(self, wiring: Wiring) -> None:
        self.wiring, self.drafts, self.problems = wiring, wiring.drafts, wiring.flat.problems
        self.unifier = Unifier()
        self.misfits: set[str] = set()

    def fit(self) -> None:
        """Carry shapes along the wires to a fixed point; report ends that do not fit."""
        for draft in self.drafts.values():
            for name, value in draft.given.items():
                if value.ndim or draft.template.parameter_shapes[name] != ():
                    self._bind(draft, name, value, "")
        hooked = [d for d in self.drafts.values() if d.cls.output_shapes is not Block.output_shapes]
        waiting = self._carried(self.wiring.wires, hooked)
        for last_resort in (self._bind_defaults, self._bind_rest):
            for draft in self.drafts.values():
                last_resort(draft)
            waiting = self._carried(*waiting)

    def _carried(self, wires: list[Wire], drafts: list[Draft]) -> tuple[list[Wire], list[Draft]]:
        """Carry shapes along as far as they go; return the wires and drafts that wait for others."""
        while True:
            before = len(wires) + len(drafts)
            wires = [wire for wire in wires if not self._join(wire)]
            drafts = [draft for draft in drafts if not self._derive(draft)]
            if len(wires) + len(drafts) == before:
                return wires, drafts

    # --- shapes of values ---------------------------------------------------------------------------

    def _bind(self, draft: Draft, name: str, value: np.ndarray, origin: str) -> None:
        """Let a list fix the dimensions of its block, and say where it does not fit."""
        if value.ndim == 0:
            return
        term = self._parameter_term(draft, name)
        wanted = text_of(term, self.unifier)
        fits = value.ndim == len(term) if isinstance(term, tuple) else True
        if not fits or not self.unifier.unify(term, value.shape):
            report_value(
                self.problems,
                draft.raw,
                name,
                ValueProblem(
                    f"{origin}shape is {text_of(value.shape)}, expected {wanted}",
                    "write one number" if wanted == "scalar" else _list_hint(draft.cls.parameters[name].shape, term),
                ),
            )
            draft.given[name] = np.array(value.flat[0])

    def _parameter_term(self, draft: Draft, name: str) -> ShapeTerm:
        return draft.term(draft.template.parameter_shapes[name], self.unifier)

    def _bind_defaults(self, draft: Draft) -> None:
        """Let default lists fix what wires and given values left open."""
        defaults = draft.template.defaults if draft.template.words else {}
        for name in [name for name in defaults if name not in draft.given]:
            if self.unifier.resolved(self._parameter_term(draft, name)) is None:
                self._bind(draft, name, defaults[name], "default ")

    def _bind_rest(self, draft: Draft) -> None:
        """Take whole shapes that are still unknown as scalars, and dimensions of given scalars as 1."""
        words = [(key, variable) for key, variable in draft.variables.items() if not key.startswith("#")]
        for _, variable in words:
            if isinstance(self.unifier.shape(variable), int):
                self.unifier.unify(variable, ())
        for name in draft.given if draft.variables else ():
            term = self._parameter_term(draft, name)
            if isinstance(term, tuple) and self.unifier.resolved(term) is None:
                for dimension in term:
                    self.unifier.unify_dimension(dimension, 1)
        template = draft.template
        valued = {*draft.given, *template.defaults} >= draft.cls.parameters.keys()
        for key, variable in draft.variables.items():
            if key.startswith("#") and self.unifier.dimension(variable) < 0:
                self.unifier.unify_dimension(variable, 1)
                if valued:  # else a parameter that is missing or wrong would tell the size
                    shapes = {**template.input_shapes, **template.output_shapes, **template.parameter_shapes}
                    of = [n for n, s in shapes.items() if isinstance(s, tuple) and key[1:] in s]
                    self.problems.append(
                        Problem(
                            f"size '{key[1:]}' of {', '.join(of)} is not known",
                            draft.raw.name,
                            draft.raw.place(key=True),
                            "wire it, or give a parameter that has this size",
                            code=UNFINISHED,
                        )
                    )

    # --- shapes and units along wires ---------------------------------------------------------------

    def _term(self, end: Endpoint, is_input: bool) -> ShapeTerm:
        draft = self.drafts[end.block]
        return self.unifier.shape(draft.term(draft.template.port_shape(end.port, is_input), self.unifier))

    def _join(self, wire: Wire) -> bool:
        """Make the shapes of both ends equal; return False if a part is taken of a shape not known yet."""
        terms = []
        for end, is_input in ((wire.source, False), (wire.target, True)):
            term = self._term(end, is_input)
            if end.index:
                if isinstance(term, int):
                    return False
                if not self._is_inside(end, term, wire.place):
                    return True
                term = term[len(end.index) :]
            terms.append(term)
        before = [text_of(term, self.unifier) for term in terms] if terms[0] != terms[1] else []
        if not self.unifier.unify(terms[0], terms[1]):
            source = self._described(wire.source, False, before[0])
            target = self._described(wire.target, True, before[1])
            self.problems.error(
                f"shapes differ: {source}, but {target}",
                f"{wire.source} -> {wire.target}",
                wire.place,
                self._shape_cure(wire),
            )
        self._compare_units(wire)
        return True

    def _is_inside(self, end: Endpoint, term: tuple[int, ...], place: Place) -> bool:
        shape = text_of(term, self.unifier)
        if len(end.index) > len(term):
            self.problems.error(
                f"shape is {shape}: too many indices", str(end), place, "entries count from 1, one index a dimension"
            )
            return False
        for i, dimension in zip(end.index, term, strict=False):
            if 0 <= self.unifier.dimension(dimension) <= i:
                self.problems.error(
                    f"index {i + 1} is out of range", str(end), place, f"shape is {shape}, counted from 1"
                )
                return False
        return True

    def _described(self, end: Endpoint, is_input: bool, shape: str) -> str:
        unit = self.drafts[end.block].template.ports(is_input)[end.port].unit
        return f"{end}: {shape}" + ("" if unit in (None, "1") else f" [{unit}]")

    def _shape_cure(self, wire: Wire) -> str:
        source, target = self._numbers(wire.source, False), self._numbers(wire.target, True)
        additive = self.drafts[wire.target.block].template.inputs[wire.target.port].additive
        if source[: len(source) - len(target)] + target == source and not wire.source.index:
            ones = ",".join("1" for _ in source[len(target) :]) if not target else "1"
            return f'take a part: "{wire.source}[{ones}]" (counted from 1)'
        if additive and target[len(target) - len(source) :] == source and not wire.target.index:
            ones = ",".join("1" for _ in target[len(source) :])
            return f'name the part that it adds to: "{wire.target}[{ones}]" (counted from 1)'
        if not source:
            return "stack scalars to a vector with a mux block"
        if len(source) == len(target) == 1:
            return "take some entries with a selector block, or stack signals with a mux block"
        return "both ends must have one shape"

    def _numbers(self, end: Endpoint, is_input: bool) -> tuple[int, ...]:
        term = self._term(end, is_input)
        numbers = tuple(self.unifier.dimension(d) for d in term) if isinstance(term, tuple) else ()
        return numbers[len(end.index) :]

    def _compare_units(self, wire: Wire) -> None:
        outputs = self.drafts[wire.source.block].template.outputs
        source = outputs[wire.source.port].unit
        target = self.drafts[wire.target.block].template.inputs[wire.target.port].unit
        try:
            fit = compatible(source, target)
        except UnitError:
            return  # the block's declaration is at fault, and its own tests say so
        if fit == "same":
            return
        what = f"units differ: {wire.source} [{source}], but {wire.target} [{target}]"
        fitting = [name for name, declared in outputs.items() if declared.unit == target]
        hint = "convert it with a gain block"
        if fitting:
            hint = f"{wire.source.block}.{fitting[0]} is in {target}"
        elif fit == "different":
            hint = f"wire a signal in {target}, or convert it with a gain block"
        report = self.problems.warning if fit == "angle" else self.problems.error
        report(what, f"{wire.source} -> {wire.target}", wire.place, hint)

    def _derive(self, draft: Draft) -> bool:
        """Let a block find the shapes of its outputs from those of its inputs; return whether it could."""
        template, place = draft.template, draft.raw.place(key=True)
        inputs: dict[str, Shape] = {}
        for name, declared in template.input_shapes.items():
            is_cut = (draft.raw.name, name) in self.wiring.cut
            if name in draft.wired or is_cut:
                shape = self.unifier.resolved(draft.term(declared, self.unifier))
                if shape is None and not is_cut:
                    return False
                inputs[name] = shape or ()  # what is cut reads zero
        try:
            derived = dict(template.block.output_shapes(inputs))
        except Exception as error:  # the code of the block is foreign
            self.problems.error(
                f"block type '{draft.cls.type_name}' cannot tell its shapes: {type(error).__name__}: {error}",
                draft.raw.name,
                place,
                f"see `rotorsim blocks {draft.cls.type_name}`",
            )
            return True
        for name, shape in derived.items():
            if name not in template.output_shapes:
                continue
            term = draft.term(template.output_shapes[name], self.unifier)
            before = text_of(term, self.unifier)
            if not self.unifier.unify(term, shape):
                self.problems.error(
                    f"shapes differ: the block gives {text_of(shape)}, but what is wired to it takes {before}",
                    f"{draft.raw.name}.{name}",
                    place,
                    "change its options or the wire",
                )
        return True

    def is_signal(self, end: Endpoint, place: Place) -> bool:
        """Return whether a recorded signal exists and its index is inside; say what is wrong."""
        draft = self.drafts.get(end.block)
        declared = draft.template.inputs.get(end.port) if draft else None
        is_input = declared is not None and declared.additive
        if end.block in self.wiring.broken or not (is_input or self.wiring.exists(end, False, place)):
            return False
        term = self._term(end, is_input)
        return not end.index or (isinstance(term, tuple) and self._is_inside(end, term, place))

    # --- finished blocks ----------------------------------------------------------------------------

    def nodes(self) -> dict[str, Node]:
        """Return the finished blocks."""
        return {name: self._node(draft) for name, draft in self.drafts.items()}

    def _node(self, draft: Draft) -> Node:
        template, name = draft.template, draft.raw.name
        values: dict[str, np.ndarray] = {}
        for key, declared in template.parameter_shapes.items():
            if key in draft.given:
                values[key] = filled(draft.given[key], self._shape(draft, declared))
            elif key in template.fixed:
                values[key] = template.fixed[key]
            elif key in template.defaults:
                values[key] = self._default(draft, key, self._shape(draft, declared))
        inputs, outputs = (
            {n: Port(name, n, self._shape(draft, template.port_shape(n, k)), d.unit, d) for n, d in ports.items()}
            for k, ports in ((True, template.inputs), (False, template.outputs))
        )
        states, randoms = (
            {n: self._shape(draft, s) for n, s in shapes.items()}
            for shapes in (template.state_shapes, template.random_shapes)
        )
        place = draft.raw.place(key=True)
        return Node(name, template.block, values, draft.references, inputs, outputs, states, randoms, place)

    def _shape(self, draft: Draft, declared: ShapeTerm) -> Shape:
        if not draft.template.words and isinstance(declared, tuple):
            return declared
        return self.unifier.resolved(draft.term(declared, self.unifier)) or ()

    def _default(self, draft: Draft, name: str, shape: Shape) -> np.ndarray:
        value = draft.template.defaults[name]
        if value.ndim and value.shape != shape:
            self.problems.error(
                f"default of '{name}' has shape {text_of(value.shape)}, but {text_of(shape)} is needed here",
                draft.raw.name,
                draft.raw.place(key=True),
                f'give "{name}"',
            )
            self.misfits.add(draft.raw.name)
            return np.zeros(shape)
        return filled(value, shape)


def _list_hint(declared: Any, term: ShapeTerm) -> str:
    """Return how a list of this shape is written; the words of the declaration say what its rows are."""
    if not isinstance(term, tuple) or len(term) < 2:
        return "write a list [...]"
    words = f": [{', '.join(map(str, declared))}]" if isinstance(declared, tuple) else ""
    return f"write a list of rows [[...], ...]{words}"
