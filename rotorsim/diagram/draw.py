"""Draw a diagram as SVG."""

from __future__ import annotations

from collections.abc import Mapping

from rotorsim.diagram.diagram import Diagram, Endpoint
from rotorsim.diagram.sheet import MARGIN, Box, Key, Sheet, sheet_of
from rotorsim.errors import escape

MARKED, BESIDE = 3.5, "#8796a0"  # px: width of a wire that is marked; colour of the others then
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#8c5fa8", "#b8860b", "#56697a", "#a0522d", "#3b7a57")
FILL = {
    "rotor": "#dcebf7",
    "bearing": "#e2f2e6",
    "controller": "#fdeedb",
    "excitation": "#fbe4dd",
    "clock": "#efe7f5",
    "diagram": "#e8ebee",
    "elementary": "#f4f4f2",
}


def colours_of(sheet: Sheet) -> dict[Key, str]:
    """Return the colour of each signal."""
    return {
        key: COLOURS[k % len(COLOURS)] for k, key in enumerate(dict.fromkeys(drawn.signal for drawn in sheet.wires))
    }


def draw_svg(
    diagram: Diagram, highlight: Mapping[str, str] | None = None, marked: Mapping[Key, tuple[str, str]] | None = None
) -> str:
    """Return the diagram as SVG text.

    Blocks stand where the document's ``layout`` says ([column, row]), else in layers from left to right.
    highlight: block -> colour of its frame. marked: (block, port) -> colour of the wires of an output, or of the one
    into an input, and what is written there. Wires of one output share a line and branch at dots.
    """
    marked = marked or {}
    sheet = sheet_of(diagram)
    parts = [_box(box, (highlight or {}).get(name)) for name, box in sheet.boxes.items()]
    colour = colours_of(sheet)
    if marked:
        colour = dict.fromkeys(colour, BESIDE) | {key: shade for key, (shade, _) in marked.items()}
    lines: list[str] = []
    written: dict[Key, str] = {}
    for drawn in sorted(sheet.wires, key=lambda drawn: (drawn.target.block, drawn.target.port) in marked):
        source, target = drawn.source, drawn.target
        into = target.block, target.port
        mark = into if into in marked else drawn.signal
        shade = marked[into][0] if into in marked else colour[drawn.signal]
        lines.append(_wire(drawn.points, shade, source, target, MARKED if mark in marked else 1.3))
        if mark in marked and mark not in written:
            at = drawn.points[0 if mark == drawn.signal else -1]
            written[mark] = _label(at, *marked[mark], before=mark == into)
    marks = [_dot(point, colour[signal]) for point, signal in sheet.dots]
    width, height = sheet.width, sheet.height
    title = escape(diagram.name)
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.0f}" height="{height:.0f}" '
        f'viewBox="0 0 {width:.0f} {height:.0f}" font-family="Helvetica, Arial, sans-serif">\n'
        f"<title>{title}</title>\n"
        '<rect width="100%" height="100%" fill="white"/>\n'
        f'<text x="{MARGIN}" y="26" font-size="17" font-weight="bold">{title}</text>'
    )
    return "\n".join([head, *lines, *marks, *parts, *written.values(), "</svg>"]) + "\n"


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


def _dot(point: tuple[float, float], colour: str) -> str:
    return f'<circle cx="{point[0]:.1f}" cy="{point[1]:.1f}" r="2.4" fill="{colour}"/>'


def _box(box: Box, frame: str | None) -> str:
    node = box.node
    fill = FILL.get(box.category, FILL["elementary"])
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
    parts += [_tag(box, side == "inputs", port, text) for (side, port), text in box.tags.items()]
    return "\n".join(parts)


def _tag(box: Box, is_input: bool, port: str, text: str) -> str:
    """Return an arrow with the name of a port of the diagram, at the port of the block that it leads to."""
    x, y = (box.x if is_input else box.x + box.width), box.port_y(port, is_input=is_input)
    tip, anchor, shift, lift = (x - 3, "end", -10, 3.5) if is_input else (x + 12, "start", 3, -4)
    return (
        f'<path d="M{tip:.1f},{y:.1f} l-8,-4.5 v9 z" fill="#005a8c"/>'
        f'<text x="{tip + shift:.1f}" y="{y + lift:.1f}" font-size="10" font-weight="bold" fill="#005a8c" '
        f'stroke="white" stroke-width="3" paint-order="stroke" text-anchor="{anchor}">{escape(text)}</text>'
    )
