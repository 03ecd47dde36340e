"""The closed loop of a machine as first-order equations, with named inputs and outputs."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.concealed.plant import Bearing, Plant

Array = NDArray[Any]


def mark_of(name: str) -> tuple[str, int]:
    """Return kind and number of an input or output, 0 without number: `f3` is ("f", 3)."""
    kind = name.rstrip("0123456789")
    return kind, int(name[len(kind) :] or 0)


def paired(a: Array, b: Array) -> Array:
    """Return the matrix of q -> a q + b conj(q) on (q, conj q)."""
    return np.block([[a, b], [b.conj(), a.conj()]])


class Core:
    """The closed loop as X' = A X + B inputs, y = C X, at one speed.

    X = (q, q', int z_s of each bearing, states of its current path), behind it conj(X) and conj(inputs) if the machine
    is anisotropic, and free integrators at the end. Inputs by name: `f3`, `m3` force and moment at node 3, `e`, `edot`
    what the probe of the first controller adds and its rate, `e2`, `edot2` of the second, `base` acceleration of the
    base, `aux0` the rate of the first free integrator. Outputs: `z3`, `v3` displacement and velocity at node 3, `w3`
    the rate of its tilt, `p3` what the probe at node 3 sees, `command` and `i` the current before and behind the path,
    `command2`, `i2`, `aux0`.
    """

    def __init__(self, plant: Plant, speed: float, integrators: int = 0) -> None:
        self.plant, self.integrators, n = plant, integrators, plant.size
        self.path_at = [2 * n + len(plant.bearings)]
        for bearing in plant.bearings:
            self.path_at.append(self.path_at[-1] + len(bearing.path.poles))
        self.one = self.path_at[-1]  # states, without their conjugates
        self.states = self.one * (2 if plant.anisotropic else 1)  # without free integrators
        self.speed, self.inverse = speed, np.linalg.inv(plant.mass)
        self.command: list[Array] = []
        self.current: list[Array] = []
        for k, bearing in enumerate(plant.bearings):
            self._control(k, bearing)

    def _control(self, k: int, bearing: Bearing) -> None:
        """Write the current of a bearing as rows on the states."""
        plant, n = self.plant, self.plant.size
        KP, KI, KD = bearing.gains
        probe, states = plant.probes[bearing.probe], slice(self.path_at[k], self.path_at[k + 1])
        command = np.zeros(self.one, complex)
        command[:n], command[n : 2 * n], command[2 * n + k] = KP * probe, KD * probe, KI
        current = bearing.path.direct * command
        current[states] += bearing.path.residues
        self.command.append(command)
        self.current.append(current)

    def _matrix(self, inverse: Array) -> Array:
        """Return A for inverse = M^-1; with the unit matrix instead, E A of E X' = E A X, E = diag(1, M, 1)."""
        plant, n = self.plant, self.plant.size
        A = np.zeros((self.one, self.one), complex)
        A[:n, n : 2 * n] = np.eye(n)
        A[n : 2 * n, :n] = -inverse @ plant.stiffness
        A[n : 2 * n, n : 2 * n] = -inverse @ (plant.damping - 1j * self.speed * plant.gyroscopic)
        for k, bearing in enumerate(plant.bearings):
            push = inverse[:, plant.displacement[bearing.node]]
            A[n : 2 * n, plant.displacement[bearing.node]] += push * bearing.ks
            A[n : 2 * n] -= bearing.ki * np.outer(push, self.current[k])
            A[2 * n + k, :n] = plant.probes[bearing.probe]
            for j, pole in enumerate(bearing.path.poles, self.path_at[k]):
                A[j] = self.command[k]
                A[j, j] += pole
        if plant.stiffness_conj is None or plant.damping_conj is None:
            return A
        other = np.zeros_like(A)
        other[n : 2 * n, :n] = -inverse @ plant.stiffness_conj
        other[n : 2 * n, n : 2 * n] = -inverse @ plant.damping_conj
        return paired(A, other)

    def _modes(self) -> tuple[Array, Array]:
        """Return eigenvalues and eigenvectors.

        Of a stiff machine from A^-1 = (E A)^-1 E: rounding is then small beside the slow modes, which are what moves.
        """
        if not self.plant.stiff:
            lam, right = np.linalg.eig(self._matrix(self.inverse))
            return lam, right
        n = self.plant.size
        E = np.eye(self.one, dtype=complex)
        E[n : 2 * n, n : 2 * n] = self.plant.mass
        E = paired(E, np.zeros_like(E)) if self.plant.anisotropic else E
        mu, right = np.linalg.eig(np.linalg.solve(self._matrix(np.eye(n)), E))
        return 1 / mu, right

    def eigen(self) -> tuple[Array, Array, Array]:
        """Return eigenvalues, right eigenvectors and their inverse; free integrators stand apart.

        Raises:
            ArithmeticError: the machine is not stable
        """
        n, size = self.states, self.states + self.integrators
        right, left = np.eye(size, dtype=complex), np.eye(size, dtype=complex)
        lam, right[:n, :n] = self._modes()
        left[:n, :n] = np.linalg.inv(right[:n, :n])
        if lam.real.max() >= 0:
            raise ArithmeticError("the machine is not stable")
        return np.concatenate([lam, np.zeros(self.integrators)]), right, left

    def inputs(self, names: tuple[str, ...]) -> Array:
        """Return B (states, inputs): of the inputs named and, of an anisotropic machine, of their conjugates."""
        found = [self._column(name) for name in names]
        if self.plant.anisotropic:
            found += [np.concatenate([0 * b[: self.one], b[: self.one].conj(), 0 * b[2 * self.one :]]) for b in found]
        return np.stack(found, axis=1)

    def outputs(self, names: tuple[str, ...]) -> Array:
        """Return C (outputs, states)."""
        return np.stack([self._row(name) for name in names])

    def _blank(self) -> Array:
        return np.zeros(self.states + self.integrators, complex)

    def _column(self, name: str) -> Array:
        """Return the column of B of an input."""
        b, plant, n = self._blank(), self.plant, self.plant.size
        kind, number = mark_of(name)
        if kind in ("e", "edot"):
            k = max(number, 1) - 1
            bearing = plant.bearings[k]
            gain = bearing.gains[0 if kind == "e" else 2]
            push = self.inverse[:, plant.displacement[bearing.node]]
            b[n : 2 * n] = -bearing.ki * bearing.path.direct * gain * push
            b[self.path_at[k] : self.path_at[k + 1]] = gain
            b[2 * n + k] = 1.0 if kind == "e" else 0.0
        elif kind == "base":
            b[n : 2 * n] = -self.inverse @ plant.base
        elif kind == "aux":
            b[self.states + number] = 1.0
        else:
            dofs = plant.displacement if kind == "f" else plant.tilt
            b[n : 2 * n] = self.inverse[:, dofs[number]]
        return b

    def _row(self, name: str) -> Array:
        """Return the row of C of an output."""
        c, plant, n = self._blank(), self.plant, self.plant.size
        kind, number = mark_of(name)
        if kind in ("i", "command"):
            c[: self.one] = (self.current if kind == "i" else self.command)[max(number, 1) - 1]
        elif kind == "aux":
            c[self.states + number] = 1.0
        elif kind == "p":
            c[:n] = plant.probes[number]
        elif kind == "w":
            c[n + plant.tilt[number]] = 1.0
        else:
            c[plant.displacement[number] + (n if kind == "v" else 0)] = 1.0
        return c
