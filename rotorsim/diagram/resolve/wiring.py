"""Second stage: the wires between blocks, what is wired twice, and what is not."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from rotorsim.diagram.diagram import Endpoint, Node, Wire
from rotorsim.diagram.parse.document import FlatDocument, RawWire
from rotorsim.diagram.resolve.draft import Draft
from rotorsim.diagram.resolve.template import Templates
from rotorsim.errors import Place, Problem, near_miss

MAX_WIRE_HINTS = 50
INPUT_OF_PART = "part"  # code of inputs that come from the diagram that this one is a part of
UNFINISHED = "unfinished"  # code of what is only missing yet: the rest of the diagram can be drawn


@dataclass
class Wiring:
    """The drafts of a document, with the wires between them; mistakes go to the problems of the document.

    removed: blocks taken out, broken: blocks that could not be read. cut: inputs that read zero without a wire, if only
    in parts, whose indices are in cut_parts. parts: wires of the inputs that are wired by parts.
    """

    flat: FlatDocument
    drafts: Mapping[str, Draft]
    removed: frozenset[str]
    wires: list[Wire] = field(default_factory=list)
    cut: set[tuple[str, str]] = field(default_factory=set)
    cut_parts: dict[tuple[str, str], list[tuple[int, ...]]] = field(default_factory=dict)
    parts: dict[tuple[str, str], list[RawWire]] = field(default_factory=dict)
    _hints: dict[str, str] = field(default_factory=dict)

    @cached_property
    def broken(self) -> set[str]:
        return self.flat.broken | (self.flat.blocks.keys() - self.drafts.keys() - self.removed)

    def connect(self, templates: Templates) -> None:
        """Check that both ends of every wire exist and that inputs have one wire; note which are wired."""
        first: dict[tuple[str, str], list[RawWire]] = {}
        for raw in self.flat.wires:
            ends = ((raw.source, False), (raw.target, True))
            blocks = {raw.source.block, raw.target.block}
            if blocks & self.removed:
                self._cut(raw.target)
            elif blocks & self.broken:
                for end, is_input in ends:
                    if end.block in self.drafts and self.exists(end, is_input, raw.end_place(is_input)):
                        self.drafts[end.block].wired.add(end.port)
            elif not self._is_backwards(raw):
                good_source, good_target = [self.exists(end, k, raw.end_place(k)) for end, k in ends]
                if good_target and self._take(raw, first, good_source) and good_source:
                    self.wires.append(Wire(raw.source, raw.target, raw.place))
        self.parts = {key: wires for key, wires in first.items() if any(wire.target.index for wire in wires)}
        for end, is_input, place in self.flat.port_ends:
            if end.block not in self.broken and end.block not in self.removed:
                self.exists(end, is_input, place)
        for name, draft in self.drafts.items():
            self._report_unwired(name, draft)
            inputs = draft.template.inputs
            told = frozenset(p for p in draft.wired if p in inputs and (inputs[p].optional or inputs[p].additive))
            if told:
                draft.template = templates.of(draft.cls, draft.options, told)

    def gaps(self, nodes: Mapping[str, Node]) -> list[Problem]:
        """Return the inputs that are wired by parts, and not by all of them."""
        found = []
        for (block, port), wires in self.parts.items():
            shape = nodes[block].inputs[port].shape
            wired = np.zeros(shape, bool)
            for index in (*(wire.target.index for wire in wires), *self.cut_parts.get((block, port), ())):
                wired[index] = True
            rows = [k + 1 for k in range(shape[0]) if not wired[k].all()]
            if rows:
                missing = ", ".join(f"{port}[{k}]" for k in rows)
                hint = f'add a wire to each, as ["block.output", "{block}.{port}[{rows[0]}]"]'
                found.append(
                    Problem(
                        f"input is wired by parts, but not {missing}",
                        f"{block}.{port}",
                        wires[0].place,
                        hint,
                        code=UNFINISHED,
                    )
                )
        return found

    def _cut(self, end: Endpoint) -> None:
        """Let an input, or a part of it, read zero whose wire has been taken out."""
        self.cut_parts.setdefault((end.block, end.port), []).append(end.index)
        inputs = self.drafts[end.block].template.inputs if end.block in self.drafts else {}
        if end.port in inputs and not inputs[end.port].additive and not inputs[end.port].optional:
            self.cut.add((end.block, end.port))

    def _is_backwards(self, raw: RawWire) -> bool:
        """Return whether a wire leads from an input to an output, which is said."""
        source, target = self.drafts.get(raw.source.block), self.drafts.get(raw.target.block)
        if source is None or target is None or raw.source.port in source.template.outputs:
            return False
        if raw.source.port not in source.template.inputs or raw.target.port not in target.template.outputs:
            return False
        self.flat.problems.error(
            f"the wire runs backwards: '{raw.source.port}' is an input and '{raw.target.port}' an output",
            f"{raw.source} -> {raw.target}",
            raw.place,
            f'write ["{raw.target}", "{raw.source}"]',
        )
        source.wired.add(raw.source.port)
        return True

    def exists(self, end: Endpoint, is_input: bool, place: Place) -> bool:
        """Return whether there is such a port; say so if there is none."""
        draft = self.drafts.get(end.block)
        if draft is None:
            self.flat.problems.error(f"no block '{end.block}'", str(end), place, self._block_hint(end.block))
            return False
        ports = draft.template.ports(is_input)
        if end.port in ports:
            return True
        kind, other = ("input", "an output") if is_input else ("output", "an input")
        what = f"block type '{draft.cls.type_name}' has no {kind} '{end.port}'"
        hint = near_miss(end.port, ports) if ports else f"it has no {kind}s"
        if ports and "ports" in draft.cls.options:
            hint += f'; "ports": {{"{end.port}": ...}} among its parameters gives its variables this name'
        if end.port in draft.template.ports(not is_input):
            what = f"'{end.port}' is {other}"
            hint = "wires run from an output to an input" + (f"; {kind}s: {', '.join(ports)}" if ports else "")
        elif not is_input and end.port in draft.cls.no_signals:
            what = f"'{end.port}' is {draft.cls.no_signals[end.port]}"
        self.flat.problems.error(what, str(end), place, hint)
        return False

    def _block_hint(self, name: str) -> str:
        """Return the near miss of a block; after many, none (each takes a look at every block)."""
        if name not in self._hints:
            known = [*self.drafts, *self.broken, *self.flat.sub_diagrams]
            few = len(self._hints) < MAX_WIRE_HINTS
            self._hints[name] = near_miss(name, known) if few and known else 'declare it under "blocks"'
        return self._hints[name]

    def _take(self, raw: RawWire, first: dict[tuple[str, str], list[RawWire]], counts: bool) -> bool:
        """Note that an input is wired; return whether it may be (a wire from nowhere does not count)."""
        draft, end = self.drafts[raw.target.block], raw.target
        draft.wired.add(end.port)
        if draft.template.inputs[end.port].additive:
            return True
        by_parts = draft.template.inputs[end.port].by_parts
        if end.index and not by_parts:
            self.flat.problems.error(
                "an input that takes one wire cannot be wired by parts",
                str(end),
                raw.end_place(1),
                "put the parts together with a mux block",
            )
            return False
        taken = first.setdefault((end.block, end.port), [])
        depth = len(end.index)
        before = next((one for one in taken if one.target.index[:depth] == end.index[: len(one.target.index)]), None)
        if before is not None:
            where = f" at {before.place}" if before.place.line else ""
            self.flat.problems.error(
                f"input is wired twice: from {before.source}{where}, and from {raw.source}",
                str(end),
                raw.place,
                "add the signals with a sum block, or remove one wire",
            )
            return False
        if counts:
            taken.append(raw)
        return True

    def _report_unwired(self, name: str, draft: Draft) -> None:
        for port, declared in draft.template.inputs.items():
            if port in draft.wired or declared.optional or declared.additive:
                continue
            if (name, port) in self.flat.exposed:
                hint = "a diagram that runs by itself wires all its inputs"
                what, place = "input reads zero unless this diagram is a part of another", self.flat.exposed[name, port]
                self.flat.problems.append(Problem(what, f"{name}.{port}", place, hint, "warning", INPUT_OF_PART))
                self.cut.add((name, port))
            elif (name, port) not in self.cut:
                candidate = self._candidate(name, port, declared.unit)
                hint = f'add the wire ["{candidate or "block.output"}", "{name}.{port}"]'
                if not candidate and declared.unit not in (None, "1"):
                    hint += f" from an output in {declared.unit}"
                place = draft.raw.place(key=True)
                self.flat.problems.append(Problem("input is not wired", f"{name}.{port}", place, hint, code=UNFINISHED))

    def _candidate(self, block: str, port: str, unit: str | None) -> str:
        """Return an output that would suit an input: one of the same unit, best of the same name; or none."""
        keys = ((unit, port), (unit, "")) if unit not in (None, "1") else ()
        fitting = (name for key in keys for name in self._carriers.get(key, ()))
        return next((name for name in fitting if not name.startswith(f"{block}.")), "")

    @cached_property
    def _carriers(self) -> dict[tuple[str | None, str], list[str]]:
        """The first outputs of every unit, of any name ("") and of every name."""
        carriers: dict[tuple[str | None, str], list[str]] = {}
        for name, draft in self.drafts.items():
            for output, declared in draft.template.outputs.items():
                for key in ((declared.unit, output), (declared.unit, "")):
                    names = carriers.setdefault(key, [])
                    if len(names) < 10:  # some may be of the block that looks for one
                        names.append(f"{name}.{output}")
        return carriers
