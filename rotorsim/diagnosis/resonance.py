"""The diagnosis of machines at rest by their resonances: what sets the modes right, and where they are driven."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any, cast

import numpy as np
from scipy.ndimage import gaussian_filter1d

from rotorsim.diagnosis.catalogue.finder import insertions
from rotorsim.diagnosis.catalogue.insertion import Insertion, fixed_of, starts_of
from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.conclude.conclusions import Diagnosis, concluded, effects_of, in_words, verdict_of
from rotorsim.diagnosis.conclude.waveform_wording import in_terms, of_what_rests
from rotorsim.diagnosis.evidence.harmonic import Fit, Source
from rotorsim.diagnosis.evidence.resonance.fitting import (
    FREQUENCY,
    ModalSource,
    modal_errors,
    modal_score,
    open_modal_source,
)
from rotorsim.diagnosis.evidence.resonance.resonances import LEVEL, SMOOTH, Resonance
from rotorsim.diagnosis.evidence.scoring import Held
from rotorsim.diagnosis.search.naming import name_missing
from rotorsim.diagram.diagram import Diagram, Endpoint
from rotorsim.diagram.resolve.registry import Registry
from rotorsim.errors import Problem, RotorsimError
from rotorsim.jobs.threads import one_thread
from rotorsim.linear import linearisation as linear
from rotorsim.recordings.recording import Recording

__all__ = ["diagnose_modes"]

PLACES = 2  # at which a row of the catalogue is tried before it is tried everywhere
NEAR = 20.0  # times the least misfit that is promised: rows beyond are not tried everywhere
NONE = "none is needed"
TERMS = {  # of the wording for shafts
    "times the variance of the noise": f"times the variance of models from drawings ({FREQUENCY:.0%} of a frequency)",
    "runs left out one by one": "resonances left out one by one",
    "runs left out": "resonances left out",
    "of the signals (noise": "of the frequencies (their spread over the sensors",
}
LINES = 8  # of the spectrum, of which one is compared


def diagnose_modes(
    diagram: Diagram,
    recording: Recording,
    *,
    hold_out: Recording | None = None,
    registry: Registry,
    physics: Collection[str] | None = None,
    warnings: Sequence[Problem] = (),
    trust_blocks: bool = False,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[float], None] | None = None,
) -> Diagnosis:
    """Return what a diagram lacks to have the resonances that a recording shows; see `evidence.resonance.fitting`.

    Raises RotorsimError for recordings that do not fit the diagram, or show no resonance.
    """
    with one_thread():
        source = open_modal_source(diagram, recording, trust_blocks=trust_blocks)
        held = _held(diagram, recording, hold_out, trust_blocks)
        base = source.fit(diagram.document, [])
        if base.failure:
            raise RotorsimError(Problem(base.failure, diagram.name))
        kept, screened = _screened(base, source, registry, physics)
    named = name_missing(
        base,
        cast(Source, source),
        registry=registry,
        physics=kept,
        workers=workers,
        scheduler=scheduler,
        progress=progress,
    )
    effects = effects_of(named)
    after = named.fit
    with one_thread():
        scores = [modal_score(source, fit, [part for _, part in held]) for fit in (base, after)]
        words = [*_modes(source, base, after), *_driven(source, after)]
    found = concluded(
        named,
        effects,
        verdict_of(named, effects),
        fits=(base, after),
        scores=scores,
        source=cast(Source, source),
        held=tuple(Held(part, ()) for part, _ in held),
        warnings=of_what_rests(warnings),
        screened=screened,
    )
    found = in_words(found)
    told = replace(found, next_experiment=_next(source, found.next_experiment))
    return in_terms(replace(told, statement=" ".join([found.statement, *words])), TERMS)


def _held(
    diagram: Diagram, recording: Recording, hold_out: Recording | None, trust_blocks: bool
) -> list[tuple[Recording, ModalSource]]:
    parts = [(recording, recording.select("hold_out")), *([] if hold_out is None else [(hold_out, hold_out.runs)])]
    return [
        (part, open_modal_source(diagram, part, chosen=runs, trust_blocks=trust_blocks)) for part, runs in parts if runs
    ]


def _open(source: ModalSource) -> list[Resonance]:
    """Return the resonances of some size that no mode stands for."""
    return [item for item in source.open if item.level >= LEVEL]


def _next(source: ModalSource, text: str) -> str:
    """Return the next experiment: what would tell where a resonance that is left open comes from, too."""
    if not _open(source):
        return text
    where = ", ".join(f"{item.frequency:.1f} Hz" for item in _open(source))
    wanted = f"sensors along the second axis, and a sweep through the other bearing, about {where}, which is open: "
    wanted += "a mode of the other plane, or of a part that is not in the diagram, moves there"
    return wanted if text.startswith(NONE) else f"{text}; {wanted}"


def _screened(
    base: Fit, source: ModalSource, registry: Registry, physics: Collection[str] | None
) -> tuple[set[str], list[tuple[str, str]]]:
    """Return the rows of the catalogue that are worth trying everywhere, and of the others why not.

    Each is put at a few places where discs are; what counts is the misfit that one step from its start promises.
    """
    document = values_in(base.document, base.values)
    by_kind: dict[tuple[str, int], list[Insertion]] = {}
    for item in insertions(source.load(document), source.recorded, registry):
        if (physics is None or item.physics in physics) and not item.from_lines and not item.from_steps:
            by_kind.setdefault((item.physics, item.variant), []).append(item)
    least: dict[str, float] = {}
    for (name, _), items in by_kind.items():
        for item in _few(items, document):
            starts, fixed = starts_of(item, source.largest()), fixed_of(item, source.largest())
            here = [dict(zip(item.free, start.values(), strict=True)) for start in starts]
            promised = source.promise(item.document(document, {**fixed, **starts[0]}), [here])
            least[name] = min(least.get(name, np.inf), promised)
    best = min(least.values(), default=np.inf)
    kept = {name for name, value in least.items() if value <= NEAR * best}
    others = sorted((name for name in least if name not in kept), key=lambda name: least[name])
    said = (
        "changes no mode as it would have to: at the discs one step of it promises {:.3g} times the misfit of the best"
    )
    return kept, [(name, said.format(least[name] / best)) for name in others if np.isfinite(least[name])]


def _few(items: Sequence[Insertion], document: Mapping[str, Any]) -> list[Insertion]:
    """Return the insertions at nodes with discs, where there are any, else the first ones."""
    discs = {
        (name, node)
        for name, block in document["blocks"].items()
        for node in block.get("parameters", {}).get("disc_nodes", ())
    }
    at_discs = [item for item in items if (item.spot.block, item.spot.node) in discs]
    return (at_discs or list(items))[:PLACES]


def _modes(source: ModalSource, before: Fit, after: Fit) -> list[str]:
    """Return the frequencies that were measured, of the diagram and of the repaired one, and what is left open."""
    fits = (("before", before), *((("after", after),) if after is not before else ()))
    text = [f"Resonances: {', '.join(f'{item.frequency:.1f}' for item in source.found)} Hz measured"]
    for when, fit in fits:
        text[0] += f"; {', '.join(f'{value:.1f}' for value in source.frequencies(fit))} Hz {when}"
        errors = modal_errors(source, fit)
        text[0] += "" if errors is None else f" (relative error {np.sqrt(np.mean(errors**2)):.3g} rms)"
    text[0] += "."
    for item in _open(source):
        measured = np.array([other.frequency for other in source.found])
        near = measured[np.argmin(np.abs(measured - item.frequency))]
        text.append(f"Open: {item.frequency:.1f} Hz, beside {near:.1f} Hz; the diagram has no mode for it.")
    weak = [f"{item.frequency:.0f}" for item in source.open if item.level < LEVEL]
    if weak:
        text.append(f"Not compared: weak peaks at {', '.join(weak)} Hz.")
    return text


def _driven(source: ModalSource, fit: Fit) -> list[str]:
    """Return where the recorded input acts: at the node that the diagram says, or rather at one of a bearing.

    Compared is the shape of the response at each frequency with that to a force there, whatever its size.
    """
    diagram = source.load(values_in(fit.document, fit.values))
    target = _target(diagram, source)
    if target is None:
        return []
    port = f"{target.block}.{target.port}"
    bearings = [
        wire.target
        for wire in diagram.wires
        if f"{wire.target.block}.{wire.target.port}" == port
        and wire.target.index
        and diagram.nodes[wire.source.block].block.category == "bearing"
    ]
    nodes = list(dict.fromkeys([target.index[0], *(end.index[0] for end in bearings)]))
    if len(nodes) < 2:
        return []
    run = max(source.runs, key=lambda item: item.size)
    frequencies = np.fft.rfftfreq(run.size, run.dt)
    Y = np.fft.rfft(run.measured(source.channels.outputs), axis=0)
    U = np.fft.rfft(run.values[source.channels.inputs[0]])
    cross = Y * np.conj(U)[:, None]
    H = gaussian_filter1d(cross.real, SMOOTH, axis=0) + 1j * gaussian_filter1d(cross.imag, SMOOTH, axis=0)
    ends = [source.found[0].frequency / 2, source.found[-1].frequency * 1.1]
    lines = np.flatnonzero((frequencies > ends[0]) & (frequencies < ends[1]))[::LINES]
    outputs = [_moved(name) for name in source.channels.outputs]
    system = linear.linearise(diagram, inputs=[port], outputs=outputs)
    response = system.response(frequencies[lines])
    width, axis = diagram.nodes[target.block].inputs[target.port].shape[1], target.index[1] if target.index[1:] else 0
    alike = {}
    for node in nodes:
        G = response[:, :, node * width + axis]
        sizes = np.linalg.norm(G, axis=1) * np.linalg.norm(H[lines], axis=1)
        alike[node] = float((np.abs((np.conj(G) * H[lines]).sum(axis=1)) / sizes).mean())
    best = max(alike, key=lambda node: alike[node])
    each = ", ".join(f"{port}[{node + 1}] {value:.2f}" for node, value in alike.items())
    said = "as the diagram says" if best == target.index[0] else "not where the diagram says"
    return [f"The recorded input acts at {port}[{best + 1}], {said} (likeness of responses: {each})."]


def _moved(name: str) -> str:
    """Return the displacement of a recorded acceleration or velocity: of one shape at each frequency."""
    base, bracket, inside = name.partition("[")
    return f"{base.rpartition('.')[0]}.displacement{bracket}{inside}"


def _target(diagram: Diagram, source: ModalSource) -> Endpoint | None:
    """Return the first input with nodes that the recorded input leads to."""
    if len(source.channels.inputs) != 1:
        return None
    waiting = [source.channels.inputs[0].rpartition(".")[0]]
    for reached in waiting:
        for wire in diagram.wires:
            if wire.source.block != reached:
                continue
            if wire.target.index and diagram.nodes[wire.target.block].block.category == "rotor":
                return wire.target
            if wire.target.block not in waiting:
                waiting.append(wire.target.block)
    return None
