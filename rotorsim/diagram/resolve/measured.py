"""What the recordings of a diagram mean: signals behind the model of a sensor, under the name they were recorded by."""

from __future__ import annotations

from collections.abc import Mapping

from rotorsim.block import Shape
from rotorsim.diagram.diagram import Endpoint, Node
from rotorsim.diagram.parse.document import FlatDocument, endpoint
from rotorsim.diagram.resolve.fitting import Fitting

_FORM = '"measured": {"rotor.displacement": "sensor.sensed_displacement"}'


def measured_signals(
    flat: FlatDocument, fitting: Fitting, nodes: Mapping[str, Node], removed: frozenset[str]
) -> dict[Endpoint, Endpoint]:
    """Return what ``measured`` of a document says, recorded signal -> signal of the diagram; add its mistakes."""
    given = flat.data.get("measured")
    measured: dict[Endpoint, Endpoint] = {}

    def error(what: str, name: str, hint: str = "", *, key: bool = False) -> None:
        place = flat.source.place(("measured", name), key=key)
        flat.problems.error(what, f"measured.{name}", place, hint)

    for name, value in given.items() if isinstance(given, Mapping) else ():
        said, meant = endpoint(name), endpoint(value)
        if said is None or meant is None:
            shown = repr(name if said is None else value)[:60]
            error(f"{shown} is not a signal", name, _FORM, key=said is None)
            continue
        if said.block in removed or meant.block in removed:
            continue
        ends = ((said, True), (meant, False))
        if not all(fitting.is_signal(end, flat.source.place(("measured", name), key=key)) for end, key in ends):
            continue
        shapes = [_shape(nodes[end.block], end) for end, _ in ends]
        if shapes[0] != shapes[1]:
            sizes = [" x ".join(map(str, shape)) or "a single number" for shape in shapes]
            error(f"'{said}' is {sizes[0]}, '{meant}' is {sizes[1]}", name, "both are the same quantity")
        else:
            measured[said] = meant
    return measured


def _shape(node: Node, end: Endpoint) -> Shape:
    port = node.outputs.get(end.port) or node.inputs[end.port]
    return port.shape[len(end.index) :]
