"""The page with the figures of the thesis shows each, and its command draws them."""

from __future__ import annotations

import re

import pytest

from benchmarks.thesis.__main__ import main
from benchmarks.thesis.figures import FIGURES
from tests.docs.pages import ROOT, page_text

PAGE = "docs/thesis_figures.md"
LARGEST = 60_000  # bytes of a picture


def test_the_page_has_a_picture_and_a_caption_for_each_figure() -> None:
    text = page_text(PAGE)
    assert re.findall(r"!\[Figure ([\d-]+)\]\(images/thesis/figure-\1\.png\)", text) == list(FIGURES)
    assert re.findall(r"^\*\*Figure ([\d-]+)\.\*\* ", text, re.MULTILINE) == list(FIGURES)
    files = sorted((ROOT / "docs/images/thesis").glob("*.png"))
    assert {file.name for file in files} == {f"figure-{number}.png" for number in FIGURES}
    assert [file.name for file in files if file.stat().st_size > LARGEST] == []


@pytest.mark.slow
def test_the_command_draws_a_figure_as_it_is_shown(tmp_path, capsys) -> None:
    main(["figures", "2-10", "--out", str(tmp_path)])
    file = tmp_path / "figure-2-10.png"
    assert file.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    rows = [line for line in capsys.readouterr().out.splitlines() if line.startswith("| 2-10")]
    assert len(rows) == 6
    assert all(row in page_text(PAGE) for row in rows)


def test_a_figure_that_is_not_redrawn_is_named(capsys) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["figures", "2-6"])
    assert ended.value.code == 2
    assert "no figure 2-6" in capsys.readouterr().err
