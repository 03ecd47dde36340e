"""Draw a diagram as SVG: boxes with ports on a grid, wires in the lanes between them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from itertools import accumulate

import networkx as nx

from rotorsim.diagram.diagram import Diagram, Endpoint, Node
from rotorsim.errors import escape

LANE, MARGIN, HEAD, PORT = 7.0, 22.0, 38.0, 15.0  # px: wire spacing, free space, box title, one port
MARKED, BESIDE = 3.5, "#8796a0"  # px: width of a wire that is marked; colour of the others then
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#8c5fa8", "#b8860b", "#56697a", "#a0522d", "#3b7a57")
FILL = {
    "rotor": "#dcebf7",
    "bearing": "#e2f2e6",
    "controller": "#fdeedb",
    "excitation": "#fbe4dd",
    "clock": "#efe7f5",
    "elementary": "#f4f4f2",
}
SIGNS = {"+": "+", "-": "\N{MINUS SIGN}", "*": "\N{MULTIPLICATION SIGN}", "/": "\N{DIVISION SIGN}"}
Key = tuple[str, str]


@dataclass
class _Box:
    """A block on the sheet: its ports that are wired, its grid cell, and then its place in px."""

    node: Node
    inputs: list[str]
    outputs: list[str]
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
        function = getattr(self.node.block.option, "function", None)
        return f"{self.node.block.type_name}: {function}" if isinstance(function, str) else self.node.block.type_name

    @property
    def marks(self) -> dict[str, str]:
        """Input port -> its sign, where the letters of an option are signs (sum, product)."""
        if not self.plain or len(self.inputs) < 2:
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
    """Lanes of one gap between columns or rows, one for each signal that runs in it."""

    taken: dict[Key, int] = field(default_factory=dict)

    def of(self, signal: Key) -> int:
        return self.taken.setdefault(signal, len(self.taken))

    @property
    def width(self) -> float:
        return 2 * MARGIN + LANE * len(self.taken)

    def at(self, signal: Key, start: float) -> float:
        return start + MARGIN + LANE * (self.taken[signal] + 0.5)


def draw_svg(
    diagram: Diagram, highlight: Mapping[str, str] | None = None, marked: Mapping[Key, tuple[str, str]] | None = None
) -> str:
    """Return the diagram as SVG text.

    Blocks stand where the document's ``layout`` says ([column, row]), else in layers from left to right.
    highlight: block -> colour of its frame. marked: (block, port) -> colour of the wires of an output, or of the one
    into an input, and what is written there. Wires of one output share a line and branch at dots.
    """
    marked = marked or {}
    boxes = _boxes(diagram)
    _place(diagram, boxes)
    columns = max((box.column for box in boxes.values()), default=0) + 1
    rows = max((box.row for box in boxes.values()), default=0) + 1
    channels = [_Lanes() for _ in range(columns + 1)]  # gap k lies left of column k
    streets = [_Lanes() for _ in range(rows + 1)]  # gap k lies above row k
    routes = [_route(boxes, wire.source, wire.target, channels, streets) for wire in diagram.wires]
    width, height, left, top = _measure(boxes, columns, rows, channels, streets)
    parts = [_box(box, (highlight or {}).get(name)) for name, box in boxes.items()]
    colour = {key: COLOURS[k % len(COLOURS)] for k, key in enumerate(dict.fromkeys(r[0] for r in routes))}
    if marked:
        colour = dict.fromkeys(colour, BESIDE) | {key: shade for key, (shade, _) in marked.items()}
    lines: list[str] = []
    dots: dict[Key, list[list[tuple[float, float]]]] = {}
    written: dict[Key, str] = {}
    for signal, steps, source, target in sorted(routes, key=lambda route: (route[3].block, route[3].port) in marked):
        points = _points(boxes, signal, steps, source, target, channels, streets, left, top)
        into = target.block, target.port
        mark = into if into in marked else signal
        shade = marked[into][0] if into in marked else colour[signal]
        lines.append(_wire(points, shade, source, target, MARKED if mark in marked else 1.3))
        dots.setdefault(signal, []).append(points[1:-1])
        if mark in marked and mark not in written:
            written[mark] = _label(points[0 if mark == signal else -1], *marked[mark], before=mark == into)
    marks = [_dot(point, colour[signal]) for signal, points in dots.items() for point in _branches(points)]
    title = escape(diagram.name)
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.0f}" height="{height:.0f}" '
        f'viewBox="0 0 {width:.0f} {height:.0f}" font-family="Helvetica, Arial, sans-serif">\n'
        f"<title>{title}</title>\n"
        '<rect width="100%" height="100%" fill="white"/>\n'
        f'<text x="{MARGIN}" y="26" font-size="17" font-weight="bold">{title}</text>'
    )
    return "\n".join([head, *lines, *marks, *parts, *written.values(), "</svg>"]) + "\n"


def _boxes(diagram: Diagram) -> dict[str, _Box]:
    wired_in = {(wire.target.block, wire.target.port) for wire in diagram.wires}
    wired_out = {(wire.source.block, wire.source.port) for wire in diagram.wires}
    boxes = {}
    for name, node in diagram.nodes.items():
        inputs = [port for port in node.inputs if (name, port) in wired_in]
        outputs = [port for port in node.outputs if (name, port) in wired_out]
        box = _Box(node, inputs, outputs)
        count = max(len(inputs), len(outputs), 1)
        ports = 0.0 if box.plain else 6.2 * (max(map(len, inputs), default=0) + max(map(len, outputs), default=0)) + 26
        room = 12.0 if box.marks else 0.0
        box.width = max(7.6 * len(name) + 22 + room, 6.2 * len(box.kind) + 22 + room, ports, 76)
        box.height = max(HEAD, PORT * count + 8) if box.plain else HEAD + PORT * count + 6
        boxes[name] = box
    return boxes


def _place(diagram: Diagram, boxes: dict[str, _Box]) -> None:
    """Give every block a cell of its own, in the order of the layout's columns and rows."""
    layout = diagram.document.get("layout", {})
    given = {n: (float(layout[n][0]), float(layout[n][1])) for n in boxes if isinstance(layout.get(n), list | tuple)}
    if len(given) < len(boxes):
        given = _layered(diagram)
    columns = {x: k for k, x in enumerate(sorted({x for x, _ in given.values()}))}
    rows = {y: k for k, y in enumerate(sorted({y for _, y in given.values()}))}
    taken: set[tuple[int, int]] = set()
    for name, (x, y) in given.items():
        cell = columns[x], rows[y]
        while cell in taken:
            cell = cell[0], cell[1] + 1
        taken.add(cell)
        boxes[name].column, boxes[name].row = cell


