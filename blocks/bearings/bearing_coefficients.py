"""Bearing or seal of eight coefficients."""

from typing import Any

import numpy as np
from rotorsim.blocks.common import spline

from rotorsim.block import Block, Equations, In, Option, Out, Param, concatenate, rows, vec

_NAMES = ("kxx", "kxy", "kyx", "kyy", "cxx", "cxy", "cyx", "cyy")
_TABLE = {"shape": ("points",)}


class BearingCoefficients(Block):
    """Give the force of a bearing or seal of eight coefficients, which may be tables over the shaft speed W.

    f = -K(W) u - C(W) u',   K = [[kxx, kxy], [kyx, kyy]],   C = [[cxx, cxy], [cyx, cyy]]

    u: displacement of the shaft [x, y], less that of the support where one is wired. The coefficients are synchronous
    ones: those of whirl at the frequency of the shaft speed. Between the speeds of the table they are interpolated by
    the cubic not-a-knot spline (a parabola through three points, a line through two), or linearly; below and above
    the table the end values are held. A coefficient of one value is the same at all speeds.
    """

    source = "Friswell et al. (2010), sec. 5.5.3; interpolation: de Boor (1978), ch. IV"

    displacement = In(shape=2, unit="m", doc="displacement of the shaft [x, y] at the bearing")
    velocity = In(shape=2, unit="m/s", doc="velocity of the shaft [x, y] at the bearing")
    speed = In(unit="rad/s", doc="shaft speed W")
    support_displacement = In(shape=2, unit="m", optional=True, doc="displacement of the support [x, y]")
    support_velocity = In(shape=2, unit="m/s", optional=True, doc="velocity of the support [x, y]")
    force = Out(shape=2, unit="N", doc="force on the shaft [x, y]")
    reaction = Out(shape=2, unit="N", doc="force on the support [x, y], -f")
    interpolation = Option("cubic", choices=("cubic", "linear"), kind=str, doc="curve between the speeds of the table")
    speeds = Param([0.0], **_TABLE, unit="rad/s", doc="speeds of the table, increasing; one: constant coefficients")
    kxx = Param(1e7, **_TABLE, unit="N/m", doc="stiffness: force in -x by displacement in x")
    kxy = Param(0.0, **_TABLE, unit="N/m", doc="force in -x by displacement in y")
    kyx = Param(0.0, **_TABLE, unit="N/m", doc="force in -y by displacement in x")
    kyy = Param(1e7, **_TABLE, unit="N/m", doc="force in -y by displacement in y")
    cxx = Param(1e3, **_TABLE, unit="N s/m", doc="damping: force in -x by velocity in x")
    cxy = Param(0.0, **_TABLE, unit="N s/m", doc="force in -x by velocity in y")
    cyx = Param(0.0, **_TABLE, unit="N s/m", doc="force in -y by velocity in x")
    cyy = Param(1e3, **_TABLE, unit="N s/m", doc="force in -y by velocity in y")

    def check(self, values):
        """Refuse tables whose speeds do not increase."""
        speeds = np.ravel(values["speeds"])
        falls = np.flatnonzero(np.diff(speeds) <= 0)
        return [f"speeds must increase, but {speeds[k + 1]:g} rad/s follows {speeds[k]:g} rad/s" for k in falls[:1]]

    def equations(self, p, u, x, t):
        speeds = rows(p.speeds)
        into = spline.ways(speeds, u.speed)
        linear = self.option.interpolation == "linear"
        at: dict[str, Any] = {}
        for name in _NAMES:
            table = rows(getattr(p, name))
            at[name] = spline.value(table[0], spline.cubics(speeds, table, linear=linear), into)
        q = u.displacement if u.support_displacement is None else u.displacement - u.support_displacement
        v = u.velocity if u.support_velocity is None else u.velocity - u.support_velocity
        push = [
            at[f"k{axis}x"] * q[0] + at[f"k{axis}y"] * q[1] + at[f"c{axis}x"] * v[0] + at[f"c{axis}y"] * v[1]
            for axis in "xy"
        ]
        kinks = speeds if linear else [speeds[0], speeds[-1]]
        events = {"speed": concatenate([u.speed - kink for kink in kinks])} if len(speeds) > 1 else {}
        return Equations(outputs={"force": -vec(*push), "reaction": vec(*push)}, events=events)
