"""Bow of a whole shaft, in a few static shapes."""

from math import pi
from typing import Any

from rotorsim.blocks.common import beam, plane

from rotorsim.block import Block, Equations, In, Option, Out, Param, cos, matrix, sin
from rotorsim.fault import Fault, Of

_SHAPES = 4


def _nodes(option: Any) -> tuple[int, int]:
    return option.elements + 1, 2


def _fault(shapes: int) -> Fault:
    """Return the declaration with the first shapes."""
    sizes = tuple(f"amplitude{k}" for k in range(1, shapes + 1))
    free: dict[str, tuple[float, ...]] = {}
    for k, size in enumerate(sizes, start=1):
        free |= {size: (1e-6,), f"phase{k}": plane.ANGLES if k == 1 else (0.0,)}
    return Fault(
        physics="residual_bow",
        enters="shaft",
        free=free,
        most={size: Of("displacement", 1e3) for size in sizes},
        sizes=sizes,
        inherits=("elements", "element_length", "outer_diameter", "inner_diameter", "young_modulus"),
        law="1X forward, forces at all nodes constant in speed, present at slow roll",
        confused_with=("runout", "parallel_misalignment", "thermal_bow"),
        told_apart_by="a probe at the disc, another set of gains, slow roll",
    )


class ShaftBow(Block):
    """Give the forces of a beam that is bent when it is at rest.

    f = K b e^{i theta},   b(z) = sum_k amplitude_k e^{i phase_k} sin(k pi z / L),   k = 1, 2, 3, 4,   z = x + i y

    K: stiffness of the free beam (Euler-Bernoulli), b: displacement and slope of each node against the line through
    both ends. The elastic force -K (q - b) of a shaft whose unloaded shape b turns with it, less the part -K q that
    the rotor has.
    """

    source = "Nicholas, Gunter & Allaire, J. Eng. Power 98 (1976) 171-181; Friswell et al. (2010), ch. 6"
    faults = tuple(_fault(shapes) for shapes in range(1, _SHAPES + 1))

    theta = In(unit="rad", doc="shaft angle")
    force = Out(shape=_nodes, unit="N", doc="forces on the rotor [node, xy]")
    moment = Out(shape=_nodes, unit="N m", doc="moments on the rotor, in the planes of x and y [node, xy]")
    elements = Option(5, kind=int, low=1, high=2000, doc="number of elements of the rotor")
    element_length = Param(0.1, shape=("elements",), unit="m", above=0.0, doc="length of each element, or of all")
    outer_diameter = Param(0.016, shape=("elements",), unit="m", above=0.0, doc="outer diameter of each element")
    inner_diameter = Param(0.0, shape=("elements",), unit="m", low=0.0, doc="inner diameter of each element")
    young_modulus = Param(2.1e11, shape=("elements",), unit="N/m^2", above=0.0, doc="modulus of elasticity")
    shapes = (
        Param(1e-6, name="amplitude1", unit="m", low=0.0, doc="size of the first shape, one half wave"),
        Param(0.0, name="phase1", unit="rad", doc="its angle against the phase reference"),
        Param(0.0, name="amplitude2", unit="m", low=0.0, doc="size of the second shape"),
        Param(0.0, name="phase2", unit="rad", doc="its angle"),
        Param(0.0, name="amplitude3", unit="m", low=0.0, doc="size of the third shape"),
        Param(0.0, name="phase3", unit="rad", doc="its angle"),
        Param(0.0, name="amplitude4", unit="m", low=0.0, doc="size of the fourth shape"),
        Param(0.0, name="phase4", unit="rad", doc="its angle"),
    )

    def equations(self, p, u, x, t):
        count = self.option.elements
        lengths = [beam.entry(p.element_length, e) for e in range(count)]
        places: list[Any] = [0.0]
        for length in lengths:
            places.append(places[-1] + length)
        forces: list[list[Any]] = [[0.0, 0.0] for _ in range(2 * count + 2)]
        for k in range(1, _SHAPES + 1):
            wave = k * pi / places[-1]
            bent = [value for z in places for value in (sin(wave * z), wave * cos(wave * z))]
            turned = getattr(p, f"amplitude{k}") * plane.unit(u.theta + getattr(p, f"phase{k}"))
            loads: list[Any] = [0.0] * len(bent)
            for e, length in enumerate(lengths):
                sizes = (p.outer_diameter, p.inner_diameter, p.young_modulus)
                outer, inner, modulus = (beam.entry(v, e) for v in sizes)
                table = beam.stiffness(modulus * pi / 64 * (outer**4 - inner**4), length, 0.0)
                for i, row in enumerate(table):
                    loads[2 * e + i] += sum(a * b for a, b in zip(row, bent[2 * e : 2 * e + 4], strict=True))
            for i, load in enumerate(loads):
                forces[i] = [forces[i][plane] + load * turned[plane] for plane in (0, 1)]
        return Equations(outputs={"force": matrix(forces[0::2]), "moment": matrix(forces[1::2])})
