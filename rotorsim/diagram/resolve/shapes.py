"""Finding the shapes of ports, parameters and states: unification of declared shapes over a diagram.

A shape term is a tuple of dimension terms, or a variable for a whole shape. A dimension term is a whole number >= 0, or
a variable. Variables are negative numbers; those that must be equal are joined (union-find), so the cost is almost
linear in the number of wires.
"""

from __future__ import annotations

from typing import Generic, TypeVar

from rotorsim.block import Shape

DimensionTerm = int
ShapeTerm = int | tuple[DimensionTerm, ...]
Term = TypeVar("Term", DimensionTerm, ShapeTerm)


class _Variables(Generic[Term]):
    """Variables, each with what it has been joined with: another one, or a value."""

    def __init__(self) -> None:
        self._joined: list[Term | None] = []

    def new(self) -> int:
        self._joined.append(None)
        return -len(self._joined)

    def find(self, term: Term) -> Term:
        """Return the value of a term, or the variable that stands for it."""
        while isinstance(term, int) and term < 0:
            after = self._joined[-term - 1]
            if after is None:
                break
            if isinstance(after, int) and after < 0:  # halves the way
                self._joined[-term - 1] = self._joined[-after - 1] or after
            term = after
        return term

    def join(self, a: Term, b: Term) -> bool:
        """Make two terms, as `find` gives them, equal where one is a variable; return whether one is."""
        for one, other in ((a, b), (b, a)):
            if isinstance(one, int) and one < 0:
                if one != other:
                    self._joined[-one - 1] = other
                return True
        return False


class Unifier:
    """Shape and dimension variables with what is known of them."""

    def __init__(self) -> None:
        self._shapes, self._dimensions = _Variables[ShapeTerm](), _Variables[DimensionTerm]()
        self.new_shape, self.shape = self._shapes.new, self._shapes.find
        self.new_dimension, self.dimension = self._dimensions.new, self._dimensions.find

    def resolved(self, term: ShapeTerm) -> Shape | None:
        """Return the shape as numbers, or None if a part is still unknown."""
        shape = self.shape(term)
        if isinstance(shape, int):
            return None
        numbers = tuple(map(self.dimension, shape))
        return None if numbers and min(numbers) < 0 else numbers

    def unify(self, a: ShapeTerm, b: ShapeTerm) -> bool:
        """Make two shapes equal; return False (and change nothing that matters) if they cannot be."""
        a, b = self.shape(a), self.shape(b)
        if isinstance(a, int) or isinstance(b, int):
            return self._shapes.join(a, b)
        if len(a) + len(b) == 1:  # one entry fits a scalar
            return self.unify_dimension((a or b)[0], 1)
        fits = [self.unify_dimension(x, y) for x, y in zip(a, b, strict=True)] if len(a) == len(b) else [False]
        return all(fits)

    def unify_dimension(self, a: DimensionTerm, b: DimensionTerm) -> bool:
        """Make two dimensions equal; return False if they are different numbers."""
        a, b = self.dimension(a), self.dimension(b)
        return self._dimensions.join(a, b) or a == b


def text_of(shape: ShapeTerm, unifier: Unifier | None = None) -> str:
    """Return a shape for messages: ``scalar``, ``(2,)``, ``(11, 2)``, with ? for what is unknown."""
    known = unifier.shape(shape) if unifier else shape
    if isinstance(known, int):
        return "unknown shape"
    if not known:
        return "scalar"
    numbers = [unifier.dimension(d) if unifier else d for d in known]
    inside = ", ".join(str(d) if d >= 0 else "?" for d in numbers)
    return f"({inside},)" if len(numbers) == 1 else f"({inside})"
