"""The sheet of a diagram: boxes with ports on a grid, and wires in the lanes between them."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from itertools import accumulate

import networkx as nx

from rotorsim.diagram.diagram import Diagram, Endpoint, Node
from rotorsim.diagram.parts import Exposed, Part, closed_parts, exposed_ports, inside, wires_outside

LANE, MARGIN, HEAD, PORT = 7.0, 22.0, 38.0, 15.0  # px: wire spacing, free space, box title, one port
TAG = 24.0  # px: of a tag, without its text
ABOVE_ROWS = 34.0  # px: above the first row, for a title
SIGNS = {"+": "+", "-": "\N{MINUS SIGN}", "*": "\N{MULTIPLICATION SIGN}", "/": "\N{DIVISION SIGN}"}
Key = tuple[str, str]
Point = tuple[float, float]


@dataclass
class Box:
    """A block, or a closed sub-diagram, on the sheet: its ports, its grid cell, and then its place in px.

    tags: (side, port) -> the ports of the diagram itself that lead there.
    """

    node: Node | Part
    inputs: list[str]
    outputs: list[str]
    tags: dict[Key, str] = field(default_factory=dict)
    column: int = 0
    row: int = 0
    x: float = 0.0
    y: float = 0.0
    width: float = 0.0
    height: float = 0.0

    def port_y(self, name: str, *, is_input: bool) -> float:
        names = self.inputs if is_input else self.outputs
        return (
            self.y
            + (self.height if self.plain else self.height + HEAD) / 2
            + PORT * (names.index(name) - (len(names) - 1) / 2)
        )

    @property
    def plain(self) -> bool:
        """Whether port names say nothing: one unnamed input and output."""
        return not any(name.rstrip("0123456789") not in ("input", "output") for name in (*self.inputs, *self.outputs))

    @property
    def kind(self) -> str:
        """The type, with the function that a block of several functions computes."""
        if isinstance(self.node, Part):
            return self.node.kind
        function = getattr(self.node.block.option, "function", None)
        return f"{self.node.block.type_name}: {function}" if isinstance(function, str) else self.node.block.type_name

    @property
    def category(self) -> str:
        """The category of the block, "diagram" of a sub-diagram."""
        return "diagram" if isinstance(self.node, Part) else self.node.block.category

    @property
    def marks(self) -> dict[str, str]:
        """Input port -> its sign, where the letters of an option are signs (sum, product)."""
        if isinstance(self.node, Part) or not self.plain or len(self.inputs) < 2:
            return {}
        block = self.node.block
        groups = [(d, getattr(block.option, d.many)) for d in block.inputs.values() if d.many]
        return {
            port: SIGNS[sign]
            for declared, signs in groups
            if isinstance(signs, str)
            for port, sign in zip(block.port_names(declared), signs, strict=True)
            if sign in SIGNS and port in self.inputs
        }


@dataclass
class _Lanes:
    """Lanes of one gap between columns or rows, one for each signal that wires in it; before and behind, room [px]."""

    taken: dict[Key, int] = field(default_factory=dict)
    before: float = 0.0
    behind: float = 0.0

    def of(self, signal: Key) -> int:
        return self.taken.setdefault(signal, len(self.taken))

    @property
    def width(self) -> float:
        return self.before + 2 * MARGIN + LANE * len(self.taken) + self.behind

    def at(self, signal: Key, start: float) -> float:
        return start + self.before + MARGIN + LANE * (self.taken[signal] + 0.5)


@dataclass(frozen=True)
class _Grid:
    """Size of the sheet; where the gaps left of columns and above rows begin (left, top) and end (right, bottom)."""

    width: float
    height: float
    left: list[float]
    right: list[float]
    top: list[float]
    bottom: list[float]


@dataclass(frozen=True)
class DrawnWire:
    """A wire on the sheet: its ends, the signal it carries, (block, port), and its corners."""

    source: Endpoint
    target: Endpoint
    signal: Key
    points: list[Point]


@dataclass(frozen=True)
class Cell:
    """A column or row: what stands for it in the layout, where it begins and ends [px]."""

    value: float
    start: float
    end: float


@dataclass(frozen=True)
class Sheet:
    """Boxes by block, wires, points where wires of a signal branch; size [px]; columns and rows of the grid."""

    boxes: Mapping[str, Box]
    wires: list[DrawnWire]
    dots: list[tuple[Point, Key]]
    width: float
    height: float
    columns: list[Cell]
    rows: list[Cell]


def sheet_of(diagram: Diagram, *, every_port: bool = False, opened: Collection[str] | None = None) -> Sheet:
    """Return where everything stands: blocks where the document's ``layout`` says, else in layers from left to right.

    every_port: ports that are not wired are shown, too. opened: sub-diagrams whose blocks are shown, the others are one
    block each; default: all. Wires of one output share a line and branch at dots.
    """
    parts = closed_parts(diagram, diagram.sub_ports if opened is None else opened)
    seen = wires_outside(diagram, parts)
    boxes = _boxes(diagram, parts, seen, every_port)
    _tag(boxes, exposed_ports(diagram.document))
    columns_at, rows_at = _place(diagram, boxes, seen)
    columns, rows = max(len(columns_at), 1), max((box.row for box in boxes.values()), default=0) + 1
    channels = [_Lanes() for _ in range(columns + 1)]  # gap k lies left of column k
    streets = [_Lanes() for _ in range(rows + 1)]  # gap k lies above row k
    routes = [_route(boxes, source, target, channels, streets) for source, target in seen]
    for box in boxes.values():
        for (side, _), text in box.tags.items():
            room = TAG + 6.6 * len(text)
            if side == "inputs":
                channels[box.column].behind = max(channels[box.column].behind, room)
            else:
                channels[box.column + 1].before = max(channels[box.column + 1].before, room)
    grid = _measure(boxes, columns, rows, channels, streets)
    wires: list[DrawnWire] = []
    corners: dict[Key, list[list[Point]]] = {}
    for signal, steps, source, target in routes:
        points = _points(boxes, signal, steps, source, target, channels, streets, grid.left, grid.top)
        wires.append(DrawnWire(source, target, signal, points))
        corners.setdefault(signal, []).append(points[1:-1])
    dots = [(point, signal) for signal, points in corners.items() for point in _branches(points)]
    columns_of = [Cell(*one) for one in zip(columns_at, grid.right, grid.left[1:], strict=False)]
    rows_of = [Cell(*one) for one in zip(_filled(rows_at, rows), grid.bottom, grid.top[1:], strict=False)]
    return Sheet(boxes, wires, dots, grid.width, grid.height, columns_of, rows_of)


def _filled(values: list[float], count: int) -> list[float]:
    """Return values of rows with more behind them: blocks that share a cell stand below each other."""
    last = values[-1] if values else 0.0
    return values + [last + k + 1 for k in range(count - len(values))]


def _boxes(
    diagram: Diagram, parts: Mapping[str, Part], seen: Iterable[tuple[Endpoint, Endpoint]], every_port: bool
) -> dict[str, Box]:
    wires = list(seen)
    exposed = exposed_ports(diagram.document)
    wired_in = {(target.block, target.port) for _, target in wires}
    wired_in |= {(block, port) for side, block, port in exposed if side == "inputs"}
    wired_out = {(source.block, source.port) for source, _ in wires}
    wired_out |= {(block, port) for side, block, port in exposed if side == "outputs"}
    shown: dict[str, Node | Part] = {}
    for name, node in diagram.nodes.items():
        part = inside(name, parts)
        shown.setdefault(part or name, parts[part] if part else node)
    boxes = {}
    for name, one in shown.items():
        inputs = [port for port in one.inputs if every_port or (name, port) in wired_in]
        outputs = [port for port in one.outputs if every_port or (name, port) in wired_out]
        box = Box(one, inputs, outputs)
        count = max(len(inputs), len(outputs), 1)
        ports = 0.0 if box.plain else 6.2 * (max(map(len, inputs), default=0) + max(map(len, outputs), default=0)) + 26
        room = 12.0 if box.marks else 0.0
        box.width = max(7.6 * len(name) + 22 + room, 6.2 * len(box.kind) + 22 + room, ports, 76)
        box.height = max(HEAD, PORT * count + 8) if box.plain else HEAD + PORT * count + 6
        boxes[name] = box
    return boxes


def _tag(boxes: Mapping[str, Box], exposed: Exposed) -> None:
    """Note at the ports that the diagram's own ports lead to what these are called; such ports are shown."""
    for (side, block, port), named in exposed.items():
        box = boxes.get(block)
        if box is None or port not in (box.node.inputs if side == "inputs" else box.node.outputs):
            continue
        box.tags[side, port] = ", ".join(name for name, _ in named)


