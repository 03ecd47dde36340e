"""Write nodes of a program as C functions."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any

from rotorsim.model.emit import program as ir
from rotorsim.model.emit.numbers import DOUBLES, Numbers
from rotorsim.model.emit.program import Program

STATEMENTS_PER_FUNCTION = 200  # statements per C function of large diagrams (compilers are slow on long functions)


class Writer:
    """Writes nodes of a program as one C function (several, when it is long).

    given: node -> C text of what is computed before. leaf: C text of an input of the program, such as `array_leaf`.
    called: functions that are called by their number, `called_functions` of all programs of the source.
    numbers: what it computes with.
    """

    def __init__(
        self,
        program: Program,
        given: Mapping[int, str],
        leaf: Callable[[ir.Node], str],
        called: Sequence[str] = (),
        numbers: Numbers = DOUBLES,
    ) -> None:
        self.program = program
        self.given = given
        self.leaf = leaf
        self.called = called
        self.numbers = numbers

    def text(
        self, name: str, arguments: str, call: str, targets: Sequence[tuple[str, int]], whole: bool = False
    ) -> tuple[str, int]:
        """Return the C text of function ``name`` that sets targets (C text, node), and the work space it needs.

        arguments: of its declaration; call: as parts of it are called. whole: one function, however long.
        """
        order = [
            k
            for k in self.program.needed([node for _, node in targets], self.given)
            if k not in self.given and self.program.nodes[k][0] not in (ir.INPUT, ir.CONSTANT)
        ]
        if whole or len(order) <= 6 * STATEMENTS_PER_FUNCTION:
            lines = [self._statement(k, self._operand) for k in order]
            lines += [f"  {target} = {self._operand(node)};" for target, node in targets]
            return f"static void {name}({arguments}) {{\n" + "\n".join(lines) + "\n  (void)work;\n}\n", 0
        return self._chunked(name, arguments, call, targets, order)

    def _chunked(
        self, name: str, arguments: str, call: str, targets: Sequence[tuple[str, int]], order: list[int]
    ) -> tuple[str, int]:
        where = {k: i // STATEMENTS_PER_FUNCTION for i, k in enumerate(order)}
        for k in order:
            if self.program.nodes[k][0] == ir.RESULT:  # is told where the call is
                where[k] = where[self.program.operands(k)[0]]
        last_use = dict(where)
        for k in order:
            for operand in self.program.operands(k):
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
            for k in (k for k in order if where[k] == chunk):
                lines.append(self._statement(k, partial(self._chunk_operand, where, slots, chunk)))
                if isinstance(self.program.nodes[k][1], ir.Call):
                    continue
                if last_use[k] > chunk:
                    if not free:
                        free, size = [size], size + 1
                    slots[k] = free.pop()
                    released.setdefault(last_use[k], []).append(slots[k])
                    lines.append(f"  work[{slots[k]}] = v{k};")
            free += released.pop(chunk, [])  # reusable from the next chunk on
            text.append(f"static void {name}_{chunk}({arguments}) {{\n" + "\n".join(lines) + "\n}\n")
        final = [f"  {t} = {self._chunk_operand(where, slots, n_chunks, node)};" for t, node in targets]
        for start in range(0, len(final), STATEMENTS_PER_FUNCTION):
            body = "\n".join(final[start : start + STATEMENTS_PER_FUNCTION])
            text.append(f"static void {name}_out{start // STATEMENTS_PER_FUNCTION}({arguments}) {{\n{body}\n}}\n")
        calls = [f"  {name}_{chunk}({call});" for chunk in range(n_chunks)]
        calls += [f"  {name}_out{k}({call});" for k in range(math.ceil(len(final) / STATEMENTS_PER_FUNCTION))]
        text.append(f"static void {name}({arguments}) {{\n" + "\n".join(calls) + "\n}\n")
        return "\n".join(text), size

    def _chunk_operand(self, where: Mapping[int, int], slots: Mapping[int, int], chunk: int, node: int) -> str:
        if node in where and where[node] < chunk and node not in self.given:
            return f"work[{slots[node]}]"
        return self._operand(node)

    def _operand(self, number: int) -> str:
        if number in self.given:
            return self.given[number]
        op = self.program.nodes[number][0]
        if op == ir.CONSTANT:
            return self.numbers.constant(self.program.value(number))
        return self.leaf(self.program.nodes[number]) if op == ir.INPUT else f"v{number}"

    def _statement(self, number: int, operand: Callable[[int], str]) -> str:
        """Return what computes a node: of a call, all that it gives."""
        call = self.program.nodes[number][1]
        if not isinstance(call, ir.Call):
            return f"  const {self.numbers.type} v{number} = {self._expression(number, operand)};"
        given = ", ".join(map(operand, call.operands)) or "0.0"
        which, size = self.called.index(call.name), max(call.function.nnz_out(), 1)
        return (
            f"  const double a{number}[] = {{{given}}};\n  double v{number}[{size}];\n"
            f"  rs_call({which}, a{number}, v{number});"
        )

    def _expression(self, number: int, operand: Callable[[int], str]) -> str:
        op, a, b = self.program.nodes[number]
        if op == ir.RESULT:
            return f"v{a}[{b}]"
        return self.numbers.expression(op, *map(operand, self.program.operands(number)))


def called_functions(programs: Iterable[Program]) -> dict[str, Any]:
    """Return the functions that programs call, by name."""
    nodes = (node[1] for program in programs for node in program.nodes)
    return {call.name: call.function for call in nodes if isinstance(call, ir.Call)}


def call_table(called: Mapping[str, Any]) -> tuple[str, str]:
    """Return the C text of `rs_call` with the table of called functions, and of `rs_connect`, which fills the table."""
    if not called:
        return "", ""
    names = "".join(f"/* {name} */\n" for name in called)
    entry = "struct rs_entry { void (*function)(void *, const double *, double *); void *context; };\n"
    table = f"{names}{entry}static struct rs_entry rs_called[{len(called)}];\n"
    table += "#define rs_call(k, given, results) rs_called[k].function(rs_called[k].context, given, results)\n"
    return table, "RS_EXPORT void rs_connect(const void *from) { memcpy(rs_called, from, sizeof rs_called); }\n"


def array_leaf(node: tuple[int, object, int]) -> str:
    """Return the C text of an input: ``t``, or an entry of the array of its name, ``x[3]``."""
    _, vector, position = node
    return "t" if vector == "t" else f"{vector}[{position}]"
