"""Finding block classes: built-in files, entry points ``rotorsim.blocks``, and folders the user trusts.

A built-in block type is the name of its file (``blocks/controllers/pid.py`` defines type ``pid``), so that only the
files in use are imported. A file that cannot be imported is reported by name and breaks nothing else.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.metadata
import importlib.util
import re
import sys
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

from rotorsim.block import Block
from rotorsim.errors import Place, Problems, near_miss

_NAME = re.compile(r"[a-z][a-z0-9_]*")
_PACKAGE = "rotorsim.blocks"
_USER = "rotorsim_user_blocks"
_SHARED = "common"  # the folder of what several blocks share


class Registry:
    """The block types that one diagram can use.

    folders: user folders with block files; they are executed, so pass only what the user trusts.
    problems: what could not be imported so far (warnings).
    """

    def __init__(self, folders: Iterable[str | Path] = ()) -> None:
        self.folders = tuple(Path(folder) for folder in folders)
        self.problems = Problems()
        self._known: dict[str, type[Block]] = {}
        self._tried: set[str] = set()
        self._scanned = False

    def find(self, type_name: str) -> type[Block] | None:
        """Return the block class of a type, or None if there is none (see `problems`, `hint`)."""
        if type_name not in self._known and _NAME.fullmatch(type_name):
            self._import_built_in(type_name)
            for scan in (self._scan_folders, self._scan):
                if type_name not in self._known:
                    scan()
        return self._known.get(type_name)

    def all_types(self) -> dict[str, type[Block]]:
        """Return every block class by type name, sorted."""
        self._scan_folders()
        self._scan()
        return dict(sorted(self._known.items()))

    def hint(self, type_name: str) -> str:
        """Return the near misses of an unknown type."""
        if any(problem.subject.rsplit(".", 1)[-1] == type_name for problem in self.problems):
            return "its block file cannot be used; see the warning"
        return near_miss(type_name, [*self.all_types(), "diagram"])

    def _import_built_in(self, stem: str) -> None:
        module = _built_in().get(stem)
        if module is not None and module not in self._tried:
            self._tried.add(module)
            self._collect(module, lambda: importlib.import_module(module))

    def _scan(self) -> None:
        if self._scanned:
            return
        self._scanned = True
        for stem in _built_in():
            self._import_built_in(stem)
        for entry in importlib.metadata.entry_points(group=_PACKAGE):
            self._collect(f"entry point {entry.name}", entry.load)

    def _scan_folders(self) -> None:
        for folder in self.folders:
            if str(folder) in self._tried:
                continue
            self._tried.add(str(folder))
            if not folder.is_dir():
                self.problems.warning("block folder does not exist", str(folder), Place(str(folder)))
                continue
            for file in sorted(folder.glob("*.py")):
                if not file.name.startswith("_"):
                    self._collect(file.stem, lambda file=file: _import_file(file), Place(str(file)))

    def _collect(self, subject: str, load: Any, place: Place | None = None) -> None:
        try:
            loaded = load()
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # a foreign file may raise anything, also SystemExit
            text = str(error).strip().split("\n")[0]
            self.problems.warning(f"block file cannot be used: {type(error).__name__}: {text}", subject, place)
            return
        for block in _classes(loaded):
            other = self._known.setdefault(block.type_name, block)
            if other is not block:
                what = f"type '{block.type_name}' is defined again; the one in {other.__module__} is used"
                self.problems.warning(what, subject, place)


def is_built_in(block_type: type[Block]) -> bool:
    """Return whether a block type comes with rotorsim, so that every process knows it."""
    return block_type.__module__ in _built_in().values()


@cache
def _built_in() -> dict[str, str]:
    """Return type name -> module of the block files in the folders of all categories, and in theirs."""
    found = {}
    for root in map(Path, importlib.import_module(_PACKAGE).__path__):
        for file in sorted(root.glob("*/**/[a-z]*.py")):
            inside = file.relative_to(root).with_suffix("").parts
            if inside[0] != _SHARED:
                found[file.stem] = ".".join((_PACKAGE, *inside))
    return found


def _classes(loaded: Any) -> list[type[Block]]:
    values = list(vars(loaded).values()) if isinstance(loaded, ModuleType) else [loaded]
    blocks = [v for v in values if isinstance(v, type) and issubclass(v, Block) and v is not Block]
    return [v for v in blocks if v.__module__ == loaded.__name__] if isinstance(loaded, ModuleType) else blocks


def forget_user_blocks() -> None:
    """Forget the block files of users, so that they are read again where they have changed."""
    for name in [name for name in sys.modules if name.startswith(f"{_USER}.")]:
        del sys.modules[name]


def _import_file(file: Path) -> ModuleType:
    # a name of its own: two folders may hold files of the same name
    name = f"{_USER}.{file.stem}_{hashlib.sha256(str(file.resolve()).encode()).hexdigest()[:12]}"
    if name in sys.modules:
        return sys.modules[name]
    spec = importlib.util.spec_from_file_location(name, file)
    if spec is None or spec.loader is None:
        raise ImportError("not a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module


_BUILT_IN = Registry()


find = _BUILT_IN.find  # of built-in and installed types
all_types = _BUILT_IN.all_types
