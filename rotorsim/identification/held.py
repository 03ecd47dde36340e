"""Parameters that nobody measured and a diagram holds at a value: whether a recording contradicts it."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.stats import norm

from rotorsim.criteria import CRITERIA
from rotorsim.diagram.diagram import Diagram, Free
from rotorsim.diagram.resolve.free import uncertain_parameters
from rotorsim.errors import Problem, RotorsimError
from rotorsim.identification.harmonic.coordinates import ANGLE_UNIT
from rotorsim.model.heard import gives_up
from rotorsim.recordings.orders import OrderRun
from rotorsim.recordings.recording import Run
from rotorsim.units import format_quantity

CONTRADICTED = "held_value"  # code of what the recording contradicts
DIGITS_SAID = 3  # of what a recording says
MOVED_BY = 1.0  # standard deviations by which a parameter moves, to be named: beyond, most of its 90 % interval is left


@dataclass(frozen=True, eq=False)
class Estimated:
    """Estimates theta (m,) of the free parameters, and their standard deviations (m,), as the residual scatters.

    at_bound (m,): where the search ended at one. misfit: weighted sum of squares; widening: what standard deviations
    were multiplied by for its size.
    """

    free: Sequence[Free]
    theta: np.ndarray
    std: np.ndarray
    at_bound: np.ndarray
    misfit: float
    widening: float = 1.0


class FreeingFit(Protocol):
    """A fit that can be had with more free."""

    def freed(self, more: Sequence[Free] = ()) -> Estimated:
        """Return what is estimated with more parameters free, from where this fit ended. Raises RotorsimError."""


def contradictions_of(diagram: Diagram, fit: FreeingFit, known: Collection[str] = ()) -> list[Problem]:
    """Return warnings of parameters that are held and, if they were free, would be others.

    Those that blocks declare with a tolerance, the prior of a Wald test at `Criteria.not_explained`; at a bound, the
    fall of the misfit is tested. known: what the runs set.
    """
    held = [item for item in uncertain_parameters(diagram) if not {item.name, item.base} & {*known}]
    if not held:
        return []
    try:
        before, after = fit.freed(), fit.freed(held)
    except RotorsimError as error:
        if gives_up(error):
            raise
        names = " and ".join(item.name for item in held)
        what = f"whether the recording contradicts what is held was not judged ({error.problems[0].what})"
        return [Problem(what, names, severity="warning")]
    estimates = {item.name: k for k, item in enumerate(after.free)}
    limit = float(norm.isf(CRITERIA.not_explained / 2))
    problems = []
    for item in held:
        k = estimates.get(item.name)
        if k is None:
            continue
        if after.at_bound[k]:
            off, std = np.sqrt(max(before.misfit - after.misfit, 0.0)), after.widening
            bound = min(item.low, item.high, key=lambda end: abs(end - after.theta[k]))
            says = f"{format_quantity(bound, item.unit)}, its bound"
        else:
            off, std = abs(after.theta[k] - item.value), after.std[k]
            says = f"{format_quantity(after.theta[k], item.unit, DIGITS_SAID)} with a standard deviation of "
            says += format_quantity(std, item.unit, DIGITS_SAID)
        if not off > limit * std:
            continue
        what = f"is held at {format_quantity(item.value, item.unit)}, but the recording says {says}"
        hint = f'free it: "identify": {{"{item.name}": {{}}, ...}}{_moves(before, after)}'
        problems.append(Problem(what, item.name, hint=hint, severity="warning", code=CONTRADICTED))
    return problems


def settings_of(runs: Iterable[Run | OrderRun]) -> set[str]:
    """Return the parameters that runs set."""
    return {name for run in runs for name in run.settings}


def is_contradicted(problems: Iterable[Problem]) -> bool:
    """Return whether the recording contradicts a value that is held."""
    return any(problem.code == CONTRADICTED for problem in problems)


def with_contradictions(statement: str, problems: Sequence[Problem], adequate: bool) -> str:
    """Return what was found in plain words, with what is held at values that the recording contradicts.

    It is said first where it is all that is wrong.
    """
    names = [problem.subject for problem in problems if problem.code == CONTRADICTED]
    if not names:
        return statement
    held = f"value at which {names[0]} is" if len(names) == 1 else f"values at which {' and '.join(names)} are"
    matters = "the intervals hold only if that does not matter to a parameter."
    wrong = f"The recording contradicts the {held} held: {matters}"
    return f"{wrong} {statement}" if adequate else f"{statement} {wrong}"


def _moves(before: Estimated, after: Estimated) -> str:
    """Return which parameters move with what is free, and how far."""
    estimates = {item.name: value for item, value in zip(after.free, after.theta, strict=True)}
    moved = {}
    stds = np.where(before.at_bound, np.inf, before.std)
    for item, value, std in zip(before.free, before.theta, stds, strict=True):
        if item.name not in estimates or not 0 < std < np.inf:
            continue
        by = estimates[item.name] - value
        moved[item.name] = abs(np.angle(np.exp(1j * by)) if item.unit == ANGLE_UNIT else by) / std
    far = sorted((name for name, by in moved.items() if by > MOVED_BY), key=lambda name: -moved[name])
    told = ", ".join(f"{name} by {moved[name]:.2g}" for name in far)
    return f"; that moves {told} standard deviations" if told else ""
