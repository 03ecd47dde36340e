"""The equations of an FMU for Model Exchange as functions without an expression, which a trace calls.

CasADi sees numbers go in and come out; derivatives in a direction, and weighted sums of derivatives, are further
functions. Compiled code calls C where there is an instance in this process (`rotorsim.fmi.compiled`).
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import casadi as ca

from rotorsim.fmi.callbacks import Called, CalledSlopes
from rotorsim.fmi.equations import FmuEquations
from rotorsim.model.called import STEADY

_Key = tuple[str, tuple[int, ...] | None, tuple[bool, ...]]  # what it gives, rows, groups


class FmuFunctions:
    """The functions of an FMU that a trace calls: x', groups of outputs that depend on the same inputs, the start."""

    def __init__(self, equations: FmuEquations, identity: str) -> None:
        self.equations, self._identity = equations, identity
        self._made: dict[_Key, Called] = {}

    def call(self, what: str, rows: Sequence[int] | None, groups: Sequence[bool], arguments: Sequence[Any]) -> Any:
        """Return rows of x' and y (None: of where it begins) at expressions of t, x, u and p, a column."""
        key = what, None if rows is None else tuple(rows), tuple(groups)
        return self._made_for(key, Called)(*self._given(groups, arguments))

    def slopes(self, p: Any) -> Any:
        """Return the factors of states and inputs in x' and y of a linear FMU, row by row, a column."""
        groups = (False, False, False, True)
        return self._made_for(("slopes", None, groups), CalledSlopes)(*self._given(groups, (p,) * 4))

    def forcing(self, t: Any, p: Any) -> Any:
        """Return x' and y of a linear FMU where states are zero and inputs as it begins, a column."""
        rows = range(self.equations.n_x + self.equations.n_y)
        return self.call("forcing", rows, (self.equations.timed, False, False, True), (t,) * 3 + (p,))

    @staticmethod
    def _given(groups: Sequence[bool], arguments: Sequence[Any]) -> list[Any]:
        return [value if one else ca.SX(0, 1) for value, one in zip(arguments, groups, strict=True)]

    def _made_for(self, key: _Key, kind: type[Called]) -> Called:
        if key not in self._made:
            digest = hashlib.sha256(repr((self._identity, key)).encode()).hexdigest()[:16]
            steady = f"{STEADY}_" if key[2] == (False, False, False, True) else ""
            name = f"fmu_{steady}{key[0]}_{digest}"
            self._made[key] = made = kind(name, self.equations, *key[1:])
            made.answer_in_c(made, "values")
        return self._made[key]

    def named(self) -> dict[str, Called]:
        """Return the functions that were called, by name."""
        return {made.name(): made for made in self._made.values()}


def digest_of(path: Path) -> str:
    """Return the SHA-256 of a file, which is read once."""
    stat = path.stat()
    return _digest(str(path), (stat.st_mtime_ns, stat.st_size))


@lru_cache(maxsize=64)
def _digest(path: str, _stamp: tuple[int, int]) -> str:
    with open(path, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


_known: dict[str, FmuFunctions] = {}


def close_instances() -> None:
    """Free all instances that functions keep, and end their processes; they are made anew when they are needed."""
    for functions in _known.values():
        functions.equations.close()


def held_inputs(block: Any) -> dict[str, Any]:
    """Return the input ports of a block of type fmu that change at events only, and so are set once."""
    description = block.fmu_description
    return {
        name: port
        for name, port in block.fmu_inputs.items()
        if any(entry.variable.variability != "continuous" for entry in description.resolve(port.entries))
    }


def moving_inputs(block: Any) -> dict[str, Any]:
    """Return the other input ports of a block of type fmu."""
    held = held_inputs(block)
    return {name: port for name, port in block.fmu_inputs.items() if name not in held}


def texts_of(block: Any) -> dict[str, Any]:
    """Return the values that a block gives to variables that are no numbers, and are not the start values."""
    return {
        item.variable.name: item.of_fmu(getattr(block.option, key))
        for key, item in block.fmu_options.items()
        if item.variable.causality != "structuralParameter"
        and key not in block.wired
        and getattr(block.option, key) != item.default
    }


def functions_of(block: Any) -> FmuFunctions:
    """Return the functions of a block of type fmu; the same for the same block and file, with equal options.

    Blocks do not share them: each has a mode of its own.
    """
    option, texts = block.option, texts_of(block)
    digest, sizes = digest_of(block.fmu_path), sorted(block.fmu_description.sizes.items())
    ports = [(name, port.entries) for name, port in (*block.fmu_inputs.items(), *block.fmu_outputs.items())]
    about, file = (bool(option.in_process), float(option.timeout)), str(block.fmu_path)
    identity = repr((block.fmu_block, file, digest, *about, sorted(texts.items(), key=str), sizes, ports))
    if identity not in _known:
        equations = FmuEquations(
            block.fmu_block or block.fmu_description.name,
            block.fmu_path,
            block.fmu_description,
            about[0],
            texts,
            [*moving_inputs(block).values()],
            [*block.fmu_outputs.values()],
            [*block.fmu_parameters.values(), *held_inputs(block).values()],
            about[1],
        )
        _known[identity] = FmuFunctions(equations, identity)
    return _known[identity]
