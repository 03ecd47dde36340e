"""Emit a traced diagram as C: constants of a run, forcing of an instant, right-hand side, RK4 step.

What depends on parameters only is computed once per run (`rs_constants`), what depends on time and
parameters once per instant (`rs_forcing`; the instant t + h serves the next step too), and only the rest
in each of the four stages. Small diagrams get the whole RK4 step as one straight function, so that
terms shared by stages are computed once, what follows from the length of the step once per run
(`rs_step_constants`), and what is linear is one sum; large ones get the right-hand side, called four times.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial, reduce
from importlib import resources
from typing import Any

import casadi as ca

from rotorsim.model.emit import program as ir
from rotorsim.model.emit.affine import collapse_linear
from rotorsim.model.emit.angle_recurrence import share_harmonics
from rotorsim.model.emit.numbers import DOUBLES, LANES, Numbers
from rotorsim.model.emit.program import Pass, Program
from rotorsim.model.emit.turning import ANGLE_NUMBERS, Angle, emit_angles, turning_angles
from rotorsim.model.emit.writer import Writer, array_leaf, call_table, called_functions
from rotorsim.model.runge_kutta import RK4
from rotorsim.model.trace.diagram import Trace

MOST_COLLAPSED = 400  # operations of the right-hand side above which it is not tried to collapse them
UNROLL_LIMIT = 1500  # operations of the right-hand side above which the step is not unrolled
STEP_INPUTS = {"p": ir.LEVEL_PARAMETER, "c": ir.LEVEL_PARAMETER, "h": ir.LEVEL_PARAMETER}
FORCING_AT = {0.0: "g0", 0.5: "gm", 1.0: "g1"}  # forcing at t + c h


@dataclass(frozen=True)
class Kernel:
    """The programs of one diagram, cut by what they depend on.

    constants, forcing: nodes of ``program`` computed per run and per instant; xdot, outputs, update: nodes.
    angles: of sines and cosines in the forcing that a run may get by rotation.
    """

    program: Program
    constants: tuple[int, ...]
    forcing: tuple[int, ...]
    xdot: tuple[int, ...]
    outputs: tuple[int, ...]
    update: tuple[int, ...]
    trace: Trace
    angles: tuple[Angle, ...] = ()
    sizes: Mapping[str, int] = field(default_factory=dict)

    @property
    def unrolled(self) -> bool:
        """Whether the whole RK4 step is one function."""
        given = dict.fromkeys((*self.constants, *self.forcing))
        return len(self.program.needed(self.xdot, given)) <= UNROLL_LIMIT

    @property
    def called(self) -> dict[str, Any]:
        """The functions that it calls, by name."""
        return called_functions([self.program])


def build_kernel(trace: Trace, record: Sequence[ca.SX]) -> Kernel:
    """Turn a trace into programs; ``record`` are the columns to be recorded (loop residuals are added)."""
    recorded = ca.vertcat(*record, trace.loop_residuals)
    function = ca.Function(
        "diagram",
        [trace.t, trace.x, trace.z, trace.p, trace.v, trace.w, trace.hit],
        [ca.densify(trace.xdot), ca.densify(recorded), ca.densify(trace.z_next)],
        {"allow_free": False},
    )
    program = Program(reassociate=False)
    xdot, outputs, update = program.load(function, ("t", "x", "z", "p", "v", "w", "hit"))
    program.reassociate = True
    n, m = len(xdot), len(outputs)
    nodes = [*xdot, *outputs, *update]
    passes: tuple[Pass, ...] = (share_harmonics, partial(collapse_linear, n_rates=n, most=MOST_COLLAPSED))
    for rewrite in passes:
        program, nodes = rewrite(program, nodes)
    moving = [k for k in program.boundary(nodes, ir.LEVEL_TIME) if program.levels[k] == ir.LEVEL_TIME]
    hoisted = program.boundary([*nodes, *moving], ir.LEVEL_PARAMETER)
    ordered = [k for k in hoisted if program.nodes[k][0] != ir.INPUT]
    return Kernel(
        program=program,
        constants=tuple(ordered),
        forcing=tuple(moving),
        xdot=tuple(nodes[:n]),
        outputs=tuple(nodes[n : n + m]),
        update=tuple(nodes[n + m :]),
        trace=trace,
        angles=() if trace.samplers else turning_angles(program, moving),
        sizes={"RS_NX": n, "RS_NZ": len(update), "RS_NY": m, "RS_NS": len(trace.samplers), "RS_NW": trace.w.numel()},
    )


def emit_c(kernel: Kernel, calling: tuple[Sequence[str], str] | None = None, lanes: int = 0) -> str:
    """Return the whole C source of a diagram: generated functions, then the runtime.

    calling: names of the functions that it calls, and the C text of `rs_call(k, arguments, results)`, by which it calls
    number k of them; default: those of a library that is connected (`rotorsim.model.called.connect`).
    lanes: runs of an ensemble side by side, with the runtime lanes.c; 0: one run, with runtime.c.
    """
    numbers = LANES if lanes else DOUBLES
    program = kernel.program
    table, connect = call_table(kernel.called)
    called: Sequence[str] = [*kernel.called]
    if calling is not None:
        (called, table), connect = calling, ""
    constants = {node: f"c[{k}]" for k, node in enumerate(kernel.constants)}
    forcing = {node: f"g[{k}]" for k, node in enumerate(kernel.forcing)}
    given = {**forcing, **constants}
    of = numbers.type
    state = f"const {of} *x, const {of} *z, const {of} *p, const {of} *c, const {of} *g"

    def written(
        name: str, known: Mapping[int, str], inputs: str, call: str, out: str, nodes: Sequence[int]
    ) -> tuple[str, int]:
        targets = [(f"{out}[{k}]", node) for k, node in enumerate(nodes)]
        arguments = f"{inputs}, {of} *restrict {out}, {of} *restrict work"
        writer = Writer(program, known, array_leaf, called, numbers)
        return writer.text(name, arguments, f"{call}, {out}, work", targets)

    at_time = f"{of} t, const {of} *restrict p, const {of} *restrict c"
    parts = [
        written("rs_constants", {}, f"const {of} *restrict p", "p", "c", kernel.constants),
        written("rs_forcing", constants, at_time, "t, p, c", "g", kernel.forcing),
        _turning(kernel, written, constants, at_time, of),
        written("rs_rhs", given, state, "x, z, p, c, g", "xdot", kernel.xdot),
        written("rs_outputs", given, state, "x, z, p, c, g", "y", kernel.outputs),
    ]
    if kernel.trace.samplers:
        at_hit = f"{state}, const {of} *w, const {of} *hit"
        parts.append(written("rs_update", given, at_hit, "x, z, p, c, g, w, hit", "zn", kernel.update))
    step = step_program(kernel) if kernel.unrolled else None
    parts += _unrolled_step(step, called, numbers) if step else [(_staged_step(of), 0)]
    sizes = {
        **kernel.sizes,
        "RS_NC": len(kernel.constants),
        "RS_NG": len(kernel.forcing),
        "RS_NA": len(kernel.angles),
        "RS_ANGLE": ANGLE_NUMBERS,
        "RS_ND": len(step.constants) if step else 0,
        "RS_STAGES": len(RK4.b),
        "RS_WORK": max(size for _, size in parts),
        "RS_UNROLLED": int(kernel.unrolled),
        **({"RS_LANES": lanes, "RS_NP": kernel.trace.p.numel()} if lanes else {}),
    }
    head = ["#include <math.h>", "#include <stdint.h>", "#include <string.h>"]
    head += [f"#define {name} {value}" for name, value in sizes.items()]
    for name, values in (
        ("rs_period", [s.period for s in kernel.trace.samplers]),
        ("rs_seed", [s.seed or 0 for s in kernel.trace.samplers]),
        ("rs_draw_begin", [s.draws.start for s in kernel.trace.samplers]),
        ("rs_draw_end", [s.draws.stop for s in kernel.trace.samplers]),
    ):
        if values:
            head.append(f"static const int {name}[] = {{{', '.join(map(str, values))}}};")
    head += [_file("lanes.h")] if lanes else []
    return "\n".join(
        [
            *head,
            table,
            *(text for text, _ in parts),
            _file("layout.h"),
            _file("lanes.c" if lanes else "runtime.c"),
            connect,
        ]
    )


def _file(name: str) -> str:
    return resources.files("rotorsim.model.emit").joinpath(name).read_text(encoding="utf-8")


def _turning(
    kernel: Kernel, written: Callable[..., tuple[str, int]], constants: Mapping[int, str], at_time: str, of: str
) -> tuple[str, int]:
    """Return the text of the angles, and of the forcing where their cosines and sines are known."""
    if not kernel.angles:
        return "", 0
    turned = {one.cosine: f"a[{ANGLE_NUMBERS * k}]" for k, one in enumerate(kernel.angles)}
    turned |= {one.sine: f"a[{ANGLE_NUMBERS * k + 1}]" for k, one in enumerate(kernel.angles)}
    known = {node: text for node, text in turned.items() if node >= 0} | dict(constants)
    text, size = written(
        "rs_forcing_turned", known, f"{at_time}, const {of} *restrict a", "t, p, c, a", "g", kernel.forcing
    )
    before, angles = emit_angles(kernel.program, kernel.angles)
    return "\n".join([before, _file("turning.c"), angles, text]), size


@dataclass(frozen=True)
class StepProgram:
    """The step of `RK4` as one program with shared terms.

    Its inputs are x, z, p, c (constants of the run), g0, gm, g1 (forcing at t, t + h/2, t + h) and h.
    x: nodes of the states; constants: those that follow from h, c and p; y: recorded at the start of the step; new: the
    states after it.
    """

    program: Program
    x: tuple[int, ...]
    constants: tuple[int, ...]
    y: tuple[int, ...]
    new: tuple[int, ...]


def step_program(kernel: Kernel) -> StepProgram:
    """Put the stages of a step of `RK4` into one program, so that terms they share are computed once."""
    step = Program(reassociate=False, inputs=STEP_INPUTS)
    old = kernel.program
    h = step.input("h", 0)
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
            is_state = op == ir.INPUT and a == "x"
            known[number] = state[b] if is_state else step.copied(old.nodes[number], known)
        return [known[node] for node in nodes]

    stages: list[list[int]] = []
    y: list[int] = []
    for row, c in zip(RK4.a, RK4.c, strict=True):
        state = x
        for a, k in zip(row, stages, strict=True):
            if a:
                by = h if a == 1.0 else step.apply(ir.MUL, step.constant(a), h)
                state = [step.apply(ir.ADD, s, step.apply(ir.MUL, by, k[i])) for i, s in enumerate(state)]
        values = evaluate([*kernel.xdot, *([] if stages else kernel.outputs)], state, FORCING_AT[c])
        y = y or values[n:]
        stages.append(values[:n])
    unit = min(RK4.b)
    share = step.apply(ir.DIV, h, step.constant(1 / unit))
    new = []
    for i in range(n):  # h / 6 ((k_1 + k_4) + 2 (k_2 + k_3)): terms of equal weight together
        total = -1
        for weight in sorted({round(b / unit) for b in RK4.b}):
            terms = [k[i] for k, b in zip(stages, RK4.b, strict=True) if round(b / unit) == weight]
            part = reduce(lambda one, other: step.apply(ir.ADD, one, other), terms)
            part = part if weight == 1 else step.apply(ir.MUL, step.constant(float(weight)), part)
            total = part if total < 0 else step.apply(ir.ADD, total, part)
        new.append(step.apply(ir.ADD, x[i], step.apply(ir.MUL, share, total)))
    nodes = [*new, *y]
    if not kernel.trace.samplers:  # whose steps have many lengths
        step, nodes = collapse_linear(step, nodes, n_rates=n, most=4 * MOST_COLLAPSED)
    x = [step.input("x", i) for i in range(n)]
    constants = [k for k in step.boundary(nodes, ir.LEVEL_PARAMETER) if step.nodes[k][0] != ir.INPUT]
    return StepProgram(step, tuple(x), tuple(constants), tuple(nodes[n:]), tuple(nodes[:n]))


def _step_arguments(of: str) -> str:
    given = ", ".join(f"const {of} *restrict {name}" for name in ("z", "p", "c", "g0", "gm", "g1", "d"))
    return f"{of} h, {of} *restrict x, {given}, {of} *restrict y, {of} *restrict k, {of} *restrict work"


def _unrolled_step(step: StepProgram, called: Sequence[str], numbers: Numbers) -> list[tuple[str, int]]:
    """Write the constants of the step, and the step, as one C function each."""

    def leaf(node: tuple[int, object, int]) -> str:
        _, vector, position = node
        return "h" if vector == "h" else f"{vector}[{position}]"

    of = numbers.type
    of_step = f"{of} h, const {of} *restrict p, const {of} *restrict c, {of} *restrict d, {of} *restrict work"
    targets = [(f"d[{k}]", node) for k, node in enumerate(step.constants)]
    constants = Writer(step.program, {}, leaf, called, numbers).text(
        "rs_step_constants", of_step, "", targets, whole=True
    )
    loads = "".join(f"  const {of} x_{i} = x[{i}];\n" for i in range(len(step.x)))
    given = {node: f"x_{i}" for i, node in enumerate(step.x)}
    given |= {node: f"d[{k}]" for k, node in enumerate(step.constants)}
    targets = [(f"y[{k}]", node) for k, node in enumerate(step.y)]
    targets += [(f"x[{i}]", node) for i, node in enumerate(step.new)]
    arguments = _step_arguments(of)
    text, size = Writer(step.program, given, leaf, called, numbers).text("rs_step", arguments, "", targets, whole=True)
    return [constants, (text.replace("{\n", "{\n" + loads + "  (void)k, (void)d, (void)h;\n", 1), size)]


def _staged_step(of: str) -> str:
    """Write the step as calls of the right-hand side, k_j in row j of k and the state of a stage behind them."""

    def combined(weights: Sequence[float]) -> str:
        terms = [f"{weight!r} * k[{j} * RS_NX + i]" for j, weight in enumerate(weights) if weight]
        return f"x[i] + h * ({' + '.join(terms)})"

    each = "  for (int i = 0; i < RS_NX; ++i)"
    lines = ["  (void)d;", "  rs_outputs(x, z, p, c, g0, y, work);", f"  {of} *restrict at = k + RS_STAGES * RS_NX;"]
    for stage, (row, c) in enumerate(zip(RK4.a, RK4.c, strict=True)):
        if any(row):
            lines.append(f"{each} at[i] = {combined(row)};")
        state = "at" if any(row) else "x"
        lines.append(f"  rs_rhs({state}, z, p, c, {FORCING_AT[c]}, k + {stage} * RS_NX, work);")
    lines.append(f"{each} x[i] = {combined(RK4.b)};")
    return "\n".join([f"static void rs_step({_step_arguments(of)}) {{", *lines, "}", ""])
