"""Modes of the closed loop, the direction of their whirl, and how they change with speed (Campbell)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import isnan
from typing import Any

import numpy as np

from rotorsim._shown import Shown
from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem, RotorsimError
from rotorsim.linear.eigen import Eigen, eigen
from rotorsim.linear.linearisation import as_model, flat_names, provenance, speed_of
from rotorsim.linear.loop import growing_poles, linear_system
from rotorsim.model.compiled import Model
from rotorsim.units import parse_quantity

DEGENERATE = 1e-7  # relative distance of eigenvalues that count as one (isotropic rotor without gyroscopic effect)
RESONANT = 0.5**0.5  # damping ratio below which a forced response has a maximum
PLANAR = 1e-6  # relative difference of forward and backward amplitude below which the motion is a line


@dataclass(frozen=True)
class Mode:
    """One oscillating mode: x(t) = Re(shape exp(eigenvalue t)).

    eigenvalue [1/s], imaginary part positive. whirl: "forward", "backward" or "planar". shape: complex
    amplitude of every entry of the two-axis displacements (names in `Modes.shape_names`), largest entry 1. modulo [Hz]:
    the sample rate, where images at its multiples show alike and the frequency may as well be one of those; else None.
    """

    eigenvalue: complex
    whirl: str
    shape: np.ndarray
    modulo: float | None = None

    @property
    def frequency_hz(self) -> float:
        """Damped natural frequency, Im(lambda) / 2 pi [Hz]."""
        return self.eigenvalue.imag / (2 * np.pi)

    @property
    def natural_frequency_hz(self) -> float:
        """Undamped natural frequency, |lambda| / 2 pi [Hz]."""
        return abs(self.eigenvalue) / (2 * np.pi)

    @property
    def damping_ratio(self) -> float:
        """-Re(lambda) / |lambda|."""
        return -self.eigenvalue.real / abs(self.eigenvalue)

    @property
    def resonant(self) -> bool:
        """Whether a forced response has a maximum near the mode: its damping ratio is below 1/sqrt(2)."""
        return self.damping_ratio < RESONANT

    @property
    def unstable(self) -> bool:
        """Whether the mode grows."""
        return self.eigenvalue.real > 0.0


@dataclass(frozen=True, repr=False)
class Modes(Shown):
    """The modes in ascending damped frequency, one per conjugate pair, and the poles that do not oscillate.

    real_poles [1/s], ascending. speed [rad/s]: value of the diagram parameter ``speed``, None without one.
    stable: no pole has a positive real part.
    """

    modes: tuple[Mode, ...]
    real_poles: np.ndarray
    shape_names: tuple[str, ...]
    speed: float | None
    stable: bool
    notes: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)

    _figure = "rotorsim.report.figures.linear:modes_figure"

    def __repr__(self) -> str:
        listed = ", ".join(f"{mode.frequency_hz:.5g} Hz" for mode in self.modes[:4])
        more = ", ..." if len(self.modes) > 4 else ""
        state = "stable" if self.stable else "unstable"
        return f"Modes({self.provenance.get('diagram', '')}: {state}, {len(self.modes)} modes: {listed}{more})"

    def to_table(self) -> list[dict[str, Any]]:
        """Return one row per mode: frequencies [Hz], damping ratio, whirl, whether it grows."""
        return [
            {
                "frequency_hz": mode.frequency_hz,
                "natural_frequency_hz": mode.natural_frequency_hz,
                "damping_ratio": mode.damping_ratio,
                "whirl": mode.whirl,
                "unstable": mode.unstable,
                "frequency_modulo_hz": mode.modulo,
            }
            for mode in self.modes
        ]


def two_axis_signals(model: Model) -> tuple[str, ...]:
    """Return the displacement signals whose last dimension is the pair (x, y); tilts where there are none."""
    for ending, unit in ((".displacement", "m"), (".tilt", "rad")):
        found = tuple(
            name
            for name, signal in model.signals.items()
            if name.endswith(ending) and signal.shape and signal.shape[-1] == 2 and signal.unit in (unit, None)
        )
        if found:
            return found
    return ()


def modes(
    diagram: Diagram | Model, *, parameters: Mapping[str, Any] | None = None, at: np.ndarray | None = None
) -> Modes:
    """Return the modes of the closed loop: eigenvalues of A of d x/dt = A x at the operating point.

    Whirl: with x = Re(X exp(st)), y = Re(Y exp(st)), s = a + iw, w > 0,

        x + iy = ((X + iY) exp(iwt) + conj(X - iY) exp(-iwt)) exp(at) / 2,

    so that |X + iY| is the forward and |X - iY| the backward amplitude; the larger sum of squares over all
    nodes gives the direction. Equal amplitudes, and modes of equal eigenvalue (their plane is arbitrary: an
    isotropic rotor without gyroscopic effect), are "planar".

    With sampled controllers they are those of the exact loop, see `eigen`; X and Y are the components at s of a motion
    that has images at s + 2 pi i j / T, too.

    Raises RotorsimError as `linearise`, and with sampled blocks for a diagram that is not linear.
    Source: Friswell et al., Dynamics of Rotating Machines (2010), 3.6.
    """
    model = as_model(diagram)
    names = shape_names(model)
    system, notes = linear_system(model, (), names, parameters, at)
    found = eigen(system)
    direction = whirl(found, names)
    count = sum(_displacements(model))
    return Modes(
        modes=tuple(
            Mode(
                complex(value), direction[k], _normalised(found.shapes[:count, k]), None if isnan(rate) else float(rate)
            )
            for k, (value, rate) in enumerate(zip(found.values, found.modulo, strict=True))
        ),
        real_poles=found.real,
        shape_names=names[:count],
        speed=speed_of(model, model.parameter_vector(parameters)),
        stable=not len(growing_poles(system)),
        notes=notes,
        provenance=provenance(model, parameters, "modes"),
    )


def shape_signals(model: Model) -> tuple[str, ...]:
    """Return the two-axis displacements and tilts that make up mode shapes."""
    names = two_axis_signals(model)
    tilts = tuple(n for n in model.signals if n.endswith(".tilt") and model.signals[n].shape[-1:] == (2,))
    return names + tuple(n for n in tilts if n not in names)


def shape_names(model: Model) -> tuple[str, ...]:
    """Return the flat names of the entries of mode shapes."""
    return tuple(name for signal in shape_signals(model) for name in flat_names(model, signal))


def _displacements(model: Model) -> list[int]:
    return [int(np.prod(model.signals[name].shape)) for name in two_axis_signals(model)]


def _normalised(shape: np.ndarray) -> np.ndarray:
    if not len(shape) or not np.abs(shape).max():
        return np.asarray(shape, complex)
    return np.asarray(shape / shape[np.argmax(np.abs(shape))])


def whirl(eigen: Eigen, names: Sequence[str]) -> list[str]:
    """Return "forward", "backward" or "planar" for every oscillating eigenvalue, by shapes of these entries."""
    motion = eigen.shapes
    tilt = np.array([".tilt" in name for name in names], bool)
    directions = []
    for k, value in enumerate(eigen.values):
        distance = np.abs(np.delete(eigen.values, k) - value)
        if not len(motion) or distance.min(initial=np.inf) <= DEGENERATE * abs(value):
            directions.append("planar")
            continue
        column = motion[:, k]
        # a purely tilting mode does not move its disc; its direction shows in the tilt
        still = tilt.any() and np.abs(column[~tilt]).max(initial=0.0) <= 1e-9 * np.abs(column[tilt]).max()
        column = column[tilt] if still else column[~tilt] if (~tilt).any() else column
        forward = np.linalg.norm(column[0::2] + 1j * column[1::2])
        backward = np.linalg.norm(column[0::2] - 1j * column[1::2])
        if abs(forward - backward) <= PLANAR * (forward + backward):
            directions.append("planar")
        else:
            directions.append("forward" if forward > backward else "backward")
    return directions


def require_speed(model: Model, what: str) -> None:
    """Raise RotorsimError unless blocks of the diagram follow its parameter ``speed``."""
    if speed_of(model, model.p0) is None:
        raise RotorsimError(
            Problem(
                what=f"{what} varies the diagram parameter 'speed', but no block follows it",
                subject=model.diagram.name,
                hint='declare "parameters": {"speed": "1500 rpm"} and use "$speed" in the blocks',
            )
        )


def checked_speeds(speeds: Sequence[float | str] | np.ndarray, *, zero: bool) -> np.ndarray:
    """Return speeds, [rad/s] or with a unit ("1500 rpm"), as an array.

    Raises RotorsimError for none, non-finite or negative ones, and for units of something else.
    """
    given = np.atleast_1d(np.asarray(speeds, object)).ravel().tolist()
    try:
        values = np.array([parse_quantity(one, "rad/s") if isinstance(one, str) else one for one in given], float)
    except ValueError as error:
        raise RotorsimError(Problem(what=str(error), subject="speeds", hint="such as '1500 rpm'")) from None
    lowest_ok = values >= 0 if zero else values > 0
    if not len(values) or not np.isfinite(values).all() or not lowest_ok.all():
        sign = "not negative" if zero else "positive"
        raise RotorsimError(Problem(what=f"speeds must be finite and {sign} [rad/s]", subject="speeds"))
    return values
