"""Operating points and linearised state-space systems, from the exact Jacobians of the traced diagram."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any
from weakref import WeakKeyDictionary

import casadi as ca
import numpy as np

from rotorsim.block import Shape, size_of
from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem, RotorsimError
from rotorsim.linear.drift import drifting_entries, drifting_states
from rotorsim.linear.state_space import StateSpace
from rotorsim.model.compiled import Model, compile_diagram
from rotorsim.model.linearity import jacobian
from rotorsim.model.matrix_function import MatrixFunction

TURN_SAMPLES = 64  # instants for averages over one turn


@dataclass(frozen=True)
class LinearSystem(StateSpace):
    """The linear system of deviations from an operating point.

    states, inputs, outputs: flat names, one per entry. x: operating point (n,). notes: what the reader must know
    (averages, drifting states).
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    input_units: tuple[str, ...]
    output_units: tuple[str, ...]
    x: np.ndarray
    notes: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)


_WITH_INPUTS: WeakKeyDictionary[Model, dict[tuple[tuple[str, ...], tuple[str, ...]], Model]] = WeakKeyDictionary()


def as_model(diagram: Diagram | Model, inject: Sequence[str] = (), replace: Sequence[str] = ()) -> Model:
    """Return the model of a diagram with the external inputs that are asked for.

    A model that already has these external inputs is taken as it is; one made for a model is kept as long as that.
    """
    if not isinstance(diagram, Model):
        return compile_diagram(diagram, inject=inject, replace=replace)
    if not diagram.hidden and set(diagram.trace.external) >= {*inject, *replace}:
        return diagram
    known = _WITH_INPUTS.setdefault(diagram, {})
    asked = tuple(inject), tuple(replace)
    if asked not in known:
        known[asked] = compile_diagram(diagram.diagram, inject=inject, replace=replace)
    return known[asked]


def entry_names(name: str, shape: Shape) -> list[str]:
    """Return the flat names of a value's entries, row-major, counted from 1: ``name[2,1]``."""
    if not shape:
        return [name]
    return [f"{name}[{','.join(str(i + 1) for i in index)}]" for index in np.ndindex(*shape)]


def flat_names(model: Model, name: str) -> list[str]:
    """Return the flat names of the entries that a signal name (or a part of it) selects."""
    signal, positions = model.select(name)
    names = entry_names(signal.name, signal.shape)
    return [names[k] for k in positions]


def can_move(model: Model, name: str) -> bool:
    """Return whether an entry of a signal can be anything but zero (that of a pinned node cannot)."""
    expression = model.expression(name)
    return not (expression.is_constant() and float(expression) == 0.0)


def state_names(model: Model) -> tuple[str, ...]:
    """Return the flat names of the entries of x."""
    return tuple(name for state in model.states.values() for name in entry_names(state.name, state.shape))


def speed_of(model: Model, p: np.ndarray) -> float | None:
    """Return the shaft speed [rad/s] that p holds: the diagram parameter ``speed``; None without one."""
    mask = speed_entries(model)
    return float(p[mask][0]) if mask is not None and mask.any() else None


def speed_entries(model: Model) -> np.ndarray | None:
    """Return which entries of p follow the diagram parameter ``speed``, shape (n_p,); None without one."""
    if "speed" not in model.diagram.parameters:
        return None
    return np.asarray(model.parameter_vector({"speed": 1.0}) != model.parameter_vector({"speed": 2.0}))


def refuse_sampled(model: Model, what: str) -> None:
    """Raise RotorsimError if the diagram has sampled blocks, which ``what`` cannot treat."""
    if model.n_z:
        blocks = dict.fromkeys(name.rpartition(".")[0] for name in model.trace.discrete_states)
        raise RotorsimError(
            *(
                Problem(
                    what=f"{what} needs continuous blocks; this one has a sample time",
                    subject=block,
                    hint="`rotorsim swap` a continuous controller in, or use `rotorsim run`",
                )
                for block in blocks
            )
        )


