"""The next experiment: the change of speed or gains at which two explanations of the same data differ most."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from rotorsim.diagnose.fitting import Fit, Source
from rotorsim.diagram.diagram import Diagram
from rotorsim.diagram.values import ValueProblem, numeric
from rotorsim.errors import RotorsimError
from rotorsim.identify.experiment import open_experiment
from rotorsim.identify.nonlinear_likelihood import likelihood_of
from rotorsim.identify.nonlinear_motion import NonlinearMotion
from rotorsim.recordings.harmonics import RunHarmonics
from rotorsim.units import format_quantity

__all__ = ["Change", "best_change"]

GAINS = (0.7, 1.5)
SPEEDS = (0.25, 0.5, 1.5, 2.0)
SEEN = 4.0  # standard deviations by which two explanations must differ in one run
MOST_RUNS = 3  # of the recording that are repeated with a change


@dataclass(frozen=True)
class Change:
    """A change of the experiment in words, and how far apart it would put two explanations, in standard deviations."""

    words: str
    separation: float


def best_change(first: Fit, second: Fit, source: Source) -> Change | None:
    """Return the change of gains or speed that separates two fitted diagrams most, or None if none does.

    Each of the widest spread runs is repeated with the change; both diagrams predict it at the values they have.
    """
    found: Change | None = None
    order = np.argsort([abs(item.fit.speed) for item in source.harmonics])
    places = sorted({int(order[k]) for k in np.linspace(0, len(order) - 1, MOST_RUNS).round().astype(int)})
    runs = [source.harmonics[k] for k in places]
    diagram = source.load(first.document)
    for words, changed in _changes(diagram, runs):
        predicted = [_predicted(fit, source, changed) for fit in (first, second)]
        if any(part is None for part in predicted):
            continue
        white, other = (part for part in predicted if part is not None)
        distance = float(np.sqrt(max(float(d @ d) for d in (a - b for a, b in zip(white, other, strict=True)))))
        if distance > SEEN and (found is None or distance > found.separation):
            found = Change(words, distance)
    return found


def _changes(diagram: Diagram, runs: list[RunHarmonics]) -> Iterator[tuple[str, tuple[RunHarmonics, ...]]]:
    for factor in SPEEDS:
        moved = tuple(
            replace(
                item,
                fit=replace(item.fit, speed=item.fit.speed * factor),
                run=replace(item.run, settings=_without(item)),
            )
            for item in runs
        )
        rpm = ", ".join(f"{abs(item.fit.speed) * 30 / np.pi:.4g}" for item in moved)
        yield f"runs at {rpm} rpm", moved
    for name, node in diagram.nodes.items():
        if node.block.category != "controller":
            continue
        for key, value in node.values.items():
            if value.ndim or not float(value) or key not in ("KP", "KD", "KI"):
                continue
            unit = node.block.parameters[key].unit or "1"
            for factor in GAINS:
                full = f"{name}.{key}"
                changed = []
                for item in runs:
                    now = _number(item.run.settings.get(full), unit, float(value))
                    settings = {**_without(item), full: now * factor}
                    changed.append(replace(item, run=replace(item.run, settings=settings)))
                yield f"another set of gains: {full} {format_quantity(float(value) * factor, unit)}", tuple(changed)


def _without(item: RunHarmonics) -> Mapping[str, object]:
    return {key: value for key, value in item.run.settings.items() if key != "speed"}


def _number(given: object, unit: str, default: float) -> float:
    try:
        return default if given is None else float(numeric(given, unit))
    except (ValueProblem, TypeError):
        return default


def _predicted(fit: Fit, source: Source, runs: tuple[RunHarmonics, ...]) -> list[np.ndarray] | None:
    """Return the whitened prediction of each run by a fitted diagram, without its means, or None if there is none."""
    try:
        diagram = source.load(fit.document)
        experiment = open_experiment(
            diagram, source.recording, runs=[item.run for item in runs], harmonics=runs
        )  # fmt: skip
        likelihood = likelihood_of(experiment)
        theta = np.array([fit.values.get(item.name, item.value) for item in experiment.free])
        if isinstance(experiment.motion, NonlinearMotion):
            found = experiment.motion.predict(theta)
            if not found.settled.all():
                return None
            Y = found.Y
        else:
            response = experiment.linear.response(theta)
            if (np.linalg.eigvals(response.A).real > 1e-6 * np.abs(response.A).max() ** 0.5).any():
                return None
            Y = response.outputs(response.states())
    except (RotorsimError, ValueError, np.linalg.LinAlgError):
        return None
    out = []
    for r in range(len(runs)):
        rows = [likelihood.white_at(r, k, Y[r, k][:, None])[:, 0] for k in range(1, Y.shape[1])]
        out.append(np.concatenate(rows))
    return out
