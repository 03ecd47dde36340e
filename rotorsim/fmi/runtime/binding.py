"""The functions of an FMI 2.0 or 3.0 library by ctypes, and the callbacks that they want.

Only the standard library is used: this is loaded in the subprocess of an FMU, which should start fast.
"""

from __future__ import annotations

import ctypes
import os
import platform
import re
import sys
from collections import deque
from ctypes import c_bool, c_char_p, c_double, c_int, c_size_t, c_void_p
from functools import cache
from typing import Any

STATUS = ("OK", "Warning", "Discard", "Error", "Fatal", "Pending")
KEPT, LONGEST = 1000, 2000  # messages kept until they are taken, characters of one: 4 MB at most, of UTF-8 in Python
FLOOD = 20 * KEPT  # lost at once: what then is no warning is counted only, in 4 us instead of 22: no flood is a hang

# Our type -> the word in the names of the functions, the type of C.
TYPES: dict[str, dict[str, tuple[str, Any]]] = {
    "2.0": {
        "Float64": ("Real", c_double),
        "Int32": ("Integer", c_int),
        "Enumeration": ("Integer", c_int),
        "Boolean": ("Boolean", c_int),
        "String": ("String", c_char_p),
    },
    "3.0": {
        "Float64": ("Float64", c_double),
        "Float32": ("Float32", ctypes.c_float),
        "Int8": ("Int8", ctypes.c_int8),
        "UInt8": ("UInt8", ctypes.c_uint8),
        "Int16": ("Int16", ctypes.c_int16),
        "UInt16": ("UInt16", ctypes.c_uint16),
        "Int32": ("Int32", ctypes.c_int32),
        "UInt32": ("UInt32", ctypes.c_uint32),
        "Int64": ("Int64", ctypes.c_int64),
        "UInt64": ("UInt64", ctypes.c_uint64),
        "Enumeration": ("Int64", ctypes.c_int64),
        "Boolean": ("Boolean", c_bool),
        "String": ("String", c_char_p),
    },
}

TYPES["1.0"] = TYPES["2.0"] | {"Boolean": ("Boolean", c_bool)}

# Arguments: c instance, p pointer, s text, n size_t, d double, i int, b boolean.
_BOTH = {
    "ExitInitializationMode": "c",
    "Terminate": "c",
    "Reset": "c",
    "FreeInstance": "c",
    "EnterEventMode": "c",
    "EnterContinuousTimeMode": "c",
    "SetTime": "cd",
    "SetContinuousStates": "cpn",
    "GetContinuousStates": "cpn",
    "GetEventIndicators": "cpn",
    "GetNominalsOfContinuousStates": "cpn",
    "CompletedIntegratorStep": "cbpp",
    "SetDebugLogging": "cbnp",
}
_SIGNATURES = {
    "2.0": _BOTH
    | {
        "Instantiate": "sisspbb",
        "SetupExperiment": "cbddbd",
        "EnterInitializationMode": "c",
        "NewDiscreteStates": "cp",
        "GetDerivatives": "cpn",
        "DoStep": "cddb",
        "GetDirectionalDerivative": "cpnpnpp",
        "SetRealInputDerivatives": "cpnpp",
        "GetRealOutputDerivatives": "cpnpp",
        "GetRealStatus": "cip",
        "GetBooleanStatus": "cip",
        "GetFMUstate": "cp",
        "SetFMUstate": "cc",
        "FreeFMUstate": "cp",
        "SerializedFMUstateSize": "ccp",
        "SerializeFMUstate": "ccpn",
        "DeSerializeFMUstate": "cpnp",
        **{f"{verb}{word}": "cpnp" for verb in ("Get", "Set") for word, _ in TYPES["2.0"].values()},
    },
    "3.0": _BOTH
    | {
        "InstantiateModelExchange": "sssbbcp",
        "InstantiateCoSimulation": "sssbbbbpncpp",
        "EnterInitializationMode": "cbddbd",
        "UpdateDiscreteStates": "cpppppp",
        "GetContinuousStateDerivatives": "cpn",
        "DoStep": "cddbpppp",
        "GetDirectionalDerivative": "cpnpnpnpn",
        "GetAdjointDerivative": "cpnpnpnpn",
        "GetOutputDerivatives": "cpnppn",
        "GetNumberOfEventIndicators": "cp",
        "GetNumberOfContinuousStates": "cp",
        "GetFMUState": "cp",
        "SetFMUState": "cc",
        "FreeFMUState": "cp",
        "SerializedFMUStateSize": "ccp",
        "SerializeFMUState": "ccpn",
        "DeserializeFMUState": "cpnp",
        "EnterConfigurationMode": "c",
        "ExitConfigurationMode": "c",
        **{f"{verb}{word}": "cpnpn" for verb in ("Get", "Set") for word, _ in TYPES["3.0"].values()},
    },
}
_CTYPES = {"c": c_void_p, "p": c_void_p, "s": c_char_p, "n": c_size_t, "d": c_double, "i": c_int}


