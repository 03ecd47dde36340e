"""Transport delay."""

from rotorsim.blocks.common import pade

from rotorsim.block import Block, Equations, In, Option, Out, Param
from rotorsim.fault import Fault, Sampled


class Delay(Block):
    """Delay a signal by a Pade approximation of the transport delay, entry by entry.

    exp(-s T) ~ P(-s T) / P(s T),  P(z) = sum_k (2n - k)! n! / ((2n)! k! (n - k)!) z^k,   n = order, T = delay

    All-pass: magnitudes are exact, and the phase is exact to the error |H - exp(-j w T)| =
    (n!)^2 / ((2n)! (2n + 1)!) (w T)^(2n + 1) for small w T. Largest w T with an error below 1 %, and largest step h
    with which RK4 is stable:

    =====  ====  ====  ====  ====  ====  =====  =====  =====
    order     1     2     3     4     5      6      7      8
    w T    0.49  1.52  2.81  4.24  5.75   7.33   8.96  10.62
    h / T  1.39  0.81  0.53  0.38  0.30   0.25   0.21   0.19
    =====  ====  ====  ====  ====  ====  =====  =====  =====

    A jump of the input shows at once, with the sign (-1)^n, and then oscillates about the true delayed jump: use
    `unit_delay` for sampled signals. Realised as the ladder tanh(z) = 1/(1/z + 1/(3/z + 1/(5/z + ...))), z = s T / 2,
    whose states are all of the size of the signal; at rest value1 is the signal and the others vanish.
    """

    source = "Golub and Van Loan, Matrix Computations (2013), 9.3.1; DLMF 4.39.1 (ladder); Simulink: Transport Delay"
    faults = (
        Fault(
            physics="delay",
            enters="signal",
            through={"input": "output"},
            free={"delay": (Sampled(1.0), Sampled(10.0), Sampled(100.0))},
            options={"order": 3},
            finer={"order": 8},
            law="phase that falls in proportion to the frequency; no change of magnitude",
            confused_with=("lag", "missing_mode"),
            told_apart_by="high frequencies: a lag attenuates them, a delay does not",
        ),
    )

    input = In(shape="signal", unit=None, doc="signal")
    output = Out(shape="signal", unit=None, doc="delayed signal, shape of the input")
    delay = Param(1e-3, unit="s", above=0.0, doc="delay T")
    initial = Param(0.0, shape="signal", unit=None, doc="input before the start")
    order = Option(4, kind=int, low=1, high=8, doc="order n of the approximation")
    ladder = pade.ladder(8, None, init="initial")

    def equations(self, p, u, x, t):
        output, derivatives = pade.delayed(u.input, x, self.option.order, p.delay)
        return Equations(outputs={"output": output}, derivatives=derivatives)
