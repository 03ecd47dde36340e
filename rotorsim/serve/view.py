"""What the page draws of a diagram, and lists of blocks: plain data."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from typing import Any

import numpy as np

from rotorsim.block import Block
from rotorsim.diagram.diagram import Diagram, Endpoint, Node, Port
from rotorsim.diagram.draw import FILL, colours_of
from rotorsim.diagram.parts import Exposed, Part, exposed_ports
from rotorsim.diagram.sheet import Box, Cell, DrawnWire, Sheet, sheet_of
from rotorsim.errors import Problem
from rotorsim.report.text.blocks import block_data
from rotorsim.units import format_quantity

MOST_ENTRIES_WRITTEN = 12  # entries of a value that are written out
Data = dict[str, Any]


def view_of(diagram: Diagram, opened: Collection[str] = ()) -> Data:
    """Return the picture of a diagram: blocks with ports and values, wires with corners, the grid they stand on.

    opened: sub-diagrams whose blocks are shown; the others are one block each.
    """
    sheet = sheet_of(diagram, every_port=True, opened=opened)
    colour = colours_of(sheet)
    wired = {(end.block, end.port) for wire in sheet.wires for end in (wire.source, wire.target)}
    document = diagram.document
    exposed = exposed_ports(document)
    return {
        "name": diagram.name,
        "description": str(document.get("description", "")),
        "width": sheet.width,
        "height": sheet.height,
        "columns": [_cell(cell, "left", "right") for cell in sheet.columns],
        "rows": [_cell(cell, "top", "bottom") for cell in sheet.rows],
        "blocks": [_block(diagram, box, wired, exposed) for box in sheet.boxes.values()],
        "wires": [_wire(sheet, drawn, colour[drawn.signal]) for drawn in sheet.wires],
        "dots": [[round(x, 1), round(y, 1), colour[signal]] for (x, y), signal in sheet.dots],
        "parameters": parameters_of(diagram),
        "record": [str(signal) for signal in document.get("record", diagram.record)],
    }


def cells_of(diagram: Diagram, opened: Collection[str] = ()) -> dict[str, tuple[float, float]]:
    """Return [column, row] of every block where the picture stands it."""
    sheet = sheet_of(diagram, every_port=True, opened=opened)
    return {name: (sheet.columns[box.column].value, sheet.rows[box.row].value) for name, box in sheet.boxes.items()}


def _cell(cell: Cell, start: str, end: str) -> Data:
    return {"value": cell.value, start: round(cell.start, 1), end: round(cell.end, 1)}


def _block(diagram: Diagram, box: Box, wired: set[tuple[str, str]], exposed: Exposed) -> Data:
    node = box.node
    entry = diagram.document.get("blocks", {}).get(node.name)
    own = entry.get("parameters", {}) if isinstance(entry, Mapping) else {}
    return {
        "name": node.name,
        "kind": box.kind,
        "category": box.category,
        "fill": FILL.get(box.category, FILL["elementary"]),
        "x": round(box.x, 1),
        "y": round(box.y, 1),
        "width": round(box.width, 1),
        "height": round(box.height, 1),
        "editable": entry is not None,
        "plain": box.plain,
        "entry": entry,
        "inputs": [_port(box, node.inputs[name], wired, exposed, is_input=True) for name in box.inputs],
        "outputs": [_port(box, node.outputs[name], wired, exposed, is_input=False) for name in box.outputs],
        **(_of_part(diagram, node.name, own) if isinstance(node, Part) else _of_node(node, own)),
    }


def _of_node(node: Node, own: Mapping[str, Any]) -> Data:
    cls = type(node.block)
    return {
        "type": cls.type_name,
        "summary": (cls.__doc__ or "").strip().partition("\n")[0],
        "parameters": [_parameter(node, name, own) for name in node.values if name in cls.parameters],
        "options": [_option(node, name, own) for name in cls.options],
        "part": node.name.rpartition("/")[0],
        "closed": False,
    }


def _of_part(diagram: Diagram, name: str, own: Mapping[str, Any]) -> Data:
    """Return what is said of a closed sub-diagram: its parameters, given here or not."""
    inner = [one.removeprefix(f"{name}/") for one in diagram.parameters if one.startswith(f"{name}/")]
    parameters = []
    for key in dict.fromkeys([*own, *(one for one in inner if "/" not in one)]):
        given = own.get(key)
        followed = given[1:] if isinstance(given, str) and given.startswith("$") else ""
        meant = followed or f"{name}/{key}"
        unit = diagram.parameter_units.get(meant)
        value = value_text(diagram.parameters[meant], unit) if meant in diagram.parameters else str(given)
        doc = "a parameter of the sub-diagram"
        data = {"name": key, "value": value, "written": given, "follows": followed, "unit": _unit(unit), "doc": doc}
        parameters.append(data | {"required": False})
    summary = "A sub-diagram: it has a file of its own."
    return {"type": "diagram", "summary": summary, "parameters": parameters, "options": [], "part": "", "closed": True}


def _port(box: Box, port: Port, wired: set[tuple[str, str]], exposed: Exposed, *, is_input: bool) -> Data:
    x = box.x if is_input else box.x + box.width
    return {
        "name": port.name,
        "x": round(x, 1),
        "y": round(box.port_y(port.name, is_input=is_input), 1),
        "unit": _unit(port.unit),
        "shape": shape_text(port.shape),
        "wired": (port.block, port.name) in wired,
        "exposed": exposed.get(("inputs" if is_input else "outputs", port.block, port.name), []),
        "optional": is_input and (port.additive or bool(getattr(port.declaration, "optional", False))),
        "sign": box.marks.get(port.name, "") if is_input else "",
    }


def _unit(unit: str | None) -> str:
    return "any" if unit is None else unit


def shape_text(shape: tuple[int, ...]) -> str:
    """Return a shape in words: ``scalar``, ``2``, ``6 x 2``."""
    return " x ".join(map(str, shape)) or "scalar"


def value_text(value: Any, unit: str | None) -> str:
    """Return a value (SI) with its unit; of a large one its size."""
    array = np.asarray(value)
    if array.size > MOST_ENTRIES_WRITTEN:
        return f"{shape_text(array.shape)} numbers"
    if array.dtype.kind not in "fiu":
        return str(array.tolist())
    if array.ndim == 0:
        return format_quantity(float(array), unit)
    return f"{array.tolist()}" + (f" {unit}" if unit not in (None, "1") else "")


def _parameter(node: Node, name: str, written: Mapping[str, Any]) -> Data:
    declared = node.block.parameters[name]
    return {
        "name": name,
        "value": value_text(node.values[name], declared.unit),
        "written": written.get(name),
        "follows": node.references.get(name, ""),
        "unit": _unit(declared.unit),
        "doc": declared.doc,
        "required": declared.default is None,
    }


def _option(node: Node, name: str, written: Mapping[str, Any]) -> Data:
    declared = type(node.block).options[name]
    value = getattr(node.block.option, name, None)
    return {
        "name": name,
        "value": str(value),
        "written": written.get(name),
        "choices": None if declared.choices is None else list(declared.choices),
        "doc": declared.doc,
        "unit": declared.unit or "1",
        "required": declared.default is None and declared.kind is not None,
    }


def _wire(sheet: Sheet, drawn: DrawnWire, colour: str) -> Data:
    source, target = drawn.source, drawn.target
    port = sheet.boxes[source.block].node.outputs[source.port]
    shape = port.shape[len(source.index) :]
    return {
        "source": str(source),
        "target": str(target),
        "points": [[round(x, 1), round(y, 1)] for x, y in drawn.points],
        "colour": colour,
        "unit": _unit(port.unit or sheet.boxes[target.block].node.inputs[target.port].unit),
        "shape": shape_text(shape),
        "index_source": _index(source),
        "index_target": _index(target),
    }


def _index(end: Endpoint) -> str:
    return str(end)[len(f"{end.block}.{end.port}") :]


def values_of(diagram: Diagram) -> dict[str, str]:
    """Return every block's kind and values, to say in what two runs differ; what follows a parameter is that."""
    found: dict[str, str] = {}
    for name, node in diagram.nodes.items():
        declared = type(node.block)
        found[name] = declared.type_name
        for key, value in node.values.items():
            if key in declared.parameters and key not in node.references:
                found[f"{name}.{key}"] = value_text(value, declared.parameters[key].unit)
        found |= {f"{name}.{key}": str(getattr(node.block.option, key, None)) for key in declared.options}
    return found | {one["name"]: one["value"] for one in parameters_of(diagram)}


