"""Finding the shapes of ports, parameters and states: unification of declared shapes over a diagram.

A shape term is a tuple of dimension terms, or a variable (a whole number) for a whole shape. A dimension
term is a whole number >= 0, or a variable, written as a negative number. Variables that must be equal are
joined (union-find), so the cost is almost linear in the number of wires.
"""

from __future__ import annotations

from rotorsim.block import Shape

__all__ = ["DimensionTerm", "ShapeTerm", "Unifier", "text_of"]

DimensionTerm = int
ShapeTerm = int | tuple[DimensionTerm, ...]


class Unifier:
    """Shape and dimension variables with what is known of them."""

    def __init__(self) -> None:
        self._shapes: list[ShapeTerm | None] = []  # parent variable, tuple of dimensions, or None (unknown)
        self._dimensions: list[DimensionTerm | None] = []  # parent variable (negative), number, or None

    def new_shape(self) -> int:
        """Return a new variable for a whole shape."""
        self._shapes.append(None)
        return len(self._shapes) - 1

    def new_dimension(self) -> int:
        """Return a new variable for a dimension."""
        self._dimensions.append(None)
        return -len(self._dimensions)

    def shape(self, term: ShapeTerm) -> ShapeTerm:
        """Return the tuple of dimensions of a term, or the variable that stands for it."""
        if isinstance(term, tuple):
            return term
        while True:
            value = self._shapes[term]
            if value is None:
                return term
            if isinstance(value, tuple):
                return value
            after = self._shapes[value]
            if isinstance(after, int):
                self._shapes[term] = after  # halve the path
            term = value

    def dimension(self, term: DimensionTerm) -> DimensionTerm:
        """Return the number of a dimension, or the variable that stands for it."""
        while term < 0:
            value = self._dimensions[-term - 1]
            if value is None:
                return term
            term = value
        return term

    def resolved(self, term: ShapeTerm) -> Shape | None:
        """Return the shape as numbers, or None if a part is still unknown."""
        found = self.shape(term)
        if isinstance(found, int):
            return None
        numbers = tuple(self.dimension(d) for d in found)
        return None if any(d < 0 for d in numbers) else numbers

    def unify(self, a: ShapeTerm, b: ShapeTerm) -> bool:
        """Make two shapes equal; return False (and change nothing that matters) if they cannot be."""
        a, b = self.shape(a), self.shape(b)
        if isinstance(a, int):
            if a != b:
                self._shapes[a] = b
            return True
        if isinstance(b, int):
            self._shapes[b] = a
            return True
        if len(a) != len(b):
            if not a and len(b) == 1:  # one entry fits a scalar
                return self.unify_dimension(b[0], 1)
            if not b and len(a) == 1:
                return self.unify_dimension(a[0], 1)
            return False
        fits = [self.unify_dimension(x, y) for x, y in zip(a, b, strict=True)]
        return all(fits)

    def unify_dimension(self, a: DimensionTerm, b: DimensionTerm) -> bool:
        """Make two dimensions equal; return False if they are different numbers."""
        a, b = self.dimension(a), self.dimension(b)
        if a < 0:
            if a != b:
                self._dimensions[-a - 1] = b
            return True
        if b < 0:
            self._dimensions[-b - 1] = a
            return True
        return a == b


def text_of(shape: ShapeTerm, unifier: Unifier | None = None) -> str:
    """Return a shape for messages: ``scalar``, ``(2,)``, ``(11, 2)``, with ? for what is unknown."""
    found = unifier.shape(shape) if unifier else shape
    if isinstance(found, int):
        return "unknown shape"
    if not found:
        return "scalar"
    numbers = [unifier.dimension(d) if unifier else d for d in found]
    inside = ", ".join(str(d) if d >= 0 else "?" for d in numbers)
    return f"({inside},)" if len(numbers) == 1 else f"({inside})"
