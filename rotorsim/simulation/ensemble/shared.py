"""What all runs of an ensemble share."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from rotorsim.model.compiled import Model
from rotorsim.simulation.ensemble.reductions import Columns, Wanted


@dataclass(frozen=True)
class Setup:
    """What all runs of an ensemble share. angle: name of the shaft angle, empty where there is none.

    names: signals that are kept. limited: whether blocks state limits of their inputs, which are watched, too.
    """

    model: Model
    names: tuple[str, ...]
    angle: str
    n_steps: int
    every: int
    method: str
    wanted: Wanted
    use_compiler: bool = True
    limited: bool = False

    @property
    def with_end(self) -> bool:
        """Whether the end of a run is a recorded row."""
        return self.n_steps % self.every == 0


def recorded_columns(model: Model, names: tuple[str, ...], angle: str, radii: bool) -> tuple[list[ca.SX], Columns]:
    """Return the expressions of a row, and where things lie in it; the residuals of loops come behind."""
    expressions: list[ca.SX] = []
    size = 0

    def add(expression: ca.SX) -> slice:
        nonlocal size
        expressions.append(expression)
        size += expression.numel()
        return slice(size - expression.numel(), size)

    signals = {name: (add(model.expression(name)), model.shape_of(name)) for name in names}
    distances = {}
    for name, (_, shape) in signals.items():
        if radii and shape[-1:] == (2,):
            x, y = (model.expression(name)[k::2] for k in (0, 1))
            distances[name] = add(ca.sqrt(x**2 + y**2)), shape[:-1]
    at = (0, 0, 0)
    if angle:
        theta = model.expression(angle)
        at = (add(ca.cos(theta)).start, add(ca.sin(theta)).start, add(theta).start)
    loops = model.trace.loop_residuals.numel()
    return expressions, Columns(signals, distances, at, slice(size, size + loops), size + loops)
