"""Rotor of beam elements with discs."""

from itertools import accumulate
from typing import Any

from rotorsim.blocks.common.beam import each, entry
from rotorsim.blocks.common.drawing import Drawing, Section, equivalent_disc, full, tapered
from rotorsim.blocks.common.shaft import SIZES, Beam, Place, Shaft, divided

from rotorsim.block import Block, In, Option, Out, Param, State
from rotorsim.fault import Fault


def _nodes(option: Any) -> tuple[int, int]:
    return option.elements + 1, 2


def _free(option: Any) -> tuple[int, int]:
    return 2 * (option.elements * option.subdivisions + 1) - len(set(option.pinned_nodes)), 2


class RotorFe(Block):
    """Move a shaft of beam elements with rigid discs, in two planes, with gyroscopic moments.

    M q'' + (C + W G J) q' + K q = f,   C = a0 M_shaft + a1 K,   G J (q_1, q_2) = (G q_2, -G q_1)

    q: displacement and slope of every node in the planes of x and y (slope = du/dz). With q_1 + i q_2 the
    gyroscopic term is -i W G q', which raises forward modes; the thesis' eq. (3.2) has the opposite sign.
    Element matrices: Euler-Bernoulli or Timoshenko, consistent mass; shaft rotary inertia and shaft
    gyroscopic moments are options. A conical element has the shapes of the cylinder of its middle; a sleeve, conical or
    not, adds its own matrices to those of its element. Nodes count from 1 along the shaft. Rayleigh damping acts on the
    elements of the shaft, eq. (C.4), disc_damping on the displacement of each disc. M is factored once (banded
    L D L^T); cost grows linearly with elements.
    """

    type_name = "rotor_fe"
    source = "thesis eq. (4.9)-(4.16), (5.4), App. B, C; Friswell et al. (2010), ch. 5"
    refinement = "subdivisions"
    faults = (
        Fault(
            physics="disc_rotary_inertia",
            enters="replace",
            of=("rotor_fe",),
            options={"point_discs": False},
            free={"disc_inertia_factor": (1.0,)},
            law="grows with the square of frequency, on the slope of the discs: lowers modes that tilt them",
            confused_with=("gyroscopic_error", "mass_error", "support_stiffness"),
            told_apart_by="modes at rest: the shapes of those that it lowers",
            source="Friswell et al. (2010), sec. 5.4",
        ),
    )

    force = In(shape=_nodes, unit="N", additive=True, conjugate="displacement", doc="sum of the forces [node, xy]")
    moment = In(shape=_nodes, unit="N m", additive=True, conjugate="tilt", doc="sum of the moments [node, xy]")
    speed = In(unit="rad/s", doc="shaft speed W")
    displacement = Out(shape=_nodes, unit="m", doc="displacement [node, xy]")
    tilt = Out(shape=_nodes, unit="rad", doc="slope in the planes of x and y [node, xy]")
    velocity_port = Out(name="velocity", shape=_nodes, unit="m/s", doc="velocity [node, xy]")
    tilt_velocity = Out(shape=_nodes, unit="rad/s", doc="rate of slope [node, xy]")
    elements = Option(5, kind=int, low=1, high=2000, doc="number of elements")
    subdivisions = Option(1, kind=int, low=1, high=100, doc="beams that make up each element; nodes stay its ends")
    theory = Option("euler_bernoulli", choices=("euler_bernoulli", "timoshenko"), kind=str, doc="beam theory")
    rotary_inertia = Option(False, kind=bool, doc="rotary inertia of the shaft")
    shaft_gyroscopic = Option(False, kind=bool, doc="gyroscopic moments of the shaft")
    point_discs = Option(False, kind=bool, doc="leave out the rotary inertia of the discs")
    disc_nodes = Option([3], kind=int, low=1, doc="nodes that carry a disc")
    pinned_nodes = Option([], kind=int, low=1, doc="nodes whose displacement is held at zero")
    conical_elements = Option([], kind=int, low=1, doc="elements whose diameters change evenly along them; from 1")
    sleeve_elements = Option([], kind=int, low=1, doc="elements that a sleeve is shrunk on, in parallel; from 1")
    conical_sleeves = Option([], kind=int, low=1, doc="sleeves whose diameters change evenly along them; from 1")
    element_length = Param(0.1, shape=("elements",), unit="m", above=0.0, doc="length of each element, or of all")
    outer_diameter = Param(0.016, shape=("elements",), unit="m", above=0.0, doc="outer diameter of each element")
    inner_diameter = Param(0.0, shape=("elements",), unit="m", low=0.0, doc="inner diameter of each element")
    end_outer_diameter = Param(
        0.016, shape=("conical_elements",), unit="m", above=0.0, doc="outer diameter at the end of each conical element"
    )
    end_inner_diameter = Param(
        0.0, shape=("conical_elements",), unit="m", low=0.0, doc="inner diameter at the end of each conical element"
    )
    young_modulus = Param(
        2.1e11, shape=("elements",), unit="N/m^2", above=0.0, doc="modulus of elasticity (not printed in the thesis)"
    )
    density = Param(7850.0, shape=("elements",), unit="kg/m^3", above=0.0, doc="density of the shaft")
    poisson_ratio = Param(0.3, shape=("elements",), above=-1.0, high=0.5, doc="Poisson's ratio (theory timoshenko)")
    sleeve_outer_diameter = Param(0.1, shape=("sleeve_elements",), unit="m", above=0.0, doc="of each sleeve")
    sleeve_inner_diameter = Param(0.05, shape=("sleeve_elements",), unit="m", low=0.0, doc="of each sleeve")
    sleeve_end_outer_diameter = Param(
        0.1, shape=("conical_sleeves",), unit="m", above=0.0, doc="outer diameter at the end of each conical sleeve"
    )
    sleeve_end_inner_diameter = Param(
        0.05, shape=("conical_sleeves",), unit="m", low=0.0, doc="inner diameter at the end of each conical sleeve"
    )
    sleeve_young_modulus = Param(2.1e11, shape=("sleeve_elements",), unit="N/m^2", above=0.0, doc="of each sleeve")
    sleeve_density = Param(7850.0, shape=("sleeve_elements",), unit="kg/m^3", low=0.0, doc="of each sleeve")
    sleeve_poisson_ratio = Param(0.3, shape=("sleeve_elements",), above=-1.0, high=0.5, doc="of each sleeve")
    disc_mass = Param(2.0, shape=("disc_nodes",), unit="kg", low=0.0, doc="mass of each disc")
    disc_polar_inertia = Param(0.0045, shape=("disc_nodes",), unit="kg m^2", low=0.0, doc="I_p of each disc")
    disc_diametral_inertia = Param(0.0024, shape=("disc_nodes",), unit="kg m^2", low=0.0, doc="I_d of each disc")
    disc_inertia_factor = Param(1.0, low=0.0, doc="factor on the inertias I_p and I_d of all discs")
    mass_damping = Param(0.0, unit="1/s", low=0.0, doc="Rayleigh's a0")
    stiffness_damping = Param(0.0, unit="s", low=0.0, doc="Rayleigh's a1")
    disc_damping = Param(
        0.0, shape=("disc_nodes",), unit="N s/m", low=0.0, tolerance=3.0, doc="viscous damping of each disc"
    )
    position = State(shape=_free, unit=None, doc="free displacements and slopes [dof, plane], node by node")
    velocity = State(shape=_free, unit=None, doc="their rates")

    def check(self, values):
        """Refuse nodes that do not exist, doubled pins and walls of no thickness."""
        nodes = self.option.elements + 1
        problems = [
            f"{name} has node {node}; the rotor has nodes 1 to {nodes}"
            for name in ("disc_nodes", "pinned_nodes")
            for node in getattr(self.option, name)
            if not 1 <= node <= nodes
        ]
        if len(set(self.option.pinned_nodes)) != len(self.option.pinned_nodes):
            problems.append("pinned_nodes names a node twice")
        sleeves = len(self.option.sleeve_elements)
        for name, of, count in (
            ("conical_elements", "element", self.option.elements),
            ("sleeve_elements", "element", self.option.elements),
            ("conical_sleeves", "sleeve", sleeves),
        ):
            wrong = [k for k in getattr(self.option, name) if not 1 <= k <= count]
            problems += [f"{name} has {of} {k}; the rotor has {of}s 1 to {count}" for k in wrong]
        for name, of in (("conical_elements", "an element"), ("conical_sleeves", "a sleeve")):
            if len(set(getattr(self.option, name))) != len(getattr(self.option, name)):
                problems.append(f"{name} names {of} twice")
        there = {"": True, "end_": self.option.conical_elements, "sleeve_": sleeves}
        there["sleeve_end_"] = self.option.conical_sleeves
        for prefix in (prefix for prefix, any_there in there.items() if any_there):
            if not (values[f"{prefix}inner_diameter"] < values[f"{prefix}outer_diameter"]).all():
                problems.append(f"{prefix}inner_diameter must be smaller than {prefix}outer_diameter")
        return problems

    def drawing(self, values):
        """Return what the rotor looks like; values: parameters as SI arrays of their resolved shapes."""
        option, count, discs = self.option, self.option.elements, self.option.disc_nodes
        ends = [0.0, *accumulate(full(values["element_length"], count))]
        keys = ("outer_diameter", "inner_diameter", "density")

        def pieces(prefix: str, at: list[int], cones: list[int]) -> list[Section]:
            """Return sections or sleeves at elements (from 1)."""
            rows = zip(*(full(values[f"{prefix}{key}"], len(at)) for key in keys), strict=True)
            straight = [Section(ends[e - 1], ends[e], *row) for e, row in zip(at, rows, strict=True)]
            both = (full(values[f"{prefix}end_{key}"], len(cones)) for key in keys[:2])
            return tapered(straight, cones, zip(*both, strict=True))

        sections = pieces("", list(range(1, count + 1)), option.conical_elements)
        sleeves = pieces("sleeve_", option.sleeve_elements, option.conical_sleeves)
        pinned = tuple(ends[node - 1] for node in self.option.pinned_nodes)
        keys = ("disc_mass", "disc_polar_inertia", "disc_diametral_inertia")
        sizes = zip(*(full(values[key], len(discs)) for key in keys), strict=True)
        shown = [equivalent_disc(ends[node - 1], *size) for node, size in zip(discs, sizes, strict=True)]
        return Drawing(tuple(sections), tuple(shown), tuple(ends), (), "node", pinned, tuple(sleeves))

    def equations(self, p, u, x, t):
        shaft, places = self._shaft(p)
        return shaft.motion(places, p, u, x)

    def _place(self, node: int) -> int:
        """Return the place (from 0) of a node among the ends of all beams."""
        return (node - 1) * int(self.option.subdivisions)

    def _shaft(self, p: Any) -> tuple[Shaft, list[Place]]:
        """Return the shaft with its discs, and the places of the nodes."""
        option, parts = self.option, self.option.subdivisions
        lengths = [entry(p.element_length, e) / parts for e in range(option.elements)]

        def beams(prefix: str, at: list[int], cones: list[int]) -> list[list[Beam]]:
            """Return the parts of the elements or sleeves at elements (from 1)."""
            sizes = each((getattr(p, f"{prefix}{key}") for key in SIZES), len(at))
            straight = [Beam(lengths[e - 1], *size) for e, size in zip(at, sizes, strict=True)]
            both = each((getattr(p, f"{prefix}end_{key}") for key in SIZES[:2]), len(cones))
            return [divided(one, parts) for one in tapered(straight, cones, both)]

        elements = beams("", list(range(1, option.elements + 1)), option.conical_elements)
        shaft = Shaft(
            [one for element in elements for one in element],
            theory=option.theory,
            rotary_inertia=option.rotary_inertia,
            gyroscopic=option.shaft_gyroscopic,
            pinned=map(self._place, option.pinned_nodes),
        )
        sleeves = beams("sleeve_", option.sleeve_elements, option.conical_sleeves)
        for e, sleeve in zip(option.sleeve_elements, sleeves, strict=True):
            for part, one in enumerate(sleeve):
                shaft.add_beam((e - 1) * parts + part, one)
        places = [shaft.at(self._place(node)) for node in range(1, option.elements + 2)]
        for k, node in enumerate(option.disc_nodes):
            inertias = (p.disc_polar_inertia, p.disc_diametral_inertia)
            polar, diametral = (p.disc_inertia_factor * entry(value, k) for value in inertias)
            shaft.add_disc(
                places[node - 1],
                entry(p.disc_mass, k),
                None if option.point_discs else polar,
                diametral,
                entry(p.disc_damping, k),
            )
        return shaft, places
