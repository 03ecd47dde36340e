"""Pade approximation of a transport delay as a ladder, for blocks that delay a signal.

Source: Golub & Van Loan, Matrix Computations (2013), 9.3.1; DLMF 4.39.1 (ladder).
"""

from typing import Any

from rotorsim.block import State

_ORDINALS = ("first", "second", "third", "fourth", "fifth", "sixth", "seventh", "eighth")


def ladder(most: int, unit: str | None, init: float | str = 0.0) -> tuple[State, ...]:
    """Declare the states of a ladder whose option `order` is at most ``most``; init: of the first state."""
    first = State(name="value1", shape="signal", unit=unit, init=init, doc="first state of the ladder")
    return (
        first,
        *(
            State(
                name=f"value{k}",
                shape="signal",
                unit=unit,
                when=lambda option, k=k: option.order >= k,
                doc=f"{_ORDINALS[k - 1]} state of the ladder",
            )
            for k in range(2, most + 1)
        ),
    )


def delayed(signal: Any, x: Any, order: int, delay: Any) -> tuple[Any, dict[str, Any]]:
    """Return the delayed signal and the derivatives of the states of the ladder, one state for each order."""
    states = [getattr(x, f"value{k}") for k in range(1, order + 1)]
    # A ladder of series capacitors (states 1, 3, ...: voltages) and shunt inductors (states 2, 4, ...: currents)
    # behind a unit resistor. Behind the last element the voltage or the current is zero, which closes the ladder.
    voltages, currents = states[0::2], states[1::2]
    if len(states) % 2:
        current, voltage = signal - sum(voltages), sum(voltages[1:])
    else:
        current = sum(currents)
        voltage = signal - voltages[0] - current
    output = signal - 2 * current
    derivatives = {}
    for k, state in enumerate(states, start=1):
        derivatives[f"value{k}"] = 2 * (2 * k - 1) / delay * (current if k % 2 else voltage)
        if k % 2 == 0:
            current = current - state
        elif k > 1:
            voltage = voltage - state
    return output, derivatives
