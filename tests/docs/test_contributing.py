"""The map of CONTRIBUTING is true: every room has its line, what it may import is what the contracts say."""

from __future__ import annotations

import re
import tomllib
from itertools import pairwise

import pytest

from benchmarks.markers import table_text
from benchmarks.rooms import layers_of, rooms, table
from tests.docs.pages import ROOT, page_text

PAGE = "CONTRIBUTING.md"
PLACEHOLDERS = ("CATEGORY", "NAME", "my_block", "my_fault")


def stated() -> dict[str, str]:
    """Return what the page says of each room: name -> what it may import."""
    text = page_text(PAGE).partition("<!-- rooms -->")[2].partition("<!-- end -->")[0]
    lines = [line.strip("| ").split(" | ") for line in text.strip().splitlines()[2:]]
    return {name.strip("`"): imports for name, _, imports in lines}


def test_every_package_has_its_line_and_no_line_is_of_none() -> None:
    packages = {
        ".".join(file.parent.relative_to(ROOT).parts).removeprefix("rotorsim.")
        for folder in ("rotorsim", "blocks")
        for file in (ROOT / folder).rglob("__init__.py")
    } - {"rotorsim"}
    files = {file.stem for file in (ROOT / "rotorsim").glob("*.py")} - {"__init__", "__main__"}
    assert set(stated()) == packages | files


def test_the_map_is_current() -> None:
    text = page_text(PAGE)
    assert f"<!-- rooms -->\n{table()}\n<!-- end -->" in text, f"run: python -m benchmarks.rooms --page {PAGE}"


def test_a_room_may_import_the_layer_below_it() -> None:
    layers = layers_of("rotorsim")
    for above, below in pairwise(layers):
        for name in above:
            assert all(f"`{room}`" in stated()[name] for room in below), name
    assert "serve" in stated()["cli"]
    assert stated()["errors"] == "no other room"


def test_every_contract_of_layers_notices_a_module_that_it_does_not_list() -> None:
    contracts = tomllib.loads(page_text("pyproject.toml"))["tool"]["importlinter"]["contracts"]
    assert [c["name"] for c in contracts if c["type"] == "layers" and not c.get("exhaustive")] == []


def test_every_room_has_a_docstring_of_one_line() -> None:
    assert [room.name for room in rooms() if not 20 < len(room.holds) < 140] == []


@pytest.mark.parametrize("page", [PAGE, "docs/writing-a-block.md", "benchmarks/README.md"])
def test_paths_that_are_named_are_there(page: str) -> None:
    named = re.findall(r"`((?:rotorsim|blocks|tests|benchmarks|docs|diagrams)/[\w./]*)`", page_text(page))
    real = [name for name in named if not any(word in name for word in PLACEHOLDERS)]
    assert [name for name in real if not (ROOT / name).exists()] == []
    assert page != PAGE or len(real) > 20


def test_tables_have_a_cell_for_an_empty_text() -> None:
    assert table_text(["a", ""], [["1", "2"]]) == "| a | |\n|---|---|\n| 1 | 2 |"