_CACHE: WeakKeyDictionary[Model, dict[tuple[str, ...], dict[str, MatrixFunction]]] = WeakKeyDictionary()


def jacobians(model: Model, outputs: tuple[str, ...] = ()) -> dict[str, MatrixFunction]:
    """Return A, B, C, D as functions of (t, x, z, p); they are kept as long as the model lives."""
    known = _CACHE.setdefault(model, {})
    if outputs not in known:
        trace = model.trace
        arguments = [trace.t, trace.x, trace.z, trace.p]
        y = ca.vertcat(ca.SX(0, 1), *[model.expression(name) for name in outputs])
        made = {"A": MatrixFunction(arguments, lambda: model.jacobian_expression)}
        for key, of, by in (("B", trace.xdot, trace.v), ("C", y, trace.x), ("D", y, trace.v)):
            slopes = ca.substitute(jacobian(of, by), trace.v, ca.SX.zeros(*trace.v.shape))
            made[key] = MatrixFunction(arguments, slopes)
        known[outputs] = made
        if outputs:  # the same for all outputs
            known[outputs] |= {key: jacobians(model)[key] for key in "AB"}
    return known[outputs]


_VARYING: WeakKeyDictionary[Model, bool] = WeakKeyDictionary()


def _varies_in_time(model: Model) -> bool:
    """Return whether the Jacobian depends on time; looked at once, since expressions may be long."""
    if model not in _VARYING:
        _VARYING[model] = bool(ca.depends_on(model.jacobian_expression, model.trace.t))
    return _VARYING[model]


def require_finite(model: Model, A: np.ndarray) -> None:
    """Raise RotorsimError, with the blocks, where a Jacobian (..., n, n) has entries that are not finite."""
    bad = ~np.isfinite(A.reshape(-1, *A.shape[-2:])).all(axis=(0, 2))
    if bad.any():
        names = state_names(model)
        first = {model.block_of_state(k): names[k] for k in np.flatnonzero(bad).tolist()[::-1]}
        hint = "a parameter is out of all proportion: a mass, density or time constant of nearly nothing"
        problems = [Problem(f"the rate of {name} has no finite derivatives", b, hint=hint) for b, name in first.items()]
        raise RotorsimError(*problems[::-1])


