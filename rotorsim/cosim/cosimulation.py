"""Co-simulate a diagram: compiled parts and FMUs side by side, exchanging signals at communication points."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from rotorsim.cosim.coupling import Coupling
from rotorsim.cosim.cut import couple, open_coupling, sources_of
from rotorsim.cosim.masters.choice import make_master
from rotorsim.cosim.masters.master import Schedule, Settings, Trajectory
from rotorsim.cosim.participant import Participant
from rotorsim.cosim.stability import CouplingStability, coupling_stability, why_not_linear
from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem, RotorsimError
from rotorsim.model.input_limits import input_limits, passed_limit
from rotorsim.simulation.result import Result
from rotorsim.simulation.validity import growth_rate

__all__ = ["cosimulate", "cosimulate_diagram", "couple", "open_coupling", "recorded", "sources_of"]

EXPLODED = 1e3  # times larger in the last eighth than in the first, and still growing: an integral of t^2 is 64 times


def cosimulate_diagram(
    diagram: Diagram,
    groups: Sequence[Iterable[str]] = (),
    *,
    step: float,
    stop: float | None = None,
    parameters: Mapping[str, Any] | None = None,
    log: Callable[[str, float, str, str, str], None] | None = None,
    use_compiler: bool = True,
    **settings: Any,
) -> Result:
    """Open the FMUs of a diagram, co-simulate it, and close them; settings as for `cosimulate`.

    log: gets block, time [s], status, category and text of every message of an FMU.
    """
    given = {"stop": stop, "parameters": parameters, "log": log, "use_compiler": use_compiler}
    coupling = open_coupling(diagram, groups, **given)  # type: ignore[arg-type]
    try:
        return cosimulate(coupling, diagram, step=step, stop=stop, **settings)
    finally:
        coupling.close()


def recorded(diagram: Diagram, result: Result) -> Result:
    """Return a result of a co-simulation with the recorded signals of the diagram alone."""
    wanted = dict.fromkeys(str(name).partition("[")[0] for name in diagram.record)
    names = [name for base in wanted for name in result.signals if name.partition("[")[0] == base]
    provenance = {**result.provenance, "diagram": diagram.name}
    return replace(result, signals={name: result.signals[name] for name in names}, provenance=provenance)


def cosimulate(
    coupling: Coupling[Participant],
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
    schedule = Schedule(step, diagram.solver.stop if stop is None else stop, adaptive, fast, progress)
    every = coupling.rates_of(rates or {})
    _refuse(coupling, master, order, schedule, every)
    for participant in coupling.participants:
        participant.method = solver
    if not 0 < step <= schedule.end:
        what = f"communication step {step:g} s is not between 0 and the stop time {schedule.end:g} s"
        raise RotorsimError(Problem(what, hint="give one that is positive and no longer than the run"))
    worker = make_master(master, coupling, Settings(order, tolerance, every))
    _, first = worker.start(0.0)
    about = _About(step, master, order, {name: int(n) for name, n in (rates or {}).items()})
    if check and worker.in_steps:
        about.analyse(coupling, every, adaptive)
    made = worker.run(schedule, first)
    about.order, about.counters = worker.order, worker.counters
    return _result(coupling, diagram, made, about)


def _status(coupling: Coupling[Participant], diagram: Diagram, made: Trajectory, about: _About) -> tuple[str, str]:
    """Return status and message of a run."""
    if made.failure is not None:
        problem = made.failure.problems[0]
        message = ": ".join(part for part in (problem.subject, problem.what) if part)
        return "stopped", message + (f"\n\nhint: {problem.hint}" if problem.hint else "")
    for participant in coupling.participants:
        if why := participant.unstable_step():
            return "diverged", f"{participant.name}: {why}\n\nhint: --solver radau (implicit), or a smaller --step"
    bad = np.flatnonzero(~np.isfinite(made.rows[-1]))
    if bad.size:
        name, t = [name for p in coupling.participants for name in p.outputs][bad[0]], made.times[-1]
        hint = "a smaller communication step, or another master"
        return "diverged", f"{name} left the finite numbers at t = {t:g} s: {hint}"
    growth, grown = _growth(made.times, made.rows)
    loop = about.stability
    if loop is not None and not loop.stable and loop.largest_step == 0:
        if loop.exact:
            return "unstable", "the loop is unstable as a whole, with any step"
        if growth > 0:  # a nonlinear loop may settle on a bounded motion
            what = "the linearised loop is unstable as a whole, with any step, and its motion grows at"
            return "unstable", f"{what} {growth:.3g} 1/s"
    options = (getattr(node.block.option, "profile", "constant") for node in diagram.nodes.values())
    if grown > EXPLODED and all(option == "constant" for option in options):
        return "unstable", f"the motion grows at {growth:.3g} 1/s, and has become {grown:.2g} times larger"
    return "finished", ""


def _growth(times: np.ndarray, rows: np.ndarray) -> tuple[float, float]:
    """Return how fast a motion still grows [1/s], and how many times larger it is at the end than at the start."""
    even = np.linspace(times[0], times[-1], len(times))
    rows = np.column_stack([np.interp(even, times, row) for row in rows.T]) if rows.size else rows
    rate, m = growth_rate(even, rows), len(rows) // 8
    if not rate:
        return 0.0, 0.0
    first, last = np.ptp(rows[:m], axis=0), np.ptp(rows[-m:], axis=0)
    return rate, float(np.divide(last, first, out=np.zeros_like(last), where=first > 0).max(initial=0.0))


@dataclass
class _About:
    """What is reported of a run besides its signals. chosen: order that was asked for; order: that of the master."""

    step: float
    master: str
    chosen: int | None
    rates: Mapping[str, int]
    order: int = 0
    counters: Mapping[str, int] = field(default_factory=dict)
    stability: CouplingStability | None = None
    why_not: str = ""

    def analyse(self, coupling: Coupling[Participant], rates: Sequence[int], adaptive: float | None) -> None:
        """Find out how stable the coupled loop is. Raises RotorsimError where it must diverge."""
        if adaptive is not None:
            self.why_not = "the step adapts itself"
            return
        found = coupling_stability(coupling, self.step, master=self.master, order=self.chosen, rates=rates)
        self.stability = found
        self.why_not = "" if found is not None else why_not_linear(coupling, self.step, rates)
        if found is not None and not found.stable and found.largest_step > 0:
            largest = f"the largest stable step is {found.largest_step:.3g} s"
            what = f"with this step the coupled loop is unstable; {largest}"
            hint = "a smaller step, or another master (iterative bears the largest steps)"
            raise RotorsimError(Problem(what, f"step {self.step:g} s, {self.master}", hint=hint), exit_code=1)

    def provenance(self) -> dict[str, Any]:
        """Return it as plain data."""
        made: dict[str, Any] = {"master": self.master, "order": self.order, "communication_step": self.step}
        if self.rates:
            made["rates"] = dict(self.rates)
        if self.stability is not None:
            kept = None if np.isnan(self.stability.kept) else self.stability.kept
            made |= {"damping_kept": kept, "largest_stable_step": self.stability.largest_step}
        if self.why_not:
            made["stability_not_analysed"] = self.why_not
        return made


def _refuse(
    coupling: Coupling[Participant], master: str, order: int | None, schedule: Schedule, rates: Sequence[int]
) -> None:
    """Refuse settings that do not go together."""
    adaptive, fast = schedule.adaptive is not None, schedule.fast
    chosen = [("order", order is not None), ("adaptive steps", adaptive), ("the fast loop", fast)]
    problems = []
    if master == "waveform":
        what = ", ".join(name for name, on in chosen if on)
        hint = "it repeats the whole run, with cubic splines through fixed steps"
        problems += [Problem(f"cannot be combined with {what}", "master waveform", hint=hint)] if what else []
    elif fast and adaptive:
        hint = "leave out one of them"
        problems.append(Problem("cannot be combined with adaptive steps", "the fast loop", hint=hint))
    stuck = [p.name for p in coupling.participants if not p.can_restore]
    if fast and any(p.has_log for p in coupling.participants):
        problems.append(Problem("tells no messages of FMUs", "the fast loop", hint="leave out --fast, or the log"))
    if adaptive and stuck:
        hint = "take fixed steps"
        problems.append(Problem(f"cannot take a step back: {', '.join(stuck)}", "adaptive steps", hint=hint))
    if max(rates) > 1:
        hint = "rates go with fixed steps of master jacobi or gauss_seidel"
        together = [("master waveform", master == "waveform"), *chosen[1:]]
        problems += [Problem("takes all participants at one rate", what, hint=hint) for what, on in together if on]
    problems = problems or [
        problem
        for participant, rate in zip(coupling.participants, rates, strict=True)
        if participant.equal_steps
        for problem in _unequal(participant.name, rate * schedule.step, rate, schedule.end, adaptive)
    ]
    if problems:
        raise RotorsimError(*problems)


def _unequal(name: str, width: float, rate: int, end: float, adaptive: bool) -> list[Problem]:
    """Return why steps of a width [s] are not all equal, for an FMU that cannot vary its communication step."""
    what, count = "cannot vary its communication step", end / width
    if adaptive:
        return [Problem(f"{what}, as adaptive steps do", name, hint="take fixed steps")]
    if abs(count - round(count)) <= 1e-9:
        return []
    hint = f"such as --step '{end / max(1, round(count)) / rate:.15g} s'"
    return [Problem(f"{what}: its steps of {width:g} s do not divide the stop time {end:g} s", name, hint=hint)]


def _result(coupling: Coupling[Participant], diagram: Diagram, made: Trajectory, about: _About) -> Result:
    signals = _signals([name for p in coupling.participants for name in p.outputs], made.rows)
    ports = {f"{b}.{n}": p.unit for b, node in diagram.nodes.items() for n, p in node.outputs.items()}
    units = {name: ports.get(name.partition("[")[0]) or "" for name in signals}
    status, message = _status(coupling, diagram, made, about)
    if status == "finished" and (too_far := passed_limit(input_limits(diagram), made.times, signals)):
        status, message = "diverged", too_far
    provenance = about.provenance()
    if fmus := {p.name: told for p in coupling.participants if (told := p.report()) is not None}:
        provenance["fmus"] = fmus
    if made.mismatch is not None:
        signals["coupling.error"], units["coupling.error"] = made.mismatch, "1"
    return Result(made.times, signals, units, status, message, dict(about.counters), provenance)


def _signals(names: Sequence[str], rows: np.ndarray) -> dict[str, np.ndarray]:
    """Return the columns of rows (n, n_y) as signals: arrays where all entries are there, else entry by entry."""
    signals: dict[str, np.ndarray] = {}
    grouped: dict[str, list[int]] = {}
    for k, name in enumerate(names):
        grouped.setdefault(name.partition("[")[0], []).append(k)
    for base, columns in grouped.items():
        inside = [names[k].partition("[")[2].rstrip("]") for k in columns]
        if inside == [""]:
            signals[base] = rows[:, columns[0]]
            continue
        index = np.array([[int(part) for part in text.split(",")] for text in inside])
        shape = tuple(index.max(axis=0))
        if index.min() == 1 and len(index) == int(np.prod(shape)):
            signals[base] = rows[:, columns].reshape(len(rows), *shape)
        else:
            signals.update({names[k]: rows[:, k] for k in columns})
    return signals
