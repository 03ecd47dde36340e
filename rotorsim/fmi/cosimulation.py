"""Co-simulate a diagram: compiled parts and FMUs side by side, exchanging signals at communication points."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from rotorsim.compile.part import open_part
from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem, RotorsimError, near_miss
from rotorsim.fmi.coupling import Coupling
from rotorsim.fmi.fmu_participant import FmuParticipant, fmu_participant
from rotorsim.fmi.loop import FastLoop
from rotorsim.fmi.masters import Master, make_master
from rotorsim.fmi.participant import CompiledParticipant, Participant
from rotorsim.fmi.stability import CouplingStability, coupling_stability
from rotorsim.fmi.waveform import relaxed
from rotorsim.simulate.linear import entry_names
from rotorsim.simulate.result import Result

__all__ = ["cosimulate", "cosimulate_diagram", "couple", "open_coupling", "sources_of"]

LARGEST_ADAPTIVE = 100  # the adaptive step over the one given


def couple(
    diagram: Diagram, groups: Sequence[Iterable[str]], *, parameters: Mapping[str, Any] | None = None,
    participants: Mapping[str, Participant] | None = None, use_compiler: bool = True,
) -> Coupling:  # fmt: skip
    """Return a diagram cut into participants: one compiled part for each group of blocks, and the participants given.

    participants: block -> a participant in its place (an FMU); its inputs and outputs are named as the block's ports,
    "rotor.force[1]". Blocks that no group names make one more part. Raises RotorsimError for what does not fit.
    """
    given = dict(participants or {})
    taken = [block for group in groups for block in group]
    rest = [block for block in diagram.nodes if block not in taken and block not in given]
    parts = [tuple(group) for group in groups] + ([tuple(rest)] if rest else [])
    _refuse_doubles(diagram, [*taken, *given])
    crossing = _crossing(diagram, [*parts, *((block,) for block in given)])
    made: list[Participant] = []
    for blocks in parts:
        part = open_part(diagram, blocks, by_source=True)
        p = part.parameter_vector(parameters)
        record = [port for port in crossing if port.rpartition(".")[0] in blocks]
        watched = [str(name) for name in diagram.record if str(name).partition(".")[0] in blocks]
        record += [name for name in watched if name.partition("[")[0] not in record]
        name = "+".join(blocks) if len(blocks) < 4 else f"{blocks[0]}+{len(blocks) - 1} more"
        made.append(CompiledParticipant(name, part, record, p, diagram.solver.step, use_compiler=use_compiler))
    made += given.values()
    L, u0 = _wires(diagram, made, set(given))
    sampled = np.array([_is_sampled(diagram, name) for participant in made for name in participant.outputs], bool)
    feeding = L != 0
    held = feeding.any(axis=1) & ~(feeding & ~sampled).any(axis=1)
    return Coupling(tuple(made), L, u0, held)


def _is_sampled(diagram: Diagram, name: str) -> bool:
    """Return whether an output changes at sample hits only."""
    block, _, port = name.partition("[")[0].rpartition(".")
    found = diagram.nodes[block].block
    if found.opaque:
        ports: Any = getattr(found, "fmu_outputs", {})
        return port in ports and bool(ports[port].discrete)
    return found.sample_time is not None


def _refuse_doubles(diagram: Diagram, blocks: Sequence[str]) -> None:
    problems = [Problem("is in two parts", block) for block in dict.fromkeys(blocks) if blocks.count(block) > 1]
    problems += [
        Problem("no such block", block, hint=near_miss(block, diagram.nodes))
        for block in dict.fromkeys(blocks)
        if block not in diagram.nodes
    ]
    if problems:
        raise RotorsimError(*problems)


def _crossing(diagram: Diagram, parts: Sequence[Sequence[str]]) -> list[str]:
    """Return the output ports that feed another part."""
    home = {block: k for k, blocks in enumerate(parts) for block in blocks}
    return list(dict.fromkeys(
        f"{w.source.block}.{w.source.port}" for w in diagram.wires if home[w.source.block] != home[w.target.block]
    ))  # fmt: skip


def _wires(diagram: Diagram, participants: Sequence[Participant], foreign: set[str]) -> tuple[np.ndarray, np.ndarray]:
    """Return L and u0: a compiled part's inputs are named by their source, a foreign one's by its own ports."""
    outputs = [name for participant in participants for name in participant.outputs]
    at = {name: k for k, name in enumerate(outputs)}
    rows = []
    for participant in participants:
        for name in participant.inputs:
            row = np.zeros(len(outputs))
            if name.partition(".")[0] in foreign and participant is not None and _owns(participant, name, foreign):
                for source in sources_of(diagram, name):
                    row[at[source]] += 1.0
            else:
                row[at[name]] = 1.0
            rows.append(row)
    L = np.array(rows).reshape(len(rows), len(outputs))
    return L, np.zeros(len(rows))


def _owns(participant: Participant, name: str, foreign: set[str]) -> bool:
    return participant.name in foreign and name.partition(".")[0] == participant.name


def sources_of(diagram: Diagram, name: str) -> list[str]:
    """Return the flat output entries that add up to one input entry of a block."""
    found = []
    for wire in diagram.wires:
        target, source = wire.target, wire.source
        declared = diagram.nodes[target.block].inputs[target.port]
        entries = entry_names(f"{target.block}.{target.port}", declared.shape)
        if name not in entries:
            continue
        port = diagram.nodes[source.block].outputs[source.port]
        out = np.array(entry_names(f"{source.block}.{source.port}", port.shape)).reshape(port.shape or (1,))
        inside = np.array(entries).reshape(declared.shape or (1,))
        if source.index:
            out = out[source.index]
        if target.index:
            inside = inside[target.index]
        out, inside = np.atleast_1d(out), np.atleast_1d(inside)
        out = np.broadcast_to(out, inside.shape)
        found += [str(o) for o, i in zip(out.ravel(), inside.ravel(), strict=True) if str(i) == name]
    return found


def open_coupling(
    diagram: Diagram, groups: Sequence[Iterable[str]] = (), *, stop: float | None = None,
    parameters: Mapping[str, Any] | None = None, use_compiler: bool = True,
) -> Coupling:  # fmt: skip
    """Return the participants of a diagram: its FMUs, the groups of blocks given, and the rest; FMUs are opened.

    Close them with `Coupling.close`. Raises RotorsimError, also for a diagram of one participant.
    """
    end = diagram.solver.stop if stop is None else stop
    opened: dict[str, Participant] = {}
    try:
        for name, node in diagram.nodes.items():
            if node.block.opaque:
                wired = {wire.target.port for wire in diagram.wires if wire.target.block == name}
                opened[name] = fmu_participant(name, node, wired, end, diagram.solver.step)
        if not opened and not groups:
            hint = "cut it with --part BLOCK,BLOCK, or `rotorsim run` it"
            raise RotorsimError(Problem("has no FMU: there is nothing to be coupled", diagram.name, hint=hint))
        return couple(diagram, groups, parameters=parameters, participants=opened, use_compiler=use_compiler)
    except BaseException:
        for participant in opened.values():
            participant.close()
        raise


def cosimulate_diagram(
    diagram: Diagram, groups: Sequence[Iterable[str]] = (), *, step: float, stop: float | None = None,
    parameters: Mapping[str, Any] | None = None, **settings: Any,
) -> Result:  # fmt: skip
    """Open the FMUs of a diagram, co-simulate it, and close them; settings as for `cosimulate`."""
    coupling = open_coupling(diagram, groups, stop=stop, parameters=parameters)
    try:
        return cosimulate(coupling, diagram, step=step, stop=stop, **settings)
    finally:
        coupling.close()


def cosimulate(
    coupling: Coupling, diagram: Diagram, *, step: float, stop: float | None = None, master: str = "gauss_seidel",
    order: int | None = None, tolerance: float = 1e-8, adaptive: float | None = None, check: bool = False,
    fast: bool = False, progress: Callable[[float], None] | None = None,
) -> Result:  # fmt: skip
    """Advance the participants from 0 to stop with communication steps; return the outputs at these points.

    The result also holds ``coupling.error``: per step, how far inputs were from what the outputs then asked for.

    step: communication step [s]. adaptive: relative error allowed per step; the step is then halved or doubled as step
    doubling says (every participant must be able to step back). A participant that fails or a signal that leaves
    the finite numbers ends the run; what was found until then is kept, with status and message. check: refuse a step
    with which the linearised loop is unstable though the loop as a whole is stable. fast: the plain loop in C, inputs
    held and outputs taken as each participant left them (no sweeps through direct feedthrough), for FMUs in process.
    """
    end = diagram.solver.stop if stop is None else stop
    if master == "waveform" and 0 < step <= end:
        return _by_waveform(coupling, diagram, step, end, tolerance, progress)
    if not 0 < step <= end:
        raise RotorsimError(Problem(f"communication step {step:g} s is not between 0 and the stop time {end:g} s"))
    worker = make_master(master, coupling, order=order, tolerance=tolerance, held=coupling.held)
    mismatch = [0.0]
    times, rows = [0.0], []
    status, message = "finished", ""
    y = worker.start(0.0)[1]
    rows.append(y)
    found = coupling_stability(coupling, step, master=master, order=order) if check and adaptive is None else None
    if found is not None and not found.stable and found.largest_step > 0:
        what = f"with this step the coupled loop is unstable; the largest stable step is {found.largest_step:.3g} s"
        hint = "a smaller step, or another master (iterative bears the largest steps)"
        raise RotorsimError(Problem(what, f"step {step:g} s, {master}", hint=hint), exit_code=1)
    if fast:
        return _fast(coupling, diagram, step, end, master, worker, rows[0], found, progress)
    t, count, width = 0.0, 0, step
    while t < end - 1e-9 * step:
        try:
            if adaptive is None:
                count += 1
                target = min(count * step, end)
                y = worker.step(t, target - t)[1]
            else:
                target, y, width = _doubled(worker, t, min(width, end - t), adaptive, step)
        except RotorsimError as error:
            status, message = "stopped", error.problems[0].what
            break
        t = target
        times.append(t)
        rows.append(y)
        mismatch.append(worker.mismatch)
        if not np.isfinite(y).all():
            status = "diverged"
            bad = int(np.flatnonzero(~np.isfinite(y))[0])
            names = [name for p in coupling.participants for name in p.outputs]
            message = (
                f"{names[bad]} left the finite numbers at t = {t:g} s: a smaller communication step, or another master"
            )
            break
        if progress is not None:
            progress(t / end)
    result = _result(coupling, diagram, np.array(times), np.array(rows), status, message, worker, master, step, found)
    signals = {**result.signals, "coupling.error": np.array(mismatch)}
    return replace(result, signals=signals, units={**result.units, "coupling.error": "1"})


def _by_waveform(
    coupling: Coupling, diagram: Diagram, step: float, end: float, tolerance: float,
    progress: Callable[[float], None] | None,
) -> Result:  # fmt: skip
    """Repeat the whole run until the waveforms agree; see `rotorsim.fmi.waveform`."""
    times, rows, counters = relaxed(coupling, step, end, tolerance, progress)
    worker = make_master("jacobi", coupling)
    worker.counters.update(counters)
    return _result(coupling, diagram, times, rows, "finished", "", worker, "waveform", step, None)


def _fast(
    coupling: Coupling, diagram: Diagram, step: float, end: float, master: str, worker: Master, first: np.ndarray,
    found: CouplingStability | None, progress: Callable[[float], None] | None,
) -> Result:  # fmt: skip
    """Run the loop in C; see `rotorsim.fmi.loop`."""
    if master == "iterative" or worker.order > 0:
        raise RotorsimError(Problem("the fast loop holds inputs: master jacobi or gauss_seidel, order 0", "fast"))
    members: list[Any] = [p.slave if isinstance(p, FmuParticipant) else p for p in coupling.participants]
    sequence = coupling.order if master == "gauss_seidel" else None
    count = round(end / step)
    made = FastLoop(members, coupling.L, coupling.u0, sequence).run(0.0, step, count, progress=progress)
    rows = np.vstack([first, made])
    status, message = "finished", ""
    if len(made) < count or not np.isfinite(rows[-1]).all():
        status, message = "diverged", f"left the finite numbers at t = {len(made) * step:g} s: a smaller step"
    worker.counters["steps"] = len(made)
    return _result(coupling, diagram, np.arange(len(rows)) * step, rows, status, message, worker, master, step, found)


def _doubled(worker: Master, t: float, h: float, allowed: float, most: float) -> tuple[float, np.ndarray, float]:
    """Take one step of h and, from the same state, two of h/2; return time, outputs, next step."""
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
            grown = h * min(2.0, 0.9 * (allowed / max(error, 1e-30)) ** 0.5)
            return t + h, twice, min(grown, LARGEST_ADAPTIVE * most)
        worker.counters["rejected"] += 1
        worker.restore(saved)
        h *= max(0.2, 0.9 * (allowed / error) ** 0.5)


def _result(
    coupling: Coupling, diagram: Diagram, times: np.ndarray, rows: np.ndarray, status: str, message: str,
    worker: Master, master: str, step: float, found: CouplingStability | None,
) -> Result:  # fmt: skip
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
    made = {"master": master, "order": worker.order, "communication_step": step}
    if found is not None:
        made |= {"damping_kept": found.kept, "largest_stable_step": found.largest_step}
    ports = {f"{b}.{n}": p.unit for b, node in diagram.nodes.items() for n, p in node.outputs.items()}
    units = {name: ports.get(name.partition("[")[0]) or "" for name in signals}
    return Result(times, signals, units, status, message, dict(worker.counters), made)
