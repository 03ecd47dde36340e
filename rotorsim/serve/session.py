"""What one server serves: a diagram's file, its runs, and the pages that look at them."""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from rotorsim.diagram.diagram import Diagram, Port
from rotorsim.diagram.draw import draw_svg
from rotorsim.diagram.edit import fitting_types
from rotorsim.diagram.parse.document import endpoint
from rotorsim.diagram.parse.fmt import format_document
from rotorsim.diagram.parse.source import read_document
from rotorsim.diagram.resolve.registry import Registry
from rotorsim.diagram.resolve.resolution import shipped_diagrams
from rotorsim.diagram.resolve.values import ValueProblem, numeric, option_value
from rotorsim.diagram.resolve.wiring import INPUT_OF_PART
from rotorsim.diagram.sheet import sheet_of
from rotorsim.errors import Problem, RotorsimError, near_miss
from rotorsim.files import write_atomically
from rotorsim.model.load import load
from rotorsim.serve.beside import read_recording, recordings_below
from rotorsim.serve.changes import ConflictError
from rotorsim.serve.outcomes import Outcomes
from rotorsim.serve.runs import Runs, Source
from rotorsim.serve.store import DiagramFile, data_of
from rotorsim.serve.view import palette_of, parameters_of, problem_of_block, shape_text, view_of
from rotorsim.units import UnitError, compatible

Data = dict[str, Any]
MOST_ANSWERS = 200  # to edits, that are kept for pages whose connection broke before they heard