def parameters_of(diagram: Diagram) -> list[Data]:
    """Return the parameters of a diagram, with the parameters of blocks that follow each."""
    followers: dict[str, list[str]] = {}
    for block, node in diagram.nodes.items():
        for key, followed in node.references.items():
            followers.setdefault(followed, []).append(f"{block}.{key}")
    written = diagram.document.get("parameters", {})
    blocks = diagram.document.get("blocks", {})
    for name in diagram.parameters:
        part, slash, key = name.partition("/")
        if slash and "/" not in key and part in blocks:  # of a sub-diagram: given to its block
            written = {**written, name: blocks[part].get("parameters", {}).get(key)}
    return [
        {
            "name": name,
            "field": name.replace("/", ".") if name in written else "",
            "value": value_text(value, diagram.parameter_units.get(name)),
            "written": written.get(name),
            "unit": diagram.parameter_units.get(name) or "1",
            "followers": followers.get(name, []),
        }
        for name, value in diagram.parameters.items()
    ]


def problem_of_block(problem: Problem, blocks: Iterable[str]) -> Data:
    """Return a problem as data, with the block and port that it belongs to."""
    block, _, port = problem.subject.partition(" ->")[0].rpartition(".")
    known = set(blocks)
    if problem.subject in known:
        block, port = problem.subject, ""
    return {
        "severity": problem.severity,
        "what": problem.what,
        "subject": problem.subject,
        "hint": problem.hint,
        "place": str(problem.place),
        "block": block if block in known else "",
        "port": port.partition("[")[0] if block in known else "",
    }


def palette_of(types: Mapping[str, type[Block]]) -> list[Data]:
    """Return what the palette says of every type of block."""
    return [_type(cls) for _, cls in sorted(types.items())]


def _type(cls: type[Block]) -> Data:
    data = block_data(cls)
    ports = {
        side: [
            {"name": name, "unit": _unit(one["unit"]), "shape": one["shape"], "optional": bool(one.get("optional"))}
            for name, one in data[side].items()
        ]
        for side in ("inputs", "outputs")
    }
    values = {
        kind: [
            {
                "name": name,
                "unit": _unit(one["unit"]),
                "default": one.get("default"),
                "choices": one.get("choices"),
                "doc": one["doc"],
                "required": "default" not in one,
            }
            for name, one in data[kind].items()
        ]
        for kind in ("parameters", "options")
    }
    return {"type": cls.type_name, "category": cls.category, "summary": data["summary"], **ports, **values}