def equilibrium(
    model: Diagram | Model,
    p: np.ndarray | None = None,
    t: float | None = 0.0,
    *,
    start: np.ndarray | None = None,
    hold_drifting: bool = False,
) -> np.ndarray:
    """Return the state x (n_x,) at which dx/dt(t, x) = 0, by Newton's method with the exact Jacobian.

    t: instant at which explicit time is frozen; None averages dx/dt over one turn of the diagram
    parameter ``speed``. hold_drifting: states that nothing depends on, such as the integral of a controller
    whose bearing is cut, keep their start value; otherwise they are an error.

    Raises RotorsimError when there is no equilibrium, with the block of the largest residual.
    """
    model = as_model(model)
    p = model.p0 if p is None else p
    times = _instants(model, p) if t is None else np.array([t])
    x = (model.x0(p) if start is None else np.asarray(start, float)).copy()
    z, many = model.z0(p), np.repeat(p[None], len(times), 0)
    jacobian = jacobians(model)["A"]
    names = state_names(model)

    def rates(at: np.ndarray) -> np.ndarray:
        return model.rhs_batch(times, np.repeat(at[None], len(times), 0), z, many)

    def evaluate(at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        points = np.repeat(at[None], len(times), 0)
        return rates(at).mean(axis=0), jacobian(times[None, :], points.T, z, p).mean(axis=0)

    forced = np.abs(rates(np.zeros_like(x))).mean(axis=0)  # what cancels over the turn, and against the springs

    f, A = evaluate(x)
    require_finite(model, A)
    seeds, held = drifting_states(A) if hold_drifting or len(x) else ([], [])
    if seeds and not hold_drifting:
        raise RotorsimError(
            *(
                Problem(
                    what="no equilibrium: nothing returns this state, it may take any value or drift",
                    subject=names[k],
                    hint="wire what it acts on, or remove its block",
                )
                for k in seeds
            )
        )
    free = np.setdiff1d(np.arange(len(x)), held)
    for _ in range(50):
        try:
            step = np.linalg.solve(A[np.ix_(free, free)], -f[free])
            if _is_rounding(step, A[np.ix_(free, free)], x[free], forced[free]):
                x[free] += step
                return x
        except np.linalg.LinAlgError:
            break
        x, f, A, done = _damped_step(evaluate, x, f, step, free)
        if done:
            return x
    worst = int(free[np.argmax(np.where(np.isfinite(f[free]), np.abs(f[free]), np.inf))]) if len(free) else 0
    raise RotorsimError(
        Problem(
            what=f"no equilibrium found: the rate of {names[worst]} stays at {f[worst]:.3g}",
            subject=model.block_of_state(worst),
            hint="start nearer (initial values of the blocks), or check that static forces can be carried",
        ),
        exit_code=1,
    )


def _is_rounding(step: np.ndarray, A: np.ndarray, x: np.ndarray, forced: np.ndarray) -> bool:
    """Return whether a Newton step is what rounding of the terms that cancel in f = A x + forced leaves.

    |step| <= 1e-13 | |A^-1| (|A| |x| + |forced|) |, largest entries of balanced states: a state that an integral
    action holds at zero has no size of its own. Source: Higham, Accuracy and Stability (2002), sec. 7.2, 25.2.
    """
    from scipy.linalg import matrix_balance  # as in `drifting_states`

    balanced, (scale, _) = matrix_balance(A, permute=False, separate=True)
    terms = np.abs(balanced) @ np.abs(x / scale) + forced / scale
    reach = np.abs(np.linalg.inv(balanced)) @ terms
    return bool(np.abs(step / scale).max(initial=0.0) <= 1e-13 * reach.max(initial=0.0))


def _damped_step(
    evaluate: Any, x: np.ndarray, f: np.ndarray, step: np.ndarray, free: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, bool]:
    """Return the point after one Newton step, shortened until the residual falls, and whether it is the last."""
    scale = np.abs(f[free]).max(initial=0.0)
    length = 1.0
    while True:
        new = x.copy()
        new[free] += length * step
        g, A = evaluate(new)
        small = bool(np.all(np.abs(step) <= 1e-12 * np.abs(new[free]) + 1e-300))
        lower = bool(np.isfinite(g).all()) and np.abs(g[free]).max(initial=0.0) < scale
        if small or lower or length < 1e-4 or scale == 0.0:
            rounding = np.abs(A[np.ix_(free, free)]) @ np.abs(new[free])
            flat = bool(np.all(np.abs(g[free]) <= 1e-13 * rounding + 1e-300))
            return new, g, A, bool(np.isfinite(g).all()) and (small or flat)
        length /= 2


def _instants(model: Model, p: np.ndarray) -> np.ndarray:
    """Return instants over one turn; one instant where nothing depends on time."""
    if not ca.depends_on(model.trace.xdot, model.trace.t):
        return np.zeros(1)
    speed = speed_of(model, p)
    if speed is None or speed == 0.0:
        return np.zeros(1)
    return np.arange(TURN_SAMPLES) * (2 * math.pi / abs(speed) / TURN_SAMPLES)


def linearise(
    diagram: Diagram | Model,
    *,
    parameters: Mapping[str, Any] | None = None,
    inputs: Sequence[str] = ("controller.current",),
    outputs: Sequence[str] = ("rotor.displacement",),
    at: np.ndarray | None = None,
    open_loop: bool = False,
    told: bool = True,
) -> LinearSystem:
    """Return the linear system between external inputs and signals at an operating point.

    d x/dt = A x + B u, y = C x + D u, from exact Jacobians. inputs: output ports to whose value u is added
    for all consumers; with open_loop u replaces the value, which opens the loop there. outputs: signals, or
    parts of them (a port's own value, without u). at: operating point x; None takes the equilibrium of the
    mean over one turn (a linear diagram needs none). Explicit time in the forcing is dropped; a Jacobian that
    depends on time is averaged over one turn, and a note says so. told: False does not look for drifting states to
    tell in notes, which takes longer than the matrices.

    Raises RotorsimError for sampled blocks, unknown signals and where there is no operating point.
    """
    ports = tuple(inputs)
    model = as_model(diagram, *(((), ports) if open_loop else (ports, ())))
    refuse_sampled(model, "linearise")
    p = model.parameter_vector(parameters)
    notes: list[str] = []
    z = model.z0(p)
    if at is None:
        x = model.x0(p) if model.linear else equilibrium(model, p, None, hold_drifting=True)
    else:
        x = np.asarray(at, float).ravel()
        if x.shape != (model.n_x,):
            raise RotorsimError(Problem(what=f"operating point has {x.size} entries, {model.n_x} expected"))
    made = jacobians(model, tuple(outputs))
    times = np.zeros(1)
    if _varies_in_time(model):
        times = _instants(model, p)
        how = "averaged over one turn" if len(times) > 1 else "taken at t = 0"
        notes.append(f"the Jacobian depends on time and was {how}; parametric resonance is not seen")
    given = [model.trace.external[port] for port in ports]
    columns = [k for u in given for k in np.arange(model.trace.v.numel())[u.part]]
    with np.errstate(all="ignore"):
        values = {key: f(times[None, :], x, z, p).mean(axis=0) for key, f in made.items()}
    require_finite(model, values["A"])
    values["B"], values["D"] = values["B"][:, columns], values["D"][:, columns]
    labels = _labels(model, ports, tuple(outputs))
    if told:
        notes += [f"{name} has a pole at zero: nothing returns it" for name in drifting_entries(model, values["A"])]
    made_from = provenance(model, parameters, "linearise")
    return LinearSystem(**values, **labels, x=x, notes=tuple(notes), provenance=made_from)


_LABELS: WeakKeyDictionary[Model, dict[tuple[tuple[str, ...], tuple[str, ...]], dict[str, Any]]] = WeakKeyDictionary()


def _labels(model: Model, ports: tuple[str, ...], outputs: tuple[str, ...]) -> dict[str, Any]:
    """Return names and units of a linear system, made once: at hundreds of speeds they take as long as its matrices."""
    known = _LABELS.setdefault(model, {})
    if (ports, outputs) not in known:
        given = [model.trace.external[port] for port in ports]
        known[ports, outputs] = {
            "states": state_names(model),
            "inputs": tuple(name for u in given for name in entry_names(u.name, u.shape)),
            "outputs": tuple(name for output in outputs for name in flat_names(model, output)),
            "input_units": tuple(unit for u in given for unit in given_units(model, u)),
            "output_units": units_of(model, outputs),
        }
    return known[ports, outputs]


def given_units(model: Model, given: Any) -> tuple[str, ...]:
    """Return the unit of each entry of an external input."""
    signal = model.select(given.name)[0] if given.name in model.signals else given
    return (signal.unit or "1",) * size_of(given.shape)


def units_of(model: Model, names: Sequence[str]) -> tuple[str, ...]:
    """Return the unit of each entry of signals."""
    found = [model.select(name) for name in names]
    return tuple(signal.unit or "1" for signal, positions in found for _ in positions)


def provenance(model: Model, parameters: Mapping[str, Any] | None, analysis: str) -> dict[str, Any]:
    """Return what a result came from: diagram, values that were set, and the analysis."""
    given = {
        name: value if isinstance(value, str) else np.asarray(value, float).tolist()
        for name, value in (parameters or {}).items()
    }
    return {"diagram": model.diagram.name, "file": model.diagram.file, "set": given, "analysis": analysis}
