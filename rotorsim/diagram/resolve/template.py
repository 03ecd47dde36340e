"""What a block declares under its options and wiring, which like blocks of a diagram share."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np

from rotorsim.block import Block, In, Out, Shape
from rotorsim.diagram.parse.document import NAME_PATTERN
from rotorsim.diagram.resolve.values import numeric


class Template:
    """What all blocks of one class with the same options and wired inputs share.

    words: whether a shape has parts that only wires or values tell. defaults: SI arrays; fixed: those of resolved shape
    where there are no such words.
    """

    def __init__(self, cls: type[Block], options: Mapping[str, Any], wired: frozenset[str]) -> None:
        self.block = block = cls(options, wired)
        self.inputs: dict[str, In] = {n: d for d in cls.inputs.values() for n in block.port_names(d)}
        self.outputs: dict[str, Out] = {n: d for d in cls.outputs.values() for n in block.port_names(d)}
        self.input_shapes = {name: block.declared_shape(d, name) for name, d in self.inputs.items()}
        self.output_shapes = {name: block.declared_shape(d, name) for name, d in self.outputs.items()}
        self.parameter_shapes = {name: block.declared_shape(d) for name, d in cls.parameters.items()}
        self.state_shapes = {name: block.declared_shape(d) for name, d in block.active_states().items()}
        self.random_shapes = {name: block.declared_shape(d) for name, d in cls.randoms.items()}
        groups = (self.input_shapes, self.output_shapes, self.parameter_shapes, self.state_shapes, self.random_shapes)
        shapes = [shape for group in groups for shape in group.values()]
        self.words = any(isinstance(s, str) or any(isinstance(d, str) for d in s) for s in shapes)
        self.defaults = {n: numeric(d.default, d.unit) for n, d in cls.parameters.items() if d.default is not None}
        self.fixed = {n: filled(v, self.parameter_shapes[n]) for n, v in self.defaults.items() if not self.words}

    def ports(self, is_input: bool) -> Mapping[str, In] | Mapping[str, Out]:
        """Return the inputs or the outputs."""
        return self.inputs if is_input else self.outputs

    def port_shape(self, port: str, is_input: bool) -> Any:
        """Return the declared shape of an input or output."""
        return (self.input_shapes if is_input else self.output_shapes)[port]

    @cached_property
    def bad_names(self) -> list[str]:
        """What cannot be a name of a port among the names that options give."""
        bad: list[str] = []
        for group in (self.block.inputs, self.block.outputs):
            names = [(name, d.many) for d in group.values() for name in self.block.port_names(d)]
            count = Counter(name for name, _ in names)
            bad += [name for name, many in names if many and (count[name] > 1 or not NAME_PATTERN.fullmatch(name))]
        return list(dict.fromkeys(bad))


class Templates:
    """The templates of one diagram."""

    def __init__(self) -> None:
        self._made: dict[Any, Template] = {}

    def of(self, cls: type[Block], options: Mapping[str, Any], wired: frozenset[str] = frozenset()) -> Template:
        """Return the shared template; raises whatever the code of the block raises."""
        key = (cls, _frozen(options), wired)
        if key not in self._made:
            self._made[key] = Template(cls, options, wired)
        return self._made[key]


def _frozen(value: Any) -> Any:
    """Return an option value as something that can be a key."""
    if isinstance(value, list | tuple):
        return tuple(_frozen(item) for item in value)
    if isinstance(value, Mapping):
        return tuple((key, _frozen(item)) for key, item in value.items())
    return (type(value).__name__, value)


def filled(value: np.ndarray, shape: Shape) -> np.ndarray:
    """Return a scalar as an array of a shape, any other value as it is; read-only."""
    result = np.full(shape, value) if value.ndim == 0 and shape else value
    result.setflags(write=False)  # like blocks share it
    return result
