"""Parts of a diagram whose equations are those of a mode, which events change: declared here, carried out by a run."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, Protocol

import casadi as ca
import numpy as np

from rotorsim.block import unflatten
from rotorsim.model.compiled import Model


class Mode(Protocol):
    """The mode of one part, in one run with values of its parameters.

    n_indicators: of its event indicators; that one is above zero, or not, is its side. reports: it wants to be told of
    every completed step. due: time [s] of its next time event, infinity where there is none. *The present point* is
    where its rates were asked for last.
    """

    n_indicators: int
    reports: bool
    due: float

    @property
    def can_go_back(self) -> bool:
        """Whether all that was saved since `begin` can be restored."""

    def begin(self) -> None:
        """Begin anew at t = 0."""

    def end(self) -> None:
        """End the run: whoever asks for the equations next finds the mode in which the part begins."""

    def guard(self, on: bool) -> None:
        """Say whether the equations end where an event is due, or go on as if there was none."""

    def inputs(self) -> np.ndarray:
        """Return the inputs at the present point."""

    def indicators(self) -> np.ndarray:
        """Return the event indicators (n_indicators,) at the present point."""

    def sides(self) -> np.ndarray:
        """Return which indicators (n_indicators,) are above zero in the mode."""

    def settle(self) -> None:
        """Take the sides at the present point as those of the mode."""

    def completed(self, t: float, x: np.ndarray) -> bool:
        """Tell the part that a step to t with its states x is accepted; return whether it wants an event."""

    def completed_callback(self) -> tuple[int, int] | None:
        """Return the addresses of a function of C and of its context, None where there is none.

        It does what `completed` does, at the present point, and returns what the part wants, 0 for nothing.
        """

    def completed_result(self, t: float, said: int) -> bool:
        """Take what that of `completed_callback` returned at t, the last time; return whether the part wants an event.

        It is not told again, but where it was not told at all. Raises what `completed` raises.
        """

    def event(self, t: float, x: np.ndarray) -> np.ndarray:
        """Carry out an event at t, with its states x and the inputs of the present point; return its states then."""

    def save(self) -> Any:
        """Return what `restore` needs."""

    def restore(self, saved: Any) -> None:
        """Go back to a saved mode. Raises RotorsimError where events came between and the part cannot be set back."""


@dataclass(frozen=True)
class ModeOf:
    """The mode of a block; part: where its states lie in x."""

    block: str
    mode: Mode
    part: slice


def modes_of(model: Model, p: np.ndarray) -> list[ModeOf]:
    """Return the modes of the blocks of a diagram with parameters p (n_p,) that have any."""
    found = []
    for name, node in model.diagram.nodes.items():
        if not node.block.opaque:
            continue
        values = {
            key: unflatten(ca.SX(p[model.parameters[f"{name}.{key}"]]), np.shape(value))
            for key, value in node.values.items()
        }
        mode = node.block.mode(SimpleNamespace(**values))
        if mode is not None:
            parts = [model.states[f"{name}.{key}"].part for key in node.state_shapes]
            found.append(ModeOf(name, mode, slice(parts[0].start, parts[-1].stop)))
    return found
