"""A rotor of ROSS as a diagram: a finite-element rotor, a block for each bearing, seal and support mass, and wires."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem, Problems, RotorsimError
from rotorsim.linear.linearisation import linearise
from rotorsim.model.load import load
from rotorsim.ross.elements import Bearing, Elements, ShaftElement, elements_of
from rotorsim.ross.source import RossFile, Table, read_ross

MOST_SHOWN = 50
STOP = 0.5  # s
RECORDED = 1e-4  # s between the samples that are kept, at least
STABLE_REACH = 2.0  # step times largest |eigenvalue| of A: RK4 is stable to 2.8 along the imaginary axis
SOFTEST = 1e8  # N/m^2, of shafts; this and the next as of block rotor_drawing
MASSLESS, LIGHTEST, HEAVIEST = 0.1, 100.0, 3e4  # kg/m^3
RELATIVE = 1e-9  # of the length: sleeves as long as the element they are on


@dataclass(frozen=True)
class ImportedRoss:
    """A rotor of ROSS as a diagram: the document, the diagram, the version that saved it, what is not carried over."""

    document: dict[str, Any]
    diagram: Diagram
    version: str
    warnings: tuple[Problem, ...] = ()


def import_ross(file: str | Path) -> ImportedRoss:
    """Return a rotor saved by ROSS (TOML or JSON of ROSS 1.0 and newer) as a diagram.

    Node n of ROSS is node n + 1 of block ``rotor``. Discs have an unbalance each, of eccentricity 0. What a diagram
    cannot hold is refused where it changes lateral motion, else said in ``warnings``.
    Raises RotorsimError with every mistake.
    """
    source = read_ross(file)
    problems = Problems()
    elements = elements_of(source, problems)
    _refuse(problems)
    document = _Writer(source, elements, problems).document()
    _refuse(problems)
    document["solver"] = _solver(load(document))
    diagram = load(document)
    return ImportedRoss(document, diagram, source.version, (*problems, *diagram.warnings))


def _refuse(problems: Problems) -> None:
    errors = [problem for problem in dict.fromkeys(problems) if problem.severity == "error"]
    if errors:
        more = len(errors) - MOST_SHOWN
        rest = [Problem(f"... and {more} more mistakes")] if more > 0 else []
        raise RotorsimError(*errors[:MOST_SHOWN], *rest)


def _solver(diagram: Diagram) -> dict[str, Any]:
    """Return steps of RK4 in which the stiffest mode is stable: without damping, adaptive methods take more of them."""
    A = linearise(diagram, inputs=(), outputs=()).A
    largest = float(np.abs(np.linalg.eigvals(A)).max())
    limit = min(STABLE_REACH / largest if largest else RECORDED, RECORDED) * (1 + RELATIVE)
    decade = math.floor(math.log10(limit))
    step = max(value for first in (1, 2, 5) if (value := float(f"{first}e{decade}")) <= limit)
    every = round(RECORDED / step)
    return {"method": "rk4", "step": step, "stop": STOP} | ({"record_every": every} if every > 1 else {})


def _no_material(shaft: ShaftElement) -> Iterator[tuple[str, str]]:
    """Yield what no material of a shaft has, and hints."""
    if shaft.density == 0.0:
        yield "rho is 0: the shaft has no mass here", f"give a small density, {MASSLESS:g} kg/m^3 at most"
    elif MASSLESS < shaft.density < LIGHTEST or shaft.density > HEAVIEST:
        yield f"rho is {shaft.density:g} kg/m^3, the density of no solid", "ROSS saves SI units: 7850 is 7.85 g/cm^3"
    if shaft.modulus < SOFTEST:
        yield f"E is {shaft.modulus:g} N/m^2, softer than any shaft", "ROSS saves SI units: 211e9 is 211 GPa"


def _same(values: Sequence[Any]) -> Any:
    """Return one value for all where they are equal, else the list."""
    return values[0] if len(set(values)) == 1 else list(values)


def _tapers(listed: str, prefix: str, pieces: Sequence[ShaftElement]) -> dict[str, Any]:
    """Return the parameters of those that are conical."""
    cones = {k: one for k, one in enumerate(pieces, 1) if one.is_conical}
    found: dict[str, Any] = {listed: list(cones)}
    for name in ("outer", "inner"):
        found[f"{prefix}{name}_diameter"] = [getattr(one, name)[1] for one in cones.values()]
    return found if cones else {}


class _Writer:
    """Makes the document; mistakes go to ``problems``."""

    def __init__(self, source: RossFile, elements: Elements, problems: Problems) -> None:
        self.source, self.elements, self.problems = source, elements, problems
        self.chain, self.sleeves = self._chain()
        self.first = self.chain[0].n
        self.names = {"clock", "rotor"}
        self.blocks: dict[str, Any] = {}
        self.wires: list[list[str]] = []
        self.supports: dict[int, str] = {}
        self.masses: dict[int, list[float]] = {}  # further masses on the shaft, by node

    def document(self) -> dict[str, Any]:
        """Return the document."""
        speed = self._speed()
        self.blocks["clock"] = {"type": "clock", "parameters": {"speed": "$speed"}}
        self.blocks["rotor"] = {}
        self.wires.append(["clock.speed", "rotor.speed"])
        self._place_masses()
        for bearing in self.elements.bearings:
            self._bearing(bearing)
        for disc in self.elements.discs:
            self._unbalance(disc.table, disc.n, disc.mass)
        self.blocks["rotor"] = {"type": "rotor_fe", "parameters": self._rotor()}
        nodes = f"node n of ROSS is node {self._plus(1 - self.first)} of block rotor"
        version = f"ROSS {self.source.version}" if self.source.version else "ROSS"
        return {
            "schema_version": 1,
            "name": re.sub(r"[^A-Za-z0-9_]+", "_", self.source.path.stem).strip("_") or "rotor",
            "description": f"Rotor saved by {version}: {nodes}; tables of bearings are over the shaft speed.",
            "parameters": {"speed": f"{speed!r} rad/s"},
            "blocks": self.blocks,
            "wires": self.wires,
            "solver": {"method": "rk4", "step": RECORDED, "stop": STOP},
            "record": ["rotor.displacement", "clock.theta"],
        }

    @staticmethod
    def _plus(offset: int) -> str:
        return "n" if offset == 0 else f"n {'+' if offset > 0 else '-'} {abs(offset)}"

    # -- the shaft -----------------------------------------------------------------------------------------------------

    def _chain(self) -> tuple[list[ShaftElement], list[ShaftElement]]:
        """Return the elements that make up the shaft, the stiffest at every place, and the sleeves on them."""
        layers: dict[int, list[ShaftElement]] = {}
        for element in sorted(self.elements.shaft, key=lambda one: one.n):
            layers.setdefault(element.n, []).append(element)
        chain, sleeves = [], []
        for n, group in layers.items():
            shaft = max(group, key=lambda one: one.bending_stiffness)
            chain.append(shaft)
            for one in group:
                if one is shaft:
                    continue
                sleeves.append(one)
                if abs(one.length - shaft.length) > RELATIVE * shaft.length:
                    what = f"L is {one.length:g}, that of {shaft.table.name} at the same node {shaft.length:g}"
                    hint = "elements at one node are layers of one length"
                    self.problems.error(what, one.table.name, one.table.locate("L"), hint)
            for what, hint in _no_material(shaft):
                self.problems.error(what, shaft.table.name, shaft.table.locate("material"), hint)
            if n != chain[0].n + len(chain) - 1:
                what = f"begins at node {n}, and no element ends there"
                hint = "one shaft without gaps is expected; rotors of several shafts are not supported"
                self.problems.error(what, shaft.table.name, shaft.table.locate("n"), hint)
                break
        self._uniform()
        return chain, sleeves

    def _uniform(self) -> None:
        """Refuse what a rotor has once and elements have differently."""
        reads: dict[str, Callable[[ShaftElement], Any]] = {
            **{name: lambda one, name=name: one.flags[name] for name in self.elements.shaft[0].flags},  # type: ignore[misc]
            "alpha": lambda one: one.damping[0],
            "beta": lambda one: one.damping[1],
        }
        first = self.elements.shaft[0]
        for key, read in reads.items():
            other = next((one for one in self.elements.shaft if read(one) != read(first)), None)
            if other is not None:
                words = [str(read(one)).lower() for one in (other, first)]
                what = f"{key} is {words[0]}, that of {first.table.name} {words[1]}"
                hint = "one value for all elements is expected"
                self.problems.error(what, other.table.name, other.table.locate(key), hint)

    def _rotor(self) -> dict[str, Any]:
        """Return the parameters of the rotor."""
        chain, first = self.chain, self.chain[0]
        found: dict[str, Any] = {"elements": len(chain)}
        found["theory"] = "timoshenko" if first.flags["shear_effects"] else "euler_bernoulli"
        found["rotary_inertia"] = first.flags["rotary_inertia"]
        found["shaft_gyroscopic"] = first.flags["gyroscopic"]
        found["element_length"] = _same([one.length for one in chain])
        found["outer_diameter"] = _same([one.outer[0] for one in chain])
        found["inner_diameter"] = _same([one.inner[0] for one in chain])
        found |= self._material("", chain) | _tapers("conical_elements", "end_", chain)
        if self.sleeves:
            found["sleeve_elements"] = [one.n - self.first + 1 for one in self.sleeves]
            for name in ("outer", "inner"):
                found[f"sleeve_{name}_diameter"] = [getattr(one, name)[0] for one in self.sleeves]
            found |= self._material("sleeve_", self.sleeves) | _tapers("conical_sleeves", "sleeve_end_", self.sleeves)
        discs = [(one.n, one.mass, one.polar, one.diametral) for one in self.elements.discs]
        discs += [(n, mass, 0.0, 0.0) for n, masses in self.masses.items() for mass in masses]
        columns = list(zip(*discs, strict=True)) or [()] * 4
        found["disc_nodes"] = [n - self.first + 1 for n in columns[0]]
        for name, values in zip(("mass", "polar_inertia", "diametral_inertia"), columns[1:], strict=True):
            found |= {f"disc_{name}": list(values)} if discs else {}
        for name, value in zip(("mass_damping", "stiffness_damping"), first.damping, strict=True):
            found |= {name: value} if value else {}
        return found

    @staticmethod
    def _material(prefix: str, elements: Sequence[ShaftElement]) -> dict[str, Any]:
        names = {"young_modulus": "modulus", "density": "density", "poisson_ratio": "poisson"}
        return {f"{prefix}{name}": _same([getattr(one, key) for one in elements]) for name, key in names.items()}

    # -- what is on it -------------------------------------------------------------------------------------------------

    def _on_shaft(self, n: int) -> bool:
        return self.first <= n <= self.first + len(self.chain)

    def _place_masses(self) -> None:
        """Put point masses on the shaft, and make a block for each beside it."""
        for disc in self.elements.discs:
            self._known(disc.n, disc.table, "n")
        extra = {b.n: 0.0 for b in self.elements.bearings}
        for bearing in self.elements.bearings:
            extra[bearing.n] += bearing.mass
        beside: dict[int, list[tuple[float, float]]] = {}
        for point in self.elements.points:
            if not self._on_shaft(point.n):
                beside.setdefault(point.n, []).append(point.mass)
            elif point.mass[0] == point.mass[1]:
                self.masses.setdefault(point.n, []).append(point.mass[0])
            else:
                what = f"mx is {point.mass[0]:g}, my {point.mass[1]:g}, at a node of the shaft"
                hint = "a mass on the shaft is the same in both directions"
                self.problems.error(what, point.table.name, point.table.locate("mx"), hint)
        for n, masses in beside.items():
            table = next(point.table for point in self.elements.points if point.n == n)
            both = [sum(mass[k] for mass in masses) + extra.get(n, 0.0) for k in (0, 1)]
            if min(both) <= 0.0:
                self.problems.error("has no mass", table.name, table.place, "a mass beside the shaft must be above 0")
            self.supports[n] = name = self._name(table)
            self.blocks[name] = {"type": "support_mass", "parameters": {"mass": both}}
        for n, mass in extra.items():
            if mass and self._on_shaft(n):
                self.masses.setdefault(n, []).append(mass)

    def _known(self, n: int, table: Table, key: str) -> bool:
        if self._on_shaft(n) or n in self.supports:
            return True
        last = self.first + len(self.chain)
        what = f"{key} is {n}: neither a node of the shaft, {self.first} to {last}, nor of a point mass"
        hint = "a node beside the shaft needs a PointMass" if key == "n_link" or n > last else "nodes count from 0"
        self.problems.error(what, table.name, table.locate(key), hint)
        return False

    def _name(self, table: Table) -> str:
        """Return a name for the block of an element, from its tag."""
        plain = re.sub(r"[^a-z0-9]+", "_", table.tag.lower()).strip("_") or table.kind.lower()
        plain = plain if plain[0].isalpha() else f"element_{plain}"
        name, k = plain, 2
        while name in self.names:
            name, k = f"{plain}_{k}", k + 1
        self.names.add(name)
        return name

    def _ends(self, n: int) -> tuple[str, str, str]:
        """Return displacement, velocity and force of a node."""
        block, index = (self.supports[n], "") if n in self.supports else ("rotor", f"[{n - self.first + 1}]")
        return tuple(f"{block}.{port}{index}" for port in ("displacement", "velocity", "force"))  # type: ignore[return-value]

    def _bearing(self, bearing: Bearing) -> None:
        known = self._known(bearing.n, bearing.table, "n")
        if bearing.link is not None:
            known = self._known(bearing.link, bearing.table, "n_link") and known
        if not known or not any(map(any, bearing.coefficients.values())):
            return
        name = self._name(bearing.table)
        parameters: dict[str, Any] = {} if len(bearing.speeds) == 1 else {"speeds": list(bearing.speeds)}
        for key, values in bearing.coefficients.items():
            if any(values) or key in ("kxx", "kyy", "cxx", "cyy"):  # all others are 0 unless given
                parameters[key] = values[0] if len(values) == 1 else list(values)
        self.blocks[name] = {"type": "bearing_coefficients", "parameters": parameters}
        displacement, velocity, force = self._ends(bearing.n)
        self.wires += [["clock.speed", f"{name}.speed"], [displacement, f"{name}.displacement"]]
        self.wires += [[velocity, f"{name}.velocity"], [f"{name}.force", force]]
        if bearing.link is not None:
            displacement, velocity, force = self._ends(bearing.link)
            self.wires += [[displacement, f"{name}.support_displacement"], [velocity, f"{name}.support_velocity"]]
            self.wires.append([f"{name}.reaction", force])

    def _unbalance(self, table: Table, n: int, mass: float) -> None:
        name = self._name(replace(table, tag=f"unbalance_{table.tag}"))
        self.blocks[name] = {"type": "unbalance", "parameters": {"mass": mass, "eccentricity": 0.0}}
        self.wires += [["clock.theta", f"{name}.theta"], ["clock.speed", f"{name}.speed"]]
        self.wires.append([f"{name}.force", f"rotor.force[{n - self.first + 1}]"])

    def _speed(self) -> float:
        """Return the speed that the diagram begins with: rated, or where all tables hold, or at rest."""
        for key in ("rated_w", "max_w"):
            value = self.source.parameters.get(key)
            if isinstance(value, int | float) and not isinstance(value, bool) and 0.0 <= value < float("inf"):
                return float(value)
        tables = [bearing.speeds for bearing in self.elements.bearings if len(bearing.speeds) > 1]
        if not tables:
            return 0.0
        low, high = max(one[0] for one in tables), min(one[-1] for one in tables)
        return float(low if low >= high else (low + high) / 2)
