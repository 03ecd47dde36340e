"""What the documents say is true: generated pages are current, examples work. Commands: test_pages."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest

from rotorsim.diagram.resolve.registry import all_types
from rotorsim.diagram.schema import schema_text
from rotorsim.report.text.blocks import markdown_page
from tests.docs.pages import FENCE, ROOT, blocks


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


@pytest.mark.parametrize(
    "page",
    [
        "README.md",
        "CONTRIBUTING.md",
        "CHANGELOG.md",
        *sorted(str(file.relative_to(ROOT)) for file in (ROOT / "docs").glob("*.md")),
    ],
)
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
    from rotorsim.model.load import load
    from rotorsim.simulation.run import simulate

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
