"""Dead zone."""

from rotorsim.block import Block, Equations, In, Out, Param, maximum, minimum
from rotorsim.fault import Fault, Of


class DeadZone(Block):
    """Pass only what exceeds a zone about zero, entry by entry.

    output = input - width/2  above the zone,  input + width/2  below it,  0 inside [-width/2, width/2]
    """

    source = "Simulink: Dead Zone"
    faults = (
        Fault(
            physics="dead_zone",
            enters="signal",
            through={"input": "output"},
            free={"width": (Of("input", 0.1), Of("input", 0.5))},
            sizes=("width",),
            law="nothing passes inside the zone (a clearance); its share falls with the amplitude",
            confused_with=("dry_friction", "gain_error"),
            told_apart_by="amplitude: the share that is lost falls as it grows",
        ),
    )

    input = In(shape="signal", unit=None, doc="signal")
    output = Out(shape="signal", unit=None, doc="excess over the zone, shape of the input")
    width = Param(1.0, unit=None, low=0.0, doc="full width of the zone (twice a clearance)")

    def equations(self, p, u, x, t):
        half = p.width / 2
        return Equations(
            outputs={"output": maximum(u.input - half, 0.0) + minimum(u.input + half, 0.0)},
            events={"upper": u.input - half, "lower": u.input + half},
        )
