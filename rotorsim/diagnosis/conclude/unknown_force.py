"""A force that no row of the catalogue explains: place, harmonics, law, work, memory, and a map fitted in the loop."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import chi2

from rotorsim.diagnosis.catalogue.insertion import Spot
from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.evidence.harmonic import Fit, Source
from rotorsim.errors import RotorsimError
from rotorsim.identification.likelihood import Likelihood
from rotorsim.signals.asynchronous import Second

__all__ = ["Unknown", "describe"]

TERMS = ("cubic", "damping_growth", "drag", "friction", "quadratic", "cross", "cross_cubic", "quintic")
MOST_TERMS = 4
CHANCE = 1e-3  # probability that noise alone makes any order of a force
SHOWN = 0.1  # of the largest harmonic of the force: those above are named
KEPT = 0.1  # of the misfit left over that one more term of the map must explain
NAME = "force_map"
TURN = 2 * np.pi


@dataclass(frozen=True, eq=False)
class Unknown:
    """What is known of a force: plain data for diagnosis.json, a description in words, and the fitted map."""

    data: Mapping[str, Any]
    description: str
    fit: Fit | None


def describe(base: Fit, source: Source, spot: Spot) -> Unknown:
    """Return what can be said of an unknown force at a spot, beside the fitted diagram as given."""
    document = values_in(base.document, base.values)
    data: dict[str, Any] = {"place": str(spot)}
    words: list[str] = []
    force = _equivalent(document, source, spot)
    if force is not None:
        data.update(_law(force, words))
        data.update(_lines(force, source.second, words))
    mapped = _mapped(base, document, source, spot)
    if mapped is not None:
        fit, terms = mapped
        share = 1 - fit.misfit / base.misfit
        data["map"] = {"terms": {t: fit.values[f"{NAME}.{t}"] for t in terms}, "explains": share}
        if terms:
            words.append(
                f"a map of displacement and velocity ({', '.join(terms)}) explains {100 * share:.3g} % of the misfit"
                + ("; the rest has memory or another cause" if fit.misfit > 4 * fit.freedom else "")
            )
    text = f"The unknown force at {spot}: " + "; ".join(words) + "." if words else ""
    return Unknown(data, text, mapped[0] if mapped else None)


@dataclass(frozen=True, eq=False)
class _Force:
    """What leaves least over beside a diagram: harmonics F (R, K+1, axes) at speeds (R,), told (K+1,): from noise.

    X: of the displacement there, not a number where it was not measured. beside (R, L, axes), beside_told (L,): at the
    lines beside the harmonics, of orders (L,).
    """

    speeds: np.ndarray
    F: np.ndarray
    X: np.ndarray
    told: np.ndarray
    orders: np.ndarray
    beside: np.ndarray
    beside_told: np.ndarray


def _equivalent(document: Mapping[str, Any], source: Source, spot: Spot) -> _Force | None:
    """Return the force at a spot that explains most, every order by itself; None where there is none."""
    if not isinstance(source, Source):  # in time: there are no harmonics
        return None
    try:
        diagram = source.load(document)
        node = diagram.nodes[spot.block]
        port = node.inputs[spot.port]
        experiment = source.open(diagram, inject=[f"{spot.block}.{spot.port}"])
    except (RotorsimError, KeyError):
        return None
    motion = experiment.motion.linear()
    if motion is None:
        return None
    likelihood = Likelihood(experiment)
    found = likelihood.evaluate(experiment.theta0)
    transfer = motion.response(experiment.theta0).transfer()
    width = port.shape[-1] if port.shape else 1
    first = 0 if spot.node is None else (spot.node - 1) * width
    H = transfer[..., first : first + width]
    D = likelihood.data[:, :, : likelihood.c] - found.Y
    R, orders = len(D), likelihood.K + 1
    F = np.zeros((R, likelihood.orders, width), complex)
    taken = np.zeros(likelihood.orders)
    for r in range(R):
        for k in range(1, likelihood.orders):
            columns = np.concatenate([H[r, k], 1j * H[r, k]], axis=1)
            white = likelihood.white_at(r, k, np.column_stack([columns, D[r, k]]))
            best = np.linalg.lstsq(white[:, :-1], white[:, -1], rcond=1e-10)[0]
            F[r, k] = best[:width] + 1j * best[width:]
            taken[k] += float(np.sum((white[:, :-1] @ best) ** 2))
    told = chi2.sf(taken, 2 * width * R) < CHANCE / likelihood.orders
    conjugate = getattr(port.declaration, "conjugate", None) or "displacement"
    suffix = "" if spot.node is None else f"{spot.node},"
    names = [f"{spot.block}.{conjugate}[{suffix}{axis + 1}]" for axis in range(width)]
    X = np.full((R, orders, width), np.nan, complex)
    if all(name in experiment.predicted for name in names):
        X = likelihood.data[:, :orders, [experiment.predicted.index(name) for name in names]]
    return _Force(
        motion.speeds, F[:, :orders], X, told[:orders], experiment.beside_orders, F[:, orders:], told[orders:]
    )


def _typical(F: np.ndarray) -> np.ndarray:
    """Return the 0-peak sizes (orders,) of a force (R, orders, axes), rms over runs."""
    return np.asarray(2 * np.sqrt((np.abs(F) ** 2).sum(axis=2).mean(axis=0)))


def _lines(force: _Force, second: Second | None, words: list[str]) -> dict[str, Any]:
    """Return where lines beside the harmonics are, and the force at them; add it in words."""
    if second is None or not force.beside_told.any():
        return {}
    typical = _typical(force.beside)
    shown = {
        int(k): float(size) for k, size, told in zip(force.orders, typical, force.beside_told, strict=True) if told
    }
    value, unit = (second.value, "times the speed") if second.follows else (second.value / TURN, "Hz")
    factor = 1.0 if second.follows else TURN
    sizes = [f"{k:+d}X {size:.2g} N" if k else f"{size:.2g} N" for k, size in shown.items()]
    words.append(f"lines beside the harmonics at {value:.4g} {unit} ({', '.join(sizes)})")
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
    typical = np.where(force.told, _typical(F), 0.0)
    orders = [int(k) for k in np.flatnonzero(typical > SHOWN * typical.max(initial=0.0)) if k]
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


def _mapped(base: Fit, document: Mapping[str, Any], source: Source, spot: Spot) -> tuple[Fit, list[str]] | None:
    """Return the diagram with a force map whose terms were chosen one by one, refitted in the loop."""
    diagram = source.load(document)
    node = diagram.nodes.get(spot.block)
    if node is None or spot.port not in node.inputs or "velocity" not in node.outputs:
        return None
    index = "" if spot.node is None else f"[{spot.node}]"
    wires = [
        [f"{spot.block}.displacement{index}", f"{NAME}.displacement"],
        [f"{spot.block}.velocity{index}", f"{NAME}.velocity"],
        [f"{NAME}.force", f"{spot.block}.{spot.port}{index}"],
    ]
    scales = _scales(source, spot)
    best: Fit = base
    chosen: list[str] = []
    while len(chosen) < MOST_TERMS:
        trials: list[tuple[float, str, Fit]] = []
        for term in TERMS:
            if term in chosen:
                continue
            terms = [*chosen, term]
            values = {t: best.values.get(f"{NAME}.{t}", 1e-3 * scales[t]) for t in terms}
            new = values_in(document, best.values)
            new = {
                **new,
                "blocks": {
                    **new["blocks"],
                    NAME: {"type": "force_map", "parameters": {**values, "width": scales["width"]}},
                },
                "wires": [*new["wires"], *wires],
                "identify": {**new.get("identify", {}), **{f"{NAME}.{t}": {} for t in terms}},
            }
            fit = source.fit(new, [[{}]], most=12)
            if not fit.failure:
                trials.append((fit.misfit, term, fit))
        if not trials:
            break
        misfit, term, fit = min(trials, key=lambda item: item[0])
        if misfit > (1 - KEPT) * best.misfit:
            break
        chosen, best = [*chosen, term], fit
        if best.misfit < 1.1 * best.freedom:
            break
    return (best, chosen) if chosen else (base, [])


def _scales(source: Source, spot: Spot) -> dict[str, float]:
    """Return the size of each term that makes a force of one newton at the largest motion."""
    largest = source.largest()
    prefix = f"{spot.block}.displacement"
    q = max((v for name, v in largest.items() if name.startswith(prefix)), default=1e-5)
    turned = q * max((abs(item.fit.speed) for item in getattr(source, "harmonics", ())), default=100.0)
    v = max((v for name, v in largest.items() if name.startswith(f"{spot.block}.velocity")), default=turned)
    return {
        "quadratic": 1 / q**2,
        "cubic": 1 / q**3,
        "quintic": 1 / q**5,
        "drag": 1 / v**2,
        "friction": 1.0,
        "damping_growth": 1 / (q**2 * v),
        "cross": 1 / q,
        "cross_cubic": 1 / q**3,
        "width": 0.05 * v,
    }
