"""Rotor from a drawing."""

from itertools import accumulate, pairwise
from typing import Any

from rotorsim.blocks.common.beam import entry
from rotorsim.blocks.common.drawing import Drawing, DrawnDisc, Section, cylinder, equivalent_disc, full
from rotorsim.blocks.common.mesh import ROUNDING, Mesh, meshed
from rotorsim.blocks.common.shaft import Beam, Place, Shaft

from rotorsim.block import Block, In, Option, Out, Param, State


def _mesh(option: Any) -> Mesh:
    places = (*option.disc_positions, *option.drawn_disc_positions, *option.stations)
    return meshed(option.section_lengths, places, option.longest_element, option.shortest_element, option.subdivisions)


def _free(option: Any) -> tuple[int, int]:
    return 2 * len(_mesh(option).ends), 2


MOST_BEAMS = 500  # that a drawing is meshed with
FITS = 0.02  # of a diameter, by which a bore may be narrower than the shaft


class RotorDrawing(Block):
    """Move the rotor of a drawing: sections, discs, and stations where forces act and motion is seen.

    M q'' + (C + W G J) q' + K q = f - M 1_y g,   C = a0 M_shaft + a1 K,   G J (q_1, q_2) = (G q_2, -G q_1)

    As rotor_fe, whose matrices it has, but meshed by itself: beams end at section ends, discs and stations, unless
    these are closer than shortest_element to one another; such a station or disc acts on the beam by its shapes.
    Positions are measured along the axis from the left end. A disc is rigid, has its mass at its middle, and does not
    stiffen the shaft. Gravity acts in -y on all mass (0: a rotor that stands upright). Without bearings it is free.
    Shear, rotary inertia and gyroscopic moments of the shaft are in; one row of a port is one station.
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
    young_modulus = Param(
        2.1e11, shape=("section_lengths",), unit="N/m^2", above=0.0, doc="modulus of elasticity, of each or all"
    )
    density = Param(7850.0, shape=("section_lengths",), unit="kg/m^3", above=0.0, doc="density, of each or all")
    poisson_ratio = Param(0.3, shape=("section_lengths",), low=0.0, high=0.5, doc="Poisson's ratio, of each or all")
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
        """Refuse what is off the shaft, walls of no thickness, and discs without mass."""
        option, total = self.option, sum(self.option.section_lengths)
        problems = []
        for name in ("section_lengths", "stations"):
            if not getattr(option, name):
                problems.append((name, (), "the list is empty", "a rotor has a section, and a station to act on"))
        for name, what in (("stations", "station"), ("disc_positions", "disc"), ("drawn_disc_positions", "disc")):
            for k, z in enumerate(getattr(option, name)):
                if total and not -ROUNDING * total <= z <= total * (1 + ROUNDING):
                    side = f"{z * 1e3:g} mm is {'left' if z < 0 else 'right'} of the shaft"
                    problems.append((name, (k,), f"{what} {k + 1} at {side}", f"it goes from 0 to {total * 1e3:g} mm"))
        names = option.station_names
        if names and len(names) != len(option.stations):
            what = f"has {len(names)} entries, but there are {len(option.stations)} stations"
            problems.append(("station_names", (), what, "give one name for each, or none"))
        if option.longest_element and option.shortest_element > option.longest_element:
            problems.append(("shortest_element", (), "is longer than longest_element", "or leave both out"))
        for prefix, what, lengths in (
            ("", "section", option.section_lengths),
            ("drawn_disc_", "disc", option.drawn_disc_positions),
        ):
            problems += self._walls(prefix, what, len(lengths), given)
        problems += self._massless(given)
        problems += self._bores(given)
        if option.longest_element and total / option.longest_element > MOST_BEAMS:
            what = f"makes more than {MOST_BEAMS} beams of {total * 1e3:g} mm"
            problems.append(("longest_element", (), what, "a twelfth of the shaft is the default"))
        return problems

    def _bores(self, given):
        """Refuse discs whose bore is narrower than the shaft within them: its material would count twice."""
        shaft, bores, widths = (
            given.get(name) for name in ("outer_diameter", "drawn_disc_inner_diameter", "drawn_disc_width")
        )
        count, borders = len(self.option.drawn_disc_positions), [0.0, *accumulate(self.option.section_lengths)]
        if shaft is None or widths is None or not count:
            return []
        shaft, widths = full(shaft, len(borders) - 1), full(widths, count)
        bores = full(0.0 if bores is None else bores, count)
        if not (len(shaft) == len(borders) - 1 and len(widths) == len(bores) == count):  # said elsewhere
            return []
        problems = []
        for k, (z, width, bore) in enumerate(zip(self.option.drawn_disc_positions, widths, bores, strict=True)):
            within = [
                d for (a, b), d in zip(pairwise(borders), shaft, strict=True) if a < z + width / 2 and b > z - width / 2
            ]
            if within and bore < min(within) * (1 - FITS):
                what = f"of disc {k + 1} is {bore * 1e3:g} mm, and the shaft in it {min(within) * 1e3:g} mm"
                hint = "give the shaft's diameter: its material would count twice"
                problems.append(("drawn_disc_positions", (k,), f"the bore {what}", hint))
        return problems

    def _walls(self, prefix, what, count, given):
        outer, inner = (given.get(f"{prefix}{side}_diameter") for side in ("outer", "inner"))
        outer = None if outer is None else full(outer, count)
        inner = full(0.0 if inner is None else inner, count)
        if outer is None or not len(outer) == len(inner) == count:  # missing or not as long: said elsewhere
            return []
        name, listed = f"{prefix}inner_diameter", prefix + "inner_diameter" in given
        at = given.get(name)
        problems = []
        for k, (wide, bore) in enumerate(zip(outer, inner, strict=True)):
            if bore >= wide > 0 and listed:
                text = f"{bore * 1e3:g} mm of {what} {k + 1} must be smaller than its outer diameter, {wide * 1e3:g} mm"
                problems.append((name, (k,) if at.ndim else (), text, "a solid one has 0"))
        return problems

    def _massless(self, given):
        problems = []
        for name, positions, hint in (
            ("disc_mass", "disc_positions", "a disc given by mass and inertias needs disc_mass"),
            ("drawn_disc_outer_diameter", "drawn_disc_positions", "a disc by dimensions needs its outer diameter"),
            ("drawn_disc_width", "drawn_disc_positions", "a disc by dimensions needs its width"),
        ):
            count, value = len(getattr(self.option, positions)), given.get(name)
            if not count:
                continue
            if value is None:
                problems.append((positions, (), f"{name} is not given", hint))
                continue
            wrong = [k for k, one in enumerate(full(value, count)) if one <= 0]
            problems += [
                (name, (k,) if value.ndim else (), f"of disc {k + 1} must be greater than 0", hint) for k in wrong
            ]
        return problems

    def drawing(self, values):
        """Return what the rotor looks like; values: parameters as SI arrays of their resolved shapes."""
        option, borders = self.option, [0.0, *accumulate(self.option.section_lengths)]
        columns = [full(values[key], len(borders) - 1) for key in ("outer_diameter", "inner_diameter", "density")]
        sections = [Section(*ends, *row) for ends, *row in zip(pairwise(borders), *columns, strict=True)]
        count = len(option.disc_positions)
        keys = ("disc_mass", "disc_polar_inertia", "disc_diametral_inertia")
        given = zip(option.disc_positions, *(full(values[key], count) for key in keys), strict=True)
        discs = [equivalent_disc(*row) for row in given]
        count = len(option.drawn_disc_positions)
        keys = tuple(f"drawn_disc_{key}" for key in ("density", "outer_diameter", "inner_diameter", "width"))
        drawn = zip(option.drawn_disc_positions, *(full(values[key], count) for key in keys), strict=True)
        discs += [DrawnDisc(z, cylinder(*size)[0], *size[1:], drawn=True) for z, *size in drawn]
        return Drawing(tuple(sections), tuple(discs), tuple(option.stations), tuple(option.station_names))

    def equations(self, p, u, x, t):
        shaft, places = self._shaft(p)
        return shaft.motion(places, p, u, x, gravity=p.gravity)

    def _shaft(self, p: Any) -> tuple[Shaft, list[Place]]:
        """Return the shaft with its discs, and the places of the stations."""
        option, mesh = self.option, _mesh(self.option)
        sizes = (p.outer_diameter, p.inner_diameter, p.young_modulus, p.density, p.poisson_ratio)
        beams = [
            Beam(end - begin, *(entry(value, section) for value in sizes))
            for (begin, end), section in zip(pairwise(mesh.ends), mesh.sections, strict=True)
        ]
        shaft = Shaft(
            beams, theory=option.theory, rotary_inertia=option.rotary_inertia, gyroscopic=option.shaft_gyroscopic
        )

        def at(z: float) -> Place:
            number, distance = mesh.place(z)
            return shaft.within(number, distance) if distance else shaft.at(number)

        for k, z in enumerate(option.disc_positions):
            mass, polar, diametral = (
                entry(value, k) for value in (p.disc_mass, p.disc_polar_inertia, p.disc_diametral_inertia)
            )
            shaft.add_disc(at(z), mass, polar, diametral, 0.0)
        for k, z in enumerate(option.drawn_disc_positions):
            size = (p.drawn_disc_density, p.drawn_disc_outer_diameter, p.drawn_disc_inner_diameter, p.drawn_disc_width)
            shaft.add_disc(at(z), *cylinder(*(entry(value, k) for value in size)), 0.0)
        return shaft, [at(z) for z in option.stations]
