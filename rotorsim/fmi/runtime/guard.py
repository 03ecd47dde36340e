"""FMUs in this process that end it: not without a word, and never by exit(0), which would look like an empty result."""

from __future__ import annotations

import atexit
import ctypes
from functools import cache
from typing import Any

from rotorsim.model.emit.toolchain import CompilerError, compile_c, find_compiler

_SOURCE = r"""
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#ifdef _WIN32
#include <io.h>
#define RS_EXPORT __declspec(dllexport)
#else
#include <unistd.h>
#define RS_EXPORT
#endif
static const char *said;
static int tell(const char *how) {
    return said && write(2, how, strlen(how)) > 0 && write(2, said, strlen(said)) > 0;
}
static void left(void) {
    if (said && tell("error: this process has left by exit()")) _exit(1);
    if (said) _exit(1);
}
static void crashed(int number) {
    tell("error: this process has crashed");
    signal(number, SIG_DFL);
    raise(number);
}
RS_EXPORT void rs_guard(const char *text) {
    static const int crashes[] = {SIGSEGV, SIGABRT, SIGFPE, SIGILL};
    static int known;
    said = text;
    if (!text || known) return;
    known = !atexit(left);
    for (int k = 0; k < 4; k++) {
        void (*before)(int) = signal(crashes[k], crashed);
        if (before != SIG_DFL) signal(crashes[k], before);
    }
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
    """Let this process end with a message where an FMU in it crashes, or calls exit: with exit code 1 then.

    Needs a C compiler. Python's own end, which comes before that of C, is no such end.
    """
    if path in _inside or (guard := _guard()) is None:
        return
    text = f", in which there are FMUs: {', '.join([*_inside, path])}\n\n"
    text += 'hint: in a process of its own, without "in_process", only what one was asked for fails\n'
    _inside[path] = kept = text.encode()  # C keeps the address
    guard(kept)
