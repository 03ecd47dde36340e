"""A diagram at work: parameters, states and the time loop, in C or on CasADi's virtual machine.

Both keep the same promises:

1. ``x`` (n_x,) and ``z`` (n_z,) are the current states; they may be read and written between calls.
2. ``start(t)`` must be called once; it carries out the sample hits due at t.
3. ``run(n0, n1, t0, h, every, rows)`` takes RK4 steps n0..n1-1; a row is recorded at the start of every
   step divisible by ``every``; it returns the step reached (less than n1 if a state is not `sound`).
4. ``derivative(t, x)`` and ``record(t, x)`` are pure; ``sample(t)`` carries out hits due at t.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Any, Protocol

import casadi as ca
import numpy as np

from rotorsim.model.compiled import Library, Model
from rotorsim.model.emit.emit import Kernel, step_program
from rotorsim.model.emit.program import INPUT

HIT_TOLERANCE = 1e-9  # of the period, as in runtime.c
LARGEST_NUMBER = 1e290  # of all states together, as in runtime.c: what is recorded is still a number in micrometres


class StepCallback(ctypes.Structure):
    """A function of C that is told of every step, and its context; what it has said (``rs_callback`` of runtime.c)."""

    _fields_ = [("function", ctypes.c_void_p), ("context", ctypes.c_void_p), ("said", ctypes.c_int64)]


class Instance(Protocol):
    """What both kinds of instance offer."""

    path: str
    x: np.ndarray
    z: np.ndarray
    n_y: int

    def start(self, t: float) -> None: ...
    def run(self, n0: int, n1: int, t0: float, h: float, every: int, rows: np.ndarray) -> int: ...
    def derivative(self, t: float, x: np.ndarray) -> np.ndarray: ...
    def record(self, t: float, x: np.ndarray) -> np.ndarray: ...
    def sample(self, t: float) -> None: ...
    def next_hit(self) -> float: ...
    def save(self) -> Any: ...
    def restore(self, saved: Any) -> None: ...


def sound(x: np.ndarray) -> bool:
    """Return whether states (n_x,) are numbers within all bounds."""
    with np.errstate(over="ignore"):
        return bool(np.abs(x).sum() <= LARGEST_NUMBER)


def make_instance(model: Model, record: Sequence[str], p: np.ndarray, *, use_compiler: bool = True) -> Instance:
    """Return an instance in C where there is a compiler, else on CasADi's virtual machine."""
    library = model.library(tuple(record)) if use_compiler else None
    if library is not None:
        return CompiledInstance(model, library, p)
    return InterpretedInstance(model, tuple(record), p)


class CompiledInstance:
    """An instance that runs the generated C."""

    def __init__(self, model: Model, library: Library, p: np.ndarray) -> None:
        self.functions = library.handle
        self.path = f"C ({library.compiler}, {'from the cache' if library.cached else 'compiled now'})"
        self.samplers = model.trace.samplers
        self.p = np.ascontiguousarray(p, float)
        self.memory = library.memory()
        self.n_y = library.kernel.sizes["RS_NY"]
        self.x = self.memory[: model.n_x]
        self.z = self.memory[model.n_x : model.n_x + model.n_z]
        self._count_at = len(self.memory)
        self._p, self._m = self.p.ctypes.data, self.memory.ctypes.data
        self._x, self._z = self.x.ctypes.data, self._m + 8 * model.n_x
        self._point = np.empty(max(model.n_x, 1))
        self._slope, self._row = np.empty(model.n_x), np.empty(self.n_y)
        self._held: np.ndarray | None = None
        self.functions.rs_prepare(self._p, self._m)
        self.x[:], self.z[:] = model.initial(self.p)

    def start(self, t: float) -> None:
        self.functions.rs_start(t, self._p, self._m)

    def run(self, n0: int, n1: int, t0: float, h: float, every: int, rows: np.ndarray) -> int:
        return int(self.functions.rs_run(self._p, self._m, n0, n1, t0, h, every, rows.ctypes.data))

    def run_stepwise(
        self, n0: int, n1: int, t0: float, h: float, every: int, rows: np.ndarray, callbacks: Sequence[StepCallback]
    ) -> int:
        """Take steps as `run`, and tell functions of C of each; see ``rs_run_stepwise`` in runtime.c."""
        if self._held is None:
            self._held = np.empty_like(self.memory)
        table, held = (StepCallback * len(callbacks))(*callbacks), self._held
        room = held.ctypes.data, self._slope.ctypes.data, len(callbacks), ctypes.addressof(table)
        n = int(self.functions.rs_run_stepwise(self._p, self._m, n0, n1, t0, h, every, rows.ctypes.data, *room))
        for one, after in zip(callbacks, table, strict=True):
            one.said = after.said
        return n

    def derivative(self, t: float, x: np.ndarray) -> np.ndarray:
        self._point[: len(x)] = x
        self.functions.rs_derivative(t, self._point.ctypes.data, self._z, self._p, self._m, self._slope.ctypes.data)
        return self._slope.copy()

    def record(self, t: float, x: np.ndarray) -> np.ndarray:
        self._point[: len(x)] = x
        self.functions.rs_record(t, self._point.ctypes.data, self._z, self._p, self._m, self._row.ctypes.data)
        return self._row.copy()

    def sample(self, t: float) -> None:
        self.functions.rs_sample(t, self._p, self._m)

    def next_hit(self) -> float:
        return float(self.functions.rs_next(self._p, self._m)) if self.samplers else np.inf

    def save(self) -> Any:
        return self.memory.copy()

    def restore(self, saved: Any) -> None:
        self.memory[:] = saved


