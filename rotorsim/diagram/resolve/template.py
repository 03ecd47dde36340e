"""What a block declares under its options and wiring, and one block while it is checked."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rotorsim.block import Block, In, Out, Param, Shape
from rotorsim.diagram.parse.document import NAME, RawBlock
from rotorsim.diagram.resolve.shapes import ShapeTerm, Unifier
from rotorsim.diagram.resolve.values import numeric

__all__ = ["Template", "Work", "filled"]


class Template:
    """What all blocks of one class with the same options and wired inputs share."""

    def __init__(self, cls: type[Block], options: Mapping[str, Any], wired: frozenset[str]) -> None:
        self.block = block = cls(options, wired)
        self.inputs: dict[str, In] = {n: d for d in cls.inputs.values() for n in block.port_names(d)}
        self.outputs: dict[str, Out] = {n: d for d in cls.outputs.values() for n in block.port_names(d)}
        self.bad_names = _bad_names(block)
        self.parameters: dict[str, Param] = cls.parameters
        shape = block.declared_shape
        self.input_shapes = {name: block.port_shape(d, name) for name, d in self.inputs.items()}
        self.output_shapes = {name: block.port_shape(d, name) for name, d in self.outputs.items()}
        self.parameter_shapes = {name: shape(d) for name, d in cls.parameters.items()}
        self.state_shapes = {name: shape(d) for name, d in block.active_states().items()}
        self.random_shapes = {name: shape(d) for name, d in cls.randoms.items()}
        groups = (self.input_shapes, self.output_shapes, self.parameter_shapes, self.state_shapes, self.random_shapes)
        every = [s for group in groups for s in group.values()]
        self.words = any(isinstance(s, str) or any(isinstance(d, str) for d in s) for s in every)
        self.defaults = {
            name: numeric(d.default, d.unit) for name, d in cls.parameters.items() if d.default is not None
        }
        self.needed_inputs = [name for name, d in self.inputs.items() if not d.optional and not d.additive]
        self.fixed = (
            {} if self.words else {name: filled(v, self.parameter_shapes[name]) for name, v in self.defaults.items()}
        )
        self.has_check = cls.check is not Block.check


def _bad_names(block: Block) -> list[str]:
    """Return what cannot be a name of a port among the names that options give."""
    bad: list[str] = []
    for group in (block.inputs, block.outputs):
        names = [(name, d.many) for d in group.values() for name in block.port_names(d)]
        count = Counter(name for name, _ in names)
        bad += [name for name, many in names if many and (count[name] > 1 or not NAME.fullmatch(name))]
    return list(dict.fromkeys(bad))


def filled(value: np.ndarray, shape: Shape) -> np.ndarray:
    """Return a scalar as an array of a shape, any other value as it is; read-only."""
    result = np.full(shape, value) if value.ndim == 0 and shape else value
    result.setflags(write=False)  # like blocks share it
    return result


@dataclass
class Work:
    """One block while it is checked. given: SI arrays of given parameters, of any shape still."""

    raw: RawBlock
    cls: type[Block]
    options: dict[str, Any]
    key: Any
    template: Template
    given: dict[str, np.ndarray] = field(default_factory=dict)
    references: dict[str, str] = field(default_factory=dict)
    wired: set[str] = field(default_factory=set)
    variables: dict[str, Any] | None = None

    def term(self, declared: Any, unifier: Unifier) -> ShapeTerm:
        """Return the shape term of a declared shape, with the variables of this block for its words."""
        if isinstance(declared, tuple) and not any(isinstance(d, str) for d in declared):
            return declared
        if self.variables is None:
            self.variables = {}
        found = self.variables
        if isinstance(declared, str):
            key = declared
            if key not in found:
                found[key] = unifier.new_shape()
            return found[key]  # type: ignore[no-any-return]
        result = []
        for entry in declared:
            if isinstance(entry, str):
                key = "#" + entry
                if key not in found:
                    found[key] = unifier.new_dimension()
                entry = found[key]
            result.append(entry)
        return tuple(result)
