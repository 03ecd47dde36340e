"""Recordings of machines at rest as evidence: resonances, and which fault candidates change the modes as they must."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from rotorsim.criteria import CRITERIA
from rotorsim.diagnosis.catalogue.catalogue import Catalogue
from rotorsim.diagnosis.catalogue.insertion import Insertion, Law, fixed_of, starts_of
from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.evidence.fit import Fit
from rotorsim.diagnosis.evidence.opened import Opened
from rotorsim.diagnosis.evidence.resonance.evidence import ResonanceEvidence
from rotorsim.diagnosis.evidence.resonance.resonances import resonances
from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem, RotorsimError
from rotorsim.identification.waveform.recorded.data import STABLE_STEP, channels_of, chosen_runs
from rotorsim.identification.waveform.recorded.reading import marked, read_runs
from rotorsim.identification.waveform.search import SIMULATION_SUBSTEPS
from rotorsim.linear.linearisation import jacobians
from rotorsim.model.compiled import compile_diagram
from rotorsim.recordings.recording import Recording, Run

WORK = 1e9  # steps of all runs times derivatives of states: seconds for one evaluation of hundreds
PLACES = 2  # at which a fault candidate is tried before it is tried everywhere


def open_resonances(
    diagram: Diagram,
    recording: Recording,
    hold_out: Recording | None,
    catalogue: Catalogue,
    warnings: Sequence[Problem],
) -> Opened:
    """Return the resonances of a recording as evidence, and the fit of the diagram as given.

    Raises RotorsimError for recordings that do not fit the diagram, or show no resonance.
    """
    parts = [(recording, recording.select("hold_out")), *([] if hold_out is None else [(hold_out, hold_out.runs)])]
    held = tuple(_evidence(diagram, part, runs, catalogue.trust) for part, runs in parts if runs)
    evidence = _evidence(diagram, recording, chosen_runs(recording), catalogue.trust, held)
    base = evidence.fit(diagram.document, [])
    if base.failure:
        raise RotorsimError(Problem(base.failure, diagram.name))
    kept, screened = _screened(base, evidence, catalogue)
    return Opened(evidence, base, base, evidence, kept, bool(held), warnings, screened)


def _evidence(
    diagram: Diagram,
    recording: Recording,
    chosen: Sequence[Run],
    trust_blocks: bool,
    held: tuple[ResonanceEvidence, ...] = (),
) -> ResonanceEvidence:
    """Return the resonances of some runs. Raises RotorsimError with all that does not fit."""
    channels = channels_of(diagram, recording)
    runs = read_runs(diagram, chosen, channels)
    gappy = marked(channels, runs).gappy
    wrong = [run.id for run in runs if run.steps is not None or gappy or run.notes]
    if wrong:
        hint = "resample the runs at equal steps, and leave out what has gaps"
        what = f"resonances are read from even samples without gaps, which {', '.join(wrong)} has not"
        raise RotorsimError(Problem(what, recording.name, hint=hint))
    every = resonances(runs, channels.outputs, channels.inputs)
    strong = tuple(item for item in every if item.strong)
    if not strong:
        hint = "its modes are too fast to be simulated at this sample rate; what is compared are resonances"
        raise RotorsimError(Problem("no resonance stands out in the recording", recording.name, hint=hint))
    sizes = {name: float(np.abs(values).max()) for run in runs for name, values in run.values.items()}
    folder = diagram.folder
    weak = tuple(item for item in every if not item.strong)
    return ResonanceEvidence(recording, runs, channels, sizes, folder, trust_blocks, strong, weak, held)


def is_by_resonances(diagram: Diagram, recording: Recording) -> bool:
    """Return whether a diagram is compared by its resonances: no simulation follows its modes, or not in time.

    The fastest mode sets the steps between samples; each moves the states and their derivatives.
    """
    samples = [(float(run.time[-1] - run.time[0]), len(run.time)) for run in recording.runs if len(run.time) > 1]
    model = compile_diagram(diagram)
    if not samples or model.n_z or not model.n_x:
        return False
    A = jacobians(model)["A"](np.zeros((1, 1)), model.x0(), model.z0(), model.p0)[0]
    rates = np.linalg.eigvals(A) if np.isfinite(A).all() else np.zeros(1)
    if not (np.abs(rates.imag) > np.abs(rates.real)).any():  # it has no resonance
        return False
    fastest = float(np.abs(rates).max())
    steps = sum(max(fastest * length / STABLE_STEP, count) for length, count in samples)
    period = max(length / (count - 1) for length, count in samples)
    return fastest * period > STABLE_STEP * SIMULATION_SUBSTEPS or steps * model.n_x**2 > WORK


def _screened(base: Fit, evidence: ResonanceEvidence, catalogue: Catalogue) -> tuple[Catalogue, list[tuple[str, str]]]:
    """Return the fault candidates that are worth trying everywhere, and of the others why not.

    Each is put at a few places where discs are; what counts is the misfit that one step from its start promises.
    """
    document, largest = values_in(base.document, base.values), evidence.largest()
    by_law: dict[Law, list[Insertion]] = {}
    for item in catalogue.candidates(evidence.load(document), evidence.recorded):
        if not item.from_lines and not item.read_off:
            by_law.setdefault(item.law, []).append(item)
    least: dict[str, float] = {}
    for (name, *_), items in by_law.items():
        for item in _few(items, document):
            starts = starts_of(item, largest)
            here = [dict(zip(item.free, start.values(), strict=True)) for start in starts]
            tried = item.document(document, {**fixed_of(item, largest), **starts[0]})
            least[name] = min(least.get(name, np.inf), evidence.promise(tried, [here]))
    best = min(least.values(), default=np.inf)
    kept = {name for name, value in least.items() if value <= CRITERIA.screened * best}
    text = "changes no mode as it must: at the discs one step of it promises {:.3g} times the misfit of the best"
    lost = sorted((value, name) for name, value in least.items() if name not in kept and np.isfinite(value))
    return catalogue.only(kept), [(name, text.format(value / best)) for value, name in lost]


def _few(items: Sequence[Insertion], document: Mapping[str, Any]) -> list[Insertion]:
    """Return the insertions at nodes with discs, where there are any, else the first ones."""
    discs = {
        (name, node)
        for name, block in document["blocks"].items()
        for node in block.get("parameters", {}).get("disc_nodes", ())
    }
    at_discs = [item for item in items if (item.spot.block, item.spot.node) in discs]
    return (at_discs or list(items))[:PLACES]
