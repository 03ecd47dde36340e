"""A block on its way from the document to the diagram."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rotorsim.block import Block
from rotorsim.diagram.parse.document import RawBlock
from rotorsim.diagram.resolve.shapes import ShapeTerm, Unifier
from rotorsim.diagram.resolve.template import Template


@dataclass
class Draft:
    """A block whose class and options are known.

    given: SI arrays of the parameters given, of any shape still. references: parameter -> diagram parameter. wired:
    inputs that a wire leads to. variables: of the unifier, for the words in its shapes ("#" before a dimension).
    """

    raw: RawBlock
    cls: type[Block]
    options: dict[str, Any]
    template: Template
    given: dict[str, np.ndarray] = field(default_factory=dict)
    references: dict[str, str] = field(default_factory=dict)
    wired: set[str] = field(default_factory=set)
    variables: dict[str, int] = field(default_factory=dict)

    def term(self, declared: Any, unifier: Unifier) -> ShapeTerm:
        """Return the shape term of a declared shape, with the variables of this block for its words."""
        if isinstance(declared, str):
            if declared not in self.variables:
                self.variables[declared] = unifier.new_shape()
            return self.variables[declared]
        for word in declared:
            if isinstance(word, str) and f"#{word}" not in self.variables:
                self.variables[f"#{word}"] = unifier.new_dimension()
        return tuple(self.variables[f"#{d}"] if isinstance(d, str) else d for d in declared)
