"""The file of a diagram as the page's only store: read, watched, edited by operations, written in canonical form."""

from __future__ import annotations

import hashlib
import json
from collections import OrderedDict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from time import sleep
from typing import Any

from rotorsim.diagram.diagram import Diagram
from rotorsim.diagram.parse.document import free_name
from rotorsim.diagram.parse.fmt import format_document
from rotorsim.diagram.parse.source import read_document
from rotorsim.diagram.resolve.registry import Registry, forget_user_blocks
from rotorsim.diagram.resolve.resolution import resolve
from rotorsim.errors import Place, Problem, RotorsimError
from rotorsim.files import write_atomically
from rotorsim.model.load import load
from rotorsim.serve.changes import NOTHING, Change, differences, with_changes
from rotorsim.serve.operations import Document, Editing, Operation, applied
from rotorsim.serve.view import cells_of

MOST_VERSIONS = 2000  # that are kept, so that an edit of an older one can be put into the present one
REBASED = (
    "rename",
    "patch",
    "add",
    "insert",
    "group",
    "dissolve",
)  # bring along what was changed in a block, or find by themselves what fits
TRUNCATED, TRUNCATED_READS = 0.02, 5  # s, and times that a file is read again whose content has vanished
CHANGED_MEANWHILE = "the file was changed while it was being written; nothing was written"


@dataclass(frozen=True)
class Edited:
    """An edit that was written: the hash of the file now, what takes the edit back, and what does it again.

    before: what stood in the file; made: files that are new.
    """

    sha: str
    undo: list[Operation]
    redo: list[Operation]
    before: bytes
    made: tuple[Path, ...] = ()


