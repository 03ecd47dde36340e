"""Meshes so fine that a recording does not show what finer ones would change."""

from __future__ import annotations

from typing import Protocol, Self, TypeVar

from rotorsim.criteria import CRITERIA
from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import RotorsimError
from rotorsim.model.heard import gives_up

FINEST = 8
BY_HALVING = 256  # of the square of what meshes get wrong, by half the length: cubic elements err with its fourth power


class Judged(Protocol):
    """What a fit leaves."""

    @property
    def adequate(self) -> bool:
        """Whether noise explains what it leaves."""


class MeshedFit(Protocol):
    """The fit of a diagram that has meshes to a recording."""

    @property
    def estimate(self) -> Judged:
        """What the fit leaves."""

    def change(self, block: str, parts: int) -> float:
        """Return the square of what a finer mesh of a block changes in the whitened prediction.

        Raises RotorsimError where that cannot be predicted.
        """

    def finer(self, block: str, parts: int) -> Self:
        """Return the fit with a finer mesh of a block, from where this one ended. Raises RotorsimError."""

    def worse_by(self, other: Self) -> float:
        """Return how much more another fit leaves, as a weighted sum of squares."""


Meshed = TypeVar("Meshed", bound=MeshedFit)


def on_fine_meshes(diagram: Diagram, fit: Meshed) -> tuple[Meshed, list[str]]:
    """Return the fit of a diagram on meshes so fine that finer ones change nothing, and what was refined.

    A block that declares ``refinement`` is refined until a finer mesh changes the whitened prediction by less than
    `Criteria.mesh_visible` (sum of squares). One that explains the data stays where a finer one explains less of them:
    they are of that mesh.
    """
    notes: list[str] = []
    for name, node in diagram.nodes.items():
        option = node.block.refinement
        if option is None:
            continue
        level, told = int(getattr(node.block.option, option)), ""
        while level < FINEST:
            try:
                change = fit.change(name, 2 * level)
                if change <= CRITERIA.mesh_visible:
                    break
                finer = fit.finer(name, 2 * level)
            except RotorsimError as error:
                if gives_up(error):
                    raise
                told += "; " if told else ""
                told += f"{option} {2 * level} cannot be compared ({error.problems[0].what})"
                break
            if fit.estimate.adequate and fit.worse_by(finer) > CRITERIA.mesh_visible:
                break
            fit, level = finer, 2 * level
            told = f"{option} {level}, for what the coarser mesh gets wrong shows in these data"
            if level >= FINEST and change > BY_HALVING * CRITERIA.mesh_visible:
                told += "; a finer one would show, too"
        notes += [f"{name}: {told}"] if told else []
    return fit, notes
