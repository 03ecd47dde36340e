"""One-dimensional lookup table."""

import numpy as np

from rotorsim.block import Block, Equations, In, Option, Out, Param, concatenate, maximum, minimum, rows, where


class LookupTable(Block):
    """Interpolate linearly in a table, entry by entry.

    output = y_k + (y_(k+1) - y_k) (input - x_k) / (x_(k+1) - x_k)    for x_k <= input < x_(k+1)

    Outside the table the end values are held (``clamp``) or the end segments prolonged (``extrapolate``).
    """

    source = "Simulink: 1-D Lookup Table"

    input = In(shape="signal", unit=None, doc="signal")
    output = Out(shape="signal", unit=None, doc="interpolated values, shape of the input")
    breakpoints = Param([0.0, 1.0], shape=("points",), unit=None, doc="x_k, increasing, at least two")
    values = Param([0.0, 1.0], shape=("points",), unit=None, doc="y_k, as many as breakpoints")
    outside = Option("clamp", choices=("clamp", "extrapolate"), doc="what happens outside the table")

    def check(self, values):
        """Refuse tables that are too short or not increasing."""
        breakpoints = np.ravel(values["breakpoints"])
        if breakpoints.size < 2:
            return [f"the table needs at least two breakpoints, got {breakpoints.size}"]
        falls = np.flatnonzero(np.diff(breakpoints) <= 0)
        if falls.size:
            k = int(falls[0])
            return [
                f"breakpoints must increase, but breakpoint {k + 2} = {breakpoints[k + 1]:g} follows {breakpoints[k]:g}"
            ]
        return []

    def equations(self, p, u, x, t):
        xs, ys = rows(p.breakpoints), rows(p.values)
        inside = u.input if self.option.outside == "extrapolate" else minimum(maximum(u.input, xs[0]), xs[-1])
        segments = [ys[k] + (ys[k + 1] - ys[k]) * ((inside - xs[k]) / (xs[k + 1] - xs[k])) for k in range(len(xs) - 1)]
        output = segments[-1]
        for k in range(len(segments) - 2, -1, -1):
            output = where(inside < xs[k + 1], segments[k], output)
        kinks = xs if self.option.outside == "clamp" else xs[1:-1]
        events = {"breakpoint": concatenate([u.input - kink for kink in kinks])} if kinks else {}
        return Equations(outputs={"output": output}, events=events)
