"""What the runs of an ensemble share, and what tells them apart."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem, RotorsimError
from rotorsim.model.compiled import Model, compiled_in
from rotorsim.model.input_limits import input_limits
from rotorsim.simulation.ensemble.reductions import (
    KINDS,
    NUMBERS,
    OF_TURNS,
    ROWS_A_TURN,
    Rows,
    Wanted,
    chosen_reductions,
)
from rotorsim.simulation.ensemble.shared import Setup, recorded_columns
from rotorsim.simulation.run import LARGEST_RECORD, check_times

WINDOW_ROWS = 8  # rows
EVEN_INSTANTS = 32  # of a run, at which its shaft must have turned evenly
ANGLE_INSTANTS = 65  # of a window, at which the angle is looked at before


@dataclass(frozen=True, eq=False)
class Varied:
    """What tells n runs apart: parameters as given (texts, numbers), in SI, their units; p: of all runs (n, n_p)."""

    n: int
    given: Mapping[str, list[Any]]
    values: Mapping[str, np.ndarray]
    units: Mapping[str, str]
    p: np.ndarray


@dataclass(frozen=True)
class Given:
    """The arguments of `simulate_many` that all runs share."""

    stop: float | None
    step: float | None
    turns: float | None
    reduce: Iterable[str]
    window: tuple[float, float] | None
    record: Iterable[str] | None
    record_every: int | None
    method: str | None
    angle: str | None
    use_compiler: bool


def varied_values(model: Model, parameters: Mapping[str, Any], initial: np.ndarray | None) -> Varied:
    """Return what tells the runs apart. Raises RotorsimError with everything that is wrong."""
    if not isinstance(parameters, Mapping):
        raise RotorsimError(Problem("is no mapping of names to values", "parameters", hint="{'speed': [100.0, 200.0]}"))
    problems = []
    lists = {name: _each(values) for name, values in parameters.items()}
    sizes = {name: len(values) for name, values in lists.items() if len(values) != 1}
    if initial is not None:
        shape = np.shape(initial)
        if shape[-1:] != (model.n_x,) or len(shape) > 2:
            what = f"has shape {shape}; ({model.n_x},) or (runs, {model.n_x}) expected"
            problems.append(Problem(what, "initial"))
        elif not np.issubdtype(np.asarray(initial).dtype, np.number) or not np.isfinite(initial).all():
            problems.append(Problem("holds what is no finite number", "initial"))
        elif len(shape) == 2 and shape[0] != 1:
            sizes["initial"] = shape[0]
    n = max(sizes.values(), default=1)
    for name, size in sizes.items():
        if size != n or size == 0:
            problems.append(Problem(f"{size} values given, {n or 'some'} expected", name, hint="one for each run"))
    found: dict[str, np.ndarray] = {}
    units: dict[str, str] = {}
    for name, values in lists.items():
        problem = changes_structure(model.diagram, name)
        if problem is not None:
            problems.append(problem)
            continue
        try:
            vectors = [model.parameter_vector({name: value}) for value in values]
        except RotorsimError as error:
            problems += error.problems[:1]
            continue
        part = next(iter(model.positions(name).values()))
        if not len(part):
            what = "nothing in the diagram follows it: all runs would be the same"
            problems.append(Problem(what, name, hint=f"refer to it in a block: '${name}'"))
            continue
        array = np.array([vector[part] for vector in vectors])
        array = array[:, 0] if array.shape[1:] == (1,) else array
        found[name] = np.broadcast_to(array, (n, *array.shape[1:])) if len(array) == 1 else array
        units[name] = model.diagram.unit_of_parameter(name) or ""
    if problems:
        raise RotorsimError(*problems)
    lists = {name: values * n if len(values) == 1 else values for name, values in lists.items()}
    p = np.array([model.parameter_vector({name: values[k] for name, values in lists.items()}) for k in range(n)])
    return Varied(n, lists, found, units, p.reshape(n, model.n_p))


def _each(values: Any) -> list[Any]:
    """Return the values of a parameter, run by run, as plain data."""
    if isinstance(values, str) or np.ndim(values) == 0:
        return [values.item() if isinstance(values, np.generic) else values]
    return values.tolist() if isinstance(values, np.ndarray) else list(values)


def changes_structure(diagram: Diagram, name: str) -> Problem | None:
    """Return why a name cannot be varied within one ensemble, None where it can (or is unknown)."""
    base = name.partition("[")[0]
    block, _, key = base.rpartition(".")
    if block == "solver":
        return Problem("is the same for all runs of an ensemble", name, hint="the arguments step, stop, method")
    node = diagram.nodes.get(block)
    if node is not None and key in node.block.options:
        what = "is an option: another value makes other equations, which are not those of one ensemble"
        return Problem(what, name, hint=f"one ensemble for each: load(..., set={{'{name}': ...}}), or --set {name}=...")
    if base in diagram.structural:
        return compiled_in(base, diagram.structural[base])
    if name in diagram.nodes:
        hint = f"`rotorsim blocks {diagram.nodes[name].block.type_name}` lists its parameters"
        return Problem("is a block, not a parameter", name, hint=hint)
    return None


def make_setup(model: Model, varied: Varied, given: Given) -> tuple[Setup, np.ndarray]:
    """Return what all runs share, and the length of the step of each [s]. Raises RotorsimError."""
    solver = model.diagram.solver
    kinds = chosen_reductions([given.reduce] if isinstance(given.reduce, str) else given.reduce)
    every = solver.record_every if given.record_every is None else int(given.record_every)
    names = tuple(dict.fromkeys(model.record_names(given.record)))
    for name in names:
        model.select(name)
    if not kinds:
        raise RotorsimError(Problem("nothing is kept of the runs", "reduce", hint=f"one of {', '.join(KINDS)}"))
    of_turns = [kind for kind in OF_TURNS if kind in kinds]
    needed = [*of_turns, *(["turns"] if given.turns is not None else [])]
    theta = _angle_of(model, given.angle, needed) if needed or given.angle is not None else ""
    n_steps, steps, row, whole = _steps(model, varied, given, theta, every)
    n = n_steps // every + 1 if n_steps % every == 0 else -(-n_steps // every)
    rows = Rows(n, _window(n, row, given.window, whole, "s" if given.turns is None else "turns"))
    if kinds.get("envelope", 0) > n:
        what = f"{kinds['envelope']} parts of runs of {n} recorded rows: some would hold none"
        raise RotorsimError(Problem(what, "reduce: envelope", hint=f"envelope={min(n, NUMBERS['envelope'])}"))
    limits = input_limits(model.diagram, {name: varied.p[0][part] for name, part in model.parameters.items()})
    watched = tuple(dict.fromkeys((*names, *(str(item.source) for item in limits))))
    angle = theta if of_turns else ""
    columns = recorded_columns(model, watched, angle, "radius" in kinds)[1]
    if "radius" in kinds and not set(columns.radii) & set(names):
        hint = "a signal whose last dimension is [x, y]"
        raise RotorsimError(Problem("no recorded signal has two axes", "reduce: radius", hint=hint))
    points = _points(model, theta, varied.p, rows, every * steps, kinds) if of_turns else 0
    wanted = Wanted(kinds, rows, columns, names, points)
    _refuse_size(wanted, varied.n)
    method = (given.method or solver.method).lower()
    return Setup(model, names, angle, n_steps, every, method, wanted, given.use_compiler, bool(limits)), steps


def _steps(model: Model, varied: Varied, given: Given, theta: str, every: int) -> tuple[int, np.ndarray, float, float]:
    """Return the number of steps, their lengths [s] (n,), and a row and the whole run in s (with turns: in turns)."""
    solver = model.diagram.solver
    h = solver.step if given.step is None else float(given.step)
    if given.turns is None:
        whole = solver.stop if given.stop is None else float(given.stop)
        check_times(h, whole, every)
        n_steps, steps, row = max(math.ceil(whole / h - 1e-9), 1), np.full(varied.n, h), every * h
    else:
        if given.stop is not None:
            raise RotorsimError(Problem("stop and turns exclude each other", "turns", hint="give one of them"))
        whole = float(given.turns)
        turn = _turn(model, theta, varied.p)
        check_times(h, whole * float(turn.max()), every)
        _refuse_changing_speed(model, theta, varied.p, turn, whole)
        in_turn = math.ceil(float(turn.max()) / h - 1e-9)
        n_steps, steps, row = max(math.ceil(whole * in_turn - 1e-9), 1), turn / in_turn, every / in_turn
    if every > n_steps:
        what = f"every {every:.6g}th step of {n_steps} is recorded: nothing but the start"
        raise RotorsimError(Problem(what, "record_every", hint=f"at most {n_steps}, or longer runs"))
    return n_steps, steps, row, whole


def _window(n: int, row: float, window: tuple[float, float] | None, whole: float, unit: str) -> tuple[int, int]:
    """Return the first row of the window, and the one behind its last, of n rows that are ``row`` [unit] apart."""
    try:
        begin, end = map(float, window if window is not None else (whole / 2, whole))
    except (TypeError, ValueError):
        raise RotorsimError(Problem(f"{window}: is no pair of numbers", "window", hint="(from, to)")) from None
    if not 0 <= begin < end or end > whole * (1 + 1e-9):
        what = f"{begin:.6g} {unit} to {end:.6g} {unit} is no part of runs of {whole:.6g} {unit}"
        raise RotorsimError(Problem(what, "window", hint=f"for example {whole / 2:.6g} to {whole:.6g}"))
    first, last = math.ceil(begin / row - 1e-9), min(math.floor(end / row + 1e-9) + 1, n)
    if last - first < WINDOW_ROWS:
        what = f"{begin:.6g} {unit} to {end:.6g} {unit} holds {max(last - first, 0)} rows; at least {WINDOW_ROWS}"
        raise RotorsimError(Problem(what, "window", hint="a longer one, or more recorded rows"))
    return first, last


def _angle_of(model: Model, angle: str | None, needed: Sequence[str]) -> str:
    """Return the signal of the shaft angle. Raises RotorsimError where what is needed has none."""
    if angle is None:
        clocks = [name for name, node in model.diagram.nodes.items() if node.block.category == "clock"]
        angle = "clock.theta" if "clock" in clocks else f"{clocks[0]}.theta" if len(clocks) == 1 else None
    if angle is None:
        hint = "angle='clock.theta', a signal in rad"
        raise RotorsimError(Problem("needs the angle of a shaft; no single clock gives one", needed[0], hint=hint))
    if model.shape_of(angle) != () or model.select(angle)[0].unit != "rad":
        raise RotorsimError(Problem(f"'{angle}' is no single angle", "angle", hint="a scalar signal in rad"))
    if ca.depends_on(model.expression(angle), ca.vertcat(model.trace.x, model.trace.z)):
        what = f"'{angle}' depends on states: how often it turns is not known before"
        raise RotorsimError(Problem(what, "angle", hint="the angle of a clock"))
    return angle


def _angles(model: Model, theta: str, p: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Return the shaft angle [rad] of every run at its own time t (n,) [s]."""
    starts = [model.initial(one) for one in p]
    x, z = (np.array([start[k] for start in starts]).reshape(len(p), -1).T for k in (0, 1))
    return np.array(model.output((theta,))(t[None, :], x, z, p.T)).ravel()


