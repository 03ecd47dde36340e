"""Where the recorded input of a machine at rest acts: by the shapes of the responses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import networkx as nx
import numpy as np
from scipy.ndimage import gaussian_filter1d

from rotorsim.diagnosis.evidence.resonance.resonances import SMOOTH, Resonance
from rotorsim.diagnosis.evidence.waveform.runs import SampledRuns
from rotorsim.diagram.diagram import Diagram, Endpoint
from rotorsim.linear.linearisation import linearise

SMOOTHED_LINES = 8  # of the spectrum, of which one is compared: smoothed neighbours say the same


def driven_at(runs: SampledRuns, measured: Sequence[Resonance], document: Mapping[str, Any]) -> list[str]:
    """Return in words where the recorded input acts: at the node that the diagram says, or rather at one of a bearing.

    Compared is the shape of the response at each frequency with that to a force there, whatever its size.
    """
    diagram = runs.load(document)
    target = _target(diagram, runs.channels.inputs)
    if target is None:
        return []
    port = f"{target.block}.{target.port}"
    bearings = [
        wire.target.index[0]
        for wire in diagram.wires
        if (wire.target.block, wire.target.port) == (target.block, target.port)
        and wire.target.index
        and "bearing" in diagram.nodes[wire.source.block].block.roles
    ]
    nodes = list(dict.fromkeys([target.index[0], *bearings]))
    if len(nodes) < 2:
        return []
    run = max(runs.runs, key=lambda item: item.size)
    frequencies = np.fft.rfftfreq(run.size, run.dt)
    Y = np.fft.rfft(run.measured(runs.channels.outputs), axis=0)
    U = np.fft.rfft(run.values[runs.channels.inputs[0]])
    H = gaussian_filter1d(Y * np.conj(U)[:, None], SMOOTH, axis=0)
    between = (frequencies > measured[0].frequency / 2) & (frequencies < measured[-1].frequency * 1.1)
    lines = np.flatnonzero(between)[::SMOOTHED_LINES]
    system = linearise(diagram, inputs=[port], outputs=[_moved(name) for name in runs.channels.outputs])
    width, axis = diagram.nodes[target.block].inputs[target.port].shape[1], target.index[1] if target.index[1:] else 0
    G, H = system.response(frequencies[lines])[:, :, [node * width + axis for node in nodes]], H[lines, :, None]
    overlap = np.abs((np.conj(G) * H).sum(axis=1)) / (np.linalg.norm(G, axis=1) * np.linalg.norm(H, axis=1))
    alike = overlap.mean(axis=0)
    best = nodes[int(alike.argmax())]
    each = ", ".join(f"{port}[{node + 1}] {value:.2f}" for node, value in zip(nodes, alike, strict=True))
    said = "as the diagram says" if best == target.index[0] else "not where the diagram says"
    return [f"The recorded input acts at {port}[{best + 1}], {said} (likeness of responses: {each})."]


def _moved(name: str) -> str:
    """Return the displacement of a recorded acceleration or velocity: of one shape at each frequency."""
    base, bracket, inside = name.partition("[")
    return f"{base.rpartition('.')[0]}.displacement{bracket}{inside}"


def _target(diagram: Diagram, inputs: Sequence[str]) -> Endpoint | None:
    """Return the first input with nodes that the recorded input leads to."""
    if len(inputs) != 1:
        return None
    first = inputs[0].rpartition(".")[0]
    reached = [first, *(block for _, block in nx.bfs_edges(diagram.graph, first))]
    targets = (wire.target for block in reached for wire in diagram.wires if wire.source.block == block)
    return next((end for end in targets if end.index and "rotor" in diagram.nodes[end.block].block.roles), None)
