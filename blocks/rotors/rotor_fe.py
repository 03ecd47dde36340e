"""Rotor of beam elements with discs."""

from itertools import accumulate
from math import pi
from typing import Any

from rotorsim.blocks.common import beam
from rotorsim.blocks.common.beam import Banded, solve_factored

from rotorsim.block import Block, Equations, In, Option, Out, Param, State, matrix
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
    gyroscopic moments are options. Nodes count from 1 along the shaft. Rayleigh damping acts on the
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
    element_length = Param(0.1, shape=("elements",), unit="m", above=0.0, doc="length of each element, or of all")
    outer_diameter = Param(0.016, shape=("elements",), unit="m", above=0.0, doc="outer diameter of each element")
    inner_diameter = Param(0.0, shape=("elements",), unit="m", low=0.0, doc="inner diameter of each element")
    young_modulus = Param(2.1e11, unit="N/m^2", above=0.0, doc="modulus of elasticity (not printed in the thesis)")
    density = Param(7850.0, unit="kg/m^3", above=0.0, doc="density of the shaft")
    poisson_ratio = Param(0.3, low=0.0, high=0.5, doc="Poisson's ratio (theory timoshenko)")
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
        if not (values["inner_diameter"] < values["outer_diameter"]).all():
            problems.append("inner_diameter must be smaller than outer_diameter")
        return problems

    def equations(self, p, u, x, t):
        free = self._free_numbers()
        mass, gyroscopic, stiffness, disc = self._matrices(p, free)
        lower, inverse_d = mass.factor()
        q = [x.position[:, plane].elements() for plane in (0, 1)]
        v = [x.velocity[:, plane].elements() for plane in (0, 1)]
        loads = [self._loads(u, free, plane) for plane in (0, 1)]
        spin = [[u.speed * g for g in gyroscopic.times(v[1])], [-u.speed * g for g in gyroscopic.times(v[0])]]
        accelerations = []
        for plane in (0, 1):
            # M^-1 a0 M_shaft v = a0 v - M^-1 a0 M_disc v, so that damping costs next to nothing
            bent = stiffness.times([a + p.stiffness_damping * b for a, b in zip(q[plane], v[plane], strict=True)])
            rest = [f - k - g for f, k, g in zip(loads[plane], bent, spin[plane], strict=True)]
            for number, inertia in disc.items():
                rest[number] = rest[number] + p.mass_damping * inertia * v[plane][number]
            for k, node in enumerate(self.option.disc_nodes):
                across = free[2 * self._place(node)]
                if across is not None:
                    rest[across] = rest[across] - beam.entry(p.disc_damping, k) * v[plane][across]
            solved = solve_factored(lower, inverse_d, rest)
            accelerations.append([a - p.mass_damping * b for a, b in zip(solved, v[plane], strict=True)])
        return Equations(
            outputs={
                "displacement": self._by_node(free, q, 0),
                "tilt": self._by_node(free, q, 1),
                "velocity": self._by_node(free, v, 0),
                "tilt_velocity": self._by_node(free, v, 1),
            },
            derivatives={"position": x.velocity, "velocity": matrix(list(zip(*accelerations, strict=True)))},
        )

    def _free_numbers(self) -> list[int | None]:
        """Return the number of every degree of freedom among the free ones (None: pinned)."""
        pinned = {self._place(node) for node in self.option.pinned_nodes}
        places = range(self.option.elements * self.option.subdivisions + 1)
        held = [place in pinned and not is_slope for place in places for is_slope in (False, True)]
        return [None if h else n - 1 for h, n in zip(held, accumulate(not h for h in held), strict=True)]

    def _place(self, node: int) -> int:
        """Return the place (from 0) of a node among the ends of all beams."""
        return (node - 1) * int(self.option.subdivisions)

    def _matrices(self, p: Any, free: list[int | None]) -> tuple[Banded, Banded, Banded, dict[int, Any]]:
        """Return M, G and K of one plane, and the disc entries of the diagonal of M."""
        size = sum(number is not None for number in free)
        mass, gyroscopic, stiffness = Banded(size), Banded(size), Banded(size)

        parts_of = self.option.subdivisions
        for e in range(self.option.elements * parts_of):
            sizes = (p.element_length, p.outer_diameter, p.inner_diameter)
            length, outer, inner = (beam.entry(v, e // parts_of) for v in sizes)
            length = length / parts_of
            area = pi / 4 * (outer**2 - inner**2)
            second = pi / 64 * (outer**4 - inner**4)
            phi: Any = 0.0
            if self.option.theory == "timoshenko":
                shear = p.young_modulus / (2 * (1 + p.poisson_ratio))
                kappa = beam.shear_coefficient(p.poisson_ratio, inner, outer)
                phi = 12 * p.young_modulus * second / (kappa * shear * area * length**2)
            rotary = beam.rotary_mass(p.density * second, length, phi)
            parts = [(stiffness, beam.stiffness(p.young_modulus * second, length, phi), 1.0)]
            parts.append((mass, beam.translation_mass(p.density * area * length, length, phi), 1.0))
            if self.option.rotary_inertia:
                parts.append((mass, rotary, 1.0))
            if self.option.shaft_gyroscopic:
                parts.append((gyroscopic, rotary, 2.0))
            numbers = free[2 * e : 2 * e + 4]
            for target, table, factor in parts:
                for i, row in zip(numbers, table, strict=True):
                    for j, value in zip(numbers, row, strict=True):
                        if i is not None and j is not None:
                            target.add(i, j, factor * value)
        disc: dict[int, Any] = {}
        for k, node in enumerate(self.option.disc_nodes):
            across, slope = free[2 * self._place(node)], free[2 * self._place(node) + 1]
            if across is not None:
                disc[across] = disc.get(across, 0.0) + beam.entry(p.disc_mass, k)
            if slope is not None and not self.option.point_discs:
                disc[slope] = disc.get(slope, 0.0) + p.disc_inertia_factor * beam.entry(p.disc_diametral_inertia, k)
                gyroscopic.add(slope, slope, p.disc_inertia_factor * beam.entry(p.disc_polar_inertia, k))
        for number, inertia in disc.items():
            mass.add(number, number, inertia)
        return mass, gyroscopic, stiffness, disc

    def _loads(self, u: Any, free: list[int | None], plane: int) -> list[Any]:
        forces, moments = u.force[:, plane].elements(), u.moment[:, plane].elements()
        every: list[Any] = [0.0] * len(free)
        for node, pair in enumerate(zip(forces, moments, strict=True), start=1):
            every[2 * self._place(node) : 2 * self._place(node) + 2] = pair
        return [value for value, number in zip(every, free, strict=True) if number is not None]

    def _by_node(self, free: list[int | None], values: list[list[Any]], which: int) -> Any:
        def at(node: int, plane: int) -> Any:
            number = free[2 * self._place(node) + which]
            return 0.0 if number is None else values[plane][number]

        return matrix([[at(node, 0), at(node, 1)] for node in range(1, self.option.elements + 2)])