@dataclass(frozen=True, eq=False)
class State:
    """What stands in the file: hash of its bytes, its document where it is JSON, what is wrong with it.

    diagram: the last that could be drawn. valid: it is the one in the file. parts: the files that it names, when they
    were written and how large they are.
    """

    sha: str
    document: Document | None
    diagram: Diagram | None
    valid: bool
    problems: tuple[Problem, ...] = ()
    parts: tuple[tuple[str, int, int], ...] = ()


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
    _start: bytes | None = None  # what was there when it was opened

    def __post_init__(self) -> None:
        self.path = Path(self.path).resolve()
        self.state = State("", None, None, False)
        self._start = _bytes(self.path)
        self.refresh()

    def refresh(self) -> bool:
        """Read the file again where it, or one that it names, has changed; return whether one had."""
        content = _bytes(self.path)
        for _ in range(TRUNCATED_READS):
            if content != b"" or not self._content:
                break
            sleep(TRUNCATED)  # an editor that empties a file before it writes it has not written yet
            content = _bytes(self.path)
        if content == self._content and self.state.sha and self.state.parts == self._parts(self.state.document):
            return False
        self._content = content
        sha = _sha(content)
        try:
            document = read_document(self.path).data
        except RotorsimError as error:
            self.state = State(sha, None, self.state.diagram, False, self._named(error.problems))
            return True
        self._keep(sha, document)
        parts = self._parts(document)  # before they are read: what is saved meanwhile is seen the next time
        if parts != self.state.parts:
            forget_user_blocks()
        diagram, problems = self._read(str(self.path))
        known = self.state.diagram if diagram is None else diagram
        self.state = State(sha, document, known, diagram is not None, self._named(problems), parts)
        return True

    def _parts(self, document: Document | None) -> tuple[tuple[str, int, int], ...]:
        """Return what is known of the files that a document names, those of its sub-diagrams too."""
        found: dict[str, tuple[str, int, int]] = {}
        _stamp(document, self.path.parent, found)
        return tuple(found.values())

    def edit(self, base: str, operations: Sequence[Operation], *, mine: bool = False) -> Edited:
        """Make operations on the version with the hash ``base`` in the file as it is now, and write it.

        What others changed meanwhile stays. mine: what both sides changed is written over, as long as the file is the
        one with that hash: nobody has seen another. Raises ConflictError for that otherwise, and RotorsimError for what
        cannot be done, would leave a diagram that cannot be drawn, or a file whose own mistakes would be written over;
        nothing is written then.
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
        editing = replace(self._editing(), mine=mine and base == self.state.sha)
        if base == self.state.sha or all(operation.get("op") in REBASED for operation in operations):
            new = applied(now, operations, editing)
        else:
            new = with_changes(now, differences(old, applied(old, operations, editing)))
        undo, redo = differences(new, now), differences(now, new)
        before, made = self._content or b"", list[Path]()
        try:
            for name, document in editing.created.items():
                with self.path.with_name(name).open("x", encoding="utf-8") as stream:  # never over another file
                    made.append(self.path.with_name(name))
                    stream.write(format_document(document))
            self._check(new)
            self._write(new)
        except (OSError, RotorsimError) as error:
            for path in made:
                path.unlink(missing_ok=True)
            raise error if isinstance(error, RotorsimError) else RotorsimError(Problem(str(error), "edit")) from error
        return Edited(self.state.sha, _patches(undo), _patches(redo), before, tuple(made))

    def restore(self, edited: Edited) -> None:
        """Put back what stood in the file before an edit, where nobody has changed it since."""
        if self.state.sha == edited.sha and _sha(_bytes(self.path)) == edited.sha:
            write_atomically(self.path, edited.before)
            for path in edited.made:
                path.unlink(missing_ok=True)
        self.refresh()

    def _editing(self) -> Editing:
        diagram = self.state.diagram
        if diagram is None:
            return Editing(self.registry, {}, self.path.parent)
        recorded = [str(end) for end in diagram.record]
        return Editing(self.registry, cells_of(diagram), self.path.parent, recorded=recorded)

    @property
    def registry(self) -> Registry:
        """The block types that the diagram can use."""
        document = self.state.document or {}
        folders = document.get("block_folders", []) if self.trusted else []
        own = self.path.parent
        inside = [own / name for name in folders if isinstance(name, str) and _is_below(own / name, own)]
        return Registry(inside)

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
        if not self._backed_up and self._start is not None:
            stamp = datetime.now().strftime("%Y%m%d-%H%M%S")
            name = free_name(f"{self.path.name}.{stamp}", {file.stem for file in self.path.parent.glob("*.backup")})
            mode = self.path.stat().st_mode & 0o777
            write_atomically(self.path.with_name(f"{name}.backup"), self._start, mode=mode)
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


def _stamp(document: Any, folder: Path, found: dict[str, tuple[str, int, int]]) -> None:
    """Note when the files that blocks and block folders of a document name were written, and how large they are."""
    blocks = document.get("blocks") if isinstance(document, dict) else None
    entries = [one for one in blocks.values() if isinstance(one, dict)] if isinstance(blocks, dict) else []
    named = [one for one in entries if isinstance(one.get("file"), str)]
    files = [(folder / one["file"], one.get("type") == "diagram") for one in named]
    folders = document.get("block_folders", []) if isinstance(document, dict) else []
    for name in folders if isinstance(folders, list) else []:
        files += [(file, False) for file in _python_files(folder / str(name))]
    for file, is_diagram in files:
        if str(file) in found:
            continue
        try:
            known = file.stat()
        except (OSError, ValueError):
            found[str(file)] = str(file), 0, 0
            continue
        found[str(file)] = str(file), known.st_mtime_ns, known.st_size
        if is_diagram:
            try:
                _stamp(read_document(file).data, file.parent, found)
            except RotorsimError:  # its mistakes are said where it is resolved
                continue


def _python_files(folder: Path) -> list[Path]:
    try:
        return sorted(folder.glob("*.py"))
    except (OSError, ValueError):  # a name that is too long, or none
        return []


def _is_below(path: Path, folder: Path) -> bool:
    try:
        return path.resolve().is_relative_to(folder.resolve())
    except (OSError, RuntimeError, ValueError):
        return False


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