class CallError(Exception):
    """A function of an FMU did not do what was asked; plain data, so that it can cross from process to process.

    kind: "discard", "error", "fatal", "refused" (by us: a value, a step that is impossible), "load".
    """

    def __init__(self, kind: str, function: str, what: str, **more: Any) -> None:
        super().__init__(f"{function}: {what}")
        self.kind, self.function, self.what, self.more = kind, function, what, more

    def data(self) -> dict[str, Any]:
        """Return what `from_data` takes."""
        return {"kind": self.kind, "function": self.function, "what": self.what, "more": self.more}

    @classmethod
    def from_data(cls, data: dict[str, Any]) -> CallError:
        """Return the failure that another process has told of."""
        texts = (str(data.get(key, ""))[:4000] for key in ("kind", "function", "what"))
        more = data.get("more")
        return cls(*texts, **(more if isinstance(more, dict) else {}))


def status_error(function: str, status: int, prefix: str, **more: Any) -> CallError:
    """Return the failure that a status beyond a warning means; prefix: of its name, ``fmi2`` or ``fmi3``."""
    kind = {2: "discard", 4: "fatal"}.get(status, "error")
    word = prefix + STATUS[status] if 0 <= status < len(STATUS) else f"status {status}"
    return CallError(kind, function, f"returned {word}", **more)


class Library:
    """The library of an FMU: ``library["DoStep"]`` is the function, ready to be called."""

    def __init__(self, path: str, version: str) -> None:
        self.version, self.prefix = version, f"fmi{version[0]}"
        self._boolean = c_int if version == "2.0" else c_bool
        self._found: dict[str, Any] = {}
        folder = os.path.dirname(path)
        if sys.platform == "win32":
            os.add_dll_directory(folder)
        try:
            self._handle = ctypes.CDLL(path)
        except OSError as error:
            raise CallError("load", "load", str(error).replace(folder + os.sep, "")) from None

    def __getitem__(self, name: str) -> Any:
        function = self._found.get(name)
        if function is None:
            try:
                function = self._handle[self.prefix + name]
            except AttributeError:
                raise CallError("load", "load", f"the library has no function {self.prefix}{name}") from None
            signature = _SIGNATURES[self.version][name]
            kinds: list[Any] = [self._boolean if letter == "b" else _CTYPES[letter] for letter in signature]
            function.argtypes = kinds
            function.restype = c_void_p if name.startswith("Instantiate") else c_int
            self._found[name] = function
        return function


@cache
def library_of(path: str, version: str) -> Library:
    """Return the library at a path, loaded once: what it takes to load it is more than an instance does."""
    return Library(path, version)


@cache
def _libc() -> Any:
    return ctypes.cdll.msvcrt if sys.platform == "win32" else ctypes.CDLL(None)


class _Callbacks2(ctypes.Structure):
    _fields_ = [(name, c_void_p) for name in ("logger", "allocate", "free", "finished", "environment")]


