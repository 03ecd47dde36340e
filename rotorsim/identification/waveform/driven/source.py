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
#define RS_MULTIPLY(name, COUNT, rows, cols)                                              \
  static inline void name(const double *value, const double *S, double *out) {            \
    for (int e = 0; e < COUNT; ++e) {                                                     \
      double *restrict to = out + rows[e] * RS_K;                                         \
      const double a = value[e];                                                          \
      if (cols[e] < RS_N) {                                                               \
        const double *restrict from = S + cols[e] * RS_K;                                 \
        for (int k = 0; k < RS_K; ++k) to[k] += a * from[k];                              \
      } else {                                                                            \
        to[cols[e] - RS_N] += a;                                                          \
      }                                                                                   \
    }                                                                                     \
  }
RS_MULTIPLY(rs_multiply_f, RS_F_COUNT, rs_f_rows, rs_f_cols)
RS_MULTIPLY(rs_multiply_g, RS_G_COUNT, rs_g_rows, rs_g_cols)
"""


def source_of(
    eq: DrivenEquations, f: Any, g: Any, columns: int, runtime: str, sizes: Mapping[str, float]
) -> tuple[str, int, dict[str, Any]]:
    """Return the C source of a simulation with so many sensitivities, the size of its fixed memory, what it calls.

    f, g: expressions of the arguments of the equations, for rs_f and rs_g; with rs_f_jacobian and rs_g_jacobian, whose
    places are in rs_f_rows, rs_f_cols ... runtime: what steps them. sizes: further macros. Constants of the parameters
    come first in memory, then RS_WORK numbers and RS_JAC.
    """
    width = eq.n + eq.m
    jacobians = {key: eq.jacobian(of) if columns else ca.SX(of.numel(), width) for key, of in (("f", f), ("g", g))}
    expressions = [f, jacobians["f"].nz[:], g, jacobians["g"].nz[:]]
    function = ca.Function("f", list(eq.arguments), [ca.densify(expression) for expression in expressions])
    program = Program()
    values, slopes, outputs, output_slopes = program.load(function, ("t", "x", "v", "p"))
    hoisted = program.boundary([*values, *slopes, *outputs, *output_slopes], ir.LEVEL_PARAMETER)
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

    parts = [
        written("rs_constants", ("p",), {}, c=constants),
        written("rs_f", INPUTS, given, out=values),
        written("rs_f_jacobian", INPUTS, given, out=values, jac=slopes),
        written("rs_g", INPUTS, given, out=outputs),
        written("rs_g_jacobian", INPUTS, given, out=outputs, jac=output_slopes),
    ]
    work, jac = max(size for _, size in parts), max(len(slopes), len(output_slopes))
    sizes = {
        "RS_N": eq.n,
        "RS_K": columns,
        "RS_C": len(eq.outputs),
        "RS_NV": len(eq.inputs),
        "RS_NC": len(constants),
        "RS_WORK": work,
        "RS_JAC": jac,
        "RS_F_COUNT": len(slopes),
        "RS_G_COUNT": len(output_slopes),
        "RS_LARGE": LARGE,
        "RS_SMALL": SMALL,
        **sizes,
    }
    head = ["#include <math.h>", "#include <stdint.h>", "#include <string.h>"]
    head += [f"#define {name} {value}" for name, value in sizes.items()]
    head += ["#if defined(_WIN32)", "#define RS_EXPORT __declspec(dllexport)", "#else"]
    head += ['#define RS_EXPORT __attribute__((visibility("default")))', "#endif"]
    for name, jacobian in jacobians.items():
        for key, places in zip(("rows", "cols"), jacobian.sparsity().get_triplet(), strict=True):
            head.append(f"static const int rs_{name}_{key}[] = {{{', '.join(map(str, places)) or 0}}};")
    source = "\n".join([*head, table, *(text for text, _ in parts), MULTIPLY, runtime, connect])
    return source, len(constants) + work + jac, called
