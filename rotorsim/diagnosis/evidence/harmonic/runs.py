"""Harmonics of the runs of a recording, and a diagram opened beside them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from rotorsim.diagnosis.catalogue.insertion import LEAST, LINES, LONGEST, RATE
from rotorsim.diagram.diagram import Diagram, Free
from rotorsim.identification.harmonic.drifting import DriftingLikelihood
from rotorsim.identification.harmonic.experiment import Experiment, open_experiment
from rotorsim.identification.harmonic.likelihood import Likelihood
from rotorsim.model.load import load
from rotorsim.recordings.recording import Recording
from rotorsim.signals.asynchronous import Asynchronous
from rotorsim.signals.converters import before_converters
from rotorsim.signals.harmonics import RunHarmonics

SAME_SPEED = 0.02  # relative


@dataclass(frozen=True, eq=False)
class HarmonicRuns:
    """Harmonics of R runs, and where the diagram's files are.

    second: the asynchronous frequency with which the harmonics were fitted. standing: nuisance parameters of the
    diagram as given (see `Fit.criterion`); given: its free parameters, whose sizes and priors hold in every later fit,
    whatever value that begins from. drifting: variance of the drift of 1X within the runs, as a multiple of what noise
    makes, where fits are to it, too; else 0.
    """

    recording: Recording
    harmonics: tuple[RunHarmonics, ...]
    folder: str | None = None
    trust_blocks: bool = False
    second: Asynchronous | None = None
    standing: int | None = None
    given: tuple[Free, ...] = ()
    drifting: float = 0.0

    def load(self, document: Mapping[str, Any]) -> Diagram:
        """Return the diagram of a document. Raises RotorsimError."""
        folder = Path(self.folder) if self.folder else None
        return load(document, folder=folder, trust_blocks=self.trust_blocks)

    def open(self, diagram: Diagram, *, inject: Sequence[str] = ()) -> Experiment:
        """Return a diagram beside the harmonics; see `rotorsim.identification.harmonic.experiment.open_experiment`."""
        return open_experiment(
            before_converters(diagram),
            self.recording,
            runs=[item.run for item in self.harmonics],
            inject=inject,
            harmonics=self.harmonics,
            free=[self._as_given(item) for item in diagram.free],
        )

    def likelihood(self, experiment: Experiment) -> Likelihood:
        """Return the likelihood of an experiment that is fitted."""
        return DriftingLikelihood(experiment, self.drifting) if self.drifting else Likelihood(experiment)

    def _as_given(self, item: Free) -> Free:
        """Return a free parameter with size and prior of the diagram as given, not of the fit that it starts from."""
        first = next((other for other in self.given if other.name == item.name), item)
        return replace(item, scale=first.scale, prior_mean=first.prior_mean, prior_std=first.prior_std)

    @property
    def recorded(self) -> list[str]:
        """The flat names of the recorded signals, without those that are zero throughout: nothing senses there."""
        runs = [item.run.values for item in self.harmonics]
        channels = self.recording.channels.items()
        return [item.name for key, item in channels if not runs or any(key in run and run[key].any() for run in runs)]

    @property
    def alike(self) -> bool:
        """Whether all runs have one speed, to SAME_SPEED of it, and the same settings."""
        speeds = [item.fit.speed for item in self.harmonics]
        settings = [{k: v for k, v in item.run.settings.items() if k != "speed"} for item in self.harmonics]
        near = max(speeds) - min(speeds) <= SAME_SPEED * abs(speeds[0])
        return near and all(one == settings[0] for one in settings)

    def largest(self) -> dict[str, float]:
        """Return the largest magnitude of every recorded signal, by its flat name, and of the rates of displacements.

        "least NAME": in the run in which it is smallest. "rate of NAME": of its rate of change. LONGEST: the length of
        the longest run.
        """
        sizes: dict[str, list[float]] = {}
        fastest: dict[str, float] = {}
        for item in self.harmonics:
            rates = item.fit.orders[:, None] * item.fit.speed * item.fit.values
            for c, name in enumerate(item.fit.names):
                size = float(abs(item.fit.values[0, c])) + float(np.sqrt(2) * item.fit.rms[c])
                sizes.setdefault(name, []).append(size)
                rate = 2 * float(np.sqrt((np.abs(rates[:, c]) ** 2).sum()))
                fastest[name] = max(fastest.get(name, 0.0), rate)
                port, _, rest = name.partition("[")
                if port.endswith(".displacement"):
                    sizes.setdefault(f"{port.removesuffix('displacement')}velocity[{rest}", []).append(rate)
        largest = {name: max(values) for name, values in sizes.items()}
        largest |= {f"{RATE} {name}": rate for name, rate in fastest.items()}
        largest |= {f"{LEAST} {name}": min(values) for name, values in sizes.items()}
        largest[LONGEST] = max(float(np.ptp(item.run.time)) for item in self.harmonics)
        if self.second is not None and not self.second.follows:
            largest[LINES] = self.second.value
        return largest


def has_mesh(diagram: Diagram) -> bool:
    """Return whether a block of the diagram is a mesh, which is never exact."""
    return any(node.block.refinement for node in diagram.nodes.values())
