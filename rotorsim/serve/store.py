"""The file of a diagram as the page's only store: read, watched, edited by operations, written in canonical form."""

from __future__ import annotations

import hashlib
import json
from collections import OrderedDict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import Any

from rotorsim.diagram.diagram import Diagram
from rotorsim.diagram.parse.fmt import format_document
from rotorsim.diagram.parse.source import read_document
from rotorsim.diagram.resolve.registry import Registry
from rotorsim.diagram.resolve.resolution import resolve
from rotorsim.errors import Place, Problem, RotorsimError
from rotorsim.files import write_atomically
from rotorsim.model.load import load
from rotorsim.serve.changes import NOTHING, Change, differences, with_changes
from rotorsim.serve.operations import Document, Editing, Operation, applied
from rotorsim.serve.view import cells_of

MOST_VERSIONS = 2000  # that are kept, so that an edit of an older one can be put into the present one
REBASED = ("rename", "patch")  # bring along what was changed in a block, or find out by themselves what fits
CHANGED_MEANWHILE = "the file was changed while it was being written; nothing was written"


@dataclass(frozen=True)
class Edited:
    """An edit that was written: the hash of the file now, what takes the edit back, and what does it again."""

    sha: str
    undo: list[Operation]
    redo: list[Operation]


@dataclass(frozen=True, eq=False)
class State:
    """What stands in the file: hash of its bytes, its document where it is JSON, what is wrong with it.

    diagram: the last that could be drawn. valid: it is the one in the file.
    """

    sha: str
    document: Document | None
    diagram: Diagram | None
    valid: bool
    problems: tuple[Problem, ...] = ()


@dataclass
class DiagramFile:
    """A diagram on disk. Nothing is kept but the last good picture, and the versions that were seen."""

    path: Path
    trusted: bool = False
    read_only: bool = False
    state: State = field(init=False)
    _versions: OrderedDict[str, Document] = field(default_factory=OrderedDict)
    _backed_up: bool = False
    _content: bytes | None = None

    def __post_init__(self) -> None:
        self.path = Path(self.path).resolve()
        self.state = State("", None, None, False)
        self.refresh()

    def refresh(self) -> bool:
        """Read the file again where it has changed; return whether it had."""
        content = _bytes(self.path)
        if content == self._content and self.state.sha:
            return False
        self._content = content
        sha = _sha(content)
        try:
            document = read_document(self.path).data
        except RotorsimError as error:
            self.state = State(sha, None, self.state.diagram, False, self._named(error.problems))
            return True
        self._keep(sha, document)
        diagram, problems = self._read(str(self.path))
        known = self.state.diagram if diagram is None else diagram
        self.state = State(sha, document, known, diagram is not None, self._named(problems))
        return True

    def edit(self, base: str, operations: Sequence[Operation], *, mine: bool = False) -> Edited:
        """Make operations on the version with the hash ``base`` in the file as it is now, and write it.

        What others changed meanwhile stays. mine: what both sides changed is written over. Raises ConflictError for
        that otherwise, and RotorsimError for what cannot be done, would leave a diagram that cannot be drawn, or a file
        whose own mistakes would be written over; nothing is written then.
        """
        if self.read_only:
            raise RotorsimError(Problem("nothing is written: --read-only", str(self.path.name)))
        self.refresh()
        if self.state.document is None or not self.state.valid:
            what = "the file on disk has mistakes, and nothing is written over them"
            raise RotorsimError(Problem(what, self.path.name, hint="correct them there"), *self.state.problems)
        now = self.state.document
        old = self._versions.get(base)
        if old is None:
            raise RotorsimError(Problem("the version that was edited is not known any more", hint="load the page anew"))
        editing = replace(self._editing(), mine=mine)
        if base == self.state.sha or all(operation.get("op") in REBASED for operation in operations):
            new = applied(now, operations, editing)
        else:
            new = with_changes(now, differences(old, applied(old, operations, editing)), mine=mine)
        self._check(new)
        undo, redo = differences(new, now), differences(now, new)
        self._write(new)
        return Edited(self.state.sha, _patches(undo), _patches(redo))

    def _editing(self) -> Editing:
        diagram = self.state.diagram
        return Editing(self.registry, {} if diagram is None else cells_of(diagram))

    @property
    def registry(self) -> Registry:
        """The block types that the diagram can use."""
        document = self.state.document or {}
        folders = document.get("block_folders", []) if self.trusted else []
        return Registry([self.path.parent / folder for folder in folders if isinstance(folder, str)])

    def _read(self, source: str | Mapping[str, Any]) -> tuple[Diagram | None, list[Problem]]:
        """Return a diagram that may be unfinished, None where it cannot be drawn; and what is wrong with it."""
        unfinished: list[Problem] = []
        try:
            diagram = resolve(source, trust_blocks=self.trusted, folder=self.path.parent, unfinished=unfinished)
        except RotorsimError as error:
            return None, [*error.problems]
        problems = [*unfinished, *diagram.warnings]
        if not unfinished:
            try:
                load(source, trust_blocks=self.trusted, folder=self.path.parent)
            except RotorsimError as error:  # equations, algebraic loops: it can be drawn all the same
                problems = list(dict.fromkeys([*error.problems, *problems]))
        return diagram, problems

    def _check(self, new: Document) -> None:
        """Raise RotorsimError for a document that could not be drawn, with what is wrong."""
        try:
            resolve(new, trust_blocks=self.trusted, folder=self.path.parent, unfinished=[])
        except RotorsimError as error:
            raise RotorsimError(*[p for p in error.problems if p.severity == "error"]) from None

    def _write(self, new: Document) -> None:
        text = format_document(new)
        if not self._backed_up and self._content is not None:
            stamp = datetime.now().strftime("%Y%m%d-%H%M%S")
            backup = self.path.with_name(f"{self.path.name}.{stamp}.backup")
            write_atomically(backup, self._content)
            self._backed_up = True
        if _bytes(self.path) != self._content:
            self.refresh()
            raise RotorsimError(Problem(CHANGED_MEANWHILE, self.path.name, hint="it is shown as it is now; try again"))
        write_atomically(self.path, text)
        self.refresh()

    def _keep(self, sha: str, document: Document) -> None:
        self._versions[sha] = document
        while len(self._versions) > MOST_VERSIONS:
            self._versions.popitem(last=False)

    def _named(self, problems: Iterable[Problem]) -> tuple[Problem, ...]:
        """Return problems whose places say the name of the file without its folders."""
        named = []
        for problem in problems:
            place = problem.place
            if place.file == str(self.path):
                problem = replace(problem, place=Place(self.path.name, place.line, place.column))
            named.append(problem)
        return tuple(named)


def _patches(changes: list[Change]) -> list[Operation]:
    return [{"op": "patch", "changes": [change.as_data() for change in changes]}]


def _bytes(path: Path) -> bytes | None:
    """Return what stands in a file, None where it cannot be read."""
    try:
        return path.read_bytes()
    except OSError:
        return None


def _sha(content: bytes | None) -> str:
    return "missing" if content is None else hashlib.sha256(content).hexdigest()


def data_of(value: Any) -> Any:
    """Return a value of a conflict for the page: as JSON is written, None for what is not there."""
    return None if value is NOTHING else value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
