"""C source of equations of a sampled run: two vectors of expressions with their Jacobians, and what steps them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca

from rotorsim.identification.waveform.driven.equations import DrivenEquations
from rotorsim.linear.sampled import LARGE, SMALL
from rotorsim.model.emit import program as ir
from rotorsim.model.emit.program import Program
from rotorsim.model.emit.writer import Writer, array_leaf, call_table, called_functions

INPUTS = ("t", "x", "v", "p", "c")
MULTIPLY = r"""
/* out += (sparse value) S, whose last rows are the unit vectors of the parameters; RS_K columns. */
static inline void rs_multiply(int count, const int *rows, const int *cols, int inputs, const double *value,
                               const double *S, double *out) {
  for (int e = 0; e < count; ++e) {
    double *restrict to = out + rows[e] * RS_K;
    const double a = value[e];
    if (cols[e] < inputs) {
      const double *restrict from = S + cols[e] * RS_K;
      for (int k = 0; k < RS_K; ++k) to[k] += a * from[k];
    } else {
      to[cols[e] - inputs] += a;
    }
  }
}
"""


def source_of(
    eq: DrivenEquations,
    functions: Mapping[str, Any],
    columns: int,
    runtime: str,
    sizes: Mapping[str, float | str],
    x: Any = None,
) -> tuple[str, int, dict[str, Any]]:
    """Return the C source of a simulation with so many sensitivities, the size of its fixed memory, what it calls.

    functions: expressions of the arguments of the equations, x in the place of their states where it is given. Of "f"
    rs_f is the value and rs_f_jacobian that with derivatives, which rs_multiply_f multiplies with those of x. runtime:
    what steps them. sizes: further macros. Constants of the parameters come first in memory, then RS_WORK numbers and
    RS_JAC.
    """
    t, states, v, p = eq.arguments
    x = states if x is None else x
    width = x.numel() + eq.m
    jacobians = {key: eq.jacobian(of, x) if columns else ca.SX(of.numel(), width) for key, of in functions.items()}
    expressions = [one for key, of in functions.items() for one in (of, jacobians[key].nz[:])]
    function = ca.Function("f", [t, x, v, p], [ca.densify(expression) for expression in expressions])
    program = Program()
    nodes = program.load(function, ("t", "x", "v", "p"))
    hoisted = program.boundary([one for own in nodes for one in own], ir.LEVEL_PARAMETER)
    constants = [k for k in hoisted if program.nodes[k][0] != ir.INPUT]
    given = {node: f"c[{k}]" for k, node in enumerate(constants)}
    called = called_functions([program])
    table, connect = call_table(called)

    def written(name: str, inputs: Sequence[str], known: Mapping[int, str], **out: Sequence[int]) -> tuple[str, int]:
        arguments = ["double t" if key == "t" else f"const double *{key}" for key in inputs]
        arguments += [f"double *{key}" for key in (*out, "work")]
        targets = [(f"{key}[{k}]", node) for key, nodes in out.items() for k, node in enumerate(nodes)]
        call = ", ".join([*inputs, *out, "work"])
        return Writer(program, known, array_leaf, [*called]).text(name, ", ".join(arguments), call, targets)

    parts = [written("rs_constants", ("p",), {}, c=constants)]
    for key, values, slopes in zip(functions, nodes[::2], nodes[1::2], strict=True):
        parts += [written(f"rs_{key}", INPUTS, given, out=values)]
        parts += [written(f"rs_{key}_jacobian", INPUTS, given, out=values, jac=slopes)]
    work, jac = max(size for _, size in parts), max(map(len, nodes[1::2]))
    sizes = {
        "RS_N": eq.n,
        "RS_K": columns,
        "RS_C": len(eq.outputs),
        "RS_NV": len(eq.inputs),
        "RS_NC": len(constants),
        "RS_WORK": work,
        "RS_JAC": jac,
        "RS_LARGE": LARGE,
        "RS_SMALL": SMALL,
        **sizes,
    }
    head = ["#include <math.h>", "#include <stdint.h>", "#include <string.h>"]
    head += [f"#define {name} {value}" for name, value in sizes.items()]
    head += ["#if defined(_WIN32)", "#define RS_EXPORT __declspec(dllexport)", "#else"]
    head += ['#define RS_EXPORT __attribute__((visibility("default")))', "#endif"]
    multiply = []
    for key, jacobian in jacobians.items():
        for name, places in zip(("rows", "cols"), jacobian.sparsity().get_triplet(), strict=True):
            head.append(f"static const int rs_{key}_{name}[] = {{{', '.join(map(str, places)) or 0}}};")
        places = f"{jacobian.nnz()}, rs_{key}_rows, rs_{key}_cols, {x.numel()}"
        multiply.append(f"#define rs_multiply_{key}(value, S, out) rs_multiply({places}, value, S, out)")
    source = "\n".join([*head, table, *(text for text, _ in parts), MULTIPLY, *multiply, runtime, connect])
    return source, len(constants) + work + jac, called
