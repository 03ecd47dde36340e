"""The settled periodic motion of a diagram at one or many speeds, as harmonics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rotorsim._shown import Shown, xarray_module
from rotorsim.errors import Problem, RotorsimError, near_miss


@dataclass(frozen=True, repr=False)
class Periodic(Shown):
    """Harmonics of the settled motion: signal(t) = sum over k of R_k exp(i orders[k] W t).

    speeds (n,) [rad/s]; orders (2H+1,): -H..H, divided by the number of turns of one period.
    harmonics: name -> complex array (n, 2H+1), peak values in SI units. A two-axis signal
    (``rotor.displacement``, ``rotor.displacement[3]``) is x + iy: positive orders turn with the rotor. A single
    channel (``rotor.displacement[1]``) has conjugate coefficients at -k. units: name -> unit.
    status: one text per speed, "settled" or what is wrong; a speed without a solution is NaN throughout, and a
    signal that drifts has order 0 NaN. stable: per speed, None where it was not examined. truncation (n,):
    size of the harmonics of the states that are left out, relative to the largest but the mean.
    truncation_error (n,): what leaving them out changes of those kept, relative to the largest, worst channel: zero in
    a linear diagram, and where as many are kept as needed. drifting: flat names of states without a mean.
    images: of sampled blocks, name -> (n,): largest magnitude of what the motion has beside its harmonics, at
    orders[k] W + 2 pi j / T, T the common sample time. largest_values: name -> (n,) of all of the motion then.
    """

    speeds: np.ndarray
    orders: np.ndarray
    harmonics: Mapping[str, np.ndarray]
    units: Mapping[str, str]
    status: tuple[str, ...]
    stable: tuple[bool | None, ...]
    truncation: np.ndarray
    truncation_error: np.ndarray
    drifting: tuple[str, ...] = ()
    counters: Mapping[str, int] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    largest_values: Mapping[str, np.ndarray] = field(default_factory=dict)
    images: Mapping[str, np.ndarray] = field(default_factory=dict)

    _figure = "rotorsim.report.figures.linear:periodic_figure"

    def __repr__(self) -> str:
        rpm = self.speeds * (30 / np.pi)
        span = f"{len(rpm)} speeds, {rpm.min():.6g}..{rpm.max():.6g} rpm" if len(rpm) > 1 else f"{rpm[0]:.6g} rpm"
        failed = f", {int((~self.settled).sum())} without a solution" if not self.settled.all() else ""
        names = ", ".join(self.two_axis or self.harmonics)
        return f"Periodic({self.provenance.get('diagram', '')}: {span}{failed}, {names})"

    def to_xarray(self) -> Any:
        """Return an xarray.Dataset over speed [rad/s] and order; needs the optional package xarray."""
        variables: dict[str, Any] = {
            name: (("speed", "order"), values, {"units": self.units[name]}) for name, values in self.harmonics.items()
        }
        variables["status"] = (("speed",), np.array(self.status, dtype=object), {})
        coordinates = {"speed": ("speed", self.speeds, {"units": "rad/s"}), "order": self.orders}
        return xarray_module().Dataset(variables, coordinates, {k: str(v) for k, v in self.provenance.items()})

    @property
    def settled(self) -> np.ndarray:
        """Whether there is a solution at each speed, shape (n,)."""
        return np.array([not text.startswith("failed") for text in self.status], bool)

    @property
    def two_axis(self) -> tuple[str, ...]:
        """The signals that are x + i y: their first axis is in the result as well."""
        firsts = {name: f"{name[:-1]},1]" if name.endswith("]") else f"{name}[1]" for name in self.harmonics}
        return tuple(name for name, first in firsts.items() if first in self.harmonics)

    def harmonic(self, signal: str, order: float) -> np.ndarray:
        """Return R_order of a signal at every speed, shape (n,). Raises RotorsimError for unknown names."""
        values = self._values(signal)
        place = np.flatnonzero(np.isclose(self.orders, order, rtol=0, atol=1e-9))
        if not len(place):
            what = f"no harmonic of order {order:g}; orders run from {self.orders[0]:g} to {self.orders[-1]:g}"
            raise RotorsimError(Problem(what=what, subject=signal))
        return np.asarray(values[:, place[0]])

    def time_history(self, signal: str, n: int = 256) -> tuple[np.ndarray, np.ndarray]:
        """Return times (speeds, n) [s] over one period and the signal there, complex for two axes, else real.

        Of its harmonics: without the images of sampled blocks.
        """
        values = np.nan_to_num(self._values(signal), nan=0.0) if self.drifting else self._values(signal)
        angle = np.arange(n) * (2 * np.pi * self._turns / n)
        motion = values @ np.exp(1j * np.outer(self.orders, angle))
        real = np.allclose(values, values[:, ::-1].conj(), rtol=1e-9, atol=0, equal_nan=True)
        return angle[None] / self.speeds[:, None], motion.real if real else motion

    def largest(self, signal: str) -> np.ndarray:
        """Return the largest magnitude of a signal at every speed, (n,): of x + i y the distance from the centre.

        With sampled blocks at every phase of the samplers against the shaft, images included. NaN without a solution.
        """
        self._values(signal)
        if self.largest_values:
            return np.asarray(self.largest_values[signal])
        return np.asarray(np.abs(self.time_history(signal)[1]).max(axis=1))

    @property
    def _turns(self) -> int:
        return 1 if len(self.orders) < 2 else round(1 / float(self.orders[1] - self.orders[0]))

    def _values(self, signal: str) -> np.ndarray:
        if signal not in self.harmonics:
            raise RotorsimError(
                Problem(what="no such signal in this result", subject=signal, hint=near_miss(signal, self.harmonics))
            )
        return self.harmonics[signal]

    def to_table(self, *, threshold: float = 0.0) -> list[dict[str, Any]]:
        """Return one row per speed, signal and order whose amplitude is above ``threshold`` of the largest.

        Columns: speed [rad/s], signal, order, real, imag, amplitude (in unit), phase [rad], unit.
        """
        amplitudes = {name: np.abs(values) for name, values in self.harmonics.items()}
        return [
            {
                "speed": float(speed),
                "signal": name,
                "order": float(order),
                "real": float(value.real),
                "imag": float(value.imag),
                "amplitude": float(size),
                "phase": float(np.angle(value)),
                "unit": self.units[name],
            }
            for j, speed in enumerate(self.speeds)
            for name, amplitude in amplitudes.items()
            for order, value, size in zip(self.orders, self.harmonics[name][j], amplitude[j], strict=True)
            if size > threshold * np.nanmax(amplitude[j], initial=0.0)
        ]
