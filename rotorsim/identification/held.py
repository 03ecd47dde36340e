"""Parameters that nobody measured and a diagram holds at a value: whether a recording contradicts it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.stats import norm

from rotorsim.criteria import CRITERIA
from rotorsim.diagram.diagram import Diagram, Free
from rotorsim.diagram.resolve.free import uncertain_parameters
from rotorsim.errors import Problem, RotorsimError
from rotorsim.model.heard import gives_up
from rotorsim.units import format_quantity

MOVED_BY = 1.0  # standard deviations by which a parameter moves, to be named: beyond, most of its 90 % interval is left


@dataclass(frozen=True, eq=False)
class Estimated:
    """Estimates theta (m,) of the free parameters, and their standard deviations (m,), as the residual scatters.

    Infinite where a parameter is at a bound, or the data say nothing of it.
    """

    free: Sequence[Free]
    theta: np.ndarray
    std: np.ndarray


class FreeingFit(Protocol):
    """A fit that can be had with more free."""

    def freed(self, more: Sequence[Free] = ()) -> Estimated:
        """Return what is estimated with more parameters free, from where this fit ended. Raises RotorsimError."""


def contradictions_of(diagram: Diagram, fit: FreeingFit) -> list[Problem]:
    """Return warnings of parameters that are held and, if they were free, would be others.

    Those that blocks declare with a tolerance, the prior of a Wald test at `Criteria.not_explained`.
    """
    held = uncertain_parameters(diagram)
    if not held:
        return []
    try:
        before, after = fit.freed(), fit.freed(held)
    except RotorsimError as error:
        if gives_up(error):
            raise
        return []
    estimates = {item.name: k for k, item in enumerate(after.free)}
    limit = float(norm.isf(CRITERIA.not_explained / 2))
    problems = []
    for item in held:
        k = estimates.get(item.name)
        if k is None or not abs(after.theta[k] - item.value) > limit * after.std[k]:
            continue
        says = f"{format_quantity(after.theta[k], item.unit)} with a standard deviation of "
        says += format_quantity(after.std[k], item.unit)
        what = f"is held at {format_quantity(item.value, item.unit)}, but the recording says {says}"
        hint = f'free it: "identify": {{"{item.name}": {{}}, ...}}{_moves(before, after)}'
        problems.append(Problem(what, item.name, hint=hint, severity="warning"))
    return problems


def with_contradictions(statement: str, problems: Sequence[Problem]) -> str:
    """Return what was found in plain words, with what is held at values that the recording contradicts."""
    if not problems:
        return statement
    names = [problem.subject for problem in problems]
    held = f"value at which {names[0]} is" if len(names) == 1 else f"values at which {' and '.join(names)} are"
    wrong = (
        f"The recording contradicts the {held} held: the intervals hold only if that does not matter to a parameter."
    )
    return f"{wrong} {statement}"


def _moves(before: Estimated, after: Estimated) -> str:
    """Return which parameters move with what is free, and how far."""
    estimates = {item.name: value for item, value in zip(after.free, after.theta, strict=True)}
    pairs = zip(before.free, before.theta, before.std, strict=True)
    moved = {item.name: abs(estimates[item.name] - value) / std for item, value, std in pairs if item.name in estimates}
    far = sorted((name for name, by in moved.items() if by > MOVED_BY), key=lambda name: -moved[name])
    told = ", ".join(f"{name} by {moved[name]:.2g}" for name in far)
    return f"; that moves {told} standard deviations" if told else ""
