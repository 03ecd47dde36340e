"""Settled periodic motion at one or many speeds: direct for linear diagrams, harmonic balance for the rest."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any
from weakref import WeakKeyDictionary

import casadi as ca
import numpy as np

from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem, RotorsimError
from rotorsim.linear import linearisation as linear
from rotorsim.linear.eigenmodes import checked_speeds, require_speed
from rotorsim.model.compiled import Model
from rotorsim.model.input_limits import input_limits, passed_limit
from rotorsim.model.matrix_function import MatrixFunction
from rotorsim.settled import linear_response as periodic_linear
from rotorsim.settled.harmonic_balance import Settings, balance
from rotorsim.settled.linear_response import Motion, Setup
from rotorsim.settled.result import Periodic

__all__ = ["Periodic", "periodic"]


@dataclass
class _Outputs:
    """Signals as functions: y = C x + y0(t) where they are linear, else y(t, x)."""

    names: tuple[str, ...]
    channels: tuple[str, ...]
    pairs: tuple[tuple[str, int], ...]
    is_linear: bool
    matrix: MatrixFunction
    matrix_varies: bool
    constant: MatrixFunction
    timed: bool
    units: dict[str, str] = field(default_factory=dict)


_SETUPS: WeakKeyDictionary[Model, Setup] = WeakKeyDictionary()
_OUTPUTS: WeakKeyDictionary[Model, dict[tuple[str, ...], _Outputs]] = WeakKeyDictionary()


def periodic(
    diagram: Diagram | Model,
    *,
    speeds: Sequence[float] | np.ndarray | None = None,
    parameters: Mapping[str, Any] | None = None,
    harmonics: int | None = None,
    signals: Sequence[str] | None = None,
    subharmonic: int = 1,
    stability: bool = True,
    tolerance: float = 1e-8,
) -> Periodic:
    """Return the settled periodic motion at one or many speeds [rad/s] (the diagram parameter ``speed``).

    Linear diagrams, d x/dt = A x + f(t): X_k = (i k W I - A)^-1 F_k, with F_k the Fourier coefficients of
    dx/dt at x = 0 over one period, sampled finely enough, or integrated piecewise between the instants where it
    jumps. Others: harmonic balance with alternating frequency/time. Default speeds: the diagram's own.
    harmonics: number H of orders kept; default as many as the motion has. signals: what is returned; default
    what the diagram records. subharmonic: the period in turns. stability: examine whether the motion is stable
    (eigenvalues of A, or Floquet multipliers). tolerance: relative size of the harmonics left out.

    A speed at which no solution is found says so in ``status`` and leaves the others as they are.

    Raises RotorsimError for sampled blocks, motion that is not periodic (a ramp, another period), wrong names.
    Source: Cameron & Griffin, J. Appl. Mech. 56 (1989) 149-154; Krack & Gross, Harmonic Balance for Nonlinear
    Vibration Problems (2019), ch. 2-4.
    """
    model = linear.as_model(diagram)
    linear.refuse_sampled(model, "periodic")
    require_speed(model, "periodic")
    if subharmonic < 1 or (harmonics is not None and harmonics < 1):
        raise RotorsimError(Problem(what="subharmonic and harmonics must be at least 1", subject="periodic"))
    setup = _SETUPS.get(model) or _SETUPS.setdefault(model, Setup(model))
    p0 = model.parameter_vector(parameters)
    own = linear.speed_of(model, p0)
    if speeds is None and not own:
        what = "the diagram's own speed is zero: there is no turn to be periodic in"
        raise RotorsimError(
            Problem(what=what, subject="speed", hint="give speeds, and a clock that does not accelerate")
        )
    values = checked_speeds([own or 0.0] if speeds is None else speeds, zero=False)
    p = np.repeat(p0[None], len(values), 0)
    p[:, setup.speed_entries] = values[:, None]

    base = values / subharmonic
    outputs = _prepared(setup, _returning(setup, signals, float(base[0]), p[0]))
    if model.linear:
        motion = periodic_linear.solve(setup, base, p, harmonics, tolerance, stability)
    else:
        settings = Settings(harmonics=harmonics, tolerance=tolerance, stability=stability)
        motion = balance(setup, base, p, settings)
    _refuse_beyond_limits(setup, base, p, motion)
    channels = _evaluate(setup, outputs, base, p, motion)
    error = np.zeros(len(values))
    if motion.finer is not None:
        error = _change(channels, _evaluate(setup, outputs, base, p, replace(motion, X=motion.finer)))
    return _result(model, outputs, values, motion, channels, error, subharmonic, parameters)


def _refuse_beyond_limits(setup: Setup, base: np.ndarray, p: np.ndarray, motion: Motion) -> None:
    """Fail the speeds at which an input of a block passes the magnitude below which its equations hold."""
    model, count = setup.model, motion.X.shape[1]
    m = max(8 * count, 128)
    for j, W in enumerate(base):
        limits = input_limits(model.diagram, {name: p[j][part] for name, part in model.parameters.items()})
        names = list(dict.fromkeys(str(item.source) for item in limits))
        if not names or not np.isfinite(motion.X[j]).all():
            continue
        time = setup.instants(np.array([W]), m)[0]
        x = np.fft.irfft(motion.X[j] * m, m, axis=0)
        signals = {}
        for name in names:
            column = np.array(model.output((name,))(time[None], x.T, setup.z, p[j])).T
            signals[name] = column.reshape(m, *model.shape_of(name))
        too_far = passed_limit(limits, time, signals)
        if too_far:
            motion.status[j] = f"failed: {too_far}"
            motion.X[j] = np.nan


def _change(channels: np.ndarray, finer: np.ndarray) -> np.ndarray:
    """Return the largest change of harmonics by more orders, relative to the largest, worst channel, (n,).

    Zero where there is no motion, infinite where there is none with more orders.
    """
    change, largest = np.abs(finer[:, : channels.shape[1]] - channels).max(axis=1), np.abs(finer).max(axis=1)
    moving = largest > periodic_linear.ROUNDING * largest.max(axis=1, keepdims=True, initial=0.0)
    share = np.divide(change, largest, out=np.zeros_like(change), where=moving & np.isfinite(change))
    failed, lost = (np.isnan(Y).all(axis=(1, 2)) for Y in (channels, finer))
    return np.where(failed, 0.0, np.where(lost, np.inf, share.max(axis=1, initial=0.0)))


def _returning(setup: Setup, signals: Sequence[str] | None, base: float, p: np.ndarray) -> tuple[str, ...]:
    """Return the signals asked for; of those that the diagram records, the ones that return after one period.

    An angle grows from turn to turn. Raises RotorsimError where such a signal is asked for by name.
    """
    model = setup.model
    key = None if signals is None else tuple(signals)
    if key not in setup.returning:
        names = model.record_names(key)
        x = np.sin(1.0 + np.arange(setup.n_x)) * 1e-6
        turn = 2 * np.pi / base
        kept = []
        for name in names:
            first, then = (
                np.array(model.output((name,))(t, x, setup.z, p)).ravel()
                for t in (periodic_linear.PROBE * turn, (1 + periodic_linear.PROBE) * turn)
            )
            if np.all(np.abs(then - first) <= 1e-7 * (np.abs(first) + np.abs(then)).max(initial=0.0)):
                kept.append(name)
            elif key is not None:
                raise RotorsimError(
                    Problem(what="this signal does not return after one period: it has no harmonics", subject=name)
                )
        setup.returning[key] = tuple(kept)
    return setup.returning[key]


def _prepared(setup: Setup, names: tuple[str, ...]) -> _Outputs:
    model = setup.model
    known = _OUTPUTS.setdefault(model, {})
    if names in known:
        return known[names]
    if not names:
        raise RotorsimError(
            Problem(
                what="nothing to return: the diagram records no signal",
                subject=model.diagram.name,
                hint='add "record": ["rotor.displacement"] or name signals',
            )
        )
    channels: list[str] = []
    pairs: list[tuple[str, int]] = []
    units: dict[str, str] = {}
    for name in names:
        signal, _ = model.select(name)
        flat = linear.flat_names(model, name)
        shape = model.shape_of(name)
        if shape and shape[-1] == 2:
            for k in range(0, len(flat), 2):
                node = flat[k].rpartition(",")[0]
                pair = name if len(flat) == 2 else f"{node}]"
                pairs.append((pair, len(channels) + k))
                units[pair] = signal.unit or "1"
        channels += flat
        units.update(dict.fromkeys(flat, signal.unit or "1"))
    trace = model.trace
    column = model.closed(ca.vertcat(*[model.expression(name) for name in names]))
    jacobian = ca.jacobian(column, trace.x)
    arguments = [trace.t, trace.x, trace.z, trace.p]
    varying = ca.vertcat(trace.x, trace.t)
    is_linear = not ca.depends_on(jacobian, varying)
    at_rest = ca.substitute(column, trace.x, ca.SX.zeros(*trace.x.shape)) if is_linear else column
    speed = trace.p[np.flatnonzero(setup.speed_entries).tolist()]
    known[names] = _Outputs(
        names=names,
        channels=tuple(channels),
        pairs=tuple(pairs),
        is_linear=is_linear,
        matrix=MatrixFunction(arguments, jacobian),
        matrix_varies=bool(ca.depends_on(jacobian, speed)),
        constant=MatrixFunction(arguments, at_rest),
        timed=bool(ca.depends_on(at_rest, trace.t)),
        units=units,
    )
    return known[names]


def _evaluate(setup: Setup, outputs: _Outputs, base: np.ndarray, p: np.ndarray, motion: Motion) -> np.ndarray:
    """Return the coefficients of every channel at orders 0..H, shape (n, H+1, channels)."""
    X = motion.X
    n, count = X.shape[:2]
    z = setup.z
    if outputs.is_linear:
        few = p if outputs.matrix_varies else p[:1]
        C = outputs.matrix(0.0, np.zeros(setup.n_x), z, few.T)
        Y = X @ C.transpose(0, 2, 1)
        if outputs.timed:
            instants = setup.instants(base, max(2 * count, periodic_linear.FIRST_SAMPLES))
            m = instants.shape[1]
            flat = np.repeat(p, m, 0)
            y = outputs.constant(instants.reshape(1, -1), np.zeros(setup.n_x), z, flat.T)
            Y = Y + np.fft.rfft(y.reshape(n, m, -1), axis=1)[:, :count] / m
        elif len(outputs.constant.rows):
            Y[:, 0] += outputs.constant(0.0, np.zeros(setup.n_x), z, p.T)[:, :, 0]
        if motion.drifting:
            touched = np.any(C[:, :, motion.drifting] != 0, axis=(0, 2))
            Y[:, 0, touched] = np.nan
        return np.asarray(Y)
    m = max(8 * count, 128)
    Y = np.full((n, count, len(outputs.channels)), np.nan + 0j)
    instants = setup.instants(base, m)
    for j in range(n):
        if np.isfinite(X[j]).all():
            x = np.fft.irfft(X[j] * m, m, axis=0)
            y = outputs.constant(instants[j][None], x.T, z, p[j])[:, :, 0]
            Y[j] = np.fft.rfft(y, axis=0)[:count] / m
    if motion.drifting:
        touched = np.isin(outputs.matrix.columns, motion.drifting)
        Y[:, 0, np.unique(outputs.matrix.rows[touched])] = np.nan
    return Y


def _result(
    model: Model,
    outputs: _Outputs,
    speeds: np.ndarray,
    motion: Motion,
    Y: np.ndarray,
    error: np.ndarray,
    turns: int,
    parameters: Mapping[str, Any] | None,
) -> Periodic:
    conjugate = Y[:, :0:-1].conj()
    both = np.concatenate([conjugate, Y], axis=1)  # orders -H..H
    found: dict[str, np.ndarray] = {}
    for name, k in outputs.pairs:
        found[name] = both[:, :, k] + 1j * both[:, :, k + 1]
    found.update({name: both[:, :, k] for k, name in enumerate(outputs.channels)})
    H = Y.shape[1] - 1
    names = linear.state_names(model)
    drifting = tuple(names[k] for k in motion.seeds)
    text = f"; drifts: {', '.join(drifting)}" if drifting else ""
    return Periodic(
        speeds=speeds,
        orders=np.arange(-H, H + 1) if turns == 1 else np.arange(-H, H + 1) / turns,
        harmonics=found,
        units=outputs.units,
        status=tuple(s + text if s == "settled" else s for s in motion.status),
        stable=motion.stable,
        truncation=motion.truncation,
        truncation_error=error,
        drifting=drifting,
        counters=motion.counters,
        provenance={
            **linear.provenance(model, parameters, "periodic"),
            "method": motion.method,
            "harmonics": H,
            "turns": turns,
        },
    )
