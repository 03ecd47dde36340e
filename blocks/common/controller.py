"""What all controllers of magnetic bearings share: ports, control error, velocity, and laws used twice."""

from __future__ import annotations

from typing import Any

from rotorsim.block import Equations, In, Out, Param, State

DISPLACEMENT = In(shape=2, unit="m", doc="rotor displacement [x, y] at the bearing")
VELOCITY = In(shape=2, unit="m/s", optional=True, doc="rotor velocity [x, y]; unwired: filtered derivative")
UNUSED_VELOCITY = In(shape=2, unit="m/s", optional=True, doc="rotor velocity [x, y]; not used")
REFERENCE = In(shape=2, unit="m", optional=True, doc="set-point of the displacement; unwired: zero")
CURRENT = Out(shape=2, unit="A", doc="control current [x, y]")
FILTER: Any = Param(1e-4, unit="s", above=0.0, doc="filter of the derivative if velocity is unwired")
START: Any = Param([0.0, 0.0], shape=2, unit="m", doc="displacement before the start, for the filter of the derivative")
FILTERED = State(
    shape=2, unit="m", init="initial_displacement", unless_wired="velocity", doc="displacement behind the filter"
)


def error_of(u: Any) -> Any:
    """Return the control error e = displacement - reference."""
    return u.displacement if u.reference is None else u.displacement - u.reference


def velocity_of(p: Any, u: Any, x: Any) -> tuple[Any, dict[str, Any]]:
    """Return the wired velocity, or s / (1 + T s) of the displacement with the derivative of its state."""
    if u.velocity is not None:
        return u.velocity, {}
    velocity = (u.displacement - x.filtered) / p.derivative_time_constant
    return velocity, {"filtered": velocity}


def pid_of(p: Any, u: Any, x: Any) -> tuple[Any, Any, Any, dict[str, Any]]:
    """Return KP e + KI int e dt + KD u' (thesis eq. 2.24), e, u' and the derivatives of the states."""
    error = error_of(u)
    velocity, derivatives = velocity_of(p, u, x)
    current = p.KP * error + p.KI * x.integral + p.KD * velocity
    return current, error, velocity, {"integral": error, **derivatives}


def state_space_of(p: Any, u: Any, x: Any) -> Equations:
    """Return d value / dt = A value + B e, i = C value + D e."""
    error = error_of(u)
    return Equations(
        outputs={"current": p.C @ x.value + p.D @ error}, derivatives={"value": p.A @ x.value + p.B @ error}
    )
