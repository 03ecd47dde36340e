"""Diagram -> CasADi functions -> C -> shared library, with a cache and one C runtime."""

from rotorsim.compile.model import Model, compile_diagram
from rotorsim.compile.trace import Signal, Trace, trace_diagram

__all__ = ["Model", "Signal", "Trace", "compile_diagram", "trace_diagram"]
