"""Harmonics of a common angle: sines and cosines of k (theta + phi) by recurrence.

Crack series, unbalances and reference signals of one shaft are sines and cosines of whole multiples of
one angle. One sine and one cosine are computed; the rest follow from

    cos k a = 2 cos 2a cos (k-2) a - cos (k-4) a,      sin k a = 2 cos 2a sin (k-2) a - sin (k-4) a

and angles that differ by something that depends on parameters only follow from a rotation, whose sine
and cosine are computed outside the time loop. The error grows as k^2 times rounding.
Source: Chebyshev's recurrence, Abramowitz & Stegun (1964), 4.3.27 f.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction

from rotorsim.model.emit import program as ir
from rotorsim.model.emit.program import Program

LARGEST_MULTIPLE = 64
Form = dict[int, float]  # node -> coefficient: a linear combination of nodes
Direction = tuple[tuple[int, float], ...]  # one divided by its first coefficient


def share_harmonics(old: Program, outputs: Sequence[int]) -> tuple[Program, list[int]]:
    """Return an equal program whose sines and cosines share what they can, and its outputs (a `Pass`)."""
    needed = old.needed(outputs)
    forms = {
        number: _linear_form(old, *old.operands(number))
        for number in needed
        if old.nodes[number][0] in (ir.SIN, ir.COS) and old.levels[number] >= ir.LEVEL_TIME
    }
    new = Program(old.reassociate, old.inputs)
    copied: dict[int, int] = {}
    harmonics = _Harmonics(old, new, copied, forms.values())
    for number in needed:
        node = old.nodes[number]
        copied[number] = harmonics.emit(node[0], forms[number]) if number in forms else new.copied(node, copied)
    return new, [copied[number] for number in outputs]


def _linear_form(program: Program, number: int) -> Form:
    """Write a node as a sum of coefficients times nodes that are not sums themselves."""
    form: Form = {}
    stack = [(number, 1.0)]
    while stack:
        node, factor = stack.pop()
        op = program.nodes[node][0]
        a, b = (*program.operands(node), -1, -1)[:2]
        if op in (ir.ADD, ir.SUB):
            stack += [(a, factor), (b, factor if op == ir.ADD else -factor)]
        elif op in (ir.NEG, ir.TWICE):
            stack.append((a, -factor if op == ir.NEG else 2 * factor))
        elif op == ir.MUL and program.is_constant(a):
            stack.append((b, factor * program.value(a)))
        elif op == ir.MUL and program.is_constant(b):
            stack.append((a, factor * program.value(b)))
        else:
            form[node] = form.get(node, 0.0) + factor
    return {node: factor for node, factor in form.items() if factor != 0.0}


class _Harmonics:
    """The sines and cosines of a new program: whole multiples of one fundamental for each direction and phase."""

    def __init__(self, old: Program, new: Program, copied: Mapping[int, int], forms: Iterable[Form]) -> None:
        self.old, self.new, self.copied = old, new, copied
        self.fundamental: dict[Direction, float] = {}  # the smallest multiple
        for form in forms:
            direction, scale = _direction(form)
            self.fundamental[direction] = min(abs(scale), self.fundamental.get(direction, math.inf))
        self.master: dict[Direction, tuple[Form, Form]] = {}
        self.made: dict[tuple[Direction, int], tuple[int, int]] = {}

    def emit(self, op: int, form: Form) -> int:
        """Return the node of sin or cos of an angle."""
        direction, scale = _direction(form)
        unit = self.fundamental[direction]
        ratio = scale / unit
        multiple = round(ratio)
        if ratio != multiple or abs(multiple) > LARGEST_MULTIPLE or multiple == 0:
            return self.new.apply(op, self._sum(form))
        base = {node: factor * unit for node, factor in direction}
        s, c = self._multiple(direction, base, abs(multiple))
        if op == ir.COS:
            return c
        return s if multiple > 0 else self.new.apply(ir.NEG, s)

    def _multiple(self, direction: Direction, base: Form, k: int) -> tuple[int, int]:
        """Return the nodes of sin and cos of k times the fundamental (unused ones are never emitted)."""
        if (direction, k) not in self.made:
            self.made[direction, k] = self._made(direction, base, k)
        return self.made[direction, k]

    def _made(self, direction: Direction, base: Form, k: int) -> tuple[int, int]:
        apply = self.new.apply
        if k == 0:
            return self.new.constant(0.0), self.new.constant(1.0)
        if k == 1:
            return self._fundamental_pair(base)
        if k == 2:
            s, c = self._multiple(direction, base, 1)
            return (
                apply(ir.MUL, apply(ir.TWICE, s), c),
                apply(ir.SUB, apply(ir.TWICE, apply(ir.SQ, c)), self.new.constant(1.0)),
            )
        twice = apply(ir.TWICE, self._multiple(direction, base, 2)[1])
        s1, c1 = self._multiple(direction, base, k - 2)
        s0, c0 = self._multiple(direction, base, abs(k - 4))
        if k < 4:
            s0 = apply(ir.NEG, s0)
        return apply(ir.SUB, apply(ir.MUL, twice, s1), s0), apply(ir.SUB, apply(ir.MUL, twice, c1), c0)

    def _fundamental_pair(self, base: Form) -> tuple[int, int]:
        apply = self.new.apply
        moving = {node: factor for node, factor in base.items() if self.old.levels[node] >= ir.LEVEL_TIME}
        fixed = {node: factor for node, factor in base.items() if node not in moving}
        master, master_fixed = self.master.setdefault(tuple(sorted(moving.items())), (base, fixed))
        if master == base:
            angle = self._sum(base)
            return apply(ir.SIN, angle), apply(ir.COS, angle)
        s, c = self._fundamental_pair(master)
        shift = {node: fixed.get(node, 0.0) - master_fixed.get(node, 0.0) for node in (*fixed, *master_fixed)}
        angle = self._sum({node: factor for node, factor in shift.items() if factor})
        sin_shift, cos_shift = apply(ir.SIN, angle), apply(ir.COS, angle)
        return (
            apply(ir.ADD, apply(ir.MUL, s, cos_shift), apply(ir.MUL, c, sin_shift)),
            apply(ir.SUB, apply(ir.MUL, c, cos_shift), apply(ir.MUL, s, sin_shift)),
        )

    def _sum(self, form: Form) -> int:
        total = self.new.constant(0.0)
        for node, factor in sorted(form.items()):
            total = self.new.apply(ir.ADD, total, self.new.apply(ir.MUL, self.new.constant(factor), self.copied[node]))
        return total


def _direction(form: Form) -> tuple[Direction, float]:
    """Return the form divided by its first coefficient (exactly), and that coefficient."""
    items = sorted(form.items())
    first = items[0][1]
    return tuple((node, float(Fraction(factor) / Fraction(first))) for node, factor in items), first
