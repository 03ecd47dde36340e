"""The walkthrough is true: at most fifteen steps each, and every file and function that it names is there."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from tests.docs.pages import ROOT, page_text

PAGE = "docs/walkthrough.md"
MOST_STEPS = 15
LINK = re.compile(r"\[`([\w/]+\.py)`\]\(\.\./rotorsim/([\w/]+\.py)\)|`([A-Za-z_.]+)\(\)`")


def ways() -> dict[str, list[str]]:
    """Return the steps of each way through the code: command -> texts."""
    parts = re.split(r"^## `(.+)`$", page_text(PAGE), flags=re.MULTILINE)[1:]
    return {
        command: re.findall(r"^\d+\. (.*?)(?=^\d+\. |\Z)", text.strip() + "\n", re.MULTILINE | re.DOTALL)
        for command, text in zip(parts[::2], parts[1::2], strict=True)
    }


def defined(file: Path) -> set[str]:
    """Return the functions, classes and methods (Class.method) of a file."""
    names = set()
    for node in ast.parse(file.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
        if isinstance(node, ast.ClassDef):
            names |= {f"{node.name}.{item.name}" for item in node.body if isinstance(item, ast.FunctionDef)}
    return names


def test_there_are_two_ways_of_at_most_fifteen_steps() -> None:
    assert list(ways()) == ["rotorsim run jeffcott", "rotorsim diagnose jeffcott RECORDING"]
    assert all(5 < len(steps) <= MOST_STEPS for steps in ways().values())


@pytest.mark.parametrize("step", [f"{command}: {text}" for command, steps in ways().items() for text in steps])
def test_a_step_names_files_and_functions_that_are_there(step: str) -> None:
    wrong, file, named = [], None, 0
    for shown, path, function in LINK.findall(step):
        if path:
            file = ROOT / "rotorsim" / path
            wrong += [] if shown == path and file.is_file() else [path]
        elif file is None or not file.is_file() or function not in defined(file):
            wrong.append(f"{file and file.name}: {function}")
        named += bool(function)
    assert wrong == []
    assert named, "no function is named"
