"""Cut a diagram into participants of a co-simulation: compiled parts and FMUs, and the wires between them."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from rotorsim.cosim.compiled_participant import CompiledParticipant
from rotorsim.cosim.coupling import Coupling
from rotorsim.cosim.fmu_block import fmu_participant
from rotorsim.cosim.participant import Participant
from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem, RotorsimError, near_miss
from rotorsim.linear.linearisation import entry_names
from rotorsim.model.compiled import Model, model_for_runs
from rotorsim.model.part import open_part
from rotorsim.model.trace.diagram import FOREIGN_CODE


def couple(
    diagram: Diagram,
    groups: Sequence[Iterable[str]],
    *,
    parameters: Mapping[str, Any] | None = None,
    participants: Mapping[str, Participant] | None = None,
    use_compiler: bool = True,
) -> Coupling[Participant]:
    """Return a diagram cut into participants: one compiled part for each group of blocks, and the participants given.

    participants: block -> a participant in its place (an FMU); its inputs and outputs are named as the block's ports,
    "rotor.force[1]". Blocks that no group names make one more part. Raises RotorsimError for what does not fit.
    """
    given = dict(participants or {})
    taken = [block for group in groups for block in group]
    rest = [block for block in diagram.nodes if block not in taken and block not in given]
    parts = [tuple(group) for group in groups] + ([tuple(rest)] if rest else [])
    _refuse_doubles(diagram, [*taken, *given])
    crossing = _crossing(diagram, [*parts, *((block,) for block in given)])
    made: list[Participant] = []
    watched = [f"{end.block}.{end.port}" for end in diagram.record]
    for blocks in parts:
        part = open_part(diagram, blocks, by_source=True)
        record = [port for port in crossing if port.rpartition(".")[0] in blocks]
        record += [name for name in dict.fromkeys(watched) if name.rpartition(".")[0] in blocks and name not in record]
        name = "+".join(blocks) if len(blocks) < 4 else f"{blocks[0]}+{len(blocks) - 1} more"
        p = part.parameter_vector(parameters)
        made.append(CompiledParticipant(name, part, record, p, diagram.solver.step, use_compiler=use_compiler))
    made += given.values()
    L, u0 = _wires(diagram, made, set(given))
    return Coupling(tuple(made), L, u0, _held(made, L))


def _held(participants: Sequence[Participant], L: np.ndarray) -> np.ndarray:
    """Return which outputs are piecewise constant: they follow neither time nor states nor an input that moves."""
    moving = np.concatenate([p.moving for p in participants])
    following = block_diag(*(p.following for p in participants)).astype(bool)
    while True:
        new = moving | (following & ((L != 0) & moving).any(axis=1)).any(axis=1)
        if (new == moving).all():
            return np.asarray(~moving)
        moving = new


def _refuse_doubles(diagram: Diagram, blocks: Sequence[str]) -> None:
    hint = "name each block in one part only"
    problems = [Problem("is in two parts", b, hint=hint) for b in dict.fromkeys(blocks) if blocks.count(b) > 1]
    unknown = [b for b in dict.fromkeys(blocks) if b not in diagram.nodes]
    problems += [Problem("no such block", block, hint=near_miss(block, diagram.nodes)) for block in unknown]
    if problems:
        raise RotorsimError(*problems)


def _crossing(diagram: Diagram, parts: Sequence[Sequence[str]]) -> list[str]:
    """Return the output ports that feed another part."""
    home = {block: k for k, blocks in enumerate(parts) for block in blocks}
    return list(
        dict.fromkeys(
            f"{w.source.block}.{w.source.port}" for w in diagram.wires if home[w.source.block] != home[w.target.block]
        )
    )


def _wires(diagram: Diagram, participants: Sequence[Participant], foreign: set[str]) -> tuple[np.ndarray, np.ndarray]:
    """Return L and u0: a compiled part's inputs are named by their source, a foreign one's by its own ports."""
    outputs = [name for participant in participants for name in participant.outputs]
    at = {name: k for k, name in enumerate(outputs)}
    inputs = [(participant, name) for participant in participants for name in participant.inputs]
    L = np.zeros((len(inputs), len(outputs)))
    for row, (participant, name) in zip(L, inputs, strict=True):
        own = participant.name in foreign and name.partition(".")[0] == participant.name
        for source in sources_of(diagram, name) if own else [name]:
            row[at[source]] += 1.0
    return L, np.zeros(len(L))


def sources_of(diagram: Diagram, name: str) -> list[str]:
    """Return the flat output entries that add up to one input entry of a block."""
    found: list[str] = []
    for wire in diagram.wires:
        target, source = wire.target, wire.source
        declared = diagram.nodes[target.block].inputs[target.port]
        entries = np.array(entry_names(f"{target.block}.{target.port}", declared.shape))
        if name not in entries:
            continue
        port = diagram.nodes[source.block].outputs[source.port]
        out = np.array(entry_names(f"{source.block}.{source.port}", port.shape)).reshape(port.shape or (1,))
        out = np.atleast_1d(out[source.index] if source.index else out)
        inside = entries.reshape(declared.shape or (1,))
        inside = np.atleast_1d(inside[target.index] if target.index else inside)
        found += [str(o) for o in np.broadcast_to(out, inside.shape)[inside == name]]
    return found


def _refuse_foreign_code(diagram: Diagram) -> None:
    """Refuse to run the FMUs of a diagram that nobody vouches for: a process of their own is no wall against malice."""
    what, hint = FOREIGN_CODE
    foreign = [(name, node.place) for name, node in diagram.nodes.items() if node.block.opaque]
    if foreign and not diagram.trusted:
        raise RotorsimError(*[Problem(what, name, place, hint) for name, place in foreign])


def with_values(model: Model, p: np.ndarray) -> Diagram:
    """Return the diagram of a model with parameters p (n_p,) as the values of its blocks."""
    nodes = {
        name: replace(
            node,
            values={
                key: np.reshape(p[model.parameters[f"{name}.{key}"]], np.shape(value))
                for key, value in node.values.items()
            },
        )
        for name, node in model.diagram.nodes.items()
    }
    return replace(model.diagram, nodes=nodes)


def open_coupling(
    diagram: Diagram,
    groups: Sequence[Iterable[str]] = (),
    *,
    stop: float | None = None,
    parameters: Mapping[str, Any] | None = None,
    use_compiler: bool = True,
    log: Callable[[str, float, str, str, str], None] | None = None,
) -> Coupling[Participant]:
    """Return the participants of a diagram: its FMUs, the groups of blocks given, and the rest; FMUs are opened.

    log: gets block, time, status, category and text of every message of an FMU.

    Close them with `Coupling.close`. Raises RotorsimError, also for a diagram of one participant, and for one with
    FMUs that was not loaded with trust_blocks=True.
    """
    end = diagram.solver.stop if stop is None else stop
    _refuse_foreign_code(diagram)
    if parameters:
        model = model_for_runs(diagram)
        diagram = with_values(model, model.parameter_vector(parameters))
    opened: dict[str, Participant] = {}
    with contextlib.ExitStack() as stack:
        for name, node in diagram.nodes.items():
            if node.block.opaque:
                wired = {wire.target.port for wire in diagram.wires if wire.target.block == name}
                chosen = diagram.solver.rtol if "rtol" in (diagram.document.get("solver") or {}) else None
                opened[name] = fmu_participant(name, node, wired, end, diagram.solver.step, tolerance=chosen, log=log)
                stack.callback(opened[name].close)
        if not opened and not groups:
            hint = "cut it with --part BLOCK,BLOCK, or `rotorsim run` it"
            raise RotorsimError(Problem("has no FMU: there is nothing to be coupled", diagram.name, hint=hint))
        made = couple(diagram, groups, participants=opened, use_compiler=use_compiler)
        stack.pop_all()
    return made