@dataclass
class Session:
    """A diagram that is open, or the gallery of shipped ones. folder: where copies go.

    part: the sub-diagram whose file it is, as "drive/controller", in the diagram of ``outer``.
    """

    folder: Path
    file: DiagramFile | None = None
    trusted: bool = False
    read_only: bool = False
    opened: set[str] = field(default_factory=set)  # sub-diagrams whose blocks are shown
    runs: Runs = field(default_factory=Runs)
    outcomes: Outcomes = field(default_factory=Outcomes)
    part: str = ""
    outer: Session | None = None
    answered: OrderedDict[str, Data] = field(default_factory=OrderedDict)  # edits by key: asked again, not made again
    _inner: dict[str, Session] = field(default_factory=dict)

    def inner(self, part: str) -> Session:
        """Return the session of a sub-diagram's file, "" for this one. Raises RotorsimError for what is none."""
        if not part:
            return self
        name, _, rest = part.partition("/")
        entry = (self._open().state.document or {}).get("blocks", {}).get(name)
        file = entry.get("file") if isinstance(entry, dict) and entry.get("type") == "diagram" else None
        if not isinstance(file, str) or name not in self._diagram().sub_ports:
            raise RotorsimError(Problem(f"no sub-diagram '{name}'", hint=near_miss(name, self._diagram().sub_ports)))
        path = (self._open().path.parent / file).resolve()
        if not self._open().state.valid or not path.is_relative_to(self.top._open().path.parent):
            what = "the file on disk has mistakes: its sub-diagrams are not entered"
            raise RotorsimError(Problem(what, name, hint="correct them there"))
        known = self._inner.get(name)
        if known is None or known._open().path != path:
            opened = DiagramFile(path, trusted=self.trusted, read_only=self.read_only)
            known = replace(self, file=opened, part=self._below(name), outer=self, opened=set(), _inner={})
            self._inner[name] = known
        return known.inner(rest)

    @property
    def top(self) -> Session:
        """The session of the diagram that is served."""
        return self if self.outer is None else self.outer.top

    def _below(self, name: str) -> str:
        return f"{self.part}/{name}" if self.part else name

    def refresh(self) -> bool:
        """Look at the file, and at those of its sub-diagrams that were entered; return whether one has changed."""
        changed = [one.refresh() for one in self._inner.values()]
        return (self.file is not None and self.file.refresh()) or any(changed)

    def state(self) -> Data:
        """Return what every page shows."""
        if self.file is None:
            return {"kind": "state", "file": None, "read_only": self.read_only}
        state = self.file.state
        names = [] if state.diagram is None else [*state.diagram.nodes, *state.diagram.sub_ports]
        return {
            "kind": "state",
            "file": self.file.path.name,
            "part": self.part,
            "folder": hashlib.sha256(bytes(self.file.path.parent)).hexdigest(),  # whether another is the same
            "top": self.top.file.path.name if self.top.file is not None else "",
            "sha": state.sha,
            "read_only": self.read_only,
            "valid": state.valid,
            "problems": [problem_of_block(problem, names) for problem in self._problems()],
            "view": None if state.diagram is None else view_of(state.diagram, self.opened),
            "parameters": self._parameters_of_runs(),
        }

    def _problems(self) -> list[Problem]:
        """Return what is wrong in the file; of a part not that its inputs come from outside."""
        problems = () if self.file is None else self.file.state.problems
        return [problem for problem in problems if self.outer is None or problem.code != INPUT_OF_PART]

    def _parameters_of_runs(self) -> list[Data]:
        whole = None if self.top.file is None else self.top.file.state.diagram
        return [] if whole is None else parameters_of(whole)

    def palette(self) -> Data:
        """Return all types of blocks."""
        registry = Registry() if self.file is None else self.file.registry
        return {"types": palette_of(registry.all_types())}

    def gallery(self) -> Data:
        """Return the diagrams that come with rotorsim."""
        found = []
        for name, path in shipped_diagrams().items():
            data = read_document(path).data
            found.append({"name": name, "description": str(data.get("description", ""))})
        return {"diagrams": found, "open": None if self.file is None else self.file.path.name}

    def picture(self) -> str:
        """Return the diagram as SVG, as `rotorsim draw` writes it. Raises RotorsimError without one."""
        return draw_svg(self._diagram())

    def recordings(self) -> Data:
        """Return the recordings below the folder of the diagram."""
        return {"recordings": [] if self.top.file is None else recordings_below(self.top.file.path.parent)}

    def copy(self, name: object) -> Data:
        """Copy a diagram that comes with rotorsim to the folder, under a name that is not taken, and open it."""
        shipped = shipped_diagrams()
        if self.read_only or self.file is not None:
            what = "nothing is written: --read-only" if self.read_only else "a diagram is open"
            raise RotorsimError(Problem(what, "copy"))
        if not isinstance(name, str) or name not in shipped:
            raise RotorsimError(Problem("no diagram of this name", str(name), hint=near_miss(str(name), shipped)))
        names = [f"{name}.json", *(f"{name}_{k}.json" for k in range(2, 1000))]
        path = next(self.folder / one for one in names if not (self.folder / one).exists())
        write_atomically(path, format_document({**read_document(shipped[name]).data, "name": path.stem}))
        self.file = DiagramFile(path, trusted=self.trusted)
        return {"file": path.name}

    # -- what a page asks for, by the kind of its message --------------------------------------------------------------

    def answer(self, message: Mapping[str, Any]) -> Data:
        """Return the answer to a message of a page, with its id. Mistakes are answers, too."""
        asked: dict[str, Callable[[Mapping[str, Any]], Data]] = {
            "edit": self._edit,
            "fits": self._fits,
            "part": self._part,
            "types": self._types,
            "value": self._value,
        }
        kind = message.get("kind")
        try:
            if kind not in asked:
                raise RotorsimError(Problem(f"unknown message '{kind}'", hint=near_miss(str(kind), asked)))
            found = asked[str(kind)](message)
        except ConflictError as error:
            conflicts = [
                {"what": one.name, "mine": data_of(one.mine), "theirs": data_of(one.theirs)} for one in error.conflicts
            ]
            found = {"kind": "conflict", "sha": self._open().state.sha, "conflicts": conflicts}
        except RotorsimError as error:
            found = self.refused(error)
        return {**found, "id": message.get("id")}

    def refused(self, error: RotorsimError) -> Data:
        """Return mistakes as a message for the page."""
        diagram = None if self.file is None else self.file.state.diagram
        names = [] if diagram is None else list(diagram.nodes)
        return {"kind": "refused", "problems": [problem_of_block(problem, names) for problem in error.problems]}

    def _open(self) -> DiagramFile:
        if self.file is None:
            raise RotorsimError(Problem("no diagram is open", hint="copy one of the gallery"))
        return self.file

    def _diagram(self) -> Diagram:
        diagram = self._open().state.diagram
        if diagram is None:
            raise RotorsimError(Problem("the diagram cannot be drawn", hint="correct its file"))
        return diagram

    def _edit(self, message: Mapping[str, Any]) -> Data:
        operations, base, key = message.get("operations"), message.get("base"), message.get("key")
        if isinstance(key, str) and key in self.answered:
            return self.answered[key]
        if not isinstance(operations, list) or not operations or not isinstance(base, str):
            raise RotorsimError(Problem("an edit has a base and operations", "edit"))
        if message.get("part", self.part) != self.part:
            what = f"it was made in '{message['part'] or self.top._open().path.name}', which is not shown any more"
            raise RotorsimError(Problem(what, "edit", hint="do it again there"))
        file = self._open()
        broken = self._broken_outside()
        edited = file.edit(base, operations, mine=message.get("mine") is True)
        if now := [problem for problem in self._broken_outside() if problem not in broken]:
            file.restore(edited)
            self._broken_outside()
            hint = "this sub-diagram would not fit there any more"
            raise RotorsimError(*(replace(problem, hint=hint) for problem in now))
        done = {"kind": "done", "sha": edited.sha, "undo": edited.undo, "redo": edited.redo}
        if isinstance(key, str):
            self.answered[key] = done
            while len(self.answered) > MOST_ANSWERS:
                self.answered.popitem(last=False)
        return done

    def _broken_outside(self) -> list[Problem]:
        """Return what is wrong in the diagrams that this one is a part of, where they cannot be drawn."""
        found: list[Problem] = []
        outer = self.outer
        while outer is not None and outer.file is not None:
            outer.file.refresh()
            found += [] if outer.file.state.valid else _errors(outer.file)
            outer = outer.outer
        return found

    def _types(self, message: Mapping[str, Any]) -> Data:
        file, block = self._open(), str(message.get("block"))
        document = file.state.document or {}
        entry = document.get("blocks", {}).get(block)
        if entry is None:
            raise RotorsimError(Problem(f"no block '{block}' in this file", block))
        found = [name for name in fitting_types(document, block, file.registry) if name != entry.get("type")]
        return {"kind": "types", "types": found}

    def _part(self, message: Mapping[str, Any]) -> Data:
        """Show the blocks of a sub-diagram, or one block for all of them, on every page."""
        name = str(message.get("block"))
        known = self._diagram().sub_ports
        if name not in known:
            raise RotorsimError(Problem(f"no sub-diagram '{name}'", hint=near_miss(name, known)))
        self.opened = {one for one in self.opened if one != name and not one.startswith(f"{name}/")}
        self.opened |= {name} if message.get("open") is True else set()
        return {"kind": "part"}

    def _value(self, message: Mapping[str, Any]) -> Data:
        """Return what is wrong with a value that is being typed."""
        diagram, name, value = self._diagram(), str(message.get("name")), message.get("value")
        block, _, key = name.rpartition(".")
        problem, hint = "", ""
        try:
            node = diagram.nodes.get(block)
            if isinstance(value, str) and value.startswith("$"):
                if value[1:] not in diagram.parameters:
                    raise ValueProblem(f"no diagram parameter '{value[1:]}'", near_miss(value[1:], diagram.parameters))
            elif node is not None and key in node.block.options:
                option_value(value, node.block.options[key])
            else:
                numeric(value, diagram.unit_of_parameter(f"{block}/{key}" if block in diagram.sub_ports else name))
        except ValueProblem as error:
            problem, hint = error.what, error.hint
        except UnitError as error:
            problem = str(error)
        return {"kind": "value", "problem": problem, "hint": hint}

    def _fits(self, message: Mapping[str, Any]) -> Data:
        """Return the other ends that a wire from or to a port may have, and why others may not."""
        sheet = sheet_of(self._diagram(), every_port=True, opened=self.opened)
        end = endpoint(message.get("port"))
        node = None if end is None or end.block not in sheet.boxes else sheet.boxes[end.block].node
        if end is None or node is None or end.port not in {**node.inputs, **node.outputs}:
            raise RotorsimError(Problem("no such port", str(message.get("port"))))
        outward = end.port in node.outputs
        own = node.outputs[end.port] if outward else node.inputs[end.port]
        taken = {(wire.target.block, wire.target.port) for wire in sheet.wires}
        found = []
        for other in sheet.boxes.values():
            for port in (other.node.inputs if outward else other.node.outputs).values():
                source, target = (own, port) if outward else (port, own)
                why = _misfit(source, target, (target.block, target.name) in taken)
                found.append({"port": str(port), "ok": not why, "why": why})
        return {"kind": "fits", "ports": found}

    # -- runs, in a worker thread --------------------------------------------------------------------------------------

    def work(self, message: Mapping[str, Any], progress: Callable[[float], None]) -> Data:
        """Return the result of a run or an analysis of the whole diagram. Raises RotorsimError."""
        file = self.top._open()
        state = file.state  # once: another thread looks at the file
        if not state.valid:
            raise RotorsimError(Problem("the file on disk has mistakes", hint="correct them there"), *_errors(file))
        settings = message.get("set") or {}
        if not isinstance(settings, Mapping):
            raise RotorsimError(Problem("'set' is an object of names and values", "run"))
        document, folder = state.document or {}, file.path.parent

        def loaded(parameters: Mapping[str, Any]) -> Diagram:
            return load(document, folder=folder, trust_blocks=self.trusted, set=parameters)

        source, kind = Source(f"{state.sha} {state.parts}", loaded), message.get("kind")
        name, run = message.get("recording"), message.get("run")
        recording = None if name is None else read_recording(folder, str(name))
        run = None if run is None else str(run)
        if kind == "analyse":
            return {
                "kind": "table",
                **self.runs.analyse(source, str(message.get("what")), settings, recording, progress),
            }
        if kind == "cosim":
            return {"kind": "result", **self.runs.cosimulated(source, settings, message, progress)}
        if recording is None:
            if kind == "measured":
                raise RotorsimError(Problem("it takes a recording", "measured"))
            return {"kind": "result", **self.runs.run(source, settings, progress)}
        if kind == "measured":
            return {"kind": "result", **self.runs.measured(source, recording, run)}
        return {"kind": "result", **self.runs.driven(source, settings, recording, run)}

    async def find(self, message: Mapping[str, Any], progress: Callable[[float, str], None]) -> Data:
        """Return what a verb finds in a recording, of the whole diagram. Raises RotorsimError."""
        file = self.top._open()
        state = file.state
        if not state.valid or state.document is None:
            raise RotorsimError(Problem("the file on disk has mistakes", hint="correct them there"), *_errors(file))
        verb, recording = str(message.get("verb")), str(message.get("recording"))
        found = await self.outcomes.find(file.path, state.document, verb, recording, self.trusted, progress)
        return {"kind": "found", "sha": state.sha, **found}


def _errors(file: DiagramFile) -> list[Problem]:
    return [problem for problem in file.state.problems if problem.severity == "error"]


def _misfit(source: Port, target: Port, taken: bool) -> str:
    """Return why an output does not fit an input, "" if it may: what shapes are left open the wiring decides."""
    if taken and not target.additive and not target.declaration.by_parts:  # type: ignore[union-attr]
        return "has a wire already"
    if compatible(source.unit, target.unit) in ("different", "angle"):
        return f"unit '{source.unit}' does not fit '{target.unit}'"
    fixed = all(isinstance(port.declaration.shape, tuple) for port in (source, target))
    numbers = fixed and all(isinstance(n, int) for port in (source, target) for n in port.declaration.shape)  # type: ignore[union-attr]
    if numbers and source.shape != target.shape:
        return f"shape {shape_text(source.shape)} does not fit {shape_text(target.shape)}"
    return ""
