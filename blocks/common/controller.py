"""What all controllers of magnetic bearings share: ports, control error, velocity, and laws used twice."""

from typing import Any

from rotorsim.block import Equations, In, Out, Param, State

DISPLACEMENT = In(name="displacement", shape=2, unit="m", doc="rotor displacement [x, y] at the bearing")
REFERENCE = In(name="reference", shape=2, unit="m", optional=True, doc="set-point of the displacement; unwired: zero")
CURRENT = Out(name="current", shape=2, unit="A", doc="control current [x, y]")
PORTS = (
    DISPLACEMENT,
    In(name="velocity", shape=2, unit="m/s", optional=True, doc="rotor velocity [x, y]; unwired: filtered derivative"),
    REFERENCE,
    CURRENT,
)
PORTS_WITHOUT_VELOCITY = (
    DISPLACEMENT,
    In(name="velocity", shape=2, unit="m/s", optional=True, doc="rotor velocity [x, y]; not used"),
    REFERENCE,
    CURRENT,
)
GAINS = (
    Param(12200.0, name="KP", unit="A/m", doc="proportional gain"),
    Param(2000.0, name="KI", unit="A/(m s)", doc="integral gain"),
    Param(3.0, name="KD", unit="A s/m", doc="derivative gain"),
)
TIME_CONSTANT = Param(
    1e-4, name="derivative_time_constant", unit="s", above=0.0, doc="filter of the derivative if velocity is unwired"
)
START = Param(
    [0.0, 0.0],
    name="initial_displacement",
    shape=2,
    unit="m",
    doc="displacement before the start, for the filter of the derivative",
)
FILTERED = State(
    name="filtered",
    shape=2,
    unit="m",
    init="initial_displacement",
    unless_wired="velocity",
    doc="displacement behind the filter",
)
FILTER = (TIME_CONSTANT, START, FILTERED)
MATRICES = (
    Param(name="A", shape=("n", "n"), unit="1/s", doc="state matrix, shape (n, n)"),
    Param(name="B", shape=("n", 2), unit=None, doc="input matrix, shape (n, 2)"),
    Param(name="C", shape=(2, "n"), unit=None, doc="output matrix, shape (2, n)"),
    Param([[0.0, 0.0], [0.0, 0.0]], name="D", shape=(2, 2), unit="A/m", doc="feedthrough matrix, shape (2, 2)"),
    Param(0.0, name="initial", shape=("n",), unit=None, doc="state at the start, shape (n,)"),
    State(name="value", shape=("n",), unit=None, init="initial", doc="state of the controller"),
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
