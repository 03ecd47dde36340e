"""An effect: a law at a place of a plant, sized so that a refit of the diagram leaves a given misfit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import log

import numpy as np

from benchmarks.generic.laws import LAWS, ORDER, Law, Scale
from benchmarks.generic.native import Acting, Array
from benchmarks.generic.plants import Plant
from benchmarks.generic.topology import accepted, wire


@dataclass(frozen=True)
class Effect:
    """A law at a place, with its numbers; argument: the place whose signal it depends on too."""

    plant: Plant
    law: Law
    place: str
    argument: str | None
    values: tuple[float, ...] = ()

    @property
    def acting(self) -> Acting:
        """Return what the integrator needs."""
        other = self.plant.place(self.argument) if self.argument else 0
        place = self.plant.place(self.place)
        return Acting(ORDER.index(self.law.key), place, other, self.law.states, self.values)

    @property
    def fitted(self) -> list[int]:
        """Return which numbers a fit of the true structure finds."""
        return [k for k, name in enumerate(self.law.numbers) if name not in self.law.fixed]

    def port(self, place: str) -> str:
        """Return the port of a place."""
        return dict(self.plant.places)[place]

    def truth(self) -> dict[str, object]:
        """Return what the truth says of it, as the shared sets do."""
        document, location = self.plant.document, self.port(self.place)
        argument = self.port(self.argument) if self.argument else None
        return {
            "physics": self.law.physics,
            "also_called": list(self.law.also),
            "location": location,
            "wire": wire(document, location),
            "argument": argument,
            "accepted_locations": accepted(document, location, self.law.moves, argument),
            "values": dict(zip(self.law.numbers, self.values, strict=True)),
            "note": self.law.equation,
        }


def effects_of(plant: Plant, outside: bool) -> list[Effect]:
    """Return the effects that may be missing in a plant, without numbers."""
    found = []
    for text in plant.effects:
        key, place, *argument = text.split()
        law = LAWS[key]
        if law.outside == outside:
            found.append(Effect(plant, law, place, argument[0] if argument else None))
    return found


def has(plant: Plant, laws: Sequence[str], outside: bool) -> bool:
    """Return whether one of the laws, by key or name, may be missing in a plant."""
    return any({effect.law.key, effect.law.physics} & set(laws) for effect in effects_of(plant, outside))


def scale(effect: Effect, taps: Sequence[Array], duration: float) -> Scale:
    """Return what the size of an effect is measured by: the signals of the runs without it."""
    v = np.concatenate([seen[:, effect.plant.place(effect.place)] for seen in taps])
    o = np.concatenate([seen[:, effect.plant.place(effect.argument)] for seen in taps]) if effect.argument else v
    return Scale(
        peak=float(np.abs(v).max()),
        rms=float(np.sqrt((v**2).mean())),
        spread=float(v.std()),
        other_peak=float(np.abs(o).max()),
        other_rms=float(np.sqrt((o**2).mean())),
        pace=effect.plant.pace,
        duration=duration,
    )


def sized(effect: Effect, strength: float, by: Scale, seed: Sequence[int]) -> Effect:
    """Return an effect with numbers; what is not its strength depends on the seed alone. strength: 0 to 1."""
    low, high = effect.law.strengths
    share = float(np.exp(log(low) + strength * (log(high) - log(low))))
    values = effect.law.size(share, by, np.random.default_rng(list(seed)))
    return replace(effect, values=tuple(map(float, values)))
