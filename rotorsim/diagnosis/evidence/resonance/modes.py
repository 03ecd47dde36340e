"""Modes of a linear diagram at rest, as its recorded channels see them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np
import scipy.linalg
from scipy.sparse.csgraph import connected_components

from rotorsim.diagnosis.evidence.waveform.data import Channels
from rotorsim.diagnosis.evidence.waveform.equations import measured_expression
from rotorsim.diagram.diagram import Diagram
from rotorsim.linear import linearisation as linear
from rotorsim.model.compiled import compile_diagram
from rotorsim.model.matrix_function import MatrixFunction
from rotorsim.settled.linear_equations import slots_of

__all__ = ["Modes"]

LOWEST = 1e-3  # Hz: below is no mode but a drift
SEEN = 1e-9  # of the largest shape at the sensors


class Modes:
    """The modes of a linear diagram at rest with the settings of a run, as its recorded channels see them."""

    def __init__(self, diagram: Diagram, channels: Channels, settings: Mapping[str, Any]) -> None:
        model = compile_diagram(diagram)
        linear.refuse_sampled(model, "a comparison of modes")
        trace = model.trace
        y = ca.vertcat(*[measured_expression(model, name) for name in channels.outputs])
        closed = ca.substitute(ca.jacobian(y, trace.x), trace.v, ca.SX.zeros(*trace.v.shape))
        self._A = linear.functions(model).state_matrix()
        self._C = MatrixFunction([trace.t, trace.x, trace.z, trace.p], closed)
        self._model, self._p = model, model.parameter_vector(settings)
        self._slots = [slots_of(model, item) for item in diagram.free]

    def at(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return frequencies (k,) [Hz], ascending, and shapes over the channels (k, c) of the modes that they see.

        theta (m,): the free parameters of the diagram. Raises LinAlgError where the matrices are not finite.
        """
        p = self._p.copy()
        for value, slots in zip(theta, self._slots, strict=True):
            p[slots] = value
        x, z = np.zeros(self._model.n_x), self._model.z0(p)
        A, C = (f(np.zeros((1, 1)), x, z, p)[0] for f in (self._A, self._C))
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
