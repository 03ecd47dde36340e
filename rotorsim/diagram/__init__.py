"""JSON <-> Diagram: validation with file:line:col, the networkx graph, swap, diff, registry."""

from rotorsim.diagram.diagram import Diagram, Endpoint, Node, Port, Solver, Wire
from rotorsim.diagram.load import load, shipped_diagrams

__all__ = ["Diagram", "Endpoint", "Node", "Port", "Solver", "Wire", "load", "shipped_diagrams"]
