"""Delay of the control current."""

from rotorsim.blocks.common import pade

from rotorsim.block import Block, Equations, In, Option, Out, Param
from rotorsim.fault import Fault


class ControlDelay(Block):
    """Delay the current that a controller demands by the time that it needs to compute.

    i = C e^{-i w delay} x,   e^{-s T} ~ P(-s T) / P(s T),   T = delay        Pade approximation as in `delay`

    All-pass: magnitudes are exact. With order 2 the error |H - e^{-i w T}| is (w T)^5 / 720, below 1 % up to
    w T = 1.52, and RK4 is stable up to a step of 0.81 T; see `delay` for other orders.
    """

    source = "thesis, after eq. (2.30) (delay); Golub and Van Loan (2013), 9.3.1 (Pade approximation)"
    faults = tuple(
        Fault(
            physics="control_delay",
            enters="wire",
            between=("controller", "bearing"),
            through={"current": "delayed"},
            recorded=recorded,
            free={"delay": (1e-4, 4e-4)},
            law=f"phase of the current that acts, in proportion to frequency; the recorded current is the {which}",
            confused_with=("amplifier_bandwidth", "eddy_current_lag"),
            told_apart_by="the gain at high orders: a delay leaves it, an amplifier lowers it; another set of gains",
        )
        for recorded, which in (("after", "one that flows"), ("before", "demand"))
    )

    current = In(shape="signal", unit="A", doc="current that the controller demands")
    delayed = Out(shape="signal", unit="A", doc="current that flows")
    delay = Param(1e-4, unit="s", low=1e-6, high=0.02, doc="delay T")
    order = Option(2, kind=int, low=1, high=4, doc="order of the approximation")
    ladder = pade.ladder(4, "A")

    def equations(self, p, u, x, t):
        delayed, derivatives = pade.delayed(u.current, x, self.option.order, p.delay)
        return Equations(outputs={"delayed": delayed}, derivatives=derivatives)
