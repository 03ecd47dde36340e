"""Vectors of the compiler compute, lane by lane, what doubles do."""

from __future__ import annotations

import ctypes
from importlib import resources
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rotorsim.model.emit.numbers import DOUBLES, LANES
from rotorsim.model.emit.program import Program
from rotorsim.model.emit.toolchain import Compiler, compile_c, find_compiler, lane_width
from rotorsim.model.emit.writer import Writer, array_leaf

pytestmark = pytest.mark.skipif(find_compiler() is None, reason="no C compiler")

UNARY = "exp log sqrt sin cos tan asin acos atan floor ceil fabs erf sinh cosh tanh asinh acosh atanh log1p expm1 sign"
NUMBERS = st.floats(width=64, allow_nan=True, allow_infinity=True)


def expressions(x: ca.SX, y: ca.SX) -> ca.SX:
    """Return every operation that generated C knows."""
    both = [x + y, x - y, x * y, x / y, x**y, ca.fmin(x, y), ca.fmax(x, y), ca.fmod(x, y), ca.atan2(x, y)]
    both += [ca.hypot(x, y), ca.copysign(x, y), ca.remainder(x, y), x < y, x <= y, x == y, x != y]
    both += [ca.logic_and(x, y), ca.logic_or(x, y), ca.if_else(x < y, x, -y), 1 / x, x**2, 2 * x, -x]
    return ca.vertcat(*both, ca.logic_not(x), x * 0 + 3.0, *(getattr(ca, name)(x) for name in UNARY.split()))


def compiled(lanes: int) -> tuple[Any, int]:
    """Return a function of two numbers, or vectors of them, in C, and how many results it has."""
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    program = Program(reassociate=False)
    [nodes] = program.load(ca.Function("f", [x, y], [ca.densify(expressions(x, y))]), ("x", "y"))
    numbers, of = (LANES, "rs_lanes") if lanes else (DOUBLES, "double")
    targets = [(f"out[{k}]", node) for k, node in enumerate(nodes)]
    arguments = f"const {of} *x, const {of} *y, {of} *out, {of} *work"
    text, _ = Writer(program, {}, array_leaf, (), numbers).text("f", arguments, "", targets, whole=True)
    head = "#include <math.h>\n#include <stdint.h>\n"
    if lanes:
        head += f"#define RS_LANES {lanes}\n" + resources.files("rotorsim.model.emit").joinpath("lanes.h").read_text()
    call = f"void call(const {of} *x, const {of} *y, {of} *out) {{ f(x, y, out, out); }}\n"
    compiler = find_compiler()
    assert isinstance(compiler, Compiler)
    library, _ = compile_c(head + text + call, compiler)
    library.call.argtypes, library.call.restype = [ctypes.c_void_p] * 3, None
    return library, len(nodes)


def aligned(rows: int, lanes: int) -> np.ndarray:
    room = np.zeros(rows * lanes + 8)
    skip = -room.ctypes.data % 64 // 8
    return room[skip : skip + rows * lanes].reshape(rows, lanes)


@pytest.mark.slow
@pytest.mark.parametrize("lanes", [1, 2, 4, 8])
def test_every_operation_is_that_of_doubles_to_the_last_bit(lanes: int) -> None:
    vectors, n = compiled(lanes)
    doubles, _ = compiled(0)
    x, y, out = aligned(1, lanes), aligned(1, lanes), aligned(n, lanes)
    one = np.zeros(n)

    @settings(max_examples=100, deadline=None, derandomize=True)
    @given(st.lists(st.tuples(NUMBERS, NUMBERS), min_size=lanes, max_size=lanes))
    def check(pairs: list[tuple[float, float]]) -> None:
        x[0], y[0] = np.array(pairs).T
        vectors.call(x.ctypes.data, y.ctypes.data, out.ctypes.data)
        for k in range(lanes):
            a, b = x[:, k].copy(), y[:, k].copy()
            doubles.call(a.ctypes.data, b.ctypes.data, one.ctypes.data)
            mine, same = out[:, k], np.isnan(one) & np.isnan(out[:, k])
            assert (same | (mine == one) & (np.signbit(mine) == np.signbit(one))).all(), (a, b)

    check()


def test_the_width_is_that_of_the_processor(monkeypatch: pytest.MonkeyPatch) -> None:
    macros = {"avx512": "#define __AVX512F__ 1\n#define __AVX__ 1\n", "avx": "#define __AVX__ 1\n"}
    macros |= {"gcc on Windows": "#define _WIN32 1\n#define __AVX__ 1\n"}
    macros |= {"clang on Windows": "#define _WIN32 1\n#define __clang__ 1\n#define __AVX__ 1\n"}
    macros |= {"sse": "#define __SSE2__ 1\n", "arm": "#define __ARM_NEON 1\n", "none": ""}
    widths = {}
    for name, text in macros.items():
        monkeypatch.setattr("rotorsim.model.emit.toolchain._instructions", lambda compiler, text=text: text)
        widths[name] = lane_width(Compiler(("cc",), "cc"))
    windows = {"gcc on Windows": 2, "clang on Windows": 4}
    assert widths == {"avx512": 8, "avx": 4, **windows, "sse": 2, "arm": 2, "none": 1}
