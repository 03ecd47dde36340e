"""Every picture of the documents is drawn by a command, is shown by a page, and names rooms that are there."""

from __future__ import annotations

import re

from benchmarks.flows import diagnosis_flow, engine_flow
from benchmarks.page import SHOTS
from benchmarks.pictures import DRAWN, MEASURED, PICTURES, main
from tests.docs.pages import ROOT, page_text

IMAGES = ROOT / "docs" / "images"
LARGEST = 100_000  # bytes


def test_every_picture_is_drawn_by_the_command_and_shown() -> None:
    files = {file.name: file for file in IMAGES.iterdir() if file.is_file()}
    assert set(files) == {*DRAWN, *PICTURES, *MEASURED, *SHOTS}
    assert [name for name, file in files.items() if file.stat().st_size > LARGEST] == []
    pages = ["README.md", *(f"docs/{file.name}" for file in (ROOT / "docs").glob("*.md"))]
    shown = {name for page in pages for name in re.findall(r"!\[[^]]+\]\((?:docs/)?images/([\w.]+)\)", page_text(page))}
    assert shown == set(files)


def test_the_commands_are_those_of_pages() -> None:
    """A person who types what a page shows gets the picture below it."""
    text = " ".join(page.read_text(encoding="utf-8") for page in [ROOT / "README.md", *(ROOT / "docs").glob("*.md")])
    text = " ".join(text.replace("\\\n", " ").split())
    drawn = [command for name, picture in PICTURES.items() for command in picture.commands if name != "jeffcott.png"]
    plain = [re.sub(r" (--plot|-o|--noise) \S+( %\")?", "", command) for command in drawn]
    bare = re.sub(r" (--plot|-o|--noise) \S+( %\")?", "", text)
    assert [command for command in plain if f"rotorsim {command}" not in bare] == []
    assert [command for command in MEASURED.values() if command not in text] == []


def test_a_drawing_is_made(tmp_path, capsys) -> None:
    main(["engine.png", "--out", str(tmp_path)])
    assert (tmp_path / "engine.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert "engine.png" in capsys.readouterr().out


def test_drawings_name_rooms_that_are_there() -> None:
    words = [text.get_text() for figure in (engine_flow(), diagnosis_flow()) for text in figure.axes[0].texts]
    rooms = [word for word in words if re.fullmatch(r"[a-z]+\.[a-z]+", word) and not word.endswith(".json")]
    assert len(rooms) >= 8
    assert [room for room in rooms if not (ROOT / "rotorsim" / room.replace(".", "/") / "__init__.py").exists()] == []
