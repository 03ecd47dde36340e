"""The next experiment: which change would determine what the data leave open, by its expected information."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorsim.criteria import Z90
from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import RotorsimError
from rotorsim.identification.harmonic.estimate import Estimate
from rotorsim.identification.harmonic.experiment import Experiment, open_experiment
from rotorsim.identification.harmonic.likelihood import Likelihood
from rotorsim.identification.verdict import relative_width
from rotorsim.settled.equations import slots_of
from rotorsim.units import format_quantity

OTHER_GAINS = (0.75, 1.5)
OTHER_SPEEDS = (0.5, 0.75, 1.5)
LONGER = 4.0
EXCITATION = 0.2  # of the rms of the current
FREQUENCIES = np.geomspace(0.2, 3.0, 8)  # of the fastest mode of the loop that is damped less than half


@dataclass(frozen=True)
class Advice:
    """A change of the experiment, and the standard deviations (m,) that it promises together with the data at hand.

    solves: names of the parameters that it would determine.
    """

    change: str
    std: np.ndarray
    solves: tuple[str, ...]


def advise(experiment: Experiment, estimate: Estimate, open_names: Sequence[str], precision: float) -> list[Advice]:
    """Return changes that would determine parameters left open, the most helpful first.

    Tried are: other gains of the controller, other speeds, a longer recording, a sine added to the current. Each
    is judged by the information that it would add at the estimate, with the noise of the recording.
    """
    names = [item.name for item in estimate.free]
    wanted = [names.index(name) for name in open_names if name in names]
    if not wanted:
        return []
    base = experiment
    if experiment.given:  # what a changed loop would measure follows from the closed loop
        runs = [item.run for item in experiment.runs]
        base = open_experiment(
            experiment.diagram, experiment.recording, runs=runs, free=experiment.free, harmonics=experiment.runs
        )
    J = np.linalg.inv(estimate.coordinates.jacobian(estimate.theta))
    at_hand = J.T @ estimate.information @ J
    results = []
    for change, added in _candidates(base, estimate):
        std = _std(at_hand + added, estimate)
        limits = [relative_width(float(estimate.theta[j]), Z90 * std[j], estimate.free[j].unit) for j in wanted]
        solved = tuple(names[j] for j, width in zip(wanted, limits, strict=True) if width <= precision)
        if solved:
            results.append((len(solved), -float(np.max(limits)), Advice(change, std, solved)))
    results.sort(key=lambda item: item[:2], reverse=True)
    return [advice for _, _, advice in results]


def _std(information: np.ndarray, estimate: Estimate) -> np.ndarray:
    scale = 1 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    values, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    inverse = (vectors / np.maximum(values, 1e-13)) @ vectors.T
    return np.asarray(np.sqrt(np.maximum(np.diag(inverse), 0)) * scale)


def _candidates(base: Experiment, estimate: Estimate) -> Iterator[tuple[str, np.ndarray]]:
    theta, p = estimate.theta, base.linear.p
    yield f"a recording {LONGER:g} times as long", (LONGER - 1) * _information(base, estimate, p, base.linear.speeds)
    for text, changed in _other_gains(base.diagram, base, p):
        if _stable(base, changed, theta):
            yield (
                f"the same speeds again with other gains: {text}",
                _information(base, estimate, changed, base.linear.speeds),
            )
    entries = np.flatnonzero(base.model.parameter_vector({"speed": 1.0}) != base.model.parameter_vector({"speed": 2.0}))
    for factor in OTHER_SPEEDS:
        changed = p.copy()
        changed[:, entries] *= factor
        speeds = base.linear.speeds * factor
        if _stable(base, changed, theta):
            low, high = (format_rpm(value) for value in (np.abs(speeds).min(), np.abs(speeds).max()))
            yield f"as many runs at other speeds, {low} to {high}", _information(base, estimate, changed, speeds)
    excited = _excitation(base, estimate)
    if excited is not None:
        yield excited


def format_rpm(speed: float) -> str:
    """Return a speed [rad/s] as text in rpm."""
    return f"{speed * 30 / np.pi:.0f} rpm"


def _information(base: Experiment, estimate: Estimate, p: np.ndarray, speeds: np.ndarray) -> np.ndarray:
    """Return the information (m, m) that runs at these parameters would give, with the noise of those at hand."""
    likelihood = Likelihood(replace(base, p=p, motion=replace(base.linear, p=p, speeds=speeds, beside=None)))
    jacobian = likelihood.expected(estimate.theta)
    return np.asarray(jacobian.T @ jacobian)


def _stable(base: Experiment, p: np.ndarray, theta: np.ndarray) -> bool:
    A = base.linear.equations.at(p).whole.matrices["A"](p, np.repeat(theta[None], len(p), 0))[0]
    return bool((np.linalg.eigvals(A).real.max(axis=1) < 1e-6 * np.abs(A).max() ** 0.5).all())


def _other_gains(diagram: Diagram, base: Experiment, p: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """Yield changes of the scalar gains of every controller: one after the other, and the first with the last."""
    free = {slot for item in base.free for slot in slots_of(base.model, item)}
    for block, node in diagram.nodes.items():
        if "controller" not in node.block.roles:
            continue
        gains = [k for k, v in node.values.items() if v.ndim == 0 and float(v) != 0.0]
        gains = [k for k in gains if base.model.parameters[f"{block}.{k}"].start not in free]
        plans = [{name: factor} for name in gains for factor in OTHER_GAINS]
        if "KP" in gains and "KD" in gains:
            plans.insert(0, {"KP": OTHER_GAINS[0], "KD": OTHER_GAINS[1]})
        for plan in plans:
            changed = p.copy()
            for name, factor in plan.items():
                changed[:, base.model.parameters[f"{block}.{name}"].start] *= factor
            text = ", ".join(
                f"{block}.{name} = "
                + format_quantity(
                    float(changed[0, base.model.parameters[f"{block}.{name}"].start]),
                    node.block.parameters[name].unit,
                    4,
                )
                for name in plan
            )
            yield text, changed


def _excitation(base: Experiment, estimate: Estimate) -> tuple[str, np.ndarray] | None:
    """Return the information of one run with a sine added to the measured current, at several frequencies in turn."""
    ports = dict.fromkeys(name.partition("[")[0] for name in base.predicted)
    current = next(
        (p for p in ports if base.model.signals[p].unit == "A" and base.model.signals[p].shape == (2,)), None
    )
    if current is None:
        return None
    fits = base.fits
    names = [name for name in base.predicted if name.startswith(current)]
    rms = max(float(fits[0].rms[fits[0].names.index(name)]) for name in names)
    if not rms > 0:
        return None
    try:
        runs = [base.runs[0].run]
        injected = open_experiment(
            base.diagram, base.recording, runs=runs, inject=[current], free=base.free, harmonics=base.runs[:1]
        )
    except RotorsimError:
        return None
    motion = injected.linear
    response = motion.response(estimate.theta, 0, forced=False)
    modes = np.linalg.eigvals(response.A[0])
    modes = modes[(modes.imag > 0) & (-modes.real < 0.7 * np.abs(modes))]
    centre = float(np.abs(modes).min()) if len(modes) else float(np.abs(motion.speeds[0]))
    likelihood = Likelihood(injected)
    total = np.zeros((len(estimate.free), len(estimate.free)))
    entry = injected.model.trace.external[current].part.start
    for frequency in centre * FREQUENCIES:
        sine = replace(motion, speeds=np.array([frequency]), K=1, phase=np.zeros(1), beside=None)
        at = sine.response(estimate.theta, forced=False)  # what is linear adds up: the sine alone
        inputs = np.zeros((1, 2, at.B.shape[2]), complex)
        inputs[0, 1, entry] = EXCITATION * rms / 2
        jacobian = at.sensitivity(at.states(inputs), inputs)[0, 1]
        whitened = likelihood.white_at(0, 1, jacobian)
        total += whitened.T @ whitened
    low, high = (f * centre / (2 * np.pi) for f in (FREQUENCIES[0], FREQUENCIES[-1]))
    text = (
        f"a sine of {EXCITATION * rms:.2g} A added to {current}, {low:.0f} to {high:.0f} Hz "
        f"in {len(FREQUENCIES)} steps, each as long as a run"
    )
    return text, total
