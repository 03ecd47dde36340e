"""Co-simulate a diagram: compiled parts and FMUs side by side, exchanging signals at communication points."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from rotorsim.cosim.coupling import Coupling
from rotorsim.cosim.cut import couple, open_coupling, sources_of
from rotorsim.cosim.fmu_participant import FmuParticipant
from rotorsim.cosim.loop import FastLoop
from rotorsim.cosim.masters import Master, held_mismatch, make_master
from rotorsim.cosim.participant import CompiledParticipant
from rotorsim.cosim.stability import CouplingStability, coupling_stability, why_not_linear
from rotorsim.cosim.waveform import relaxed
from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem, RotorsimError
from rotorsim.fmi.runtime.failure import FmuError
from rotorsim.fmi.runtime.instance import is_finite
from rotorsim.fmi.runtime.model_exchange import ModelExchange
from rotorsim.model.input_limits import input_limits, passed_limit
from rotorsim.simulation.result import Result
from rotorsim.simulation.validity import growth_rate

__all__ = ["cosimulate", "cosimulate_diagram", "couple", "open_coupling", "sources_of"]

LARGEST_ADAPTIVE = 100  # the adaptive step over the one given
EXPLODED = 1e3  # times larger in the last eighth than in the first, and still growing: an integral of t^2 is 64 times


def cosimulate_diagram(
    diagram: Diagram,
    groups: Sequence[Iterable[str]] = (),
    *,
    step: float,
    stop: float | None = None,
    parameters: Mapping[str, Any] | None = None,
    log: Callable[[str, float, str, str, str], None] | None = None,
    **settings: Any,
) -> Result:
    """Open the FMUs of a diagram, co-simulate it, and close them; settings as for `cosimulate`.

    log: gets block, time [s], status, category and text of every message of an FMU.
    """
    coupling = open_coupling(diagram, groups, stop=stop, parameters=parameters, log=log)
    try:
        return cosimulate(coupling, diagram, step=step, stop=stop, **settings)
    finally:
        coupling.close()


def cosimulate(
    coupling: Coupling,
    diagram: Diagram,
    *,
    step: float,
    stop: float | None = None,
    master: str = "gauss_seidel",
    order: int | None = None,
    tolerance: float = 1e-8,
    adaptive: float | None = None,
    check: bool = False,
    fast: bool = False,
    rates: Mapping[str, int] | None = None,
    solver: str = "rk4",
    progress: Callable[[float], None] | None = None,
) -> Result:
    """Advance the participants from 0 to stop with communication steps; return the outputs at these points.

    The result also holds ``coupling.error``: per step, how far inputs were from what the outputs then asked for.
    Sampled signals are held whatever the order, and sample hits that participants tell are communication points too.

    step: communication step [s]. adaptive: relative error allowed per step; the step is then halved or doubled as step
    doubling says (every participant must be able to step back). rates: participant, or a block in it -> how many steps
    it takes at once; its outputs are extrapolated in between. A participant that fails or a signal that leaves
    the finite numbers ends the run; what was found until then is kept, with status and message. check: refuse a step
    with which the linearised loop is unstable though the loop as a whole is stable. fast: the plain loop in C, inputs
    held and outputs taken as each participant left them (no sweeps through direct feedthrough), for FMUs for
    Co-Simulation.
    solver: of the states of FMUs for Model Exchange: "rk4" with the steps of the run, or "radau", "bdf", "lsoda"
    (implicit), "dop853", "rk45" with steps of their own. Where RK4 is unstable at the poles of such an FMU, or the
    linearised loop is unstable as a whole and the motion grows, the run ends with status "diverged" or "unstable".
    """
    end = diagram.solver.stop if stop is None else stop
    every = coupling.rates_of(rates or {})
    _refuse(coupling, master, order, adaptive, fast, every)
    exchanging = [p.integrator for p in coupling.participants if isinstance(p, FmuParticipant) and p.integrator]
    for integrator in exchanging:
        integrator.method = solver
    _refuse_rigid(coupling, step, end, adaptive, every)
    if master == "waveform" and 0 < step <= end:
        found = _by_waveform(coupling, diagram, step, end, tolerance, progress)
        every_signal = np.column_stack([values.reshape(len(found.time), -1) for values in found.signals.values()])
        status, message = _judged(
            diagram, exchanging, _Told(step, master), found.time, every_signal, found.status, found.message
        )
        return replace(found, status=status, message=message)
    if not 0 < step <= end:
        what = f"communication step {step:g} s is not between 0 and the stop time {end:g} s"
        raise RotorsimError(Problem(what, hint="give one that is positive and no longer than the run"))
    worker = make_master(master, coupling, order=order, tolerance=tolerance, rates=every)
    if master == "iterative":  # it finds rates by very short steps that are taken back, also at the end
        for participant in coupling.participants:
            if isinstance(participant, FmuParticipant):
                participant.stop = None
    mismatch = [0.0]
    times, rows = [0.0], []
    status, message = "finished", ""
    y = worker.start(0.0)[1]
    rows.append(y)
    told = _Told(step, master, order, {name: int(n) for name, n in (rates or {}).items()})
    if check and adaptive is None:
        told.look(coupling, every)
    elif check:
        told.why_not = "the step adapts itself"
    plain = adaptive is None and worker.simplify()
    if fast:
        return _fast(coupling, diagram, step, end, worker, rows[0], told, progress)
    if plain and _may_be_fast(coupling, step, end):
        most = len(coupling.u0) + 2 if coupling.passes else 0
        return _fast(coupling, diagram, step, end, worker, rows[0], told, progress, most)
    t, count, width = 0.0, 0, step
    while t < end - 1e-9 * step:
        try:
            if adaptive is None:
                count += 1
                target = min(count * step, end)
                y = worker.advance(t, target, last=target >= end - 1e-9 * step)[1]
            else:
                target, y, width = _doubled(worker, t, min(width, end - t), adaptive, step)
        except RotorsimError as error:
            status, message = _stopped(error)
            if (last := _last_sample(coupling, worker, error, t)) is not None:
                times, rows, mismatch = _with_last(times, rows, mismatch, *last)
            break
        t = target
        times.append(t)
        rows.append(y)
        mismatch.append(worker.mismatch)
        if not is_finite(y):
            status, message = _diverged(coupling, y, t)
            break
        if progress is not None:
            progress(t / end)
    if status in ("finished", "diverged"):
        status, message = _judged(diagram, exchanging, told, np.array(times), np.array(rows), status, message)
    result = _result(coupling, diagram, np.array(times), np.array(rows), status, message, worker, told)
    errors = held_mismatch(coupling, np.array(rows)) if plain else np.array(mismatch)
    return _with_error(result, errors)


def _with_error(result: Result, errors: np.ndarray) -> Result:
    signals = {**result.signals, "coupling.error": errors}
    return replace(result, signals=signals, units={**result.units, "coupling.error": "1"})


def _judged(
    diagram: Diagram,
    exchanging: Sequence[ModelExchange],
    told: _Told,
    times: np.ndarray,
    rows: np.ndarray,
    status: str,
    message: str,
) -> tuple[str, str]:
    """Return status and message of a run that reached its end, or left the finite numbers. rows: (n, n_y)."""
    for integrator in exchanging:
        why = integrator.unstable_step()
        if why:
            return "diverged", f"{integrator.slave.name}: {why}\n\nhint: --solver radau (implicit), or a smaller --step"
    growth, grown = _growth(times, rows) if status == "finished" else (0.0, 0.0)
    whole = told.found is not None and not told.found.stable and told.found.largest_step == 0
    if status == "finished" and told.found is not None and whole:
        if told.found.exact:
            return "unstable", "the loop is unstable as a whole, with any step"
        if growth > 0:  # a nonlinear loop may settle on a bounded motion
            what = (
                f"the linearised loop is unstable as a whole, with any step, and its motion grows at {growth:.3g} 1/s"
            )
            return "unstable", what
    options = (getattr(node.block.option, "profile", "constant") for node in diagram.nodes.values())
    if status == "finished" and grown > EXPLODED and all(option == "constant" for option in options):
        return "unstable", f"the motion grows at {growth:.3g} 1/s, and has become {grown:.2g} times larger"
    return status, message


def _growth(times: np.ndarray, rows: np.ndarray) -> tuple[float, float]:
    """Return how fast a motion still grows [1/s], and how many times larger it is at the end than at the start."""
    even = np.linspace(times[0], times[-1], len(times))
    rows = np.column_stack([np.interp(even, times, row) for row in rows.T]) if rows.size else rows
    rate, m = growth_rate(even, rows), len(rows) // 8
    if not rate:
        return 0.0, 0.0
    first, last = np.ptp(rows[:m], axis=0), np.ptp(rows[-m:], axis=0)
    return rate, float(np.divide(last, first, out=np.zeros_like(last), where=first > 0).max(initial=0.0))


def _diverged(coupling: Coupling, y: np.ndarray, t: float) -> tuple[str, str]:
    """Return status and message of a run whose outputs (n_y,) at time t are not all finite."""
    bad = int(np.flatnonzero(~np.isfinite(y))[0])
    name = [name for p in coupling.participants for name in p.outputs][bad]
    return "diverged", f"{name} left the finite numbers at t = {t:g} s: a smaller communication step, or another master"


def _may_be_fast(coupling: Coupling, step: float, end: float) -> bool:
    """Return whether the loop in C does just what the plain steps of a master do.

    Not with algebraic loops, where a part samples (it is stopped there), where steps must be equal to the last bit, or
    where messages are wanted as they come.
    """
    whole = abs(round(end / step) * step - end) <= 1e-9 * step
    members: list[Any] = []
    for participant in coupling.participants:
        if isinstance(participant, FmuParticipant):
            if participant.rigid or participant.slave.log:
                return False
            members.append(participant.slave)
        elif isinstance(participant, CompiledParticipant) and not participant.part.trace.samplers:
            members.append(participant)
        else:
            return False
    return whole and not (coupling.passes and coupling.has_loop) and FastLoop.possible(members)


def _stopped(error: RotorsimError) -> tuple[str, str]:
    """Return status and message of a run that an error has ended."""
    problem = error.problems[0]
    message = ": ".join(part for part in (problem.subject, problem.what) if part)
    return "stopped", message + (f"\n\nhint: {problem.hint}" if problem.hint else "")


def _last_sample(coupling: Coupling, worker: Master, error: RotorsimError, t: float) -> tuple[float, np.ndarray] | None:
    """Return time and outputs where an FMU itself asks for the end; those of the others are as foreseen there."""
    problem = error.problems[0]
    if not isinstance(error, FmuError) or error.kind != "ended" or error.time is None or error.time < t:
        return None
    y = np.array(worker.foreseen(error.time), float)
    for participant, part in zip(coupling.participants, coupling.y_parts, strict=True):
        if isinstance(participant, FmuParticipant) and participant.slave.name == problem.subject:
            with contextlib.suppress(RotorsimError):
                y[part] = participant.final()
                return error.time, y
    return None


def _with_last(
    times: list[float], rows: list[np.ndarray], mismatch: list[float], t: float, y: np.ndarray
) -> tuple[list[float], list[np.ndarray], list[float]]:
    """Return the rows with a last one; it takes the place of one at the same time."""
    keep = len(times) - (t <= times[-1] + 1e-12 * abs(t))
    return [*times[:keep], t], [*rows[:keep], y], [*mismatch[:keep], 0.0]


@dataclass
class _Told:
    """What is said of a run besides its signals."""

    step: float
    master: str
    order: int | None = None
    rates: Mapping[str, int] = field(default_factory=dict)
    found: CouplingStability | None = None
    why_not: str = ""

    def look(self, coupling: Coupling, rates: Sequence[int]) -> None:
        """Find out how stable the coupled loop is. Raises RotorsimError where it must diverge."""
        found = coupling_stability(coupling, self.step, master=self.master, order=self.order, rates=rates)
        self.found = found
        self.why_not = "" if found is not None else why_not_linear(coupling, self.step, rates)
        if found is not None and not found.stable and found.largest_step > 0:
            largest = f"the largest stable step is {found.largest_step:.3g} s"
            what = f"with this step the coupled loop is unstable; {largest}"
            hint = "a smaller step, or another master (iterative bears the largest steps)"
            raise RotorsimError(Problem(what, f"step {self.step:g} s, {self.master}", hint=hint), exit_code=1)

    def provenance(self, order: int) -> dict[str, Any]:
        """Return it as plain data."""
        made: dict[str, Any] = {"master": self.master, "order": order, "communication_step": self.step}
        if self.rates:
            made["rates"] = dict(self.rates)
        if self.found is not None:
            kept = None if np.isnan(self.found.kept) else self.found.kept
            made |= {"damping_kept": kept, "largest_stable_step": self.found.largest_step}
        if self.why_not:
            made["stability_not_analysed"] = self.why_not
        return made


def _refuse(
    coupling: Coupling, master: str, order: int | None, adaptive: float | None, fast: bool, rates: Sequence[int]
) -> None:
    """Refuse settings that do not go together."""
    chosen = [("order", order is not None), ("adaptive steps", adaptive is not None), ("the fast loop", fast)]
    problems = []
    if master == "waveform":
        what = ", ".join(name for name, on in chosen if on)
        hint = "it repeats the whole run, with cubic splines through fixed steps"
        problems += [Problem(f"cannot be combined with {what}", "master waveform", hint=hint)] if what else []
    elif fast and adaptive is not None:
        hint = "leave out one of them"
        problems.append(Problem("cannot be combined with adaptive steps", "the fast loop", hint=hint))
    stuck = [p.name for p in coupling.participants if not p.can_restore]
    if fast and any(isinstance(p, FmuParticipant) and p.slave.log for p in coupling.participants):
        problems.append(Problem("tells no messages of FMUs", "the fast loop", hint="leave out --fast, or the log"))
    if adaptive is not None and stuck:
        hint = "take fixed steps"
        problems.append(Problem(f"cannot take a step back: {', '.join(stuck)}", "adaptive steps", hint=hint))
    if max(rates) > 1:
        hint = "rates go with fixed steps of master jacobi or gauss_seidel"
        together = [("master waveform", master == "waveform"), *chosen[1:]]
        problems += [Problem("takes all participants at one rate", what, hint=hint) for what, on in together if on]
    if problems:
        raise RotorsimError(*problems)


def _refuse_rigid(coupling: Coupling, step: float, end: float, adaptive: float | None, rates: Sequence[int]) -> None:
    """Refuse steps of several lengths where an FMU cannot vary its communication step."""
    problems = []
    for participant, rate in zip(coupling.participants, rates, strict=True):
        if not isinstance(participant, FmuParticipant) or not participant.rigid:
            continue
        what, count = "cannot vary its communication step", end / (rate * step)
        if adaptive is not None:
            problems.append(Problem(f"{what}, as adaptive steps do", participant.name, hint="take fixed steps"))
        elif abs(count - round(count)) > 1e-9:
            what += f": its steps of {rate * step:g} s do not divide the stop time {end:g} s"
            hint = f"such as --step '{end / max(1, round(count)) / rate:.15g} s'"
            problems.append(Problem(what, participant.name, hint=hint))
    if problems:
        raise RotorsimError(*problems)


def _by_waveform(
    coupling: Coupling,
    diagram: Diagram,
    step: float,
    end: float,
    tolerance: float,
    progress: Callable[[float], None] | None,
) -> Result:
    """Repeat the whole run until the waveforms agree; see `rotorsim.cosim.waveform`."""
    times, rows, counters = relaxed(coupling, step, end, tolerance, progress)
    worker = make_master("jacobi", coupling)
    worker.counters.update(counters)
    return _result(coupling, diagram, times, rows, "finished", "", worker, _Told(step, "waveform"))


def _fast(
    coupling: Coupling,
    diagram: Diagram,
    step: float,
    end: float,
    worker: Master,
    first: np.ndarray,
    told: _Told,
    progress: Callable[[float], None] | None,
    sweeps: int = 0,
) -> Result:
    """Run the loop in C; see `rotorsim.cosim.loop`."""
    if told.master == "iterative" or worker.order > 0:
        hint = "take master jacobi or gauss_seidel with order 0, or leave out fast"
        raise RotorsimError(Problem("it holds inputs and repeats nothing", "the fast loop", hint=hint))
    members: list[Any] = [p.slave if isinstance(p, FmuParticipant) else p for p in coupling.participants]
    sequence = coupling.order if told.master == "gauss_seidel" else None
    count = round(end / step)
    if abs(count * step - end) > 1e-6 * step:
        hint = f"such as --step '{end / count:.15g} s'"
        raise RotorsimError(
            Problem(f"takes whole steps: {step:g} s does not divide {end:g} s", "the fast loop", hint=hint)
        )
    (fu, ou), (fy, oy) = (scales_of(coupling, which) for which in ("u_scales", "y_scales"))
    L, u0 = coupling.L * fy / fu[:, None], (coupling.L @ oy + coupling.u0 - ou) / fu  # in the units of the FMUs
    loop = FastLoop(members, L, u0, sequence, sweeps)
    loop.begin((first - oy) / fy)
    status, message, last = "finished", "", None
    failure: FmuError | None = None
    try:
        made = loop.run(0.0, step, count, end=end, progress=progress)
    except FmuError as error:
        failure, made, (status, message) = error, loop.rows, _stopped(error)
    rows = np.vstack([first, made * fy + oy])
    if status == "finished" and (len(made) < count or not np.isfinite(rows[-1]).all()):
        status, message = _diverged(coupling, rows[-1], len(made) * step)
    worker.counters["steps"] = len(made)
    worker.counters["participant_steps"] = len(made) * len(members)
    if failure is not None:
        worker.known = [[(len(made) * step, rows[-1][part])] for part in coupling.y_parts]
        last = _last_sample(coupling, worker, failure, len(made) * step)
    for participant in coupling.participants:
        if isinstance(participant, FmuParticipant):
            participant.most_parts, participant.do_steps = 1, len(made)
    times = [*np.minimum(np.arange(len(rows)) * step, end)]
    if last is not None:
        times, kept, _ = _with_last(times, [*rows], times, *last)
        rows = np.array(kept)
    if status in ("finished", "diverged"):
        status, message = _judged(diagram, (), told, np.array(times), rows, status, message)
    result = _result(coupling, diagram, np.array(times), rows, status, message, worker, told)
    return _with_error(result, held_mismatch(coupling, rows))


def scales_of(coupling: Coupling, which: str) -> np.ndarray:
    """Return factors and offsets (2, n) of all inputs or outputs: SI = factor * value + offset."""
    found = [np.zeros((0, 2))]
    for p in coupling.participants:
        n = len(p.inputs if which == "u_scales" else p.outputs)
        own = getattr(p, which) if isinstance(p, FmuParticipant) else None
        found.append(np.tile((1.0, 0.0), (n, 1)) if own is None else own)
    return np.concatenate(found).T


def _doubled(worker: Master, t: float, h: float, allowed: float, most: float) -> tuple[float, np.ndarray, float]:
    """Take one step of h and, from the same state, two of h/2; return time, outputs, next step. It ends at hits."""
    wanted, h = h, min(h, max(worker.next_hit(t) - t, 1e-6 * most))
    while True:
        saved = worker.save()
        _, once = worker.step(t, h)
        worker.restore(saved)
        worker.step(t, h / 2)
        _, twice = worker.step(t + h / 2, h / 2)
        scale = np.maximum(np.maximum(np.abs(once), np.abs(twice)), 1e-12)
        worker.peak = np.maximum(worker.peak, scale)
        error = float((np.abs(twice - once) / worker.peak).max(initial=0.0))
        if error <= allowed or h < 1e-6 * most:
            grown = max(h * min(2.0, 0.9 * (allowed / max(error, 1e-30)) ** 0.5), wanted if h < wanted else 0.0)
            return t + h, twice, min(grown, LARGEST_ADAPTIVE * most)
        worker.counters["rejected"] += 1
        worker.restore(saved)
        wanted = h = h * max(0.2, 0.9 * (allowed / error) ** 0.5)


def _result(
    coupling: Coupling,
    diagram: Diagram,
    times: np.ndarray,
    rows: np.ndarray,
    status: str,
    message: str,
    worker: Master,
    told: _Told,
) -> Result:
    signals: dict[str, np.ndarray] = {}
    names = [name for p in coupling.participants for name in p.outputs]
    grouped: dict[str, list[int]] = {}
    for k, name in enumerate(names):
        grouped.setdefault(name.partition("[")[0], []).append(k)
    for base, columns in grouped.items():
        values = rows[:, columns]
        inside = [names[k].partition("[")[2].rstrip("]") for k in columns]
        if inside == [""]:
            signals[base] = values[:, 0]
            continue
        index = np.array([[int(part) for part in text.split(",")] for text in inside])
        shape = tuple(index.max(axis=0))
        full = index.min() == 1 and len(index) == int(np.prod(shape))
        if full:
            signals[base] = values.reshape(len(rows), *shape)
        else:
            signals.update({names[k]: rows[:, k] for k in columns})
    ports = {f"{b}.{n}": p.unit for b, node in diagram.nodes.items() for n, p in node.outputs.items()}
    units = {name: ports.get(name.partition("[")[0]) or "" for name in signals}
    made = told.provenance(worker.told_order)
    if fmus := {p.name: p.told() for p in coupling.participants if isinstance(p, FmuParticipant)}:
        made["fmus"] = fmus
    too_far = passed_limit(input_limits(diagram), times, signals) if status == "finished" else ""
    status, message = ("diverged", too_far) if too_far else (status, message)
    return Result(times, signals, units, status, message, dict(worker.counters), made)
