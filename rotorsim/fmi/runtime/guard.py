"""FMUs in this process that end it: exit(0) inside one would look like a result with nothing in it, and exit code 0."""

from __future__ import annotations

import atexit
import ctypes
from functools import cache
from typing import Any

from rotorsim.model.emit.toolchain import CompilerError, compile_c, find_compiler

_SOURCE = r"""
#include <stdlib.h>
#include <string.h>
#ifdef _WIN32
#include <io.h>
#else
#include <unistd.h>
#endif
static const char *said;
static void ended(void) {
    if (!said) return;
    if (write(2, said, strlen(said)) < 0) _exit(1);
    _exit(1);
}
#ifdef _WIN32
__declspec(dllexport)
#endif
void rs_guard(const char *text) {
    static int known;
    said = text;
    if (text && !known) known = !atexit(ended);
}
"""
_inside: dict[str, Any] = {}


@cache
def _guard() -> Any:
    compiler = find_compiler()
    if compiler is None:
        return None
    try:
        guard = compile_c(_SOURCE, compiler, "-O1")[0].rs_guard
    except CompilerError:
        return None
    guard.argtypes, guard.restype = [ctypes.c_char_p], None
    atexit.register(guard, None)
    return guard


def guard_exit(path: str) -> None:
    """Let this process end with a message and exit code 1 where an FMU in it calls exit; needs a C compiler.

    Python's own end, which comes before that of C, is no such end.
    """
    if path in _inside or (guard := _guard()) is None:
        return
    names = ", ".join([*_inside, path])
    text = f"error: an FMU in this process has ended it by exit(); there are {names}\n\n"
    text += 'hint: in a process of its own, without "in_process", only what it was asked for fails\n'
    _inside[path] = kept = text.encode()  # C keeps the address
    guard(kept)