def _turn(model: Model, theta: str, p: np.ndarray) -> np.ndarray:
    """Return how long a turn takes in every run [s], (n,). Raises RotorsimError where speeds are not constant."""
    speed = np.abs(_angles(model, theta, p, np.ones(len(p))) - _angles(model, theta, p, np.zeros(len(p))))
    if not (speed > 0).all():
        raise RotorsimError(Problem(f"run {int(np.argmin(speed)) + 1} does not turn", "turns", hint="use stop"))
    return np.asarray(2 * np.pi / speed)


def _refuse_changing_speed(model: Model, theta: str, p: np.ndarray, turn: np.ndarray, turns: float) -> None:
    """Raise RotorsimError where shafts do not turn evenly all through their runs."""
    first = _angles(model, theta, p, np.zeros(len(p)))
    for share in np.arange(1, EVEN_INSTANTS + 1) / EVEN_INSTANTS:
        turned = np.abs(_angles(model, theta, p, share * turns * turn) - first)
        if not (np.abs(turned - 2 * np.pi * share * turns) <= 1e-9 * turned).all():
            what = "the speed is not constant: turns differ in length"
            raise RotorsimError(Problem(what, "turns", hint="use stop"))


def _points(model: Model, theta: str, p: np.ndarray, rows: Rows, apart: np.ndarray, kinds: Mapping[str, int]) -> int:
    """Return how many turns a window holds at most, forward and back. Raises RotorsimError where one has too few rows.

    The angle is looked at at rows that are spread over the window, and at those behind them; what lies between is seen
    to as the runs go (`rotorsim.simulation.ensemble.verdicts`).
    """
    first, last = rows.window[0], rows.window[1] - 2
    spread = np.unique(np.linspace(first, last, min(ANGLE_INSTANTS, last - first + 1)).astype(int))
    angles = np.array([_angles(model, theta, p, row * apart) for row in (*spread, rows.window[1] - 1)])
    behind = np.array([_angles(model, theta, p, (row + 1) * apart) for row in spread])
    most = float(np.abs(behind - angles[:-1]).max())
    least = max(ROWS_A_TURN, 2 * kinds.get("harmonics", 0) + 2)
    if most * least > 2 * np.pi * (1 + 1e-9):
        kind = next(kind for kind in OF_TURNS if kind in kinds)
        what = f"a turn of the shaft has {2 * np.pi / most:.3g} recorded rows; at least {least} are needed"
        raise RotorsimError(Problem(what, kind, hint="a smaller record_every or step"))
    return math.ceil(1.01 * float(np.abs(np.diff(angles, axis=0)).sum(axis=0).max()) / (2 * np.pi)) + 2


def _refuse_size(wanted: Wanted, n: int) -> None:
    """Raise RotorsimError for values that would not fit into memory."""
    entries = sum(part.stop - part.start for part, _ in (wanted.columns.signals[name] for name in wanted.names))
    rows = {
        "history": wanted.rows.window[1] - wanted.rows.window[0],
        "poincare": wanted.points,
        "envelope": 2 * wanted.kinds.get("envelope", 0),
        "harmonics": 2 * wanted.kinds.get("harmonics", 0) + 2,
    }
    sizes = {kind: 8.0 * n * entries * rows.get(kind, 1) for kind in wanted.kinds}
    if sum(sizes.values()) > LARGEST_RECORD:
        kind = max(sizes, key=lambda name: sizes[name])
        what = f"the {kind} of {n} runs would take {sizes[kind] / 1e9:.3g} GB, at most 1 GB"
        hint = "a shorter window, a larger record_every, fewer signals or runs"
        raise RotorsimError(Problem(what, "reduce", hint=hint))
