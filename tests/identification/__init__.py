"""Recordings of known truth, computed by the independent generator, for the tests of identification."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from rotorsim.diagram.diagram import Diagram
from rotorsim.diagram.resolve.resolution import shipped_diagrams
from rotorsim.errors import Place
from rotorsim.identification.result import Identification
from rotorsim.model.load import load
from rotorsim.recordings.recording import Channel, Recording, Run
from tests.reference import recordings as reference
from tests.reference.recordings import RecordedRun, Truth, add_noise, tacho_times

RATE = 2000.0
OTHER_GAINS = (9000.0, 2000.0, 5.0)
MAKERS: dict[str, Callable[..., RecordedRun]] = {
    model: getattr(reference, f"{model}_run") for model in ("jeffcott", "offset_disc", "fe_rigid", "fe_flexible")
}
# other values than in the diagrams, and a crack that does not stand at the tacho mark
TRUTH = Truth(
    viscous_damping=91.0,
    crack_stiffness=2.4e5,
    crack_phase=0.9,
    force_displacement_factor=98e3,
    force_current_factor=45.0,
    eccentricity=31e-6,
    unbalance_phase=-1.1,
    eccentricity1=31e-6,
    unbalance_phase1=-0.7,
    eccentricity2=47e-6,
    unbalance_phase2=1.9,
    support_left_stiffness=(455e6, 1010e6),
    support_right_stiffness=(390e6, 760e6),
)


@cache
def shipped(model: str) -> Diagram:
    return load(model)


def changed(model: str, change: Callable[[dict[str, Any]], Any], **named: Any) -> Diagram:
    """Return a shipped diagram with its document changed."""
    document = json.loads(shipped_diagrams()[model].read_text())
    del document["$schema"]
    change(document)
    return load(document, folder=Path(), **named)


def made(
    model: str, speeds: Sequence[float], truth: Truth = TRUTH, *, level: float = 0.0, seed: int = 0, **named: Any
) -> list[RecordedRun]:
    """Return one run for each speed, each with a noise and an angle at the start of its own."""
    settings = {"rate": RATE, **named}
    runs = [MAKERS[model](truth, speed, theta0=0.7 * k, **settings) for k, speed in enumerate(speeds)]
    gains = [int(gain) for gain in named.get("gains", (0,))]
    return [add_noise(run, level, (seed, k, *gains)) if level else run for k, run in enumerate(runs)]


def pulses(run: RecordedRun) -> np.ndarray:
    """Return the times of the tacho pulses since the first sample; also of a shaft that turns back."""
    if run.speed > 0:
        return tacho_times(run) - run.time[0]
    turns = np.arange(np.ceil(run.theta[-1] / (2 * np.pi)), np.floor(run.theta[0] / (2 * np.pi)) + 1)[::-1]
    return np.asarray((turns * 2 * np.pi - run.theta[0]) / run.speed)


def recorded(runs: Sequence[RecordedRun], uses: Sequence[str] | str = "identify", **couplings: str) -> Recording:
    """Return runs as a recording in memory, with tacho pulses; couplings: column -> "ac"."""
    channels = {}
    for column in runs[0].columns:
        signal = "controller.current" if column.startswith("i") else "rotor.displacement"
        axis, node = (column[1], None) if column.startswith("i") else (column[0], int(column[1:] or 0) or None)
        unit = "A" if column.startswith("i") else "m"
        channels[column] = Channel(column, signal, axis, node, None, unit, couplings.get(column, "dc"))
    each = [uses] * len(runs) if isinstance(uses, str) else uses
    made_runs = tuple(
        Run(
            f"run{k}",
            f"run{k}.npz",
            run.time - run.time[0],
            run.columns,
            run.speed,
            pulses(run),
            run.settings,
            use,
            Place("recording.json", k + 10, 3),
            run.rate,
        )
        for k, (run, use) in enumerate(zip(runs, each, strict=True))
    )
    return Recording("made", "tests/reference", Path(), channels, made_runs)


def errors(found: Identification, truth: Truth = TRUTH) -> dict[str, float]:
    """Return what each parameter is off, as part of its true value; for an angle in radians."""
    off = {}
    for name, value in found.values.items():
        if found.parameters[name].unit == "rad":
            off[name] = abs(float(np.angle(np.exp(1j * (value - truth[name])))))
        else:
            off[name] = abs(value - truth[name]) / truth[name]
    return off


def free(model: str, **identify: Any) -> Diagram:
    """Return a shipped diagram with other free parameters; "__" in a name stands for the dot."""
    named: Mapping[str, Any] = {name.replace("__", "."): value for name, value in identify.items()}
    return changed(model, lambda document: document.update(identify=named))
