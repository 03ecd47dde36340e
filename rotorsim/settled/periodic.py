"""Settled periodic motion at one or many speeds: direct for linear diagrams, harmonic balance for the rest."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from importlib import import_module
from typing import Any
from weakref import WeakKeyDictionary

import casadi as ca
import numpy as np

from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem, RotorsimError
from rotorsim.linear import linearisation as linear
from rotorsim.linear.drift import shift_of, shifts
from rotorsim.linear.modes.eigenmodes import checked_speeds, require_speed
from rotorsim.model.compiled import Model, model_for_runs
from rotorsim.model.input_limits import input_limits, passed_limit
from rotorsim.model.linearity import jacobian
from rotorsim.model.matrix_function import MatrixFunction
from rotorsim.settled.balance import harmonics_of, samples_of
from rotorsim.settled.continuation import Orbits, Settings, Setup, orbits
from rotorsim.settled.equations import FIRST_SAMPLES, instants, without_inputs
from rotorsim.settled.forcing import PROBE, ZERO_COEFFICIENT
from rotorsim.settled.result import Periodic

__all__ = ["Channels", "Periodic", "periodic", "settled_start"]

START_TOLERANCE = 1e-10  # size of the harmonics left out of a settled start, which are its transient
COUPLED_PERIODIC = "rotorsim.cosim.coupled_periodic"  # a room above this one: imported where parts hide their equations


class _Setup(Setup):
    """What periodic motion needs of a model, and the signals that were asked for before."""

    def __init__(self, model: Model) -> None:
        super().__init__(model)
        self.returning: dict[tuple[str, ...] | None, tuple[str, ...]] = {}
        self.outputs: dict[tuple[str, ...], _Outputs] = {}


_SETUPS: WeakKeyDictionary[Model, _Setup] = WeakKeyDictionary()


def periodic(
    diagram: Diagram | Model,
    *,
    speeds: Sequence[float | str] | np.ndarray | None = None,
    parameters: Mapping[str, Any] | None = None,
    harmonics: int | None = None,
    signals: Sequence[str] | None = None,
    subharmonic: int = 1,
    stability: bool = True,
    tolerance: float = 1e-8,
    progress: Callable[[float], None] | None = None,
) -> Periodic:
    """Return the settled periodic motion at one or many speeds [rad/s] (the diagram parameter ``speed``).

    Linear diagrams, d x/dt = A x + f(t): X_k = (i k W I - A)^-1 F_k, with F_k the Fourier coefficients of
    dx/dt at x = 0 over one period, sampled finely enough, or integrated piecewise between the instants where it
    jumps. Others: harmonic balance with alternating frequency/time. Default speeds: the diagram's own.
    harmonics: number H of orders kept; default as many as the motion has. signals: what is returned; default
    what the diagram records. subharmonic: the period in turns. stability: examine whether the motion is stable
    (eigenvalues of A, or Floquet multipliers). tolerance: relative size of the harmonics left out.
    progress: is told the share that is done, of harmonic balance, which goes speed by speed.

    With sampled blocks the diagram must be linear; harmonics are then exact, and what sampling adds beside them is in
    ``images``, see `rotorsim.settled.sampled_motion`.
    Where a part hides its equations the diagram is co-simulated, and the motion extrapolated to where it settles.

    A speed at which no solution is found says so in ``status`` and leaves the others as they are.

    Raises RotorsimError for sampled blocks in a diagram that is not linear, motion that is not periodic (a ramp,
    another period), wrong names.
    Source: Cameron & Griffin, J. Appl. Mech. 56 (1989) 149-154; Krack & Gross, Harmonic Balance for Nonlinear
    Vibration Problems (2019), ch. 2-4.
    """
    model = model_for_runs(diagram, called=False)
    if not model.hidden:
        model = linear.as_model(model)
    require_speed(model, "periodic")
    if subharmonic < 1 or (harmonics is not None and harmonics < 1):
        raise RotorsimError(Problem(what="subharmonic and harmonics must be at least 1", subject="periodic"))
    p0 = model.parameter_vector(parameters)
    own = linear.speed_of(model, p0)
    if speeds is None and not own:
        what = "the diagram's own speed is zero: there is no turn to be periodic in"
        raise RotorsimError(
            Problem(what=what, subject="speed", hint="give speeds, and a clock that does not accelerate")
        )
    values = checked_speeds([own or 0.0] if speeds is None else speeds, zero=False)
    p = np.repeat(p0[None], len(values), 0)
    p[:, linear.speed_entries(model)] = values[:, None]
    if model.hidden:
        coupled = import_module(COUPLED_PERIODIC).periodic_coupled
        found: Periodic = coupled(model, signals, values, p, parameters, harmonics=harmonics, subharmonic=subharmonic)
        return found
    setup = _SETUPS.get(model) or _SETUPS.setdefault(model, _Setup(model))

    base = values / subharmonic
    names = _returning(setup, signals, float(base[0]), p[0])
    if model.n_z:
        given = [{**(parameters or {}), "speed": float(speed)} for speed in values]
        return _sampled(model, Channels(model, names), values, subharmonic, given, harmonics, stability, progress)
    outputs = setup.outputs.get(names) or setup.outputs.setdefault(names, _Outputs(model, names))
    motion = orbits(setup, base, p, Settings(harmonics, tolerance, stability, progress))
    _refuse_beyond_limits(setup, base, p, motion)
    channels = outputs.along(motion.X, setup, base, p, motion.drifting)
    error = np.zeros(len(values))
    if motion.finer is not None:
        error = _change(channels, outputs.along(motion.finer, setup, base, p, motion.drifting))
    both = np.concatenate([channels[:, :0:-1].conj(), channels], axis=1)  # orders -H..H
    H = channels.shape[1] - 1
    state_names = linear.state_names(model)
    drifting = tuple(state_names[k] for k in motion.seeds)
    text = f"; drifts: {', '.join(drifting)}" if drifting else ""
    return Periodic(
        speeds=values,
        orders=np.arange(-H, H + 1) if subharmonic == 1 else np.arange(-H, H + 1) / subharmonic,
        harmonics=outputs.channels.signals(both),
        units=outputs.channels.units,
        status=tuple(said + text if said == "settled" else said for said in motion.status),
        stable=motion.stable,
        truncation=motion.truncation,
        truncation_error=error,
        drifting=drifting,
        counters=motion.counters,
        provenance={
            **linear.provenance(model, parameters, "periodic"),
            "method": motion.method,
            "harmonics": H,
            "turns": subharmonic,
        },
    )


def _sampled(
    model: Model,
    channels: Channels,
    speeds: np.ndarray,
    turns: int,
    given: Sequence[Mapping[str, Any]],
    harmonics: int | None,
    stability: bool,
    progress: Callable[[float], None] | None,
) -> Periodic:
    """Return the motion of a linear diagram with sampled blocks."""
    from rotorsim.settled.sampled_motion import sampled_motion  # loads matrix functions of SciPy

    motion = sampled_motion(
        model,
        channels.names,
        speeds / turns,
        given,
        channels.signals,
        harmonics=harmonics,
        stability=stability,
        progress=progress,
    )
    H, none = motion.Y.shape[1] - 1, np.zeros(len(speeds))
    text = f"; drifts: {', '.join(motion.drifting)}" if motion.drifting else ""
    return Periodic(
        speeds=speeds,
        orders=np.arange(-H, H + 1) / (turns if turns > 1 else 1),
        harmonics=channels.signals(np.concatenate([motion.Y[:, :0:-1].conj(), motion.Y], axis=1)),
        units=channels.units,
        status=tuple(said + text if said.startswith("settled") else said for said in motion.status),
        stable=motion.stable,
        truncation=motion.truncation,
        truncation_error=none,
        drifting=motion.drifting,
        counters={"samples": motion.samples},
        provenance={
            **linear.provenance(model, given[0], "periodic"),
            "method": "sampled",
            "harmonics": H,
            "turns": turns,
        },
        largest_values=motion.largest,
        images=motion.images,
    )


def settled_start(diagram: Diagram | Model, *, parameters: Mapping[str, Any] | None = None) -> np.ndarray:
    """Return the states (n_x,) of the settled periodic motion at t = 0: a run from there has no transient.

    With sampled blocks (n_x + n_z,): theirs, before their hit at t = 0, stand behind; the diagram must be linear. Of
    the diagram's own speed. States that nothing returns are where a run from the start of the diagram would have
    brought them, see `start_of`.

    Raises RotorsimError as `periodic`, where no settled motion is found, and where it is not stable.
    """
    model = model_for_runs(diagram, called=False)
    if model.hidden:
        what = "a part hides its equations: the states of its settled motion are not known"
        raise RotorsimError(Problem(what, model.diagram.name, hint="run it until it has settled"))
    model = linear.as_model(model)
    require_speed(model, "a settled start")
    p = model.parameter_vector(parameters)
    speed = linear.speed_of(model, p)
    if not speed:
        hint = "give a speed, and a clock that does not accelerate"
        raise RotorsimError(Problem("its speed is zero: there is no turn to be periodic in", "speed", hint=hint))
    if model.n_z:
        from rotorsim.settled.sampled_motion import sampled_start  # loads matrix functions of SciPy

        return sampled_start(model, abs(speed), parameters)
    setup = _SETUPS.get(model) or _SETUPS.setdefault(model, _Setup(model))
    _returning(setup, None, abs(speed), p)
    motion = orbits(setup, np.array([abs(speed)]), p[None], Settings(None, START_TOLERANCE, True))
    _refuse_beyond_limits(setup, np.array([abs(speed)]), p[None], motion)
    if motion.status[0].startswith("failed"):
        raise RotorsimError(Problem(f"no settled motion: {motion.status[0]}", model.diagram.name), exit_code=1)
    if motion.stable[0] is False:
        what = "its settled motion is not stable: no run stays there"
        raise RotorsimError(Problem(what, model.diagram.name, hint="`rotorsim modes` shows what grows"), exit_code=1)
    return start_of(model, motion, p, parameters)


def start_of(model: Model, motion: Orbits, p: np.ndarray, parameters: Mapping[str, Any] | None = None) -> np.ndarray:
    """Return the states (n_x,) at t = 0 of the first of some settled motions of a model.

    With states that drift, such as a shaft angle or an integrator without feedback, it stays one when it is shifted by
    N c, A N = 0. Of a linear diagram W' x returns after each turn, W' A = 0, but for what grows from turn to turn:
    c is that with which it is what the diagram starts with, where one is. A free body, of which none is, has no mean
    displacement.
    """
    X = np.nan_to_num(motion.X[0], nan=0.0)
    x = np.asarray(X[0].real + 2 * X[1:].real.sum(axis=0))
    if not motion.drifting:
        return x
    A = linear.linearise(model, parameters=parameters, inputs=(), outputs=(), at=X[0].real, told=False).A
    N, W = shifts(A)
    return np.asarray(x + shift_of(W.T @ (model.x0(p) - x), N, W))


def _refuse_beyond_limits(setup: Setup, base: np.ndarray, p: np.ndarray, motion: Orbits) -> None:
    """Fail the speeds at which an input of a block passes the magnitude below which its equations hold."""
    model = setup.model
    m = max(8 * motion.X.shape[1], 128)
    for j, times in enumerate(instants(base, m)):
        limits = input_limits(model.diagram, {name: p[j][part] for name, part in model.parameters.items()})
        names = list(dict.fromkeys(str(item.source) for item in limits))
        if not names or not np.isfinite(motion.X[j]).all():
            continue
        x = samples_of(motion.X[j : j + 1], m)[0]
        columns = {name: np.array(model.output((name,))(times[None], x.T, setup.z, p[j])).T for name in names}
        signals = {name: column.reshape(m, *model.shape_of(name)) for name, column in columns.items()}
        too_far = passed_limit(limits, times, signals)
        if too_far:
            motion.status[j] = f"failed: {too_far}"
            motion.X[j] = np.nan


def _change(channels: np.ndarray, finer: np.ndarray) -> np.ndarray:
    """Return the largest change of harmonics by more orders, relative to the largest, worst channel, (n,).

    Zero where there is no motion, infinite where there is none with more orders.
    """
    change, largest = np.abs(finer[:, : channels.shape[1]] - channels).max(axis=1), np.abs(finer).max(axis=1)
    moving = largest > ZERO_COEFFICIENT * largest.max(axis=1, keepdims=True, initial=0.0)
    share = np.divide(change, largest, out=np.zeros_like(change), where=moving & np.isfinite(change))
    failed, lost = (np.isnan(Y).all(axis=(1, 2)) for Y in (channels, finer))
    return np.where(failed, 0.0, np.where(lost, np.inf, share.max(axis=1, initial=0.0)))


def _returning(setup: _Setup, signals: Sequence[str] | None, base: float, p: np.ndarray) -> tuple[str, ...]:
    """Return the signals asked for; of those that the diagram records, the ones that return after one period.

    An angle grows from turn to turn. Raises RotorsimError where such a signal is asked for by name.
    """
    model = setup.model
    key = None if signals is None else tuple(signals)
    if key not in setup.returning:
        names = model.record_names(key)
        x = np.sin(1.0 + np.arange(model.n_x)) * 1e-6
        turn = 2 * np.pi / base
        kept = []
        for name in names:
            first, then = (
                np.array(model.output((name,))(t, x, setup.z, p)).ravel() for t in (PROBE * turn, (1 + PROBE) * turn)
            )
            if np.all(np.abs(then - first) <= 1e-7 * (np.abs(first) + np.abs(then)).max(initial=0.0)):
                kept.append(name)
            elif key is not None:
                raise RotorsimError(
                    Problem(what="this signal does not return after one period: it has no harmonics", subject=name)
                )
        setup.returning[key] = tuple(kept)
    return setup.returning[key]


class Channels:
    """The entries of signals, one behind the other, and which of them are x and y of a signal with two axes.

    names: flat names; pairs: name of a two-axis signal -> place of its first channel; units: of both.
    """

    def __init__(self, model: Model, names: Sequence[str]) -> None:
        if not names:
            raise RotorsimError(
                Problem(
                    what="nothing to return: the diagram records no signal",
                    subject=model.diagram.name,
                    hint='add "record": ["rotor.displacement"] or name signals',
                )
            )
        self.names: list[str] = []
        self.pairs: dict[str, int] = {}
        self.units: dict[str, str] = {}
        for name in names:
            unit = model.select(name)[0].unit or "1"
            flat = linear.flat_names(model, name)
            shape = model.shape_of(name)
            if shape and shape[-1] == 2:
                for k in range(0, len(flat), 2):
                    pair = name if len(flat) == 2 else f"{flat[k].rpartition(',')[0]}]"
                    self.pairs[pair], self.units[pair] = len(self.names) + k, unit
            self.names += flat
            self.units.update(dict.fromkeys(flat, unit))

    def signals(self, both: np.ndarray) -> dict[str, np.ndarray]:
        """Return harmonics by name from those of the channels at orders -H..H, (n, 2H+1, channels)."""
        return {
            **{name: both[:, :, k] + 1j * both[:, :, k + 1] for name, k in self.pairs.items()},
            **{name: both[:, :, k] for k, name in enumerate(self.names)},
        }


class _Outputs:
    """Signals as functions of the states: y = C x + y0(t) where they are linear, else y(t, x)."""

    def __init__(self, model: Model, names: tuple[str, ...]) -> None:
        self.model, self.channels = model, Channels(model, names)
        self._y = without_inputs(model, ca.vertcat(*[model.expression(name) for name in names]))

    def _function(self, expression: Any) -> MatrixFunction:
        trace = self.model.trace
        return MatrixFunction([trace.t, trace.x, trace.z, trace.p], expression)

    @cached_property
    def _linear(self) -> bool:
        trace = self.model.trace
        return not ca.depends_on(jacobian(self._y, trace.x), ca.vertcat(trace.x, trace.t))

    @cached_property
    def _matrix(self) -> MatrixFunction:
        return self._function(jacobian(self._y, self.model.trace.x))

    @cached_property
    def _values(self) -> MatrixFunction:
        return self._function(self._y)

    def along(
        self, X: np.ndarray, setup: Setup, base: np.ndarray, p: np.ndarray, drifting: Sequence[int]
    ) -> np.ndarray:
        """Return the coefficients of every channel at orders 0..H of motions X (n, H+1, n_x), (n, H+1, channels)."""
        n, count, n_x = X.shape
        if self._linear:
            C = self._matrix(0.0, np.zeros(n_x), setup.z, p.T)
            m = max(2 * count, FIRST_SAMPLES)
            y = self._values(instants(base, m).reshape(1, -1), np.zeros(n_x), setup.z, np.repeat(p, m, 0).T)
            Y = X @ C.transpose(0, 2, 1) + harmonics_of(y.reshape(n, m, -1), count - 1)
        else:
            m = max(8 * count, 128)
            Y = np.full((n, count, len(self.channels.names)), np.nan + 0j)
            for j, times in enumerate(instants(base, m)):
                if np.isfinite(X[j]).all():
                    y = self._values(times[None], samples_of(X[j : j + 1], m)[0].T, setup.z, p[j])
                    Y[j] = harmonics_of(y[None, :, :, 0], count - 1)[0]
            C = np.zeros((1, len(self.channels.names), n_x))
            C[:, self._matrix.rows, self._matrix.columns] = 1.0
        Y[:, 0, np.any(C[:, :, drifting] != 0, axis=(0, 2))] = np.nan
        return np.asarray(Y)
