"""The force at a place that explains the residual best: orders, law of speed and amplitude, work, lines."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import chi2

from rotorsim.block import In
from rotorsim.criteria import CRITERIA
from rotorsim.diagnosis.catalogue.insertion import Spot
from rotorsim.diagnosis.evidence.evidence import Unknown
from rotorsim.diagnosis.evidence.harmonic.residual import free_amplitudes
from rotorsim.diagnosis.evidence.harmonic.runs import HarmonicRuns
from rotorsim.errors import RotorsimError
from rotorsim.identification.harmonic.likelihood import Likelihood
from rotorsim.signals.asynchronous import Asynchronous

TURN = 2 * np.pi


def unknown_force(document: Mapping[str, Any], runs: HarmonicRuns, spot: Spot) -> Unknown:
    """Return what can be said of an unknown force at a spot beside a diagram; nothing where that is not linear."""
    force = _equivalent(document, runs, spot)
    if force is None:
        return Unknown()
    words: list[str] = []
    return Unknown({**_law(force, words), **_lines(force, runs.second, words)}, words)


@dataclass(frozen=True, eq=False)
class _Force:
    """The force that explains most: harmonics F (R, K+1, axes) at speeds (R,), significant (K+1,): not made by noise.

    X: of the displacement there, not a number where it was not measured. beside (R, L, axes), lines_significant (L,):
    at the asynchronous lines, of orders (L,).
    """

    speeds: np.ndarray
    F: np.ndarray
    X: np.ndarray
    significant: np.ndarray
    orders: np.ndarray
    beside: np.ndarray
    lines_significant: np.ndarray


def _equivalent(document: Mapping[str, Any], runs: HarmonicRuns, spot: Spot) -> _Force | None:
    """Return the force at a spot that explains most, every order by itself; None where there is none."""
    try:
        diagram = runs.load(document)
        node = diagram.nodes[spot.block]
        port = node.inputs[spot.port]
        experiment = runs.open(diagram, inject=[f"{spot.block}.{spot.port}"])
    except (RotorsimError, KeyError):
        return None
    motion = experiment.motion.linear()
    if motion is None:
        return None
    likelihood = Likelihood(experiment)
    fitted = likelihood.evaluate(experiment.theta0)
    transfer = motion.response(experiment.theta0).transfer()
    width = port.shape[-1] if port.shape else 1
    first = 0 if spot.node is None else (spot.node - 1) * width
    H = transfer[..., first : first + width]
    D = likelihood.data[:, :, : likelihood.c] - fitted.Y
    R, orders = len(D), likelihood.K + 1
    F = np.zeros((R, likelihood.orders, width), complex)
    taken = np.zeros(likelihood.orders)
    for r in range(R):
        for k in range(1, likelihood.orders):
            F[r, k], gain, _ = free_amplitudes(likelihood, r, k, H[r, k], D[r, k])
            taken[k] += gain
    significant = chi2.sf(taken, 2 * width * R) < CRITERIA.chance / likelihood.orders
    conjugate = (port.declaration.conjugate if isinstance(port.declaration, In) else None) or "displacement"
    suffix = "" if spot.node is None else f"{spot.node},"
    names = [f"{spot.block}.{conjugate}[{suffix}{axis + 1}]" for axis in range(width)]
    X = np.full((R, orders, width), np.nan, complex)
    if all(name in experiment.predicted for name in names):
        X = likelihood.data[:, :orders, [experiment.predicted.index(name) for name in names]]
    return _Force(
        motion.speeds,
        F[:, :orders],
        X,
        significant[:orders],
        experiment.beside_orders,
        F[:, orders:],
        significant[orders:],
    )


def _typical(F: np.ndarray) -> np.ndarray:
    """Return the 0-peak sizes (orders,) of a force (R, orders, axes), rms over runs."""
    return np.asarray(2 * np.sqrt((np.abs(F) ** 2).sum(axis=2).mean(axis=0)))


def _lines(force: _Force, second: Asynchronous | None, words: list[str]) -> dict[str, Any]:
    """Return where asynchronous lines are, and the force at them; add it in words."""
    if second is None or not force.lines_significant.any():
        return {}
    typical = _typical(force.beside)
    shown = {
        int(k): float(size)
        for k, size, significant in zip(force.orders, typical, force.lines_significant, strict=True)
        if significant
    }
    value, unit = (second.value, "times the speed") if second.follows else (second.value / TURN, "Hz")
    factor = 1.0 if second.follows else TURN
    sizes = [f"{k:+d}X {size:.2g} N" if k else f"{size:.2g} N" for k, size in shown.items()]
    words.append(f"asynchronous lines at {value:.4g} {unit} ({', '.join(sizes)})")
    return {
        "lines": {
            "value": value,
            "std": second.std / factor,
            "unit": "orders" if second.follows else "Hz",
            "orders": {str(k): size for k, size in shown.items()},
        }
    }


def _law(force: _Force, words: list[str]) -> dict[str, Any]:
    """Return orders, exponents of speed and amplitude, work per turn; add them in words."""
    F, X, W = force.F, force.X, np.abs(force.speeds)
    size = np.sqrt((np.abs(F) ** 2).sum(axis=2)) * 2
    typical = np.where(force.significant, _typical(F), 0.0)
    orders = [int(k) for k in np.flatnonzero(typical > CRITERIA.stated * typical.max(initial=0.0)) if k]
    if not orders:
        return {}
    words.append("orders " + ", ".join(f"{k}X ({typical[k]:.2g} N)" for k in orders[:6]))
    data: dict[str, Any] = {"orders": {str(k): float(typical[k]) for k in orders}}
    main = max(orders, key=lambda k: typical[k])
    good = size[:, main] > 0
    if good.sum() >= 3:
        columns = [np.ones(int(good.sum())), np.log(W[good])]
        amplitude = np.sqrt((np.abs(X) ** 2).sum(axis=2))[:, main]
        if np.isfinite(amplitude).all() and (amplitude[good] > 0).all():
            columns.append(np.log(amplitude[good]))
        fit = np.linalg.lstsq(np.column_stack(columns), np.log(size[good, main]), rcond=None)[0]
        data["speed_exponent"] = float(fit[1])
        words.append(f"its {main}X grows as speed^{fit[1]:.2g}")
        if len(fit) > 2:
            data["amplitude_exponent"] = float(fit[2])
            words[-1] += f" amplitude^{fit[2]:.2g}"
    if np.isfinite(X).all():
        k = np.arange(X.shape[1])[None, :, None]
        work = 4 * np.pi * (k * (np.conj(X) * F).imag).sum(axis=(1, 2))
        data["work_per_turn"] = work.tolist()
        sign = "takes work out of the motion" if (work < 0).mean() > 0.8 else "puts work into it"
        if (work < 0).mean() > 0.8 or (work > 0).mean() > 0.8:
            words.append(f"it {sign} ({np.abs(work).max():.2g} J a turn at most)")
        phase = np.angle((F * np.conj(X)).sum(axis=(1, 2)))
        lag = float(np.degrees(np.median(np.abs(phase))))
        data["phase_to_displacement_deg"] = lag
    return data
