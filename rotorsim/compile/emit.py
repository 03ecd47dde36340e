"""Emit a traced diagram as C: constants of a run, forcing of an instant, right-hand side, RK4 step.

What depends on parameters only is computed once per run (`rs_constants`), what depends on time and
parameters once per instant (`rs_forcing`; the instant t + h serves the next step too), and only the rest
in each of the four stages. Small diagrams get the whole RK4 step as one straight function, so that
terms shared by stages are computed once; large ones get the right-hand side, called four times.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from importlib import resources

import casadi as ca

from rotorsim.compile import program as ir
from rotorsim.compile.affine import collapse_linear
from rotorsim.compile.harmonics import share_harmonics
from rotorsim.compile.pairing import paired_constants, paired_states
from rotorsim.compile.program import Program
from rotorsim.compile.trace import Trace

__all__ = ["Kernel", "StepProgram", "build_kernel", "emit_c", "step_program"]

UNROLL_LIMIT = 1500  # operations of the right-hand side above which the step is not unrolled
LARGEST_PAIRED = 200  # states up to which axes of one form are laid out side by side
CHUNK = 200  # statements per C function of large diagrams (compilers are slow on long functions)

_INFIX = {ca.OP_ADD: "+", ca.OP_SUB: "-", ca.OP_MUL: "*", ca.OP_DIV: "/"}
_COMPARE = {ca.OP_LT: "<", ca.OP_LE: "<=", ca.OP_EQ: "==", ca.OP_NE: "!=", ca.OP_AND: "&&", ca.OP_OR: "||"}
_CALL = {
    ca.OP_EXP: "exp", ca.OP_LOG: "log", ca.OP_POW: "pow", ca.OP_CONSTPOW: "pow", ca.OP_SQRT: "sqrt", ca.OP_SIN: "sin",
    ca.OP_COS: "cos", ca.OP_TAN: "tan", ca.OP_ASIN: "asin", ca.OP_ACOS: "acos", ca.OP_ATAN: "atan",
    ca.OP_FLOOR: "floor", ca.OP_CEIL: "ceil", ca.OP_FMOD: "fmod", ca.OP_FABS: "fabs", ca.OP_COPYSIGN: "copysign",
    ca.OP_ERF: "erf", ca.OP_FMIN: "fmin", ca.OP_FMAX: "fmax", ca.OP_SINH: "sinh", ca.OP_COSH: "cosh",
    ca.OP_TANH: "tanh", ca.OP_ASINH: "asinh", ca.OP_ACOSH: "acosh", ca.OP_ATANH: "atanh", ca.OP_ATAN2: "atan2",
    ca.OP_LOG1P: "log1p", ca.OP_EXPM1: "expm1", ca.OP_HYPOT: "hypot", ca.OP_REMAINDER: "remainder",
}  # fmt: skip
_FORMAT: dict[int, Callable[[str, str], str]] = {
    ca.OP_NEG: lambda a, _: f"-{a}",
    ca.OP_SQ: lambda a, _: f"{a} * {a}",
    ca.OP_TWICE: lambda a, _: f"{a} + {a}",
    ca.OP_INV: lambda a, _: f"1.0 / {a}",
    ca.OP_NOT: lambda a, _: f"!{a}",
    ca.OP_SIGN: lambda a, _: f"({a} > 0) - ({a} < 0)",
    ca.OP_IF_ELSE_ZERO: lambda a, b: f"{a} != 0 ? {b} : 0.0",
}


@dataclass(frozen=True)
class Kernel:
    """The programs of one diagram, cut by what they depend on.

    constants, forcing: nodes of ``program`` computed per run and per instant; xdot, outputs, update: nodes.
    order: the states as the unrolled step lays them out.
    """

    program: Program
    constants: tuple[int, ...]
    forcing: tuple[int, ...]
    xdot: tuple[int, ...]
    outputs: tuple[int, ...]
    update: tuple[int, ...]
    trace: Trace
    order: tuple[int, ...] = ()
    sizes: Mapping[str, int] = field(default_factory=dict)

    @property
    def unrolled(self) -> bool:
        """Whether the whole RK4 step is one function."""
        given = dict.fromkeys((*self.constants, *self.forcing))
        return len(self.program.needed(self.xdot, given)) <= UNROLL_LIMIT


def build_kernel(trace: Trace, record: Sequence[ca.SX]) -> Kernel:
    """Turn a trace into programs; ``record`` are the columns to be recorded (loop residuals are added)."""
    recorded = ca.vertcat(*record, trace.loop_residuals)
    function = ca.Function(
        "diagram",
        [trace.t, trace.x, trace.z, trace.p, trace.v, trace.w, trace.hit],
        [ca.densify(trace.xdot), ca.densify(recorded), ca.densify(trace.z_next)],
        {"allow_free": False},
    )
    raw = Program(reassociate=False)
    names = ["t", "x", "z", "p", "v", "w", "hit"]
    leaves = [lambda i, name=name: raw.input(name, i) for name in names]
    xdot, outputs, update = raw.load(function, leaves)
    raw.reassociate = True
    program, nodes = share_harmonics(raw, [*xdot, *outputs, *update])
    n, m = len(xdot), len(outputs)
    program, nodes = collapse_linear(program, nodes[:n], nodes[n:])
    forcing = program.boundary(nodes, ir.LEVEL_TIME)
    moving = [k for k in forcing if program.levels[k] == ir.LEVEL_TIME]
    constants = [
        k
        for k in program.boundary([*nodes, *moving], ir.LEVEL_PARAMETER)
        if program.levels[k] == ir.LEVEL_PARAMETER and program.nodes[k][0] != ir.INPUT
    ]
    extra = _constants_behind(program, moving)
    ordered = sorted({*constants, *extra})
    groups = [[state] for state in range(n)]
    if n <= LARGEST_PAIRED:
        groups = paired_states(program, nodes[:n])
        ordered = paired_constants(program, nodes[:n], groups, ordered)
    return Kernel(
        program=program,
        constants=tuple(ordered),
        forcing=tuple(moving),
        xdot=tuple(nodes[:n]),
        outputs=tuple(nodes[n : n + m]),
        update=tuple(nodes[n + m :]),
        trace=trace,
        order=tuple(state for group in groups for state in group),
        sizes={
            "RS_NX": n,
            "RS_NZ": len(update),
            "RS_NY": m,
            "RS_NS": len(trace.samplers),
            "RS_NW": trace.w.numel(),
        },
    )


def _constants_behind(program: Program, moving: Sequence[int]) -> list[int]:
    """Return the parameter-only nodes that the forcing itself needs."""
    found: set[int] = set()
    seen: set[int] = set()
    stack = list(moving)
    while stack:
        number = stack.pop()
        if number in seen:
            continue
        seen.add(number)
        op, a, b = program.nodes[number]
        if op in (ir.INPUT, ir.CONSTANT):
            continue
        if program.levels[number] <= ir.LEVEL_PARAMETER:
            found.add(number)
            continue
        stack.append(int(a))
        if b >= 0:
            stack.append(b)
    return list(found)


class _Writer:
    """Writes one C function (several, when it is long)."""

    def __init__(self, program: Program, given: Mapping[int, str], leaf: Callable[[ir.Node], str]) -> None:
        self.program = program
        self.given = given
        self.leaf = leaf

    def text(
        self, name: str, arguments: str, call: str, targets: Sequence[tuple[str, int]], whole: bool = False
    ) -> tuple[str, int]:
        """Return the C text and the work space needed; ``whole``: one function, however long."""
        order = [
            k
            for k in self.program.needed([node for _, node in targets], self.given)
            if k not in self.given and self.program.nodes[k][0] not in (ir.INPUT, ir.CONSTANT)
        ]
        if whole or len(order) <= 6 * CHUNK:
            lines = [f"  const double {self._name(k)} = {self._expression(k, self._operand)};" for k in order]
            lines += [f"  {target} = {self._operand(node)};" for target, node in targets]
            return f"static void {name}({arguments}) {{\n" + "\n".join(lines) + "\n  (void)work;\n}\n", 0
        return self._chunked(name, arguments, call, targets, order)

    def _chunked(
        self, name: str, arguments: str, call: str, targets: Sequence[tuple[str, int]], order: list[int]
    ) -> tuple[str, int]:
        where = {k: i // CHUNK for i, k in enumerate(order)}
        last_use = dict(where)
        for k in order:
            _, a, b = self.program.nodes[k]
            for operand in (int(a), b):
                if operand in where:
                    last_use[operand] = max(last_use[operand], where[k])
        n_chunks = where[order[-1]] + 1
        for _, node in targets:
            if node in where:
                last_use[node] = n_chunks
        slots: dict[int, int] = {}
        free: list[int] = []
        released: dict[int, list[int]] = {}
        text: list[str] = []
        size = 0
        for chunk in range(n_chunks):
            lines = []
            for k in order[chunk * CHUNK : (chunk + 1) * CHUNK]:
                expression = self._expression(k, partial(self._chunk_operand, where, slots, chunk))
                lines.append(f"  const double {self._name(k)} = {expression};")
                if last_use[k] > chunk:
                    if free:
                        slot = free.pop()
                    else:
                        slot, size = size, size + 1
                    slots[k] = slot
                    released.setdefault(last_use[k], []).append(slot)
                    lines.append(f"  work[{slot}] = {self._name(k)};")
            free += released.pop(chunk, [])  # reusable from the next chunk on
            text.append(f"static void {name}_{chunk}({arguments}) {{\n" + "\n".join(lines) + "\n}\n")
        final = [f"  {t} = {self._chunk_operand(where, slots, n_chunks, node)};" for t, node in targets]
        for start in range(0, len(final), CHUNK):
            body = "\n".join(final[start : start + CHUNK])
            text.append(f"static void {name}_out{start // CHUNK}({arguments}) {{\n{body}\n}}\n")
        calls = [f"  {name}_{chunk}({call});" for chunk in range(n_chunks)]
        calls += [f"  {name}_out{k}({call});" for k in range(math.ceil(len(final) / CHUNK))]
        text.append(f"static void {name}({arguments}) {{\n" + "\n".join(calls) + "\n}\n")
        return "\n".join(text), size

    def _chunk_operand(self, where: Mapping[int, int], slots: Mapping[int, int], chunk: int, node: int) -> str:
        if node in where and where[node] < chunk and node not in self.given:
            return f"work[{slots[node]}]"
        return self._operand(node)

    @staticmethod
    def _name(number: int) -> str:
        return f"v{number}"

    def _operand(self, number: int) -> str:
        if number in self.given:
            return self.given[number]
        op, a, _ = self.program.nodes[number]
        if op == ir.CONSTANT:
            return _literal(float(a))
        return self.leaf(self.program.nodes[number]) if op == ir.INPUT else self._name(number)

    def _expression(self, number: int, operand: Callable[[int], str]) -> str:
        op, a, b = self.program.nodes[number]
        left = operand(int(a))
        right = operand(b) if b >= 0 else ""
        if op in _INFIX:
            return f"{left} {_INFIX[op]} {right}"
        if op in _COMPARE:
            return f"{left} {_COMPARE[op]} {right}"
        if op in _CALL:
            return f"{_CALL[op]}({left}, {right})" if right else f"{_CALL[op]}({left})"
        return _FORMAT[op](left, right)


def _literal(value: float) -> str:
    if math.isnan(value):
        return "NAN"
    if math.isinf(value):
        return "INFINITY" if value > 0 else "(-INFINITY)"
    text = repr(value)
    return f"({text})" if value < 0 or text.startswith("-") else text


def _array_leaf(node: tuple[int, object, int]) -> str:
    _, vector, position = node
    return "t" if vector == "t" else f"{vector}[{position}]"


def emit_c(kernel: Kernel) -> str:
    """Return the whole C source of a diagram: generated functions, then the runtime."""
    program = kernel.program
    constants = {node: f"c[{k}]" for k, node in enumerate(kernel.constants)}
    forcing = {node: f"g[{k}]" for k, node in enumerate(kernel.forcing)}
    given = {**forcing, **constants}
    state = "const double *x, const double *z, const double *p, const double *c, const double *g"
    parts: list[tuple[str, int]] = [
        _Writer(program, {}, _array_leaf).text(
            "rs_constants",
            "const double *restrict p, double *restrict c, double *restrict work",
            "p, c, work",
            [(f"c[{k}]", node) for k, node in enumerate(kernel.constants)],
        ),
        _Writer(program, constants, _array_leaf).text(
            "rs_forcing",
            "double t, const double *restrict p, const double *restrict c, double *restrict g, double *restrict work",
            "t, p, c, g, work",
            [(f"g[{k}]", node) for k, node in enumerate(kernel.forcing)],
        ),
        _Writer(program, given, _array_leaf).text(
            "rs_rhs",
            f"{state}, double *restrict xdot, double *restrict work",
            "x, z, p, c, g, xdot, work",
            [(f"xdot[{k}]", node) for k, node in enumerate(kernel.xdot)],
        ),
        _Writer(program, given, _array_leaf).text(
            "rs_outputs",
            f"{state}, double *restrict y, double *restrict work",
            "x, z, p, c, g, y, work",
            [(f"y[{k}]", node) for k, node in enumerate(kernel.outputs)],
        ),
    ]
    if kernel.trace.samplers:
        parts.append(
            _Writer(program, given, _array_leaf).text(
                "rs_update",
                f"{state}, const double *w, const double *hit, double *restrict zn, double *restrict work",
                "x, z, p, c, g, w, hit, zn, work",
                [(f"zn[{k}]", node) for k, node in enumerate(kernel.update)],
            )
        )
    if kernel.unrolled:
        parts.append(_unrolled_step(kernel))
    sizes = {
        **kernel.sizes,
        "RS_NC": len(kernel.constants),
        "RS_NG": len(kernel.forcing),
        "RS_WORK": max(size for _, size in parts),
        "RS_UNROLLED": int(kernel.unrolled),
    }
    head = ["#include <math.h>", "#include <stdint.h>", "#include <string.h>"]
    head += [f"#define {name} {value}" for name, value in sizes.items()]
    order = ", ".join(map(str, kernel.order)) or "0"
    head.append(f"static const int rs_order[] = {{{order}}};")
    samplers = kernel.trace.samplers
    if samplers:
        for name, values in (
            ("rs_period", [s.period for s in samplers]),
            ("rs_seed", [s.seed or 0 for s in samplers]),
            ("rs_draw_begin", [s.draws.start for s in samplers]),
            ("rs_draw_end", [s.draws.stop for s in samplers]),
        ):
            head.append(f"static const int {name}[] = {{{', '.join(map(str, values))}}};")
    runtime = resources.files("rotorsim.compile").joinpath("runtime.c").read_text(encoding="utf-8")
    return "\n".join([*head, *(text for text, _ in parts), runtime])


@dataclass(frozen=True)
class StepProgram:
    """The classical Runge-Kutta step (Kutta 1901) as one program with shared terms.

    Its inputs are x, z, p, c (constants of the run), g0, gm, g1 (forcing at t, t + h/2, t + h) and h.
    x: nodes of the states; y: recorded at the start of the step; new: the states after it.
    """

    program: Program
    x: tuple[int, ...]
    y: tuple[int, ...]
    new: tuple[int, ...]


def step_program(kernel: Kernel) -> StepProgram:
    """Put the four stages of a step into one program, so that terms they share are computed once."""
    step = Program(reassociate=False)
    old = kernel.program
    h = step.input("h", 0)
    half, sixth = step.apply(ir.MUL, step.constant(0.5), h), step.apply(ir.DIV, h, step.constant(6.0))
    n = len(kernel.xdot)
    x = [step.input("x", i) for i in range(n)]
    at_constants = {node: step.input("c", k) for k, node in enumerate(kernel.constants)}

    def evaluate(nodes: Sequence[int], state: Sequence[int], instant: str) -> list[int]:
        known = dict(at_constants)
        known.update({node: step.input(instant, k) for k, node in enumerate(kernel.forcing)})
        for number in old.needed(nodes, known):
            if number in known:
                continue
            op, a, b = old.nodes[number]
            if op == ir.INPUT:
                known[number] = state[b] if a == "x" else step.input(str(a), b)
            elif op == ir.CONSTANT:
                known[number] = step.constant(float(a))
            else:
                known[number] = step.apply(op, known[int(a)], known[b] if b >= 0 else -1)
        return [known[node] for node in nodes]

    def moved(slope: Sequence[int], by: int) -> list[int]:
        return [step.apply(ir.ADD, x[i], step.apply(ir.MUL, by, slope[i])) for i in range(n)]

    values = evaluate([*kernel.xdot, *kernel.outputs], x, "g0")
    k1, y = values[:n], values[n:]
    k2 = evaluate(kernel.xdot, moved(k1, half), "gm")
    k3 = evaluate(kernel.xdot, moved(k2, half), "gm")
    k4 = evaluate(kernel.xdot, moved(k3, h), "g1")
    new = []
    for i in range(n):
        middle = step.apply(ir.TWICE, step.apply(ir.ADD, k2[i], k3[i]))
        total = step.apply(ir.ADD, step.apply(ir.ADD, k1[i], k4[i]), middle)
        new.append(step.apply(ir.ADD, x[i], step.apply(ir.MUL, sixth, total)))
    return StepProgram(step, tuple(x), tuple(y), tuple(new))


def _unrolled_step(kernel: Kernel) -> tuple[str, int]:
    """Write the step as one C function."""
    step = step_program(kernel)

    def leaf(node: tuple[int, object, int]) -> str:
        _, vector, position = node
        return "h" if vector == "h" else f"{vector}[{position}]"

    loads = "".join(f"  const double x_{i} = x[{k}];\n" for k, i in enumerate(kernel.order))
    given = {node: f"x_{i}" for i, node in enumerate(step.x)}
    targets = [(f"y[{k}]", node) for k, node in enumerate(step.y)]
    targets += [(f"x[{k}]", step.new[i]) for k, i in enumerate(kernel.order)]
    arguments = (
        "double *restrict x, const double *restrict z, const double *restrict p, const double *restrict c, "
        "const double *restrict g0, const double *restrict gm, const double *restrict g1, double h, "
        "double *restrict y, double *restrict k, double *restrict work"
    )
    writer = _Writer(step.program, given, leaf)
    text, size = writer.text("rs_step", arguments, "x, z, p, c, g0, gm, g1, h, y, k, work", targets, whole=True)
    return text.replace("{\n", "{\n" + loads + "  (void)k;\n", 1), size