def _place(
    diagram: Diagram, boxes: dict[str, Box], seen: Iterable[tuple[Endpoint, Endpoint]]
) -> tuple[list[float], list[float]]:
    """Give every block a cell of its own, in the order of the layout's columns and rows; return what these are."""
    layout = diagram.document.get("layout", {})
    given = {n: (float(layout[n][0]), float(layout[n][1])) for n in boxes if isinstance(layout.get(n), list | tuple)}
    if len(given) < len(boxes):
        given = _layered(seen, boxes)
    columns = {x: k for k, x in enumerate(sorted({x for x, _ in given.values()}))}
    rows = {y: k for k, y in enumerate(sorted({y for _, y in given.values()}))}
    taken: set[tuple[int, int]] = set()
    for name, (x, y) in given.items():
        cell = columns[x], rows[y]
        while cell in taken:
            cell = cell[0], cell[1] + 1
        taken.add(cell)
        boxes[name].column, boxes[name].row = cell
    return list(columns), list(rows)


def _layered(seen: Iterable[tuple[Endpoint, Endpoint]], boxes: Iterable[str]) -> dict[str, tuple[float, float]]:
    """Return columns by longest path once the feedback wires are left out, rows in order."""
    graph = nx.DiGraph()
    graph.add_nodes_from(boxes)
    for source, target in dict.fromkeys((source.block, target.block) for source, target in seen):
        if source != target and not nx.has_path(graph, target, source):
            graph.add_edge(source, target)
    layers = enumerate(nx.topological_generations(graph))
    return {name: (float(column), float(row)) for column, layer in layers for row, name in enumerate(layer)}


