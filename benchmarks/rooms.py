"""The map of the rooms: python -m benchmarks.rooms [--page CONTRIBUTING.md].

A room is a package of rotorsim or of blocks; what it holds is its docstring, what it may import is said by the
contracts of import-linter in pyproject.toml.
"""

from __future__ import annotations

import argparse
import ast
import re
import tomllib
from dataclasses import dataclass
from pathlib import Path

from benchmarks.harness import ROOT
from benchmarks.markers import expect, fill, table_text

__all__ = ["Room", "layers_of", "rooms", "table"]

BLOCKS = "blocks"
MARKER = "rooms"


@dataclass(frozen=True)
class Room:
    """A package (or a file at the top of rotorsim), what it holds, and what it may import."""

    name: str
    holds: str
    imports: str


def layers_of(container: str) -> list[list[str]]:
    """Return the layers of a package by its contract, the highest first; [] without a contract.

    A layer is a list of rooms that do not import one another. Names are relative to the package.
    """
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"][
        "contracts"
    ]
    for contract in contracts:
        if contract["type"] == "layers" and container in contract["containers"]:
            return [[name.strip().strip("()") for name in re.split(r"[|:]", layer)] for layer in contract["layers"]]
    return []


def rooms() -> list[Room]:
    """Return all rooms, the highest first, each followed by the rooms inside it."""
    found = []
    for layer in layers_of("rotorsim"):
        for name in layer:
            found += _inside(name, "rotorsim") if name != BLOCKS else _block_folders()
    return found


def _inside(name: str, container: str) -> list[Room]:
    """Return a room of a package and the rooms in it."""
    folder = ROOT / container.replace(".", "/") / name
    is_package = (folder / "__init__.py").is_file()
    path = f"{container}.{name}".removeprefix("rotorsim.")
    room = Room(
        path, _docstring(folder / "__init__.py" if is_package else folder.with_suffix(".py")), _allowed(name, container)
    )
    if not is_package:
        return [room]
    order = [inner for layer in layers_of(f"{container}.{name}") for inner in layer]
    packages = sorted(
        (file.parent.name for file in folder.glob("*/__init__.py")),
        key=lambda inner: (order.index(inner) if inner in order else len(order), inner),
    )
    return [room, *(item for inner in packages for item in _inside(inner, f"{container}.{name}"))]


def _block_folders() -> list[Room]:
    folders = sorted(file.parent for file in (ROOT / BLOCKS).glob("*/**/__init__.py"))
    common = f"as `{BLOCKS}`, and `{BLOCKS}.common`"
    top = Room(BLOCKS, _docstring(ROOT / BLOCKS / "__init__.py"), _allowed(BLOCKS, "rotorsim"))
    return [top] + [
        Room(
            ".".join((BLOCKS, *folder.relative_to(ROOT / BLOCKS).parts)),
            _docstring(folder / "__init__.py"),
            f"as `{BLOCKS}`" if folder.name == "common" else common,
        )
        for folder in folders
    ]


def _allowed(name: str, container: str) -> str:
    """Return in words what a room may import: of its own package, and below that package."""
    layers = layers_of(container)
    level = next((k for k, layer in enumerate(layers) if name in layer), None)
    inner = container.removeprefix("rotorsim").lstrip(".")
    outside = f"what `{inner}` may" if inner else ""
    if level is None:
        return outside or "anything"
    below = layers[level + 1] if level + 1 < len(layers) else []
    if not below:
        return outside or "no other room"
    names = " ".join(f"`{item}`" for item in below)
    within = f"{names} and below" if level + 2 < len(layers) else names
    return f"in `{inner}`: {within}" if inner else within


def _docstring(file: Path) -> str:
    text = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or ""
    return text.splitlines()[0].rstrip(".")


def table() -> str:
    """Return the map as a table."""
    return table_text(["room", "holds", "may import"], [[f"`{r.name}`", r.holds, r.imports] for r in rooms()])


def main(arguments: list[str] | None = None) -> None:
    """Print the map, or put it between its markers in a page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.rooms", description=__doc__.splitlines()[0])
    parser.add_argument("--page", type=Path, help=f"page with <!-- {MARKER} --> and <!-- end -->")
    page = parser.parse_args(arguments).page
    expect(page, MARKER)
    print(table())
    if page:
        fill(page, MARKER, table())


if __name__ == "__main__":
    main()
