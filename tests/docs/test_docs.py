"""What the documents say is true: commands run, generated pages are current, examples work."""

from __future__ import annotations

import math
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from rotorsim.cli.block_pages import markdown_page
from rotorsim.diagram.registry import all_types
from rotorsim.diagram.schema import schema_text

ROOT = Path(__file__).parents[2]
PAGES = [
    "README.md",
    "docs/cosimulation.md",
    "docs/diagrams.md",
    "docs/identification.md",
    "docs/recordings.md",
    "docs/thesis.md",
]
FENCE = re.compile(r"^```(\w*)\n(.*?)^```", re.MULTILINE | re.DOTALL)


def blocks(page: str, language: str) -> list[str]:
    return [text for kind, text in FENCE.findall((ROOT / page).read_text(encoding="utf-8")) if kind == language]


def commands(page: str) -> str:
    """Return the shell lines of a page, less those that install."""
    lines = "".join(blocks(page, "sh")).splitlines()
    return "\n".join(line for line in lines if ".venv/bin" not in line)


def environment(tmp_path: Path) -> dict[str, str]:
    """Return an environment in which ``rotorsim`` is this Python's."""
    folder = tmp_path / "bin"
    folder.mkdir()
    script = folder / "rotorsim"
    script.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m rotorsim "$@"\n')
    script.chmod(0o755)
    return {**os.environ, "PATH": f"{folder}{os.pathsep}{os.environ['PATH']}", "PYTHONPATH": str(ROOT)}


@pytest.mark.skipif(sys.platform == "win32", reason="the documents show a POSIX shell")
@pytest.mark.parametrize("page", PAGES)
def test_every_command_runs(page: str, tmp_path: Path) -> None:
    work = tmp_path / "work"
    shutil.copytree(ROOT / "diagrams", work / "diagrams", ignore=shutil.ignore_patterns("__pycache__"))
    text = commands(page)
    options = {"cwd": work, "env": environment(tmp_path), "capture_output": True, "text": True}
    done = subprocess.run(["sh", "-ec", text], timeout=300, check=False, **options)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr


def test_the_readme_has_two_lines_to_start_with() -> None:
    run, test = (text.strip() for text in blocks("README.md", "sh")[:2])
    assert "\n" not in run + test
    assert run.endswith(".venv/bin/rotorsim run diagrams/jeffcott.json --plot jeffcott.png")
    assert test.endswith(".venv/bin/python -m pytest -n auto")
    assert all(line.startswith("python3 -m venv .venv && .venv/bin/pip install -q -e ") for line in (run, test))


def test_the_readme_python_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    monkeypatch.chdir(ROOT)
    [text] = blocks("README.md", "python")
    exec(compile(text, "README.md", "exec"), {})
    stop, peak = map(float, capsys.readouterr().out.split())
    assert stop == pytest.approx(5.0)
    assert 1e-6 < peak < 1e-4


@pytest.mark.parametrize("page", ["README.md", "CONTRIBUTING.md", "CHANGELOG.md", *sorted(
    str(file.relative_to(ROOT)) for file in (ROOT / "docs").glob("*.md"))])  # fmt: skip
def test_links_lead_somewhere(page: str) -> None:
    file = ROOT / page
    text = FENCE.sub("", file.read_text(encoding="utf-8"))
    targets = [t.split("#")[0] for t in re.findall(r"\]\(([^)\s]+)\)", text) if "://" not in t]
    assert [target for target in targets if target and not (file.parent / target).exists()] == []


def test_the_page_of_blocks_is_current() -> None:
    page = (ROOT / "docs/blocks.md").read_text(encoding="utf-8")
    assert page == markdown_page(all_types().values()), "run: rotorsim blocks --markdown > docs/blocks.md"


def test_the_schema_is_current() -> None:
    schema = (ROOT / "diagrams/diagram.schema.json").read_text(encoding="utf-8")
    assert schema == schema_text(), "run: rotorsim blocks --schema > diagrams/diagram.schema.json"


def test_the_example_block_runs_as_shown(tmp_path: Path) -> None:
    """Duffing's spring by hand: f = -(k + a |u|^2) u."""
    from rotorsim.diagram import load
    from rotorsim.simulate import simulate

    [text] = blocks("docs/writing-a-block.md", "python")
    assert len([line for line in text.splitlines() if line.strip()]) <= 15
    (tmp_path / "my_blocks").mkdir()
    (tmp_path / "my_blocks" / "hardening_spring.py").write_text(text)
    document = {
        "schema_version": 1,
        "name": "spring",
        "block_folders": ["my_blocks"],
        "blocks": {
            "place": {"type": "constant", "parameters": {"value": [3e-4, 4e-4]}},
            "spring": {"type": "hardening_spring", "parameters": {"stiffness": "2e5 N/m"}},
        },
        "wires": [["place.output", "spring.displacement"]],
        "solver": {"step": 0.1, "stop": 0.1},
        "record": ["spring.force"],
    }
    result = simulate(load(document, folder=tmp_path, trust_blocks=True))
    k = 2e5 + 1e13 * 25e-8
    assert result["spring.force"][0] == pytest.approx([-k * 3e-4, -k * 4e-4], rel=1e-12)
    assert math.isclose(k, 2.7e6)


def test_the_mistake_shown_is_what_check_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from click.testing import CliRunner

    from rotorsim.cli.app import rotorsim

    [expected] = blocks("docs/diagrams.md", "text")
    text = (ROOT / "diagrams/jeffcott.json").read_text()
    monkeypatch.chdir(tmp_path)
    Path("mine.json").write_text(text.replace('"clock.theta", "crack', '"clock.tehta", "crack'))
    assert CliRunner().invoke(rotorsim, ["check", "mine.json"]).stderr == f"{expected}\n1 mistake\n"
