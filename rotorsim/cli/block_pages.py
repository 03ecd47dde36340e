"""What `rotorsim blocks` shows: a block's declarations as data, as text and as a Markdown page."""

from __future__ import annotations

import inspect
from collections.abc import Iterable, Mapping
from typing import Any

from rotorsim.block import Block, Declaration

__all__ = ["block_data", "block_list", "block_text", "markdown_page"]

KINDS = ("inputs", "outputs", "parameters", "options", "states", "randoms")
_TITLES = {"randoms": "random draws"}


def block_data(cls: type[Block]) -> dict[str, Any]:
    """Return everything that a block declares as plain data (``rotorsim blocks pid --json``)."""
    summary, _, body = (inspect.getdoc(cls) or "").partition("\n")
    block = cls()
    data: dict[str, Any] = {
        "type": cls.type_name,
        "category": cls.category,
        "summary": summary,
        "equation": inspect.cleandoc(body).strip(),
        "source": cls.source,
    }
    for kind in KINDS:
        data[kind] = {name: _declaration(block, item) for name, item in getattr(cls, kind).items()}
    return data


def _declaration(block: Block, item: Any) -> dict[str, Any]:
    data: dict[str, Any] = {"shape": _shape(block, item), "unit": item.unit, "doc": item.doc}
    for key in ("default", "low", "high", "above", "optional", "additive", "conjugate", "many", "init", "seed"):
        value = getattr(item, key, None)
        if value is not None and value is not False:
            data[key] = value
    choices = getattr(item, "choices", None)
    if choices:
        data["choices"] = list(choices)
    if getattr(item, "unless_wired", None):
        data["exists"] = f"unless {item.unless_wired} is wired"
    if getattr(item, "when", None):
        data["exists"] = "depending on the options"
    return data


def _shape(block: Block, item: Declaration) -> str:
    """Return the declared shape as text: ``scalar``, ``(2,)``, ``(nodes, 2)``, or the word that stands for it."""
    shape = item.shape
    if callable(shape):
        try:
            shape = block.declared_shape(item)
        except Exception:  # a function of options may need values that have no default
            return "by options"
    if isinstance(shape, str):
        return shape
    if isinstance(shape, int):
        shape = (shape,)
    if not shape:
        return "scalar"
    return "(" + ", ".join(str(entry) for entry in shape) + ("," if len(shape) == 1 else "") + ")"


def _details(data: Mapping[str, Any]) -> str:
    """Return default, bounds and wiring of a declaration in a few words."""
    words = []
    if "default" in data:
        words.append(f"default {_value(data['default'])}")
    if "choices" in data:
        words.append("one of " + ", ".join(str(choice) for choice in data["choices"]))
    if "above" in data:
        words.append(f"> {data['above']:g}")
    if "low" in data:
        words.append(f">= {data['low']:g}")
    if "high" in data:
        words.append(f"<= {data['high']:g}")
    if data.get("additive"):
        words.append("any number of wires, summed")
    if data.get("optional"):
        words.append("optional")
    if "many" in data:
        words.append(f"as many as {data['many']} says")
    if "init" in data:
        words.append(f"starts at {_value(data['init'])}")
    if "exists" in data:
        words.append(data["exists"])
    return ", ".join(words)


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_value(item) for item in value) + "]"
    return str(value)


def block_text(cls: type[Block], known: Iterable[str] = ()) -> str:
    """Return the page of one block for the terminal."""
    data = block_data(cls)
    lines = [f"{data['type']} ({data['category']})", data["summary"]]
    if data["equation"]:
        lines += ["", data["equation"]]
    for kind in KINDS:
        if not data[kind]:
            continue
        lines += ["", _TITLES.get(kind, kind)]
        cells = [
            (name, "" if kind == "options" else item["shape"], "" if kind == "options" else _unit(item), _words(item))
            for name, item in data[kind].items()
        ]
        widths = [max(len(row[k]) for row in cells) for k in range(3)]
        for row in cells:
            start = "  ".join(cell.ljust(width) for cell, width in zip(row[:3], widths, strict=True) if width)
            lines.append(f"  {start}  {row[3]}".rstrip())
    if data["source"]:
        lines += ["", f"source: {data['source']}"]
    return "\n".join(lines)


def _unit(item: Mapping[str, Any]) -> str:
    return "any" if item["unit"] is None else str(item["unit"])


def _words(item: Mapping[str, Any]) -> str:
    details = _details(item)
    return "; ".join(part for part in (str(item["doc"]), details) if part)


def by_category(classes: Iterable[type[Block]]) -> dict[str, list[type[Block]]]:
    """Return the blocks by category, elementary ones last, each in the order of the alphabet."""
    groups: dict[str, list[type[Block]]] = {}
    for cls in sorted(classes, key=lambda cls: (cls.category == "elementary", cls.category, cls.type_name)):
        groups.setdefault(cls.category, []).append(cls)
    return groups


def block_list(classes: Iterable[type[Block]]) -> str:
    """Return one line for each block, by category."""
    groups = by_category(classes)
    width = max((len(cls.type_name) for group in groups.values() for cls in group), default=0)
    lines: list[str] = []
    for category, group in groups.items():
        lines += ["", category] if lines else [category]
        lines += [f"  {cls.type_name.ljust(width)}  {_summary(cls)}" for cls in group]
    return "\n".join(lines)


def _summary(cls: type[Block]) -> str:
    return (inspect.getdoc(cls) or "").partition("\n")[0]


def markdown_page(classes: Iterable[type[Block]]) -> str:
    """Return the page of all blocks, docs/blocks.md."""
    groups = by_category(classes)
    lines = [
        "# Blocks",
        "",
        "<!-- Made by `rotorsim blocks --markdown > docs/blocks.md`; do not edit. -->",
        "",
        "Shapes are as declared: a word is an option of the block, or a size that is found from the wires.",
        'Units are SI; in JSON a quantity may carry another unit of the same kind, such as `"24 um"`.',
        "How to add a block: [writing-a-block.md](writing-a-block.md).",
        "",
    ]
    for category, group in groups.items():
        links = ", ".join(f"[`{cls.type_name}`](#{cls.type_name})" for cls in group)
        lines.append(f"- **{category}**: {links}")
    for category, group in groups.items():
        lines += ["", f"## {category[:1].upper()}{category[1:]}"]
        for cls in group:
            lines += _markdown_block(cls)
    return "\n".join(lines) + "\n"


def _markdown_block(cls: type[Block]) -> list[str]:
    data = block_data(cls)
    lines = ["", f"### {data['type']}", "", _cell(data["summary"])]
    if data["equation"]:
        lines += ["", "```text", *data["equation"].splitlines(), "```"]
    rows = [
        (
            _singular(kind),
            name,
            "" if kind == "options" else item["shape"],
            "" if kind == "options" else _unit(item),
            _words(item),
        )
        for kind in KINDS
        for name, item in data[kind].items()
    ]
    if rows:
        lines += ["", "| | name | shape | unit | |", "|---|---|---|---|---|"]
        lines += [
            f"| {kind} | `{name}` | {_cell(shape)} | {_cell(unit)} | {_cell(words)} |"
            for kind, name, shape, unit, words in rows
        ]
    if data["source"]:
        lines += ["", f"Source: {_cell(data['source'])}"]
    return lines


def _singular(kind: str) -> str:
    return {"inputs": "in", "outputs": "out"}.get(kind, kind[:-1])


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("*", "\\*").replace("<", "&lt;").replace("\n", " ")
