"""Rotor from a drawing."""

from itertools import accumulate, pairwise
from typing import Any

from rotorsim.blocks.common.beam import each
from rotorsim.blocks.common.drawing import (
    Drawing,
    DrawnDisc,
    Section,
    cylinder,
    equivalent_disc,
    full,
    sections_of,
    sleeve_ends,
    tapered,
)
from rotorsim.blocks.common.drawn_mistakes import mistakes
from rotorsim.blocks.common.mesh import Mesh, meshed
from rotorsim.blocks.common.shaft import SIZES, Beam, Place, Shaft, piece

from rotorsim.block import Block, In, Option, Out, Param, State

DRAWN_DISC = tuple(f"drawn_disc_{key}" for key in ("density", "outer_diameter", "inner_diameter", "width"))


def _mesh(option: Any) -> Mesh:
    places = (*option.disc_positions, *option.drawn_disc_positions, *option.stations)
    sleeves = [z for ends in sleeve_ends(option) for z in ends]
    longest, shortest = option.longest_element, option.shortest_element
    return meshed(option.section_lengths, places, longest, shortest, option.subdivisions, sleeves)


def _free(option: Any) -> tuple[int, int]:
    return 2 * len(_mesh(option).ends), 2


class RotorDrawing(Block):
    """Move the rotor of a drawing: sections, discs, and stations where forces act and motion is seen.

    M q'' + (C + W G J) q' + K q = f - M 1_y g,   C = a0 M_shaft + a1 K,   G J (q_1, q_2) = (G q_2, -G q_1)

    As rotor_fe, whose matrices it has, but meshed by itself: beams end at section ends, sleeves, discs and stations,
    unless a disc or station is closer than shortest_element to another end; it acts on the beam by its shapes then.
    Positions are measured along the axis from the left end. The diameters of a conical section change evenly along it.
    A sleeve has all of its mass and a share of the stiffness that it would have of one piece with the shaft: K_shaft +
    share K_sleeve. A disc is rigid, has its mass at its middle, and does not stiffen the shaft. Gravity acts in -y on
    all mass (0: a rotor that stands upright). Without bearings it is free. Shear, rotary inertia and gyroscopic
    moments of the shaft are in; one row of a port is one station.
    """

    type_name = "rotor_drawing"
    source = "Friswell et al. (2010), ch. 5; Cowper (1966)"
    refinement = "subdivisions"

    force = In(shape=("stations", 2), unit="N", additive=True, conjugate="displacement", doc="forces [station, xy]")
    moment = In(shape=("stations", 2), unit="N m", additive=True, conjugate="tilt", doc="moments [station, xy]")
    speed = In(unit="rad/s", doc="shaft speed W")
    displacement = Out(shape=("stations", 2), unit="m", doc="displacement [station, xy]")
    tilt = Out(shape=("stations", 2), unit="rad", doc="slope in the planes of x and y [station, xy]")
    velocity_port = Out(name="velocity", shape=("stations", 2), unit="m/s", doc="velocity [station, xy]")
    tilt_velocity = Out(shape=("stations", 2), unit="rad/s", doc="rate of slope [station, xy]")
    section_lengths = Option(None, kind=float, listed=True, unit="m", above=0.0, doc="length of each section")
    stations = Option(None, kind=float, listed=True, unit="m", doc="axial position of each station")
    station_names = Option([], kind=str, doc="name of each station, for pictures and messages")
    conical_sections = Option([], kind=int, low=1, doc="sections whose diameters change evenly along them; from 1")
    sleeve_begins = Option([], kind=float, unit="m", doc="axial position of the left end of each sleeve")
    sleeve_lengths = Option([], kind=float, unit="m", above=0.0, doc="length of each sleeve")
    disc_positions = Option([], kind=float, unit="m", doc="axial position of each disc given by mass and inertias")
    drawn_disc_positions = Option([], kind=float, unit="m", doc="axial position of each disc given by its dimensions")
    longest_element = Option(0.0, kind=float, unit="m", low=0.0, doc="longest beam; 0: a twelfth of the shaft")
    shortest_element = Option(
        0.0, kind=float, unit="m", low=0.0, doc="shortest beam made for a disc or station; 0: 1/200 of the shaft"
    )
    subdivisions = Option(1, kind=int, low=1, high=100, doc="beams that make up each beam of the mesh")
    theory = Option("timoshenko", choices=("euler_bernoulli", "timoshenko"), kind=str, doc="beam theory")
    rotary_inertia = Option(True, kind=bool, doc="rotary inertia of the shaft")
    shaft_gyroscopic = Option(True, kind=bool, doc="gyroscopic moments of the shaft")
    outer_diameter = Param(shape=("section_lengths",), unit="m", above=0.0, doc="outer diameter of each section")
    inner_diameter = Param(0.0, shape=("section_lengths",), unit="m", low=0.0, doc="inner diameter of each section")
    end_outer_diameter = Param(
        0.0, shape=("conical_sections",), unit="m", low=0.0, doc="outer diameter at the right end of each cone"
    )
    end_inner_diameter = Param(
        0.0, shape=("conical_sections",), unit="m", low=0.0, doc="inner diameter at the right end of each cone"
    )
    young_modulus = Param(
        2.1e11, shape=("section_lengths",), unit="N/m^2", above=0.0, doc="modulus of elasticity, of each or all"
    )
    density = Param(7850.0, shape=("section_lengths",), unit="kg/m^3", above=0.0, doc="density, of each or all")
    poisson_ratio = Param(0.3, shape=("section_lengths",), low=0.0, high=0.5, doc="Poisson's ratio, of each or all")
    sleeve_outer_diameter = Param(0.0, shape=("sleeve_begins",), unit="m", low=0.0, doc="outer diameter of each sleeve")
    sleeve_inner_diameter = Param(0.0, shape=("sleeve_begins",), unit="m", low=0.0, doc="its bore")
    sleeve_stiffness_share = Param(
        0.0, shape=("sleeve_begins",), low=0.0, high=1.0, doc="share of its stiffness; 0: mass only, 1: one piece"
    )
    sleeve_young_modulus = Param(2.1e11, shape=("sleeve_begins",), unit="N/m^2", above=0.0, doc="its modulus")
    sleeve_density = Param(7850.0, shape=("sleeve_begins",), unit="kg/m^3", above=0.0, doc="its density")
    sleeve_poisson_ratio = Param(0.3, shape=("sleeve_begins",), low=0.0, high=0.5, doc="its Poisson's ratio")
    disc_mass = Param(0.0, shape=("disc_positions",), unit="kg", low=0.0, doc="mass of each disc")
    disc_polar_inertia = Param(0.0, shape=("disc_positions",), unit="kg m^2", low=0.0, doc="I_p of each disc")
    disc_diametral_inertia = Param(0.0, shape=("disc_positions",), unit="kg m^2", low=0.0, doc="I_d of each disc")
    drawn_disc_outer_diameter = Param(
        0.0, shape=("drawn_disc_positions",), unit="m", low=0.0, doc="outer diameter of each disc by dimensions"
    )
    drawn_disc_inner_diameter = Param(0.0, shape=("drawn_disc_positions",), unit="m", low=0.0, doc="its bore")
    drawn_disc_width = Param(0.0, shape=("drawn_disc_positions",), unit="m", low=0.0, doc="its width along the axis")
    drawn_disc_density = Param(7850.0, shape=("drawn_disc_positions",), unit="kg/m^3", above=0.0, doc="its density")
    gravity = Param(9.81, unit="m/s^2", low=0.0, doc="acceleration g of gravity, in -y")
    mass_damping = Param(0.0, unit="1/s", low=0.0, doc="Rayleigh's a0, of the shaft")
    stiffness_damping = Param(0.0, unit="s", low=0.0, doc="Rayleigh's a1, of the shaft")
    position = State(shape=_free, unit=None, doc="displacements and slopes [dof, plane], end by end of the beams")
    velocity = State(shape=_free, unit=None, doc="their rates")

    def check_given(self, given):
        """Refuse what is off the shaft, walls of no thickness, and what lacks a size, a mass or a share."""
        return mistakes(self.option, given)

    def drawing(self, values):
        """Return what the rotor looks like; values: parameters as SI arrays of their resolved shapes."""
        option = self.option
        count = len(option.disc_positions)
        keys = ("disc_mass", "disc_polar_inertia", "disc_diametral_inertia")
        given = zip(option.disc_positions, *(full(values[key], count) for key in keys), strict=True)
        discs = [equivalent_disc(*row) for row in given]
        count = len(option.drawn_disc_positions)
        drawn = zip(option.drawn_disc_positions, *(full(values[key], count) for key in DRAWN_DISC), strict=True)
        discs += [DrawnDisc(z, cylinder(*size)[0], *size[1:], drawn=True) for z, *size in drawn]
        sizes = [
            full(values[f"sleeve_{key}"], len(option.sleeve_begins))
            for key in ("outer_diameter", "inner_diameter", "density")
        ]
        sleeves = tuple(Section(*ends, *row) for ends, *row in zip(sleeve_ends(option), *sizes, strict=True))
        sections = tuple(sections_of(option, values))
        return Drawing(sections, tuple(discs), tuple(option.stations), tuple(option.station_names), sleeves=sleeves)

    def equations(self, p, u, x, t):
        shaft, places = self._shaft(p)
        return shaft.motion(places, p, u, x, gravity=p.gravity)

    def _shaft(self, p: Any) -> tuple[Shaft, list[Place]]:
        """Return the shaft with its discs, and the places of the stations."""
        option, mesh = self.option, _mesh(self.option)
        shaft = Shaft(
            self._beams(p, mesh),
            theory=option.theory,
            rotary_inertia=option.rotary_inertia,
            gyroscopic=option.shaft_gyroscopic,
        )
        sleeves = each((getattr(p, f"sleeve_{key}") for key in (*SIZES, "stiffness_share")), len(option.sleeve_begins))
        for (left, right), (*sizes, share) in zip(sleeve_ends(option), sleeves, strict=True):
            for number, (begin, end) in enumerate(pairwise(mesh.ends)):
                if left < (begin + end) / 2 < right:
                    shaft.add_beam(number, Beam(end - begin, *sizes), share)

        def at(z: float) -> Place:
            number, distance = mesh.place(z)
            return shaft.within(number, distance) if distance else shaft.at(number)

        sizes = each((p.disc_mass, p.disc_polar_inertia, p.disc_diametral_inertia), len(option.disc_positions))
        for z, size in zip(option.disc_positions, sizes, strict=True):
            shaft.add_disc(at(z), *size, 0.0)
        sizes = each((getattr(p, key) for key in DRAWN_DISC), len(option.drawn_disc_positions))
        for z, size in zip(option.drawn_disc_positions, sizes, strict=True):
            shaft.add_disc(at(z), *cylinder(*size), 0.0)
        return shaft, [at(z) for z in option.stations]

    def _beams(self, p: Any, mesh: Mesh) -> list[Beam]:
        """Return the beams of the mesh, those of a cone with the diameters that it has where they end."""
        option, lengths = self.option, self.option.section_lengths
        sizes = each((getattr(p, key) for key in SIZES), len(lengths))
        straight = [Beam(length, *size) for length, size in zip(lengths, sizes, strict=True)]
        ends = each((p.end_outer_diameter, p.end_inner_diameter), len(option.conical_sections))
        sections = tapered(straight, option.conical_sections, ends)
        borders, beams = [0.0, *accumulate(lengths)], []
        for (begin, end), number in zip(pairwise(mesh.ends), mesh.sections, strict=True):
            left, length = borders[number], lengths[number]
            beams.append(piece(sections[number], (begin - left) / length, (end - left) / length, end - begin))
        return beams
