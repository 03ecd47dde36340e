"""Check wires and find the shapes that they carry from block to block."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any

from rotorsim.block import Block, Shape
from rotorsim.diagram.diagram import Endpoint, Wire
from rotorsim.diagram.parse.document import FlatDocument, RawWire
from rotorsim.diagram.resolve.build import Builder
from rotorsim.diagram.resolve.shapes import ShapeTerm, text_of
from rotorsim.diagram.resolve.template import Work
from rotorsim.errors import Place, Problem, near_miss
from rotorsim.units import UnitError, compatible

__all__ = ["Wiring"]

MAX_HINTS = 50


class Wiring:
    """Connects works along wires; mistakes go to the problems of the builder."""

    def __init__(
        self, flat: FlatDocument, builder: Builder, works: Mapping[str, Work], removed: frozenset[str]
    ) -> None:
        self.flat, self.builder, self.works, self.removed = flat, builder, works, removed
        self.problems = flat.problems
        self.wires: list[Wire] = []
        self.first: dict[tuple[str, str], tuple[Endpoint, Place]] = {}
        self.cut: set[tuple[str, str]] = set()
        self.hints: dict[str, str] = {}
        self.broken = flat.broken | {name for name in flat.blocks if name not in works and name not in removed}

    def error(self, what: str, place: Place, subject: str, hint: str = "") -> None:
        self.problems.append(Problem(what, subject=subject, place=place, hint=hint))

    def connect(self) -> None:
        """Check that both ends of every wire exist, that inputs have one wire, and note which are wired."""
        for raw in self.flat.wires:
            ends = raw.source, raw.target
            if any(end.block in self.removed for end in ends):
                self._cut(raw)
                continue
            if any(end.block in self.broken for end in ends):
                for k, end in enumerate(ends):
                    if end.block in self.works and self._exists(end, k == 1, raw.end_place(k)):
                        self.works[end.block].wired.add(end.port)
                continue
            if self._backwards(raw):
                continue
            good_source = self._exists(raw.source, False, raw.end_place(0))
            good_target = self._exists(raw.target, True, raw.end_place(1))
            if good_target and self._take(raw, good_source) and good_source:
                self.wires.append(Wire(raw.source, raw.target, raw.place))
        for end, is_input, place in self.flat.port_ends:
            if end.block not in self.broken and end.block not in self.removed:
                self._exists(end, is_input, place)
        for name, work in self.works.items():
            self._unwired(name, work)
            optional = frozenset(
                p for p in work.wired if p in work.template.inputs and work.template.inputs[p].optional
            )
            if optional:
                work.template = self.builder.template(work.cls, work.options, work.key, optional)

    def _cut(self, raw: RawWire) -> None:
        work = self.works.get(raw.target.block)
        if work is None or raw.target.port not in work.template.inputs:
            return
        declared = work.template.inputs[raw.target.port]
        if not declared.additive and not declared.optional:
            self.cut.add((raw.target.block, raw.target.port))

    def _backwards(self, raw: RawWire) -> bool:
        source, target = self.works.get(raw.source.block), self.works.get(raw.target.block)
        if source is None or target is None or raw.source.port in source.template.outputs:
            return False
        if raw.source.port not in source.template.inputs or raw.target.port not in target.template.outputs:
            return False
        what = f"the wire runs backwards: '{raw.source.port}' is an input and '{raw.target.port}' an output"
        hint = f'write ["{raw.target}", "{raw.source}"]'
        self.error(what, raw.place, f"{raw.source} -> {raw.target}", hint)
        source.wired.add(raw.source.port)
        return True

    def _exists(self, end: Endpoint, is_input: bool, place: Place) -> bool:
        work = self.works.get(end.block)
        if work is None:
            self.error(f"no block '{end.block}'", place, str(end), self._known_block(end.block))
            return False
        template = work.template
        ports: Mapping[str, Any] = template.inputs if is_input else template.outputs
        if end.port in ports:
            return True
        kind, other, others = (
            ("input", template.outputs, "an output") if is_input else ("output", template.inputs, "an input")
        )
        if end.port in other:
            hint = "wires run from an output to an input" + (f"; {kind}s: {', '.join(ports)}" if ports else "")
            self.error(f"'{end.port}' is {others}", place, str(end), hint)
            return False
        what = f"block type '{work.cls.type_name}' has no {kind} '{end.port}'"
        if not is_input and end.port in work.cls.no_signals:
            what = f"'{end.port}' is {work.cls.no_signals[end.port]}"
        self.error(what, place, str(end), near_miss(end.port, ports) if ports else f"it has no {kind}s")
        return False

    def _known_block(self, name: str) -> str:
        """Return the near miss of a block; after many, none (each takes a look at every block)."""
        if name not in self.hints:
            known = [*self.works, *self.broken, *self.flat.sub_diagrams]
            few = len(self.hints) < MAX_HINTS
            self.hints[name] = near_miss(name, known) if few and known else 'declare it under "blocks"'
        return self.hints[name]

    def _take(self, raw: RawWire, counts: bool) -> bool:
        """Note that an input is wired; return whether it may be (a wire from nowhere does not count)."""
        work = self.works[raw.target.block]
        key = raw.target.block, raw.target.port
        work.wired.add(raw.target.port)
        if work.template.inputs[raw.target.port].additive:
            return True
        if raw.target.index:
            what = "an input that takes one wire cannot be wired by parts"
            self.error(what, raw.end_place(1), str(raw.target), "put the parts together with a mux block")
            return False
        if key in self.first:
            source, place = self.first[key]
            where = f" at {place}" if place.line else ""
            what = f"input is wired twice: from {source}{where}, and from {raw.source}"
            self.error(what, raw.place, str(raw.target), "add the signals with a sum block, or remove one wire")
            return False
        if counts:
            self.first[key] = (raw.source, raw.place)
        return True

    def _unwired(self, name: str, work: Work) -> None:
        for port in work.template.needed_inputs:
            if port in work.wired:
                continue
            if (name, port) in self.flat.exposed:
                what = "input reads zero unless this diagram is a part of another"
                place = self.flat.exposed[name, port]
                hint = "a diagram that runs by itself wires all its inputs"
                self.problems.append(Problem(what, f"{name}.{port}", place, hint, "warning"))
                self.cut.add((name, port))
            elif (name, port) not in self.cut:
                unit = work.template.inputs[port].unit
                found = self._candidate(work, port)
                hint = f'add the wire ["{found or "block.output"}", "{name}.{port}"]'
                if not found and unit not in (None, "1"):
                    hint += f" from an output in {unit}"
                self.error("input is not wired", work.raw.place(key=True), f"{name}.{port}", hint)

    def _candidate(self, work: Work, port: str) -> str:
        """Return an output that would suit an input: one of the same unit, best of the same name; or none."""
        unit = work.template.inputs[port].unit
        if unit in (None, "1"):
            return ""
        own = f"{work.raw.name}."
        fitting = (name for key in ((unit, port), (unit, "")) for name in self.carriers.get(key, ()))
        return next((name for name in fitting if not name.startswith(own)), "")

    @cached_property
    def carriers(self) -> dict[tuple[str | None, str], list[str]]:
        """The first outputs of every unit, of any name ("") and of every name."""
        found: dict[tuple[str | None, str], list[str]] = {}
        for name, work in self.works.items():
            for output, declared in work.template.outputs.items():
                for key in ((declared.unit, output), (declared.unit, "")):
                    names = found.setdefault(key, [])
                    if len(names) < 10:  # some may be of the block that looks for one
                        names.append(f"{name}.{output}")
        return found

    # --- shapes and units ---------------------------------------------------------------------------

    def unify(self) -> None:
        """Carry shapes along the wires to a fixed point; report ends that do not fit."""
        self.builder.bind_given(self.works.values())
        waiting = [wire for wire in self.wires if not self._join(wire)]
        hooked = [w for w in self.works.values() if w.cls.output_shapes is not Block.output_shapes]
        for last_resort in (None, self.builder.bind_defaults, self.builder.bind_rest):
            if last_resort is not None:
                last_resort(self.works.values())
            progress = True
            while progress:
                before = len(waiting), len(hooked)
                hooked = [work for work in hooked if not self._derive(work)]
                waiting = [wire for wire in waiting if not self._join(wire)]
                progress = (len(waiting), len(hooked)) != before

    def _term(self, end: Endpoint, is_input: bool) -> ShapeTerm:
        work = self.works[end.block]
        shapes = work.template.input_shapes if is_input else work.template.output_shapes
        return self.builder.unifier.shape(work.term(shapes[end.port], self.builder.unifier))

    def _join(self, wire: Wire) -> bool:
        """Make the shapes of both ends equal; return False if a part is taken of a shape not known yet."""
        unifier = self.builder.unifier
        terms = []
        for end, is_input in ((wire.source, False), (wire.target, True)):
            term = self._term(end, is_input)
            if end.index:
                if isinstance(term, int):
                    return False
                if not self._inside(end, term, wire.place):
                    return True
                term = term[len(end.index) :]
            terms.append(term)
        before = [text_of(term, unifier) for term in terms] if terms[0] != terms[1] else []
        if not unifier.unify(terms[0], terms[1]):
            self._misfit(wire, before)
        self._units(wire)
        return True

    def _inside(self, end: Endpoint, term: tuple[int, ...], place: Place) -> bool:
        shape = text_of(term, self.builder.unifier)
        if len(end.index) > len(term):
            self.error(
                f"shape is {shape}: too many indices", place, str(end), "entries count from 1, one index a dimension"
            )
            return False
        for i, dimension in zip(end.index, term, strict=False):
            n = self.builder.unifier.dimension(dimension)
            if 0 <= n <= i:
                self.error(f"index {i + 1} is out of range", place, str(end), f"shape is {shape}, counted from 1")
                return False
        return True

    def _describe(self, end: Endpoint, is_input: bool, shape: str) -> str:
        template = self.works[end.block].template
        declared = (template.inputs if is_input else template.outputs)[end.port]
        unit = "" if declared.unit in (None, "1") else f" [{declared.unit}]"
        return f"{end}: {shape}{unit}"

    def _misfit(self, wire: Wire, shapes: list[str]) -> None:
        ends = self._describe(wire.source, False, shapes[0]), self._describe(wire.target, True, shapes[1])
        hint = self._shape_cure(wire)
        self.error(f"shapes differ: {ends[0]}, but {ends[1]}", wire.place, f"{wire.source} -> {wire.target}", hint)

    def _shape_cure(self, wire: Wire) -> str:
        source, target = (self._numbers(wire.source, False), self._numbers(wire.target, True))
        additive = self.works[wire.target.block].template.inputs[wire.target.port].additive
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
        numbers = tuple(self.builder.unifier.dimension(d) for d in term) if isinstance(term, tuple) else ()
        return numbers[len(end.index) :]

    def _units(self, wire: Wire) -> None:
        outputs = self.works[wire.source.block].template.outputs
        source = outputs[wire.source.port].unit
        target = self.works[wire.target.block].template.inputs[wire.target.port].unit
        if source is None or target is None or source == target:
            return
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
        severity = "warning" if fit == "angle" else "error"
        subject = f"{wire.source} -> {wire.target}"
        self.problems.append(Problem(what, subject, wire.place, hint, severity))

    def _derive(self, work: Work) -> bool:
        """Let a block find the shapes of its outputs from those of its inputs; return whether it could."""
        template, unifier = work.template, self.builder.unifier
        inputs: dict[str, Shape] = {}
        for name in template.inputs:
            is_cut = (work.raw.name, name) in self.cut
            if name in work.wired or is_cut:
                shape = unifier.resolved(work.term(template.input_shapes[name], unifier))
                if shape is None and is_cut:
                    shape = ()  # it reads zero
                if shape is None:
                    return False
                inputs[name] = shape
        place = work.raw.place(key=True)
        try:
            derived = dict(template.block.output_shapes(inputs))
        except Exception as error:  # the code of the block is foreign
            what = f"block type '{work.cls.type_name}' cannot tell its shapes: {type(error).__name__}: {error}"
            self.error(what, place, work.raw.name, f"see `rotorsim blocks {work.cls.type_name}`")
            return True
        for name, shape in derived.items():
            if name in template.output_shapes:
                term = work.term(template.output_shapes[name], unifier)
                before = text_of(term, unifier)
                if not unifier.unify(term, shape):
                    what = f"shapes differ: the block gives {text_of(shape)}, but what is wired to it takes {before}"
                    self.error(what, place, f"{work.raw.name}.{name}", "change its options or the wire")
        return True

    def part_shape(self, end: Endpoint, place: Place) -> bool:
        """Check a recorded signal: it exists and its index is inside."""
        if end.block in self.broken:
            return False
        work = self.works.get(end.block)
        if work is not None and end.port in work.template.inputs and work.template.inputs[end.port].additive:
            term = self._term(end, True)
        elif self._exists(end, False, place):
            term = self._term(end, False)
        else:
            return False
        return not end.index or (isinstance(term, tuple) and self._inside(end, term, place))
