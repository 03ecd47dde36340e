"""The derivatives that an FMU for Model Exchange offers: which ones, and whether they are those of its equations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from rotorsim.fmi.description.model import FLOATS, ModelDescription
from rotorsim.model.heard import remark

OFFERED = "directional", "adjoint"  # in the order in which a Jacobian takes them
CHECKED = 1e-3  # of a column: far above the error of differences, far below a derivative that was forgotten


def offered_by(description: ModelDescription, inputs: Sequence[str], outputs: Sequence[str]) -> tuple[str, ...]:
    """Return which derivatives an FMU offers for all its states, these inputs and these outputs."""
    moving = [entry.variable for entry in description.resolve(outputs) if entry.variable.type in FLOATS]
    shown = all(v.type == FLOATS[0] and v.causality == "output" for v in moving)  # of others FMI has none
    if not shown or any(entry.variable.type != FLOATS[0] for entry in description.resolve(inputs)):
        return ()
    return tuple(kind for kind in OFFERED if getattr(description.kinds["me"], f"{kind}_derivatives"))


def right_ones(block: str, told: Mapping[str, np.ndarray], found: np.ndarray) -> tuple[str, ...]:
    """Return which derivatives told by the FMU of a block agree with central differences, and say which do not.

    told: by their kind, (n_x + n_y, n_x + n_u) as the differences are.
    """
    room = CHECKED * np.abs(found).max(axis=0, initial=0.0)
    right = tuple(kind for kind, J in told.items() if (np.abs(J - found) <= room).all())
    instead = f"the {right[0]} ones" if right else "central differences"
    for kind in told:
        if kind not in right:
            remark(block, f"its {kind} derivatives are not those of its equations: {instead} are taken")
    return right
