"""How visible a fault is to somebody who knows the machine but not its free parameters.

D^2 = min over p of sum |y_fault - y_healthy(p)|^2 / sigma^2 over the samples to identify, p the free parameters. D is
about the largest z-score that a test of those data can reach: below 4 or so nothing can be seen.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.concealed.measuring import Instruments
from benchmarks.concealed.plant import MACHINES, MASS, SAG, switching
from benchmarks.concealed.simulate import Motion, Run

Array = NDArray[Any]

FREE = {
    "jeffcott": ("c", "e", "beta", "dk", "ks", "ki", "crack_phase"),
    "fe_rigid": ("e", "beta", "dk", "ks", "ki", "crack_phase"),
}
ORDERS = np.arange(-16, 17)
STEPS = 6


class Healthy:
    """Orders of the settled motion of the healthy machine in some runs, as a function of its free parameters."""

    def __init__(self, machine: str, parameters: dict[str, float], runs: list[Run], middle: float) -> None:
        self.machine, self.middle = machine, min(middle, 1e4)
        plants = [MACHINES[machine](parameters, run.gains) for run in runs]
        plant = plants[0]
        amb = plant.displacement[plant.amb]
        self.crack_is_amb = plant.displacement[plant.crack] == amb
        self.amb = list(plant.probes).index(plant.amb)
        speed = np.array([run.speed for run in runs])[:, None]
        self.s = 1j * ORDERS * speed  # (L, k)
        self.speed = speed
        self.gains = np.array([run.gains for run in runs]).T[:, :, None]
        s = self.s[..., None, None]
        spin = speed[..., None, None]
        D = s**2 * plant.mass + s * (plant.damping - 1j * spin * plant.gyroscopic) + plant.stiffness
        ports = np.zeros((plant.size, 2))
        ports[amb, 0] = ports[plant.displacement[plant.crack], 1] = 1.0
        self.receptance = np.stack(list(plant.probes.values())) @ np.linalg.solve(
            D, np.broadcast_to(ports, (*D.shape[:2], *ports.shape))
        )
        self.damping = parameters["c"]
        turn = 2 * np.pi * np.arange(64) / 64
        series = np.fft.fft(0.5 * switching(turn) * (1 + np.exp(2j * turn))) / 64
        self.shape = series[ORDERS]

    def orders(self, p: dict[str, float]) -> Array:
        """Return (L, probes + current, k and the slope of the mean in time): unbalance acts at the bearing's node."""
        R = self.receptance
        if self.machine == "jeffcott":
            R = R / (1 + R * (self.s * (p["c"] - self.damping))[..., None, None])
        crack = p["dk"] * SAG * self.shape * np.exp(1j * ORDERS * p["crack_phase"])
        unbalance = np.where(ORDERS == 1, MASS * p["e"] * self.speed**2 * np.exp(1j * p["beta"]), 0)
        free = R[..., 0] * unbalance[..., None] + R[..., 1] * crack[:, None]  # (L, k, probes), without bearing
        own, there = R[..., self.amb, 0], free[..., self.amb]
        KP, KI, KD = self.gains
        with np.errstate(divide="ignore", invalid="ignore"):
            C = KP + KI / self.s + KD * self.s
            z = there / (1 - own * (p["ks"] - p["ki"] * C))
        zero = int(np.flatnonzero(ORDERS == 0)[0])
        stiff = 1 - own[:, zero] * (p["ks"] - p["ki"] * KP[:, 0])
        rate = -own[:, zero] * p["ki"] * KI[:, 0] / stiff
        z[:, zero] = there[:, zero] / stiff * np.exp(rate * self.middle)
        push = (z - there) / own
        current = (p["ks"] * z - push) / p["ki"]
        out = np.concatenate([free + R[..., 0] * push[..., None], current[..., None]], axis=-1)
        # the mean moves on with the slow pole: z_0' = rate z_0, and the rest follows by statics
        drift = rate * z[:, zero]
        slope = np.concatenate(
            [
                R[:, zero, :, 0] * (drift / own[:, zero])[:, None],
                (drift * (p["ks"] - 1 / own[:, zero]) / p["ki"])[:, None],
            ],
            axis=-1,
        )
        return np.concatenate([np.swapaxes(out, 1, 2), slope[..., None]], axis=-1)


def detectability(
    machine: str,
    parameters: dict[str, float],
    runs: list[Run],
    lifted: float,
    healthy: Motion,
    faulty: Motion,
    instruments: Instruments,
    coarse: float,
) -> float:
    """Return D; a coarser converter counts as the noise that it adds."""
    lanes = [k for k, run in enumerate(runs) if run.use == "identify"]
    t = healthy.clock.t[0]
    middle = float(t.mean())
    model = Healthy(machine, parameters, [runs[k] for k in lanes], lifted + middle)
    names = [*(name for name in healthy.signals if name != "current"), "current"]
    sigma = np.array([instruments.noise[int(name == "current")] for name in names])
    whitened, factors, total = [], [], 0.0
    for lane in lanes:
        basis = np.vstack([np.exp(1j * ORDERS[:, None] * healthy.clock.theta[lane]), t - middle])
        L = np.linalg.cholesky(basis.conj() @ basis.T)
        seen = np.stack([faulty.signals[name][lane] - healthy.signals[name][lane] for name in names]) / sigma[:, None]
        total += float((np.abs(seen) ** 2).sum())
        whitened.append(
            np.linalg.solve(L, basis.conj() @ seen.T).T
        )  # L^-1 Phi* y: its square is what the basis explains
        factors.append(L.conj().T)
    wanted, factor = np.array(whitened), np.array(factors)
    beyond = total - float((np.abs(wanted) ** 2).sum())
    start = model.orders(parameters)

    def residual(p: dict[str, float]) -> Array:
        change = (model.orders(p) - start) / sigma[:, None]
        r = (wanted - np.einsum("lij,lpj->lpi", factor, change)).ravel()
        return np.concatenate([r.real, r.imag])

    left = _least(residual, parameters, FREE[machine])
    samples = len(lanes) * len(t) * 2 * (len(names) - 1)
    grain = coarse**2 / 12 / instruments.noise[0] ** 2
    return float(np.sqrt(max(beyond, 0.0) + left + samples / 2 * grain**2))


def _least(residual: Any, parameters: dict[str, float], names: tuple[str, ...]) -> float:
    """Return the least sum of squares near the parameters, by Gauss-Newton steps that are halved until they help."""
    p = dict(parameters)
    sizes = np.array([1.0 if name in ("beta", "crack_phase") else abs(p[name]) for name in names])
    here = residual(p)
    for _ in range(STEPS):
        J = np.array(
            [(residual(p | {n: p[n] + 1e-5 * size}) - here) / 1e-5 for n, size in zip(names, sizes, strict=True)]
        ).T
        scale = np.sqrt((J**2).sum(axis=0))
        step = -np.linalg.lstsq(J / scale, here, rcond=1e-9)[0] / scale
        step *= min(1.0, 0.5 / max(np.abs(step).max(), 1e-12))
        for half in range(6):
            moved = p | {n: p[n] + float(d * size) * 0.5**half for n, d, size in zip(names, step, sizes, strict=True)}
            new = residual(moved)
            if new @ new < here @ here:
                break
        else:
            break
        gain = 1 - (new @ new) / (here @ here)
        p, here = moved, new
        if gain < 1e-3:
            break
    return float(here @ here)
