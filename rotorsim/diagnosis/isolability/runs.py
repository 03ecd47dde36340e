"""The runs over which faults are compared by their laws: some speeds, and some of them with other gains."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem, RotorsimError
from rotorsim.linear.linearisation import speed_entries
from rotorsim.model.compiled import Model, compile_diagram
from rotorsim.units import format_quantity

SPEED_FACTORS = (0.5, 0.7, 0.9, 1.15, 1.4)  # of the diagram's speed
GAIN_FACTORS = (1.3, 0.8, 1.1)  # of proportional and derivative gains, the first that is stable


@dataclass(frozen=True, eq=False)
class Runs:
    """Runs that are compared: the settings of each, and which set of gains (R,); gains: the second set in words."""

    settings: tuple[Mapping[str, float], ...]
    sets: np.ndarray
    gains: str = ""

    @property
    def speeds(self) -> np.ndarray:
        """The speed of each run, (R,) [rad/s]."""
        return np.array([one["speed"] for one in self.settings])


def runs_of(diagram: Diagram, speeds: Sequence[float] = ()) -> Runs:
    """Return runs at some speeds [rad/s] with the gains as they are, and again with another set of gains.

    Default: speeds about that of the diagram. Speeds without settled motion are left out. Raises RotorsimError for
    diagrams without a parameter ``speed`` or settled motion.
    """
    model = compile_diagram(diagram)
    entries = speed_entries(model)
    if entries is None or not entries.any():
        hint = 'add "parameters": {"speed": "1500 rpm"} and let the clock follow it'
        raise RotorsimError(Problem("no diagram parameter 'speed'", diagram.name, hint=hint))
    wanted = list(speeds) or [factor * float(model.p0[entries][0]) for factor in SPEED_FACTORS]
    first = [one for one in ({"speed": float(speed)} for speed in wanted if speed) if _is_stable(model, one)]
    if not first:
        raise RotorsimError(Problem("no settled motion at any of these speeds", diagram.name))
    gains = _gains(diagram)
    for factor in GAIN_FACTORS if gains else ():
        changed = {name: factor * value for name, (value, _) in gains.items()}
        second = [one | changed for one in first[::2]]  # at every other speed: that is enough
        if all(_is_stable(model, one) for one in second):
            text = ", ".join(f"{name} = {format_quantity(changed[name], unit, 4)}" for name, (_, unit) in gains.items())
            return Runs((*first, *second), np.repeat([0, 1], [len(first), len(second)]), text)
    return Runs(tuple(first), np.zeros(len(first), int))


def _gains(diagram: Diagram) -> dict[str, tuple[float, str]]:
    """Return the gains of controllers that another set changes: their values and units."""
    gains: dict[str, tuple[float, str]] = {}
    for block, node in diagram.nodes.items():
        if "controller" in node.block.roles:
            units = {key: declared.unit or "1" for key, declared in node.block.parameters.items()}
            scalars = {key: float(value) for key, value in node.values.items() if value.ndim == 0 and value != 0.0}
            usual = [key for key in scalars if units[key] not in ("s", "rad/s", "1")]
            chosen = [key for key in usual if key in ("KP", "KD")] or usual
            gains |= {f"{block}.{key}": (scalars[key], units[key]) for key in chosen}
    return gains


def _is_stable(model: Model, settings: Mapping[str, float]) -> bool:
    p = model.parameter_vector(settings)
    J = np.array(model.jacobian(0.0, model.x0(p), model.z0(p), p))
    return bool((np.linalg.eigvals(J).real < 1e-6 * max(np.abs(J).max(), 1.0) ** 0.5).all())
