"""Where along a machine a row may be: nodes of the diagram by what is there."""

from __future__ import annotations

from collections.abc import Iterable

from benchmarks.concealed.machines import MACHINES, nominal

WORDS = {
    "probe": "every probe",
    "bearing": "at a bearing",
    "off bearing": "away from bearings and their probes",
    "disc": "at a disc",
    "off disc": "away from discs",
    "crack": "at the crack",
    "off crack": "away from the crack",
    "machine": "the whole machine",
}


def _sites(machine: str) -> dict[str, tuple[int, ...]]:
    """Return the nodes of each site; those away from something have probes."""
    plant = nominal(machine)
    bearings = tuple(bearing.node for bearing in plant.bearings)
    discs, crack = tuple(unbalance.node for unbalance in plant.unbalances), (plant.crack.node,)

    def without(nodes: Iterable[int]) -> tuple[int, ...]:
        held = set(nodes)
        return tuple(node for node in plant.probes if node not in held)

    return {
        "probe": tuple(plant.probes),
        "bearing": bearings,
        "off bearing": without([*bearings, *(bearing.probe for bearing in plant.bearings)]),
        "disc": discs,
        "off disc": without(discs),
        "crack": crack,
        "off crack": without(crack),
        "machine": bearings[:1],
    }


SITES = {machine: _sites(machine) for machine in MACHINES}
