"""Where along the shaft a force acts: a block wired to every node in turn, or two of it to every pair of nodes."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from rotorsim.block import In
from rotorsim.diagram.diagram import Diagram, Wire
from rotorsim.diagram.resolve.settings import with_finer_mesh
from rotorsim.errors import Problem, RotorsimError, near_miss
from rotorsim.identification.fitted import FittedHarmonics, fit_harmonics
from rotorsim.identification.harmonic.estimate import Estimate
from rotorsim.identification.harmonic.experiment import open_experiment
from rotorsim.identification.harmonic.likelihood import Likelihood
from rotorsim.identification.held import contradictions_of, settings_of
from rotorsim.identification.meshes import on_fine_meshes
from rotorsim.jobs.threads import one_thread
from rotorsim.model.heard import Heard, hearing
from rotorsim.model.load import load, load_standalone
from rotorsim.recordings.orders import renamed
from rotorsim.recordings.recording import Recording
from rotorsim.signals.harmonics import harmonics_of

MESHED = 3  # times that all places are tried on a finer mesh, as the best of them wants it


@dataclass(frozen=True, eq=False)
class Location:
    """A block at one place (or two of it at two places), refitted.

    nodes: counted from 1. misfit: minus twice the log likelihood at its best; probability: among all places tried, each
    as likely as any other before the data, the noise as large as the residual of the best place.
    """

    nodes: tuple[int, ...]
    misfit: float
    probability: float
    estimate: Estimate
    document: Mapping[str, Any]

    @property
    def values(self) -> dict[str, float]:
        """The refitted parameters, SI."""
        return {item.name: float(v) for item, v in zip(self.estimate.free, self.estimate.theta, strict=True)}


class Locations(list[Location]):
    """The places that were fitted, the most probable first.

    failed: nodes of those that could not be, and why. warnings: what went wrong without ending a fit.
    """

    def __init__(
        self, found: Iterable[Location], failed: Mapping[tuple[int, ...], str], warnings: Iterable[Problem]
    ) -> None:
        super().__init__(found)
        self.failed, self.warnings = dict(failed), list(warnings)


def locate(
    diagram: Diagram, recording: Recording, block: str, *, count: int = 1, given: Sequence[str] = ()
) -> Locations:
    """Return the places at which a block explains a recording, the most probable first.

    block: its force enters one node of an additive input (``["crack.force", "rotor.force[4]"]``); it is tried at
    every node that can move. count: 2 adds a copy of the block with parameters of its own ("crack2.stiffness",
    "crack2.phase") and tries every pair of nodes. A crack's sag stays that of the diagram: what is identified is the
    product of additive stiffness and sag at the place. Meshes are refined as the recording shows at the best place.

    A place at which a part whose equations are elsewhere fails is left out, and told. Raises RotorsimError for a block
    that does not act at one node, and what `identify` raises, where no place can be fitted.
    """
    if count not in (1, 2):
        raise RotorsimError(Problem(f"count must be 1 or 2, not {count}", "locate"))
    diagram, alone = load_standalone(diagram)
    recording, block, given = renamed(recording, alone.named), alone.block(block), [*map(alone.named, given)]
    harmonics = harmonics_of(recording, recording.select("identify"))

    def opened(placed: Diagram) -> Likelihood:
        return Likelihood(open_experiment(placed, recording, given=given, harmonics=harmonics))

    every = Heard()
    with one_thread():
        tried, failed = _tried(diagram, block, count, opened, every)
        best = min(tried.values(), key=_misfit)
        refined: list[str] = []
        for _ in range(MESHED):
            meshed, further = on_fine_meshes(best.diagram, best)
            refined = further or refined
            if meshed is best:
                break
            diagram = _with_meshes(diagram, meshed.diagram)
            tried, failed = _tried(diagram, block, count, opened, every)
            best = min(tried.values(), key=_misfit)
        contradicted = contradictions_of(best.diagram, best, settings_of(recording.select("identify")))
    least = best.estimate.misfit
    scale = max(1.0, least / max(best.estimate.freedom, 1))
    weights = np.exp(-0.5 * (np.array([fit.estimate.misfit for fit in tried.values()]) - least) / scale)
    found = [
        Location(places, fit.estimate.misfit, float(weight / weights.sum()), fit.estimate, fit.diagram.document)
        for (places, fit), weight in zip(tried.items(), weights, strict=True)
    ]
    why = {places: str(error.problems[0]) for places, error in failed.items()}
    notes = [Problem(note, severity="warning") for note in refined]
    told = (*alone.notes, *notes, *contradicted, *every.problems())
    return Locations(sorted(found, key=lambda location: location.misfit), why, told)


Nodes = tuple[int, ...]


def _misfit(fit: FittedHarmonics) -> float:
    return fit.estimate.misfit


def _tried(
    diagram: Diagram, block: str, count: int, opened: Callable[[Diagram], Likelihood], every: Heard
) -> tuple[dict[Nodes, FittedHarmonics], dict[Nodes, RotorsimError]]:
    """Return the fits with a block at each place, and why others failed; every: takes what went wrong on the way."""
    wires = _wires(diagram, block)
    tried: dict[Nodes, FittedHarmonics] = {}
    failed: dict[Nodes, RotorsimError] = {}
    for places in combinations(_nodes(diagram, wires), count):
        moved = _placed(diagram.document, diagram, block, wires, places)
        placed = load(moved, folder=diagram.folder, trust_blocks=diagram.trusted)
        with hearing() as heard:
            try:
                tried[places] = fit_harmonics(placed, opened, tries=1)
            except RotorsimError as error:
                if not heard.mishaps:
                    raise
                failed[places] = error
        every.add(heard.mishaps)
    if not tried and failed:
        raise next(iter(failed.values()))
    return tried, failed


def _with_meshes(diagram: Diagram, finer: Diagram) -> Diagram:
    """Return a diagram with the meshes of another."""
    for name, node in finer.nodes.items():
        if node.block.refinement is not None and name in diagram.nodes:
            diagram = with_finer_mesh(diagram, name, getattr(node.block.option, node.block.refinement))
    return diagram


def _wires(diagram: Diagram, block: str) -> list[Wire]:
    """Return the wires of a block into one node of an additive input."""
    if block not in diagram.nodes:
        raise RotorsimError(Problem("no such block", block, hint=near_miss(block, diagram.nodes)))
    found = []
    for wire in diagram.wires:
        declared = diagram.nodes[wire.target.block].inputs[wire.target.port].declaration
        if wire.source.block == block and isinstance(declared, In) and declared.additive and wire.target.index:
            found.append(wire)
    if not found:
        what = "its force does not enter one node of a rotor: there is no place to look for"
        raise RotorsimError(Problem(what, block, hint='a wire such as ["crack.force", "rotor.force[4]"]'))
    if len({wire.target.index[0] for wire in found}) > 1:
        raise RotorsimError(
            Problem("its wires enter different nodes", block, hint="locate moves a block with one place")
        )
    return found


def _nodes(diagram: Diagram, wires: Sequence[Wire]) -> list[int]:
    """Return the nodes (from 1) that the block can be moved to: all but pinned ones."""
    target = wires[0].target
    node = diagram.nodes[target.block]
    pinned = set(getattr(node.block.option, "pinned_nodes", ()) or ())
    return [k for k in range(1, node.inputs[target.port].shape[0] + 1) if k not in pinned]


def _placed(
    document: Mapping[str, Any], diagram: Diagram, block: str, wires: Sequence[Wire], places: Sequence[int]
) -> dict[str, Any]:
    """Return the document with the block at the first place, and a copy of it at the second."""
    moved = copy.deepcopy(dict(document))
    ends = {(str(wire.source), str(wire.target)): wire for wire in wires}
    rewired = []
    extra = []
    for pair in moved["wires"]:
        wire = ends.get((str(pair[0]).replace(" ", ""), str(pair[1]).replace(" ", "")))
        if wire is None:
            rewired.append(pair)
            continue
        base = f"{wire.target.block}.{wire.target.port}"
        rest = "".join(f",{k + 1}" for k in wire.target.index[1:])
        rewired.append([str(pair[0]), f"{base}[{places[0]}{rest}]"])
        if len(places) > 1:
            extra.append([str(pair[0]).replace(block, _second(document, block), 1), f"{base}[{places[1]}{rest}]"])
    moved["wires"] = rewired
    if len(places) > 1:
        _add_second(moved, diagram, block, extra)
    return moved


def _second(document: Mapping[str, Any], block: str) -> str:
    number = 2
    while f"{block}{number}" in document["blocks"]:
        number += 1
    return f"{block}{number}"


def _add_second(moved: dict[str, Any], diagram: Diagram, block: str, wires: list[list[str]]) -> None:
    """Add a copy of a block with its inputs, and free what is free of the first."""
    name = _second(moved, block)
    copied = copy.deepcopy(moved["blocks"][block])
    node = diagram.nodes[block]
    parameters = copied.setdefault("parameters", {})
    for key, reference in node.references.items():
        parameters[key] = np.asarray(node.values[key]).tolist()
        if reference in moved.get("identify", {}):
            moved["identify"][f"{name}.{key}"] = copy.deepcopy(moved["identify"][reference])
    for key in node.values:
        if f"{block}.{key}" in moved.get("identify", {}):
            moved["identify"][f"{name}.{key}"] = copy.deepcopy(moved["identify"][f"{block}.{key}"])
    inputs = [
        [str(s), str(t).replace(f"{block}.", f"{name}.", 1)]
        for s, t in moved["wires"]
        if str(t).startswith(f"{block}.")
    ]
    moved["blocks"][name] = copied
    moved["wires"] = [*moved["wires"], *inputs, *wires]
