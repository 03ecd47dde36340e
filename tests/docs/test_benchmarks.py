"""The commands of benchmarks/ are those that its page and the other documents name, and their modules import."""

from __future__ import annotations

import importlib
import importlib.util
import re

import pytest

from tests.docs.pages import ROOT

FOLDER = ROOT / "benchmarks"
FILES = sorted(file for file in FOLDER.rglob("*.py") if "sources" not in file.parts and file.name != "peer_models.py")
NAMED = re.compile(r"python -m (benchmarks(?:\.\w+)+)")


def module(file) -> str:
    parts = file.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] in ("__init__", "__main__") else parts)


@pytest.mark.parametrize("name", sorted({module(file) for file in FILES}))
def test_modules_import(name: str) -> None:
    importlib.import_module(name)


def test_the_page_names_every_command() -> None:
    commands = {module(file) for file in FILES if '__name__ == "__main__"' in file.read_text(encoding="utf-8")}
    assert set(NAMED.findall((FOLDER / "README.md").read_text(encoding="utf-8"))) == commands


def test_commands_that_texts_name_are_there() -> None:
    texts = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")]
    texts += [file for folder in ("docs", "benchmarks", "rotorsim") for file in (ROOT / folder).rglob("*.md")]
    texts += [file for folder in ("rotorsim", "benchmarks") for file in (ROOT / folder).rglob("*.py")]
    named = {name for file in texts for name in NAMED.findall(file.read_text(encoding="utf-8"))}
    assert len(named) > 15
    assert sorted(name for name in named if importlib.util.find_spec(name) is None) == []
