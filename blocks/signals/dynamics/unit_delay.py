"""Discrete delay of whole samples."""

from rotorsim.block import Block, DiscreteState, Equations, In, Option, Out, Param


class UnitDelay(Block):
    """Sample a signal and give it out a whole number of samples later, entry by entry.

    at hit k:  output = input at hit k - samples, held until hit k + 1; `initial` before the start

    The output never depends on the input of the same instant, so the block breaks algebraic loops. Eight samples at
    most; put blocks in a row for more.
    """

    source = "Simulink: Unit Delay, Delay"

    input = In(shape="signal", unit=None, doc="signal")
    output = Out(shape="signal", unit=None, doc="delayed samples, shape of the input")
    sample_time = Param(1e-3, unit="s", above=0.0, doc="time between hits")
    initial = Param(0.0, shape="signal", unit=None, doc="samples before the start")
    samples = Option(1, kind=int, low=1, high=8, doc="number of samples of the delay")
    values = tuple(
        DiscreteState(
            name=f"value{k}",
            shape="signal",
            unit=None,
            init="initial",
            when=(lambda option, k=k: option.samples >= k) if k > 1 else None,
            doc=("newest sample", "sample before")[k] if k < 2 else f"{k} before",
        )
        for k in range(9)
    )

    def equations(self, p, u, x, t):
        line = [getattr(x, f"value{k}") for k in range(self.option.samples + 1)]
        update = {f"value{k}": value for k, value in enumerate([u.input, *line[:-1]])}
        return Equations(outputs={"output": line[-1]}, update=update)
