"""``rotorsim docs``."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import click

from rotorsim.cli.shared import json_option, refuse_if, show
from rotorsim.errors import near_miss


@click.command("docs")
@click.argument("page", metavar="[PAGE]", required=False)
@json_option
def command(page: str | None, as_json: bool) -> None:
    """List the pages that come with rotorsim, or show one.

    \b
    rotorsim docs
    rotorsim docs diagrams | less
    """
    pages = {file.stem: file for file in sorted(_folder().glob("*.md"))}
    if page is None:
        titles = {name: {"title": _title(file), "file": str(file)} for name, file in pages.items()}
        width = max(map(len, pages))
        lines = (f"{name:{width}}  {entry['title']}" for name, entry in titles.items())
        show(as_json, lambda: {"pages": titles}, lambda: "\n".join(lines))
        return
    name = page.removesuffix(".md")
    refuse_if(name not in pages, f"no page '{page}'", hint=near_miss(page, pages))
    file = pages[name]
    text = file.read_text(encoding="utf-8")
    data = {"page": name, "title": _title(file), "file": str(file), "text": text}
    show(as_json, lambda: data, lambda: text.removesuffix("\n"))


def _folder() -> Path:
    """Return the folder of the pages: a package as the diagrams are, or docs/ of a checkout installed before it was."""
    try:
        return Path(str(resources.files("rotorsim.docs")))
    except ModuleNotFoundError:
        return Path(str(resources.files("rotorsim"))).parent / "docs"


def _title(file: Path) -> str:
    with file.open(encoding="utf-8") as stream:
        return stream.readline().lstrip("# ").strip()
