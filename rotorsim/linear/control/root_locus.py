"""Root locus: the poles of the closed loop over values of a parameter, and where it becomes unstable."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rotorsim._shown import Shown
from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem, RotorsimError
from rotorsim.linear.drift import eigenvectors
from rotorsim.linear.eigen import eigen, unfolded
from rotorsim.linear.linearisation import as_model, provenance
from rotorsim.linear.loop import growing_poles, linear_system
from rotorsim.linear.modes.eigenmodes import RESONANT, shape_names
from rotorsim.linear.sampled_data import SampledData
from rotorsim.linear.state_space import StateSpace
from rotorsim.model.compiled import Model

ROUNDING = 1e-14  # of the range of values: a limit at zero has no relative width
LIMIT = 1e-9  # relative width to which a limit of stability is found


@dataclass(frozen=True)
class StabilityLimit:
    """Value of the parameter at which a pole begins to grow, or ceases to; frequency [Hz] of that pole there.

    modulo [Hz]: see `RootLocus`, NaN where the frequency is sure.
    """

    value: float
    frequency: float
    modulo: float = np.nan


@dataclass(frozen=True, repr=False)
class RootLocus(Shown):
    """Poles [1/s] (n, m), those with a positive imaginary part and real ones, NaN where there are fewer.

    values (n,), ascending, SI, of a parameter of a unit. stable (n,). limits: between values of different stability.
    modulo (n, m): sample rate [Hz] of poles whose images show alike: their frequency may be another by multiples of it,
    and their damping ratio with it; NaN where the frequency is sure.
    """

    parameter: str
    unit: str
    values: np.ndarray
    poles: np.ndarray
    stable: np.ndarray
    limits: tuple[StabilityLimit, ...]
    modulo: np.ndarray
    notes: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)

    _figure = "rotorsim.report.figures.root_locus:root_locus_figure"

    def __repr__(self) -> str:
        found = ", ".join(f"{one.value:.4g}" for one in self.limits) or "none"
        return f"RootLocus({self.parameter}: {len(self.values)} values, limits of stability {found} {self.unit})"

    def least_damped(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return frequency [Hz], damping ratio and ``modulo`` of the least damped pole that oscillates, each (n,)."""
        with np.errstate(invalid="ignore", divide="ignore"):
            ratio = np.where(self.poles.imag > 0, -self.poles.real / np.abs(self.poles), np.inf)
        ratio = np.where(np.isnan(ratio), np.inf, ratio)
        least = ratio.argmin(axis=1)
        rows = np.arange(len(self.values))
        some = np.isfinite(ratio[rows, least])
        frequency = np.where(some, self.poles[rows, least].imag / (2 * np.pi), np.nan)
        return frequency, np.where(some, ratio[rows, least], np.nan), self.modulo[rows, least]

    @property
    def zeros(self) -> np.ndarray:
        """How many poles are zero, (n,)."""
        return np.asarray((self.poles == 0).sum(axis=1))

    @property
    def resonant(self) -> np.ndarray:
        """Which poles have a damping ratio below 1/sqrt(2), (n, m)."""
        with np.errstate(invalid="ignore"):
            return np.asarray((self.poles.imag > 0) & (-self.poles.real < RESONANT * np.abs(self.poles)))


def root_locus(
    diagram: Diagram | Model,
    parameter: str,
    values: Sequence[float] | np.ndarray,
    *,
    parameters: Mapping[str, Any] | None = None,
) -> RootLocus:
    """Return the poles of the closed loop over values [SI] of a parameter, at the operating point of each.

    Sampled loops have ln(mu) / T + 2 pi i j / T of the multipliers mu over their common period T, exactly, at the image
    j that shows most in the displacements, see `eigen`. Poles of free bodies and of integrators without feedback are
    zero, not what rounding makes of them. Between two values of which one is stable
    the limit is found to 1e-9 of it.

    Raises RotorsimError as `linearise`, for values that do not ascend, and for a parameter that does not exist.
    Source: W. R. Evans, Trans. AIEE 67 (1948) 547-551.
    """
    grid = np.atleast_1d(np.asarray(values, float)).ravel()
    if not (len(grid) and np.isfinite(grid).all() and (np.diff(grid) > 0).all()):
        raise RotorsimError(Problem("values must be finite and ascending", parameter))
    model = as_model(diagram)
    names = shape_names(model) if model.n_z else ()

    def system_at(value: float) -> tuple[StateSpace | SampledData, tuple[str, ...]]:
        return linear_system(model, (), names, {**(parameters or {}), parameter: float(value)})

    systems = [system_at(value) for value in grid]
    found = [_poles(system) for system, _ in systems]
    most = max(len(poles) for poles, _ in found)
    table, modulo = np.full((len(grid), most), np.nan + 0j), np.full((len(grid), most), np.nan)
    for row, rates, (poles, own) in zip(table, modulo, found, strict=True):
        order = np.argsort(np.abs(poles), kind="stable")
        row[: len(poles)], rates[: len(poles)] = poles[order], own[order]
    stable = np.array([not len(growing_poles(system)) for system, _ in systems])
    limits = []
    for k in np.flatnonzero(stable[:-1] != stable[1:]):
        low, high = grid[k], grid[k + 1]
        least = ROUNDING * (grid[-1] - grid[0])
        while high - low > max(LIMIT * max(abs(low), abs(high)), least):
            middle = (low + high) / 2
            grows = bool(len(growing_poles(system_at(middle)[0])))
            low, high = (middle, high) if grows != stable[k] else (low, middle)
        system = system_at(low if stable[k + 1] else high)[0]
        limits.append(StabilityLimit(float((low + high) / 2), *_frequency(system, growing_poles(system)[0])))
    return RootLocus(
        parameter=parameter,
        unit=model.diagram.unit_of_parameter(parameter) or "1",
        values=grid,
        poles=table,
        stable=stable,
        limits=tuple(limits),
        modulo=modulo,
        notes=tuple(dict.fromkeys(note for _, notes in systems for note in notes)),
        provenance=provenance(model, parameters, "root_locus"),
    )


def _poles(system: StateSpace | SampledData) -> tuple[np.ndarray, np.ndarray]:
    """Return the poles with imag >= 0, and modulo what their frequency is known [Hz]."""
    if isinstance(system, SampledData):
        found = eigen(system)
        return np.concatenate([found.values, found.real]), np.concatenate(
            [found.modulo, np.full(len(found.real), np.nan)]
        )
    poles = eigenvectors(system.A)[0]
    poles = poles[poles.imag >= 0]
    return poles, np.full(len(poles), np.nan)


def _frequency(system: StateSpace | SampledData, pole: complex) -> tuple[float, float]:
    if isinstance(system, SampledData):
        return unfolded(system, pole)
    return float(abs(pole.imag) / (2 * np.pi)), np.nan
