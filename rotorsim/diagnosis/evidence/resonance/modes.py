"""Modes of a linear diagram at rest, as its recorded channels see them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import scipy.linalg
from scipy.sparse.csgraph import connected_components

from rotorsim.diagram.diagram import Diagram
from rotorsim.identification.waveform.driven.equations import driven_equations
from rotorsim.identification.waveform.recorded.data import Channels

LOWEST = 1e-3  # Hz: below is no mode but a drift
SEEN = 1e-9  # of the largest shape at the sensors


class Modes:
    """The modes of a linear diagram at rest with the settings of a run, as its recorded channels see them.

    free: the parameters that they are functions of.
    """

    def __init__(self, diagram: Diagram, channels: Channels, settings: Mapping[str, Any]) -> None:
        self._equations = driven_equations(diagram, channels.outputs, (), diagram.free)
        self.free = self._equations.free
        self._p = self._equations.model.parameter_vector(settings)

    def at(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return frequencies (k,) [Hz], ascending, and shapes over the channels (k, c) of the modes that they see.

        theta (m,): the free parameters of the diagram. Raises LinAlgError where the matrices are not finite.
        """
        eq = self._equations
        A, C = (f(0.0, np.zeros(eq.n), np.zeros(0), eq.parameters(self._p, theta))[0] for f in eq.matrices)
        if not (np.isfinite(A).all() and np.isfinite(C).all()):
            raise np.linalg.LinAlgError("the linearised diagram is not finite at rest")
        _, group = connected_components(A != 0, directed=False)
        seen = np.isin(group, np.unique(group[np.abs(C).sum(axis=0) > 0]))
        values, vectors = scipy.linalg.eig(A[np.ix_(seen, seen)])
        shapes = (C[:, seen] @ vectors).T
        frequencies = np.abs(values) / (2 * np.pi)
        sizes = np.abs(shapes).max(axis=1) / np.maximum(np.abs(values), 1e-300)
        kept = (values.imag > 0) & (frequencies > LOWEST) & (sizes > SEEN * sizes.max(initial=0.0))
        order = np.argsort(frequencies[kept])
        return frequencies[kept][order], shapes[kept][order]
