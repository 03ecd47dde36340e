"""What a fault is, and how its size is drawn. The rows are in mechanical.py, loop.py, sensors.py and outside.py."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.concealed.integrator import Nodes
from benchmarks.concealed.plant import Bearing, Plant
from benchmarks.concealed.simulate import Clock
from benchmarks.concealed.sites import SITES

Array = NDArray[Any]
Inputs = dict[str, Array | complex]

ROTOR = ("rotor",)


@dataclass(frozen=True)
class Fault:
    """One row of the catalogue with its numbers, or one law outside it.

    Inputs and outputs are named as in `plant.Core`. What is not given does nothing.
    """

    physics: str
    effect: dict[str, float]
    node: int | None = None
    blocks: tuple[str, ...] = ROTOR  # of the diagram, where it is right to say that it is
    alias: tuple[str, ...] = ()  # rows that the data cannot tell from this one
    law: str = ""  # what is outside the catalogue
    alter: Callable[[Plant, float], None] | None = None  # linear in the motion; (plant, speed)
    force: Callable[[Clock, list[Plant]], dict[str, Array]] | None = None  # does not depend on the motion
    feedback: Callable[[Nodes, dict[str, Array]], dict[str, Array]] | None = None  # does
    measure: Callable[[Clock, dict[str, Array]], None] | None = None  # only in what is recorded
    wobble: Callable[[Array], tuple[Array, Array, Array]] | None = None  # of the shaft angle: angle, rate, acceleration
    twist: Callable[[Array], tuple[Array, Array, Array]] | None = None  # of the disc against the tacho
    lsb: float = 0.0  # of the converter of displacements
    reads: tuple[str, ...] = ()
    drives: tuple[str, ...] = ()
    integrators: int = 0
    synchronous: bool = True  # `force` is periodic with the shaft
    corner: float = 0.0  # m: error allowed at each corner of `feedback`; 0 if it is smooth
    timed: bool = False  # `feedback` depends on time or angle
    late: float = 0.0  # s: how far `feedback` looks back


@dataclass
class Draw:
    """What a row may use to draw its numbers: where it is, how large the healthy motion is, how strong to be."""

    rng: np.random.Generator
    machine: str
    node: int
    parameters: dict[str, float]
    peaks: dict[str, float]  # `z3`, `i`, `i2`: in the runs to identify; `all z3`: in every run
    strength: float  # 0: just visible, 1: plain
    lanes: int
    plant: Plant  # healthy, with the gains of the diagram

    def size(self, low: float, high: float) -> float:
        """Return low (high / low)^strength."""
        return float(low * (high / low) ** self.strength)

    def lag(self, low: float, high: float) -> float:
        """Return a time in the loop [s]; the beam's second mode bears half of what the single disc bears."""
        return self.size(low, high if self.machine == "jeffcott" else 0.5 * high)

    def angle(self) -> float:
        """Return any angle."""
        return float(self.rng.uniform(-np.pi, np.pi))

    def sign(self) -> float:
        """Return 1 or -1."""
        return float(self.rng.choice([-1.0, 1.0]))

    def between(self, low: float, high: float) -> float:
        """Return a number between, whatever the strength."""
        return float(self.rng.uniform(low, high))

    @property
    def place(self) -> tuple[str, str, str]:
        """Names of force, displacement and velocity at the node."""
        return f"f{self.node}", f"z{self.node}", f"v{self.node}"

    @property
    def bearing(self) -> Bearing:
        """The bearing at the node."""
        return next(bearing for bearing in self.plant.bearings if bearing.node == self.node)

    @property
    def follower(self) -> Bearing | None:
        """The bearing whose controller follows the probe at the node."""
        return next((bearing for bearing in self.plant.bearings if bearing.probe == self.node), None)

    @property
    def loop_node(self) -> int | None:
        """The node of bearing and controller, None where these are at different ones."""
        return self.node if self.bearing.probe == self.node else None

    @property
    def unbalances(self) -> tuple[str, ...]:
        """Blocks of the unbalances."""
        return tuple(unbalance.block for unbalance in self.plant.unbalances)

    @property
    def stiffness(self) -> float:
        """Static stiffness of the shaft at the node."""
        return 1 / self.plant.flexibility(self.node)

    @property
    def phases(self) -> Array:
        """An angle for each run, as (L, 1, 1): what is not tied to the shaft begins anywhere."""
        return self.rng.uniform(-np.pi, np.pi, self.lanes)[:, None, None]


@dataclass(frozen=True)
class Entry:
    """A row as it may be drawn."""

    make: Callable[[Draw], Fault]
    beam: str  # site on a beam
    jeffcott: bool
    group: str  # two rows of one group are not drawn together
    alone: bool = False  # not drawn with another row

    def nodes(self, machine: str) -> tuple[int, ...]:
        """Return where it can be on a machine."""
        if machine == "jeffcott":
            return (1,) if self.jeffcott else ()
        return SITES[machine][self.beam] if self.beam else ()


ROWS: dict[str, Entry] = {}
ALIASES: dict[str, Entry] = {}
OUTSIDE: dict[str, Entry] = {}


def row(
    table: dict[str, Entry], name: str, group: str, beam: str = "", jeffcott: bool = True, alone: bool = False
) -> Callable[[Callable[[Draw], Fault]], Callable[[Draw], Fault]]:
    """Enter a function that draws a fault; beam: the site on machines that have several nodes, none without it."""

    def enter(make: Callable[[Draw], Fault]) -> Callable[[Draw], Fault]:
        table[name] = Entry(make, beam, jeffcott, group, alone)
        return make

    return enter


def per_axis(law: Callable[[Array, Array], Array], a: Array, b: Array) -> Array:
    """Return law(a_x, b_x) + i law(a_y, b_y)."""
    return law(a.real, b.real) + 1j * law(a.imag, b.imag)
