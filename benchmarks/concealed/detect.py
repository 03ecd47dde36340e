"""How visible a fault is to somebody who knows the machine but not its free parameters.

D^2 = min over p of sum |y_fault - y_healthy(p)|^2 / sigma^2 over the samples to identify, p the free parameters. D is
about the largest z-score that a test of those data can reach: below 4 or so nothing can be seen. Along ramps one linear
step leads towards that minimum: D of strong faults is larger than it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.concealed.healthy import ORDERS, Healthy
from benchmarks.concealed.machines import FREE
from benchmarks.concealed.measuring import Instruments
from benchmarks.concealed.simulate import Motion, Run, Simulation

Array = NDArray[Any]

STEPS = 6
TRIALS = 40
BY_HALVED_STEPS = ("jeffcott", "fe_rigid")  # their sets were made so


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
    t, probes = healthy.clock.t[0], sum(not name.startswith("current") for name in healthy.signals)
    grain = len(lanes) * len(t) * probes * (coarse**2 / 12 / instruments.noise[0] ** 2) ** 2
    if any(run.acceleration for run in runs):
        return float(
            np.sqrt(_along_ramps(machine, parameters, runs, lifted, healthy, faulty, instruments.noise) + grain)
        )
    middle = float(t.mean())
    model = Healthy(machine, parameters, [runs[k] for k in lanes], lifted + middle)
    names = list(healthy.signals)  # probes, then currents
    currents = [name.startswith("current") for name in names]
    sigma = np.array([instruments.noise[int(current)] for current in currents])
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

    search = _least if machine in BY_HALVED_STEPS else _least_trusted
    left = search(residual, parameters, tuple(FREE[machine]))
    return float(np.sqrt(max(beyond, 0.0) + left + grain))


def _along_ramps(
    machine: str,
    parameters: dict[str, float],
    runs: list[Run],
    lifted: float,
    healthy: Motion,
    faulty: Motion,
    noise: tuple[float, float],
) -> float:
    """Return D^2 along run-ups: after one step of the free parameters, by differences of simulations."""
    lanes = [k for k, run in enumerate(runs) if run.use == "identify"]
    t = healthy.clock.t[0]

    def seen(motion: Motion) -> Array:
        shown = motion.signals.items()
        values = np.concatenate([(own[lanes] / noise[name.startswith("current")]).ravel() for name, own in shown])
        return np.concatenate([values.real, values.imag])

    here, columns = seen(healthy), []
    for name in FREE[machine]:
        size = 1e-4 * (1.0 if _is_angle(name) else abs(parameters[name]))
        moved = parameters | {name: parameters[name] + size}
        columns.append(seen(Simulation(machine, moved, runs, 1 / (t[1] - t[0]), lifted=lifted).run()) - here)
    J = np.stack(columns, axis=1)
    J /= np.sqrt((J**2).sum(axis=0))
    wanted = seen(faulty) - here
    left = wanted - J @ np.linalg.lstsq(J, wanted, rcond=1e-9)[0]
    return float(left @ left)


def _is_angle(name: str) -> bool:
    return name == "beta" or "phase" in name


def _least_trusted(residual: Any, parameters: dict[str, float], names: tuple[str, ...]) -> float:
    """Return the least sum of squares by a trust region: supports hardly show, so their steps would shorten all."""
    from scipy.optimize import least_squares

    sizes = [1.0 if _is_angle(name) else abs(parameters[name]) for name in names]

    def at(x: Array) -> Array:
        moved = {n: parameters[n] + float(d) * size for n, d, size in zip(names, x, sizes, strict=True)}
        found: Array = residual(parameters | moved)
        return found

    found = least_squares(at, np.zeros(len(names)), ftol=1e-4, xtol=1e-6, gtol=1e-10, max_nfev=TRIALS)
    return float(2 * found.cost)


def _least(residual: Any, parameters: dict[str, float], names: tuple[str, ...]) -> float:
    """Return the least sum of squares near the parameters, by Gauss-Newton steps that are halved until they help."""
    p = dict(parameters)
    sizes = np.array([1.0 if _is_angle(name) else abs(p[name]) for name in names])
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