def _layered(diagram: Diagram) -> dict[str, tuple[float, float]]:
    """Return columns by longest path once the feedback wires are left out, rows in order."""
    graph = nx.DiGraph()
    graph.add_nodes_from(diagram.nodes)
    for source, target in dict.fromkeys((w.source.block, w.target.block) for w in diagram.wires):
        if source != target and not nx.has_path(graph, target, source):
            graph.add_edge(source, target)
    layers = enumerate(nx.topological_generations(graph))
    return {name: (float(column), float(row)) for column, layer in layers for row, name in enumerate(layer)}


def _route(
    boxes: Mapping[str, _Box], source: Endpoint, target: Endpoint, channels: list[_Lanes], streets: list[_Lanes]
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


def _measure(
    boxes: Mapping[str, _Box], columns: int, rows: int, channels: list[_Lanes], streets: list[_Lanes]
) -> tuple[float, float, list[float], list[float]]:
    """Place boxes in px; return the size of the sheet and where channels and streets begin."""
    wide = [max((b.width for b in boxes.values() if b.column == c), default=0.0) for c in range(columns)]
    high = [max((b.height for b in boxes.values() if b.row == r), default=0.0) for r in range(rows)]
    left, right = _gaps(0.0, [channel.width for channel in channels], wide)
    top, bottom = _gaps(34.0, [street.width - MARGIN for street in streets], high)
    for box in boxes.values():
        box.x = right[box.column] + (wide[box.column] - box.width) / 2
        box.y = bottom[box.row] + (high[box.row] - box.height) / 2
    return right[-1], bottom[-1] + 8, left, top


def _gaps(start: float, gaps: list[float], sizes: list[float]) -> tuple[list[float], list[float]]:
    """Return where gaps begin and end, with boxes of these sizes between them."""
    ends = list(accumulate((size for pair in zip(gaps, [*sizes, 0.0], strict=True) for size in pair), initial=start))
    return ends[:-1:2], ends[1::2]


def _points(
    boxes: Mapping[str, _Box],
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


def _wire(
    points: list[tuple[float, float]], colour: str, source: Endpoint, target: Endpoint, width: float = 1.3
) -> str:
    path = "M" + " L".join(f"{x:.1f},{y:.1f}" for x, y in points)
    x, y = points[-1]
    parts = [
        f'<path d="{path}" fill="none" stroke="{colour}" stroke-width="{width}"/>',
        f'<path d="M{x:.1f},{y:.1f} l-7,-3.2 v6.4 z" fill="{colour}"/>',
    ]
    # an index is written at the other end, where the wire is alone
    for end, (at_x, at_y), anchor in ((target, points[0], "start"), (source, points[-1], "end")):
        if end.index:
            text = str(end)[len(f"{end.block}.{end.port}") :]
            shift = 3 if anchor == "start" else -9
            parts.append(
                f'<text x="{at_x + shift:.1f}" y="{at_y - 3:.1f}" font-size="9" fill="{colour}" '
                f'text-anchor="{anchor}">{escape(text)}</text>'
            )
    return "\n".join(parts)


def _label(point: tuple[float, float], colour: str, text: str, *, before: bool) -> str:
    """Return what is written on a wire where it begins, or before it ends, on white: lines behind it do not disturb."""
    x, y = point
    shift, anchor = (-9, "end") if before else (3, "start")
    return (
        f'<text x="{x + shift:.1f}" y="{y - 5:.1f}" font-size="10.5" font-weight="bold" fill="{colour}" stroke="white" '
        f'stroke-width="3" paint-order="stroke" text-anchor="{anchor}">{escape(text)}</text>'
    )


def _branches(corners: Iterable[list[tuple[float, float]]]) -> list[tuple[float, float]]:
    """Return the first corner of every wire of a signal of several wires: there its line branches."""
    wires = list(corners)
    if len(wires) < 2:
        return []
    return list(dict.fromkeys((round(wire[0][0], 1), round(wire[0][1], 1)) for wire in wires if wire))


def _dot(point: tuple[float, float], colour: str) -> str:
    return f'<circle cx="{point[0]:.1f}" cy="{point[1]:.1f}" r="2.4" fill="{colour}"/>'


def _box(box: _Box, frame: str | None) -> str:
    node = box.node
    fill = FILL.get(node.block.category, FILL["elementary"])
    stroke, line = (frame, 3.0) if frame else ("#444444", 1.1)
    middle = box.x + (box.width + 8 if box.marks else box.width) / 2
    base = box.y + (box.height / 2 - 3 if box.plain else 16)
    parts = [
        f'<rect x="{box.x:.1f}" y="{box.y:.1f}" width="{box.width:.1f}" height="{box.height:.1f}" rx="5" '
        f'fill="{fill}" stroke="{escape(stroke)}" stroke-width="{line}"/>',
        f'<text x="{middle:.1f}" y="{base:.1f}" font-size="12.5" font-weight="bold" text-anchor="middle">'
        f"{escape(node.name)}</text>",
        f'<text x="{middle:.1f}" y="{base + 14:.1f}" font-size="10.5" fill="#666666" text-anchor="middle">'
        f"{escape(box.kind)}</text>",
    ]
    parts += [
        f'<text x="{box.x + 4:.1f}" y="{box.port_y(name, is_input=True) + 3.5:.1f}" font-size="11" '
        f'fill="#333333">{sign}</text>'
        for name, sign in box.marks.items()
    ]
    if not box.plain:
        for names, is_input in ((box.inputs, True), (box.outputs, False)):
            x = box.x + 6 if is_input else box.x + box.width - 6
            anchor = "start" if is_input else "end"
            parts += [
                f'<text x="{x:.1f}" y="{box.port_y(name, is_input=is_input) + 3.5:.1f}" font-size="10" '
                f'fill="#333333" text-anchor="{anchor}">{escape(name)}</text>'
                for name in names
            ]
    return "\n".join(parts)
