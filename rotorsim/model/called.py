"""Functions without an expression, called from compiled code: of parts of a diagram whose equations are elsewhere.

A failure inside cannot pass through C: it is kept, what was asked for is not a number, and whoever ran the code asks
for it (`raise_failure`). Every function is told by its name, which no two share.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from rotorsim.model.heard import tell

STEADY = "steady"  # in the name of functions of parameters alone: what they gave last holds for the same arguments
Address = ctypes.c_void_p
CALLED = ctypes.CFUNCTYPE(None, Address, ctypes.POINTER(ctypes.c_double), ctypes.POINTER(ctypes.c_double))
CALLED_AT = ctypes.CFUNCTYPE(None, Address, Address, Address)  # the same with plain addresses
_made: dict[str, tuple[int, int, Any]] = {}  # a library that was loaded holds them as long as the process lives
_failures: list[BaseException] = []


def connect(library: ctypes.CDLL, called: Mapping[str, Any]) -> None:
    """Tell a library the functions that it calls, in the order of its table (`call_table`)."""
    if not called:
        return
    for name, function in called.items():
        if name not in _made:
            trampoline = CALLED(_caller(function))
            _made[name] = ctypes.cast(trampoline, Address).value or 0, 0, trampoline
    pairs = [address for name in called for address in _made[name][:2]]
    library.rs_connect((Address * len(pairs))(*pairs))


def register(name: str, function: int, context: int, keep: Any) -> None:
    """Let a C function answer for a function of this name: its address and that of its context, its first argument.

    keep: what both need. Libraries that are loaded already go on as they are.
    """
    _made.setdefault(name, (function, context, keep))


def called_with(function: Any, nonzeros: Sequence[Any]) -> list[Any]:
    """Return the nonzeros of all results of a function, as expressions, from those of all its arguments."""
    given, arguments = iter(nonzeros), []
    for k in range(function.n_in()):
        sparsity = function.sparsity_in(k)
        arguments.append(ca.SX(sparsity, ca.vertcat(*[next(given) for _ in range(sparsity.nnz())])))
    return [one for result in function.call(arguments) for one in ca.vertsplit(result.nz[:])]


def steady_arguments(function: Any) -> tuple[int, ...]:
    """Return the arguments of a function that calls of parameters alone (`STEADY`) inside follow."""
    found: set[int] = set()
    if not function.get_function():
        return ()
    called = function.instructions_sx()
    work: list[frozenset[int]] = [frozenset()] * function.sz_w()  # the arguments that each number follows
    for k in range(function.n_instructions()):
        op, places, to = function.instruction_id(k), function.instruction_input(k), function.instruction_output(k)
        if op == ca.OP_OUTPUT:
            continue
        follows = frozenset(places[:1]) if op == ca.OP_INPUT else frozenset().union(*(work[place] for place in places))
        if op == ca.OP_CONST:
            follows = frozenset()
        elif op == ca.OP_CALL and STEADY in called[k].which_function().name():
            found |= follows
        for place in (place for place in to if place >= 0):
            work[place] = follows
    return tuple(sorted(found))


def note_failure(error: BaseException) -> None:
    """Keep a failure inside a called function for `raise_failure`; the first counts."""
    _failures.append(error)


def has_failed() -> bool:
    """Return whether a failure waits for `raise_failure`: until then nothing that is asked for is a number."""
    return bool(_failures)


def event_that_waits() -> float | None:
    """Return the time [s] of the event that has ended a part's equations; None where nothing did, or a failure."""
    first = _failures[0] if _failures else None
    return first.time if getattr(first, "kind", "") == "event" else None  # type: ignore[union-attr]


def forget_failures() -> None:
    """Forget what failed before."""
    _failures.clear()


def raise_failure() -> None:
    """Raise the first failure of a called function since the last time, if there was one."""
    if _failures:
        first = _failures[0]
        _failures.clear()
        tell(first)
        raise first


def _caller(function: Any) -> Any:
    """Return a function of a context and two pointers, to the nonzeros of all arguments and of all results."""
    given = [np.zeros(function.nnz_in(k)) for k in range(function.n_in())]
    results = [np.zeros(function.nnz_out(k)) for k in range(function.n_out())]
    buffer, trigger = function.buffer()
    for k, array in enumerate(given):
        if array.size:
            buffer.set_arg(k, _memory(array))
    for k, array in enumerate(results):
        if array.size:
            buffer.set_res(k, _memory(array))
    sizes_in, sizes_out = [len(array) for array in given], [len(array) for array in results]
    n_in, n_out = sum(sizes_in), sum(sizes_out)

    def called(_: Any, arguments: Any, target: Any) -> None:
        if _failures:
            for k in range(n_out):
                target[k] = float("nan")
            return
        try:
            flat = np.ctypeslib.as_array(arguments, (max(n_in, 1),))
            out = np.ctypeslib.as_array(target, (max(n_out, 1),))
            at = 0
            for array, size in zip(given, sizes_in, strict=True):
                array[:] = flat[at : at + size]
                at += size
            trigger()
            if buffer.ret():
                out[:] = np.nan
                return
            at = 0
            for array, size in zip(results, sizes_out, strict=True):
                out[at : at + size] = array
                at += size
        except BaseException as error:
            note_failure(error)
            for k in range(n_out):
                target[k] = float("nan")

    return called


def _memory(array: Any) -> Any:
    return memoryview(array)