class InterpretedInstance:
    """An instance that runs on CasADi's virtual machine (no compiler needed, several times slower)."""

    CHUNK = 256

    def __init__(self, model: Model, record: tuple[str, ...], p: np.ndarray) -> None:
        self.path = f"CasADi virtual machine ({model.without})"
        self.p = np.asarray(p, float)
        trace = model.trace
        self.samplers = trace.samplers
        self.x, self.z = model.initial(self.p)
        self.counts = np.zeros(len(self.samplers))
        columns = [model.closed(model.expression(name)) for name in record]
        y = ca.densify(ca.vertcat(*columns, trace.loop_residuals)) if columns else ca.SX(0, 1)
        self.n_y = y.numel()
        arguments = [trace.x, trace.t, trace.z, trace.p]
        self._f = ca.Function("f", arguments, [ca.densify(model.closed(trace.xdot)), y], {"cse": True})
        self._prepare_step(model.kernel(record), trace)
        self._many: dict[int, ca.Function] = {}
        self._repeated: dict[int, list[ca.DM]] = {}
        self._update = ca.Function("update", [*arguments, trace.w, trace.hit], [ca.densify(model.closed(trace.z_next))])

    def _prepare_step(self, kernel: Kernel, trace: Any) -> None:
        """Make functions of the constants of the run, the forcing of an instant, and the step, as the C code has."""
        step = step_program(kernel)
        program = kernel.program
        used = sorted({b for op, a, b in (*program.nodes, *step.program.nodes) if op == INPUT and a == "p"})
        self._used = np.array(used, int)  # the others would only be copied from step to step
        sizes = {"x": len(step.x), "z": trace.z.numel(), "p": len(used), "c": len(kernel.constants), "h": 1, "t": 1}
        sizes |= dict.fromkeys(("g0", "gm", "g1"), len(kernel.forcing))
        symbols = {name: ca.SX.sym(name, size) for name, size in sizes.items()}
        zeros = {name: ca.SX.zeros(v.numel()) for name, v in (("v", trace.v), ("w", trace.w), ("hit", trace.hit))}
        leaves = {**zeros, **symbols, "p": {b: symbols["p"][k] for k, b in enumerate(used)}}
        known = {node: symbols["c"][k] for k, node in enumerate(kernel.constants)}
        constants = ca.Function("constants", [symbols["p"]], [program.to_casadi(kernel.constants, leaves, {})])
        self._c = np.array(constants(self.p[self._used])).ravel()
        arguments = [symbols[name] for name in ("t", "p", "c")]
        self._forcing = ca.Function("forcing", arguments, [program.to_casadi(kernel.forcing, leaves, known)])
        needed = step.program.needed([*step.new, *step.y], dict.fromkeys(step.constants))
        vectors = {step.program.nodes[k][1] for k in needed if k not in step.constants}
        self._given = [name for name in ("p", "c", "h") if name in vectors]  # the others would only be copied, too
        arguments = [symbols[name] for name in ("x", "z", "g0", "gm", "g1", *self._given)]
        d = ca.SX.sym("d", len(step.constants))
        follows = {node: d[k] for k, node in enumerate(step.constants)}
        results = [step.program.to_casadi(nodes, leaves, follows) for nodes in (step.new, step.y)]
        self._step = ca.Function("step", [*arguments, d], results)
        arguments = [symbols[name] for name in ("h", "p", "c")]
        self._of_step = ca.Function("of_step", arguments, [step.program.to_casadi(step.constants, leaves, {})])

    def start(self, t: float) -> None:
        self.counts = np.array([np.ceil(t / self.p[s.period] - HIT_TOLERANCE) for s in self.samplers])
        self.sample(t)

    def next_hit(self) -> float:
        return min((c * self.p[s.period] for c, s in zip(self.counts, self.samplers, strict=True)), default=np.inf)

    def sample(self, t: float) -> None:
        due = np.zeros(len(self.samplers))
        w = np.zeros(max((s.draws.stop for s in self.samplers), default=0))
        for k, s in enumerate(self.samplers):
            period = self.p[s.period]
            if self.counts[k] * period <= t + HIT_TOLERANCE * period:
                due[k] = 1.0
                seed = int(self.p[s.seed]) if s.seed is not None else 0
                w[s.draws] = normal_draws(seed, int(self.counts[k]), s.draws.stop - s.draws.start)
                self.counts[k] += 1
        if due.any():
            self.z = np.array(self._update(self.x, t, self.z, self.p, w, due)).ravel()

    def run(self, n0: int, n1: int, t0: float, h: float, every: int, rows: np.ndarray) -> int:
        n, out = n0, 0
        while n < n1:
            ahead = n1 - n
            if self.samplers:
                ahead = min(ahead, max(int((self.next_hit() - t0) / h - n - 1e-9), 0))
            if ahead > 1:
                count = min(ahead, self.CHUNK)
                values = self._steps(n, count, t0, h)
            else:
                count, values = 1, self._one(n, t0, h)
            wanted = np.flatnonzero((np.arange(n, n + count) % every) == 0)
            rows[out : out + len(wanted)] = values[wanted]
            out += len(wanted)
            n += count
            if not sound(self.x):
                break
        return n

    def _steps(self, n: int, count: int, t0: float, h: float) -> np.ndarray:
        if count not in self._many:
            self._many[count] = self._step.mapaccum(f"steps{count}", count)
        g = self._forcing_at(t0 + (n + 0.5 * np.arange(2 * count + 1)) * h)
        z = ca.repmat(ca.DM(self.z), 1, count)
        parts = [ca.DM(np.ascontiguousarray(g[:, k : k + 2 * count : 2])) for k in range(3)]
        of_step = ca.repmat(self._of_step(h, self.p[self._used], self._c), 1, count)
        p, c = self._constants(count)
        given = {"p": p, "c": c, "h": ca.repmat(ca.DM(h), 1, count)}
        arguments = (self.x, z, *parts, *(given[name] for name in self._given), of_step)
        states, y = self._many[count](*arguments)
        self.x = np.array(states)[:, -1]
        return np.array(y).T

    def _forcing_at(self, instants: np.ndarray) -> np.ndarray:
        """Return the forcing at many instants, shape (n_g, n)."""
        n = len(instants)
        return np.array(self._forcing(ca.DM(instants).T, *self._constants(n))).reshape(-1, n)

    def _constants(self, n: int) -> list[ca.DM]:
        """Return the parameters and the constants of the run, n times side by side."""
        if n not in self._repeated:
            self._repeated[n] = [ca.DM(np.repeat(a[:, None], n, 1)) for a in (self.p[self._used], self._c)]
        return self._repeated[n]

    def _one(self, n: int, t0: float, h: float) -> np.ndarray:
        t, end, row = t0 + n * h, t0 + (n + 1) * h, None
        while True:
            stop = self.next_hit()
            if stop > end - HIT_TOLERANCE * h:
                stop = end
            g = self._forcing_at(np.array([t, t + 0.5 * (stop - t), stop]))
            given = {"p": self.p[self._used], "c": self._c, "h": stop - t}
            of_step = self._of_step(given["h"], given["p"], given["c"])
            parts = [*(g[:, k] for k in range(3)), *(given[name] for name in self._given)]
            new, y = self._step(self.x, self.z, *parts, of_step)
            self.x = np.array(new).ravel()
            row = np.array(y).reshape(1, -1) if row is None else row
            self.sample(stop)
            if stop == end:
                return row
            t = stop

    def derivative(self, t: float, x: np.ndarray) -> np.ndarray:
        return np.array(self._f(x, t, self.z, self.p)[0]).ravel()

    def record(self, t: float, x: np.ndarray) -> np.ndarray:
        return np.array(self._f(x, t, self.z, self.p)[1]).ravel()

    def save(self) -> Any:
        return self.x.copy(), self.z.copy(), self.counts.copy()

    def restore(self, saved: Any) -> None:
        self.x, self.z, self.counts = (a.copy() for a in saved)


def normal_draws(seed: int, hit: int, count: int) -> np.ndarray:
    """Return the standard normal draws of one hit (splitmix64 counters and Box-Muller, as runtime.c)."""
    with np.errstate(over="ignore"):
        base = _mix(_mix(np.uint64(seed) + np.uint64(0x9E3779B97F4A7C15)) + np.uint64(hit))
        j = base + np.uint64(2) * np.arange(count, dtype=np.uint64)
        u = (_mix(_mix(j)) >> np.uint64(11)).astype(float) + 0.5
        v = (_mix(_mix(j + np.uint64(1))) >> np.uint64(11)).astype(float)
    return np.asarray(np.sqrt(-2.0 * np.log(u * 2.0**-53)) * np.cos(2 * np.pi * v * 2.0**-53))


def _mix(s: Any) -> Any:
    s = (s ^ (s >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    s = (s ^ (s >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return s ^ (s >> np.uint64(31))
