"""Settled motion of a healthy machine as a function of its free parameters, condensed to where these act."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.concealed.core import paired
from benchmarks.concealed.machines import MACHINES
from benchmarks.concealed.plant import Plant
from benchmarks.concealed.simulate import Clock, Run, base_forces

Array = NDArray[Any]

ORDERS = np.arange(-16, 17)
ZERO = 16  # where order 0 is
TURN = 64  # samples of one turn, for the harmonics of the forces
LATEST = 1e4  # s: then everything has settled


class Healthy:
    """Orders of the healthy machine in some runs.

    In each order z = R f, with R the receptance of the shaft and what holds it, known once for all, from the ports (of
    forces, bearings, supports) to ports and probes, and

    f = F + (k_s + k_0) z_b - k_i C z_s - (dK + s dD) z

    k_0 is a spring in R that holds a floating shaft; dK, dD is what free parameters change in matrices. In an
    anisotropic machine order k and the conjugate of order -k are solved together.
    """

    def __init__(self, machine: str, parameters: dict[str, float], runs: list[Run], middle: float) -> None:
        self.machine, self.runs, self.middle = machine, runs, min(middle, LATEST)
        self.plant = plant = self._plant(parameters)
        self.sides = 2 if plant.anisotropic else 1
        self.speed = np.array([run.speed for run in runs])[:, None]
        self.s = 1j * ORDERS * self.speed  # (L, k)
        self.gains = np.array([run.gains for run in runs])  # (L, bearings, 3)
        turning = [plant.crack.node, *(unbalance.node for unbalance in plant.unbalances)]
        nodes = [*(bearing.node for bearing in plant.bearings), *turning, *plant.supports]
        self.ports = list(dict.fromkeys(plant.displacement[node] for node in nodes))
        self.amb = [self.ports.index(plant.displacement[bearing.node]) for bearing in plant.bearings]
        self.springs = [bearing.ki * bearing.gains[0] - bearing.ks for bearing in plant.bearings]
        self.receptance = self._receptance()
        seen = list(plant.probes)
        self.sensors = [len(self.ports) + seen.index(bearing.probe) for bearing in plant.bearings]

    def _plant(self, parameters: dict[str, float]) -> Plant:
        return MACHINES[self.machine](parameters, self.runs[0].gains)

    def _receptance(self) -> Array:
        """Return R (L, k, ports and probes, ports), of each side."""
        plant, n, p = self.plant, self.plant.size, len(self.ports)
        held, zero = plant.stiffness.copy(), np.zeros_like(plant.stiffness)
        for port, spring in zip(self.amb, self.springs, strict=True):
            held[self.ports[port], self.ports[port]] += spring
        pairs = {
            "mass": (plant.mass, None),
            "damping": (plant.damping, plant.damping_conj),
            "spin": (-1j * plant.gyroscopic, None),
            "held": (held, plant.stiffness_conj),
        }
        whole = {
            name: paired(one, zero if other is None else other) if self.sides == 2 else one
            for name, (one, other) in pairs.items()
        }
        s, speed = self.s[..., None, None], self.speed[..., None, None]
        D = s**2 * whole["mass"] + s * (whole["damping"] + speed * whole["spin"]) + whole["held"]
        forces = np.zeros((n, p), complex)
        forces[self.ports, range(p)] = 1.0
        rows = np.concatenate([forces.T, *(row[None] for row in plant.probes.values())])
        inputs, outputs = (np.kron(np.eye(self.sides), forces), self._both(rows))
        found: Array = outputs @ np.linalg.solve(D, np.broadcast_to(inputs, (*D.shape[:2], *inputs.shape)))
        return found

    def _both(self, matrix: Array) -> Array:
        """Return what acts on (q, conj q) as the matrix on q."""
        return paired(matrix, np.zeros_like(matrix)) if self.sides == 2 else matrix

    def _forces(self, plant: Plant) -> Array:
        """Return the harmonics (L, k, ports) of crack and unbalances, of each side."""
        turn = 2 * np.pi * np.arange(TURN) / TURN + 0 * self.speed
        known = base_forces(plant, Clock(0 * turn, turn, self.speed + 0 * turn, 0 * turn, self.speed), None)
        out = np.zeros((*self.s.shape, self.sides, len(self.ports)), complex)
        for name, value in known.items():
            port = self.ports.index(plant.displacement[int(name[1:])])
            harmonics = np.fft.fft(value, axis=-1)[:, ORDERS] / TURN
            out[..., 0, port] += harmonics
            out[..., -1, port] = out[..., 0, port] if self.sides == 1 else out[:, ::-1, 0, port].conj()
        return out.reshape(*self.s.shape, -1)

    def _laws(self, plant: Plant, controllers: Array) -> Array:
        """Return G (L, k, ports, ports and probes) of f = F + G z, of each side; controllers: C (L, k, bearings)."""
        p, size = len(self.ports), len(self.ports) + len(plant.probes)
        changes = [self._change(plant, name) for name in ("stiffness", "damping")]
        G = np.zeros((*self.s.shape, self.sides * p, self.sides * size), complex)
        columns = [side * size + k for side in range(self.sides) for k in range(p)]
        G[..., columns] -= changes[0] + self.s[..., None, None] * changes[1]
        for side in range(self.sides):
            for b, bearing in enumerate(plant.bearings):
                row = side * p + self.amb[b]
                G[..., row, side * size + self.amb[b]] += bearing.ks + self.springs[b]
                G[..., row, side * size + self.sensors[b]] -= bearing.ki * controllers[..., b]
        return G

    def _change(self, plant: Plant, name: str) -> Array:
        """Return what free parameters have changed of a matrix, at the ports."""
        at = np.ix_(self.ports, self.ports)
        both = (name, f"{name}_conj")[: self.sides]
        parts = [(getattr(plant, which) - getattr(self.plant, which))[at] for which in both]
        return paired(parts[0], parts[1]) if self.sides == 2 else np.asarray(parts[0])

    def orders(self, parameters: dict[str, float]) -> Array:
        """Return (L, probes + currents, k and the slope of the mean in time)."""
        plant = self._plant(parameters)
        p, size = len(self.ports), len(self.ports) + len(plant.probes)
        KP, KI, KD = (self.gains[:, None, :, j] for j in range(3))
        s = np.where(self.s == 0, 1.0, self.s)[..., None]
        C = KP + np.where(self.s[..., None] == 0, 0, KI / s) + KD * self.s[..., None]
        R, F = self.receptance, self._forces(plant)
        G = self._laws(plant, C)
        closed = np.linalg.solve(np.eye(self.sides * size) - R @ G, R)  # ports -> ports and probes
        z = (closed @ F[..., None])[..., 0]
        # int z_s is a slow state w of its own in the mean: z = there + push w, w' = z_s
        sensors = [side * size + k for side in range(self.sides) for k in self.sensors]
        bearings = [side * p + k for side in range(self.sides) for k in self.amb]
        KI0 = np.tile(KI[:, 0], self.sides)  # (L, bearings of each side)
        ki = np.tile([bearing.ki for bearing in plant.bearings], self.sides)
        push = -closed[:, ZERO][..., bearings] * (ki * KI0)[:, None]
        w, rate = self._integrals(push[:, sensors], z[:, ZERO][:, sensors])
        z[:, ZERO] += (push @ w[..., None])[..., 0]
        drift = (push @ rate[..., None])[..., 0]
        b = len(plant.bearings)
        current = C * z[..., self.sensors]
        current[:, ZERO] += KI[:, 0] * w[:, :b]
        slope = KP[:, 0] * drift[:, self.sensors] + KI[:, 0] * rate[:, :b]
        out = np.concatenate([z[..., len(self.ports) : size], current], axis=-1)
        means = np.concatenate([drift[:, len(self.ports) : size], slope], axis=-1)
        return np.concatenate([np.swapaxes(out, 1, 2), means[..., None]], axis=-1)

    def _integrals(self, A: Array, b: Array) -> tuple[Array, Array]:
        """Return w and w' (L, n) at the middle of the runs, of w' = A w + b from w = 0 when the rotor was lifted."""
        from scipy.linalg import expm

        rate = (expm(A * self.middle) @ b[..., None])[..., 0]
        return np.linalg.solve(A, (rate - b)[..., None])[..., 0], rate
