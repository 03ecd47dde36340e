"""The thesis' dynamic condensation at one central frequency, for comparison with the exact elimination."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from rotorsim.block import In
from rotorsim.diagram.diagram import Diagram
from rotorsim.identification.harmonic.experiment import Experiment
from rotorsim.linear.linearisation import can_move, entry_names
from rotorsim.model.compiled import Model
from rotorsim.settled.equations import Equations
from rotorsim.settled.motion import LinearMotion

MOST_KNOWN = 64  # operators that are kept, for other data at the same parameters


@dataclass(frozen=True, eq=False)
class Condensed:
    """Residual forces of equations condensed with a transformation that is right at one frequency only.

    D_red = T^T D T,  T = [1; -(K_ss - w_c^2 M_ss)^-1 (K_sm - w_c^2 M_sm)]        thesis eq. (3.31)-(3.42), (4.26)

    D(s): dynamic stiffness of all displacements and tilts, (moving, moving). masters: which of them are measured.
    """

    experiment: Experiment
    motion: LinearMotion
    entries: np.ndarray
    masters: np.ndarray
    central: float
    known: dict[tuple[bytes, int], tuple[np.ndarray, np.ndarray, np.ndarray]] = field(default_factory=dict)

    def again(self, experiment: Experiment) -> Condensed:
        """Return the condensation of the same experiment with other known parameters."""
        return replace(self, experiment=experiment, motion=self.motion.at(experiment.p), known={})

    def forces(self, theta: np.ndarray, Y: np.ndarray, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return residual forces (R, K+1, c) at harmonics Y (R, K+1, c), and derivatives by central differences.

        The forces are linear in stiffness and force parameters, so that wide steps are exact.
        """
        w = self._forces(theta, Y, inputs)
        jacobian = np.empty((*w.shape, len(theta)), complex)
        for j, item in enumerate(self.experiment.free):
            step = 1e-4 * (abs(theta[j]) or abs(item.value) or 1.0)
            up, down = theta.copy(), theta.copy()
            up[j] += step
            down[j] -= step
            jacobian[..., j] = (self._forces(up, Y, inputs) - self._forces(down, Y, inputs)) / (2 * step)
        return w, jacobian

    def _forces(self, theta: np.ndarray, Y: np.ndarray, inputs: np.ndarray) -> np.ndarray:
        key = (theta.tobytes(), Y.shape[1])
        if key not in self.known:
            if len(self.known) >= MOST_KNOWN:
                self.known.clear()
            self.known[key] = self._operators(theta, Y.shape[1] - 1)
        condensed, forcing, gain = self.known[key]
        return np.asarray((condensed @ Y[..., None] - gain @ inputs[..., None])[..., 0] - forcing)

    def _operators(self, theta: np.ndarray, K: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return condensed stiffness (R, K+1, c, c), forces without inputs (R, K+1, c), forces by inputs (..., V)."""
        response = self.motion.response(theta, K)
        transfer = response.transfer()
        stiffness = np.linalg.inv(transfer[..., self.entries])
        T = self._transformation(theta)
        condensed = np.swapaxes(T, 1, 2)[:, None] @ stiffness @ T[:, None]
        rows = stiffness[:, :, self.masters]
        motion = response.outputs(response.states())
        return condensed, (rows @ motion[..., None])[..., 0], rows @ transfer

    def _transformation(self, theta: np.ndarray) -> np.ndarray:
        """Return T of every run, (R, moving, masters)."""
        response = self.motion.response(theta, 0)
        R, n = response.A.shape[:2]
        matrices = 1j * self.central * np.eye(n) - response.A
        compliance = response.C @ np.linalg.solve(matrices, response.B[..., self.entries])
        real = np.linalg.inv(compliance).real
        slaves = np.setdiff1d(np.arange(len(self.entries)), self.masters)
        T = np.zeros((R, len(self.entries), len(self.masters)))
        T[:, self.masters, np.arange(len(self.masters))] = 1.0
        if len(slaves):
            inner = real[:, slaves[:, None], slaves]
            T[:, slaves] = -np.linalg.solve(inner, real[:, slaves[:, None], self.masters])
        return T


def reduced(experiment: Experiment, master_entries: np.ndarray) -> Condensed:
    """Return the condensation of an experiment whose model takes forces and moments at all nodes."""
    outputs, entries = _pairs(experiment.model)
    motion = experiment.linear
    whole = replace(motion, equations=Equations(experiment.model, outputs, experiment.free), beside=None)
    masters = np.array([int(np.flatnonzero(entries == entry)[0]) for entry in master_entries])
    return Condensed(experiment, whole, entries, masters, float(np.mean(np.abs(motion.speeds))))


def conjugates_of(diagram: Diagram) -> dict[str, str]:
    """Return output port -> the additive input that does work on it, of all blocks."""
    found = {}
    for block, node in diagram.nodes.items():
        for name, port in node.inputs.items():
            declared = port.declaration
            if isinstance(declared, In) and declared.additive and declared.conjugate in node.outputs:
                found[f"{block}.{declared.conjugate}"] = f"{block}.{name}"
    return found


def _pairs(model: Model) -> tuple[list[str], np.ndarray]:
    """Return every moving output entry with the external force on it: names, places in v."""
    conjugates = {force: port for port, force in conjugates_of(model.diagram).items()}
    names: list[str] = []
    entries: list[int] = []
    for external, signal in model.trace.external.items():
        port = conjugates.get(external)
        for k, name in enumerate(entry_names(port, signal.shape) if port else ()):
            if can_move(model, name):
                names.append(name)
                entries.append(signal.part.start + k)
    return names, np.array(entries)