class Log:
    """Messages of an FMU, and the callbacks that collect them, each cut at `LONGEST` characters.

    Of more than `KEPT` at once the first half and the last half, with how many came between. counts: how many there
    have been, by status.
    """

    def __init__(self, version: str) -> None:
        self.first: list[tuple[str, str, str]] = []
        self.last: deque[tuple[str, str, str]] = deque(maxlen=KEPT // 2)
        self.lost = 0
        self.counts: dict[str, int] = {}
        if version == "3.0":
            form = ctypes.CFUNCTYPE(None, c_void_p, c_int, c_char_p, c_char_p)
            self.callback: Any = form(lambda _, status, category, text: self.add(status, category, text))
            return
        extra: list[Any] = [c_size_t] * _SLOTS + [c_double] * 8 if _READS_VARIADIC else []
        form = ctypes.CFUNCTYPE(None, c_void_p, c_char_p, c_int, c_char_p, c_char_p, *extra)
        self.callback = form(self._formatted)
        libc = _libc()
        self.struct = _Callbacks2(
            ctypes.cast(self.callback, c_void_p), ctypes.cast(libc.calloc, c_void_p), ctypes.cast(libc.free, c_void_p)
        )

    def add(self, status: int, category: bytes | None, message: bytes | None) -> None:
        """Keep a message."""
        if self._is_flood(status):
            return
        kind, text = ((t or b"")[:LONGEST].decode("utf-8", "replace").strip() for t in (category, message))
        word = STATUS[status] if 0 <= status < len(STATUS) else str(status)
        self.counts[word] = self.counts.get(word, 0) + 1
        if len(self.first) < KEPT // 2:
            self.first.append((word, kind, text))
            return
        self.lost += len(self.last) == self.last.maxlen
        self.last.append((word, kind, text))

    def _formatted(
        self, _: int, __: bytes, status: int, category: bytes | None, message: bytes | None, *more: Any
    ) -> None:
        if self._is_flood(status):
            return
        try:
            text = format_message(message or b"", more[:_SLOTS], more[_SLOTS:]) if more else message
        except Exception:
            text = message
        self.add(status, category, text)

    def _is_flood(self, status: int) -> bool:
        """Return whether a message is counted only, and count it then."""
        if status or self.lost < FLOOD:
            return False
        self.counts["OK"] = self.counts.get("OK", 0) + 1
        self.lost += 1
        return True

    def taken(self) -> list[tuple[str, str, str]]:
        """Return the messages and forget them."""
        said = f"{self.lost} more messages came at once and are lost"
        lines = [*self.first, *([("Warning", "rotorsim", said)] if self.lost else []), *self.last]
        self.first.clear()
        self.last.clear()
        self.lost = 0
        return lines


# A C function with "..." gets its arguments where a function with as many declared ones would find them: whole numbers
# and pointers in registers and then on the stack, numbers with a point in registers of their own. So it is on these:
_READS_VARIADIC = sys.platform == "linux" and platform.machine() in ("x86_64", "aarch64") and sys.maxsize > 2**32
_SLOTS = 10
_FORMAT = re.compile(rb"%([-+ #0]*)(\*|\d+)?(?:\.(\*|\d*))?(hh|h|ll|l|z|j|t|q|L)?([diouxXeEfFgGaAcspn%])")


def format_message(message: bytes, whole: tuple[int, ...], real: tuple[float, ...]) -> bytes:
    """Return a message in the manner of printf; ``whole`` and ``real`` are its arguments, by class."""
    numbers, floats = iter(whole), iter(real)

    def one(match: re.Match[bytes]) -> bytes:
        flags, width, precision, length, letter = match.groups()
        if letter == b"%":
            return b"%"
        form = "%" + flags.decode() + _size(width, numbers)
        form += "" if precision is None else "." + (_size(precision, numbers) or "0")
        code = letter.decode()
        if letter in b"eEfFgG":
            return (form + code).encode() % next(floats)
        if letter in b"aA":
            return next(floats).hex().encode()
        number = next(numbers)
        if letter == b"s":
            return (form + "s").encode() % ((c_char_p(number).value or b"") if number else b"(null)")[:LONGEST]
        if letter in b"pn":
            return hex(number).encode() if letter == b"p" else b""
        bits = 64 if length in (b"l", b"ll", b"z", b"j", b"t", b"q") else 32
        number &= (1 << bits) - 1
        if letter in b"di" and number >> (bits - 1):
            number -= 1 << bits
        return bytes([number & 255]) if letter == b"c" else (form + code.replace("u", "d")).encode() % number

    return _FORMAT.sub(one, message[:LONGEST])


def _size(text: bytes | None, numbers: Any) -> str:
    """Return a width or a precision, at most 200."""
    if not text:
        return ""
    size = next(numbers) & 0xFFFFFFFF if text == b"*" else int(text[:9])
    return str(min(size, 200))
