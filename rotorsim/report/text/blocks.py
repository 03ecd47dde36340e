"""A block's declarations as data, as text and as a Markdown page."""

from __future__ import annotations

import inspect
from collections.abc import Iterable, Mapping
from typing import Any

from rotorsim.block import Block, Declaration, Option

PORT_KEYS = ("default", "low", "high", "above", "optional", "additive", "by_parts", "conjugate", "many", "init", "seed")
DETAILS = {
    "default": "default {}",
    "choices": "one of {}",
    "above": "> {}",
    "low": ">= {}",
    "high": "<= {}",
    "additive": "any number of wires, summed",
    "by_parts": "as a whole or by parts",
    "optional": "optional",
    "many": "as many as {} says",
    "init": "starts at {}",
    "exists": "{}",
}
TITLES = {"randoms": "random draws"}
PORT_LABELS = {"inputs": "in", "outputs": "out"}
HEAD = """# Blocks

<!-- Made by `rotorsim blocks --markdown > docs/blocks.md`; do not edit. -->

Shapes are as declared: a word is an option of the block, or a size that is found from the wires.
Units are SI; in JSON a quantity may carry another unit of the same kind, such as `"24 um"`.
How to add a block: [writing-a-block.md](writing-a-block.md).
"""


def _kinds(cls: type[Block]) -> dict[str, Mapping[str, Declaration]]:
    """Return everything that a block declares, by kind."""
    return {
        "inputs": cls.inputs,
        "outputs": cls.outputs,
        "parameters": cls.parameters,
        "options": cls.options,
        "states": cls.states,
        "randoms": cls.randoms,
    }


def block_data(cls: type[Block]) -> dict[str, Any]:
    """Return everything that a block declares as plain data (``rotorsim blocks pid --json``)."""
    block, body = cls(), (inspect.getdoc(cls) or "").partition("\n")[2]
    data: dict[str, Any] = {
        "type": cls.type_name,
        "category": cls.category,
        "summary": _summary(cls),
        "equation": inspect.cleandoc(body).strip(),
        "source": cls.source,
    }
    for kind, declared in _kinds(cls).items():
        data[kind] = {name: _declaration(block, item) for name, item in declared.items()}
    return data


def _summary(cls: type[Block]) -> str:
    return (inspect.getdoc(cls) or "").partition("\n")[0]


def _declaration(block: Block, item: Declaration) -> dict[str, Any]:
    fields = vars(item)
    data: dict[str, Any] = {"shape": _shape(block, item), "unit": item.unit, "doc": item.doc}
    data |= {key: fields[key] for key in PORT_KEYS if fields.get(key) is not None and fields[key] is not False}
    if fields.get("choices"):
        data["choices"] = list(fields["choices"])
    if fields.get("unless_wired"):
        data["exists"] = f"unless {fields['unless_wired']} is wired"
    if fields.get("when"):
        data["exists"] = "depending on the options"
    return data


def _shape(block: Block, item: Declaration) -> str:
    """Return the declared shape as text: ``scalar``, ``(2,)``, ``(nodes, 2)``, or the word that stands for it."""
    if isinstance(item, Option) and item.is_list:
        return "list"
    shape = item.shape
    if callable(shape):
        try:
            shape = block.declared_shape(item)
        except Exception:  # a function of options may need values that have no default
            return "by options"
    if isinstance(shape, str):
        return shape
    entries = (shape,) if isinstance(shape, int) else shape
    return f"({', '.join(map(str, entries))}{',' * (len(entries) == 1)})" if entries else "scalar"


def _details(data: Mapping[str, Any]) -> str:
    """Return default, bounds and wiring of a declaration in a few words."""
    known = {**data, "choices": ", ".join(map(str, data["choices"]))} if "choices" in data else data
    return ", ".join(text.format(_value(known[key])) for key, text in DETAILS.items() if key in known)


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_value, value))}]"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _rows(data: Mapping[str, Any], kind: str) -> list[tuple[str, str, str, str]]:
    """Return name, shape, unit and words of every declaration of a kind; options are lists or not."""
    rows = []
    for name, item in data[kind].items():
        words = "; ".join(part for part in (str(item["doc"]), _details(item)) if part)
        unit = "any" if item["unit"] is None else str(item["unit"])
        is_option = kind == "options"
        shape = item["shape"].replace("scalar", "") if is_option else item["shape"]
        rows.append((name, shape, "" if is_option and unit == "1" else unit, words))
    return rows


def block_text(cls: type[Block]) -> str:
    """Return the page of one block for the terminal."""
    data = block_data(cls)
    lines = [f"{data['type']} ({data['category']})", data["summary"]]
    lines += ["", data["equation"]] if data["equation"] else []
    for kind in _kinds(cls):
        rows = _rows(data, kind)
        if rows:
            lines += ["", TITLES.get(kind, kind)]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)][:3]
        for *cells, words in rows:
            start = "  ".join(cell.ljust(width) for cell, width in zip(cells, widths, strict=True) if width)
            lines.append(f"  {start}  {words}".rstrip())
    return "\n".join([*lines, *(["", f"source: {data['source']}"] if data["source"] else [])])


def _by_category(classes: Iterable[type[Block]]) -> dict[str, list[type[Block]]]:
    """Return the blocks by category, elementary ones last, each in the order of the alphabet."""
    groups: dict[str, list[type[Block]]] = {}
    for cls in sorted(classes, key=lambda cls: (cls.category == "elementary", cls.category, cls.type_name)):
        groups.setdefault(cls.category, []).append(cls)
    return groups


def block_list(classes: Iterable[type[Block]]) -> str:
    """Return one line for each block, by category."""
    groups = _by_category(classes)
    width = max((len(cls.type_name) for group in groups.values() for cls in group), default=0)
    parts = (
        "\n".join([category, *(f"  {cls.type_name.ljust(width)}  {_summary(cls)}" for cls in group)])
        for category, group in groups.items()
    )
    return "\n\n".join(parts)


def markdown_page(classes: Iterable[type[Block]]) -> str:
    """Return the page of all blocks, docs/blocks.md."""
    groups, lines = _by_category(classes), [HEAD]
    for category, group in groups.items():
        links = ", ".join(f"[`{cls.type_name}`](#{cls.type_name})" for cls in group)
        lines.append(f"- **{category}**: {links}")
    for category, group in groups.items():
        lines += ["", f"## {category[:1].upper()}{category[1:]}"]
        lines += [line for cls in group for line in _markdown_block(cls)]
    return "\n".join(lines) + "\n"


def _markdown_block(cls: type[Block]) -> list[str]:
    data = block_data(cls)
    lines = ["", f"### {data['type']}", "", _cell(data["summary"])]
    if data["equation"]:
        lines += ["", "```text", *data["equation"].splitlines(), "```"]
    rows = [
        f"| {PORT_LABELS.get(kind, kind[:-1])} | `{name}` | {' | '.join(map(_cell, cells))} |"
        for kind in _kinds(cls)
        for name, *cells in _rows(data, kind)
    ]
    if rows:
        lines += ["", "| | name | shape | unit | |", "|---|---|---|---|---|", *rows]
    if data["source"]:
        lines += ["", f"Source: {_cell(data['source'])}"]
    return lines


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("*", "\\*").replace("<", "&lt;").replace("\n", " ")