def _route(
    boxes: Mapping[str, Box], source: Endpoint, target: Endpoint, channels: list[_Lanes], streets: list[_Lanes]
) -> tuple[Key, tuple[int, int, int], Endpoint, Endpoint]:
    """Reserve lanes: the channel right of the source, a street across columns, the one left of the target."""
    signal = source.block, source.port
    start, stop = boxes[source.block], boxes[target.block]
    first, last = start.column + 1, stop.column
    channels[first].of(signal)
    if first == last:
        return signal, (first, -1, last), source, target
    channels[last].of(signal)
    forward = last > first
    street = start.row + 1 if stop.row > start.row or not forward else start.row
    streets[street].of(signal)
    return signal, (first, street, last), source, target


def _measure(boxes: Mapping[str, Box], columns: int, rows: int, channels: list[_Lanes], streets: list[_Lanes]) -> _Grid:
    """Place boxes in px; return the size of the sheet, and where channels and streets begin and end."""
    wide = [max((b.width for b in boxes.values() if b.column == c), default=0.0) for c in range(columns)]
    high = [max((b.height for b in boxes.values() if b.row == r), default=0.0) for r in range(rows)]
    left, right = _gaps(0.0, [channel.width for channel in channels], wide)
    top, bottom = _gaps(ABOVE_ROWS, [street.width - MARGIN for street in streets], high)
    for box in boxes.values():
        box.x = right[box.column] + (wide[box.column] - box.width) / 2
        box.y = bottom[box.row] + (high[box.row] - box.height) / 2
    return _Grid(right[-1], bottom[-1] + 8, left, right, top, bottom)


def _gaps(start: float, gaps: list[float], sizes: list[float]) -> tuple[list[float], list[float]]:
    """Return where gaps begin and end, with boxes of these sizes between them."""
    ends = list(accumulate((size for pair in zip(gaps, [*sizes, 0.0], strict=True) for size in pair), initial=start))
    return ends[:-1:2], ends[1::2]


def _points(
    boxes: Mapping[str, Box],
    signal: Key,
    steps: tuple[int, int, int],
    source: Endpoint,
    target: Endpoint,
    channels: list[_Lanes],
    streets: list[_Lanes],
    left: list[float],
    top: list[float],
) -> list[tuple[float, float]]:
    start, stop = boxes[source.block], boxes[target.block]
    x0, y0 = start.x + start.width, start.port_y(source.port, is_input=False)
    x1, y1 = stop.x, stop.port_y(target.port, is_input=True)
    first, street, last = steps
    a = channels[first].at(signal, left[first])
    if street < 0:
        return [(x0, y0), (x1, y1)] if abs(y1 - y0) < 0.1 else [(x0, y0), (a, y0), (a, y1), (x1, y1)]
    b = channels[last].at(signal, left[last])
    y = top[street] + MARGIN / 2 + LANE * (streets[street].taken[signal] + 0.5)
    return [(x0, y0), (a, y0), (a, y), (b, y), (b, y1), (x1, y1)]


def _branches(corners: Iterable[list[tuple[float, float]]]) -> list[tuple[float, float]]:
    """Return the first corner of every wire of a signal of several wires: there its line branches."""
    wires = list(corners)
    if len(wires) < 2:
        return []
    return list(dict.fromkeys((round(wire[0][0], 1), round(wire[0][1], 1)) for wire in wires if wire))
