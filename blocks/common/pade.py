"""Pade approximation of a transport delay as a ladder, for blocks that delay a signal.

Source: Golub & Van Loan, Matrix Computations (2013), 9.3.1; DLMF 4.39.1 (ladder).
"""

from __future__ import annotations

from typing import Any


def delayed(signal: Any, states: list[Any], delay: Any) -> tuple[Any, list[Any]]:
    """Return the delayed signal and the rates of the states of the ladder, one state for each order."""
    # A ladder of series capacitors (states 1, 3, ...: voltages) and shunt inductors (states 2, 4, ...: currents)
    # behind a unit resistor. Behind the last element the voltage or the current is zero, which closes the ladder.
    voltages, currents = states[0::2], states[1::2]
    if len(states) % 2:
        current, voltage = signal - sum(voltages), sum(voltages[1:])
    else:
        current = sum(currents)
        voltage = signal - voltages[0] - current
    output = signal - 2 * current
    rates = []
    for k, state in enumerate(states, start=1):
        rates.append(2 * (2 * k - 1) / delay * (current if k % 2 else voltage))
        if k % 2 == 0:
            current = current - state
        elif k > 1:
            voltage = voltage - state
    return output, rates
