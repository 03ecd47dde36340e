"""Harmonics of a common angle: sines and cosines of k (theta + phi) by recurrence.

Crack series, unbalances and reference signals of one shaft are sines and cosines of whole multiples of
one angle. One sine and one cosine are computed; the rest follow from

    cos k a = 2 cos 2a cos (k-2) a - cos (k-4) a,      sin k a = 2 cos 2a sin (k-2) a - sin (k-4) a

and angles that differ by something that depends on parameters only follow from a rotation, whose sine
and cosine are computed outside the time loop. The error grows as k^2 times rounding.
Source: Chebyshev's recurrence, Abramowitz & Stegun (1964), 4.3.27 f.
"""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction

from rotorsim.model.emit import program as ir
from rotorsim.model.emit.program import Program

__all__ = ["share_harmonics"]

LARGEST_MULTIPLE = 64
Form = dict[int, float]  # node -> coefficient: a linear combination of nodes


def share_harmonics(old: Program, outputs: Iterable[int]) -> tuple[Program, list[int]]:
    """Return an equal program whose sines and cosines share what they can, and its outputs."""
    wanted = list(outputs)
    needed = old.needed(wanted)
    groups = _Groups()
    forms: dict[int, Form] = {}
    for number in needed:
        op, a, _ = old.nodes[number]
        if op in (ir.SIN, ir.COS) and old.levels[number] >= ir.LEVEL_TIME:
            forms[number] = _linear_form(old, int(a))
            groups.add(forms[number], old)

    new = Program(old.reassociate)
    copied: dict[int, int] = {}
    for number in needed:
        op, a, b = old.nodes[number]
        if op == ir.INPUT:
            copied[number] = new.input(str(a), b)
        elif op == ir.CONSTANT:
            copied[number] = new.constant(float(a))
        elif number in forms:
            copied[number] = groups.emit(op, forms[number], old, new, copied)
        else:
            copied[number] = new.apply(op, copied[int(a)], copied[b] if b >= 0 else -1)
    return new, [copied[number] for number in wanted]


def _linear_form(program: Program, number: int, scale: float = 1.0) -> Form:
    """Write a node as a sum of coefficients times nodes that are not sums themselves."""
    form: Form = {}
    stack = [(number, scale)]
    while stack:
        node, factor = stack.pop()
        op, a, b = program.nodes[node]
        if op == ir.ADD:
            stack += [(int(a), factor), (b, factor)]
        elif op == ir.SUB:
            stack += [(int(a), factor), (b, -factor)]
        elif op == ir.NEG:
            stack.append((int(a), -factor))
        elif op == ir.TWICE:
            stack.append((int(a), 2 * factor))
        elif op == ir.MUL and program.is_constant(int(a)):
            stack.append((b, factor * program.value(int(a))))
        elif op == ir.MUL and program.is_constant(b):
            stack.append((int(a), factor * program.value(b)))
        else:
            form[node] = form.get(node, 0.0) + factor
    return {node: factor for node, factor in form.items() if factor != 0.0}


class _Groups:
    """Angles sorted by direction: all whole multiples of one fundamental, for each phase."""

    def __init__(self) -> None:
        self.fundamental: dict[tuple[tuple[int, float], ...], float] = {}
        self.master: dict[tuple[tuple[int, float], ...], tuple[Form, Form]] = {}
        self.made: dict[object, tuple[int, int]] = {}

    def add(self, form: Form, program: Program) -> None:
        """Note an angle: its direction's smallest multiple becomes the fundamental."""
        direction, scale = _direction(form)
        known = self.fundamental.get(direction)
        self.fundamental[direction] = abs(scale) if known is None else min(known, abs(scale))

    def emit(self, op: int, form: Form, old: Program, new: Program, copied: dict[int, int]) -> int:
        """Return the node of sin or cos of an angle in the new program."""
        direction, scale = _direction(form)
        unit = self.fundamental[direction]
        ratio = scale / unit
        multiple = round(ratio)
        if ratio != multiple or abs(multiple) > LARGEST_MULTIPLE or multiple == 0:
            return new.apply(op, _sum(form, new, copied))
        base = {node: factor * unit for node, factor in direction}
        pair = self._multiple(direction, base, abs(multiple), old, new, copied)
        if op == ir.COS:
            return pair[1]
        return pair[0] if multiple > 0 else new.apply(ir.NEG, pair[0])

    def _multiple(
        self, direction: object, base: Form, k: int, old: Program, new: Program, copied: dict[int, int]
    ) -> tuple[int, int]:
        """Return the nodes of sin and cos of k times the fundamental (unused ones are never emitted)."""
        key = (direction, k)
        if key in self.made:
            return self.made[key]
        if k == 0:
            pair = (new.constant(0.0), new.constant(1.0))
        elif k == 1:
            pair = self._fundamental_pair(base, old, new, copied)
        elif k == 2:
            s, c = self._multiple(direction, base, 1, old, new, copied)
            pair = (
                new.apply(ir.MUL, new.apply(ir.TWICE, s), c),
                new.apply(ir.SUB, new.apply(ir.TWICE, new.apply(ir.SQ, c)), new.constant(1.0)),
            )
        else:
            twice = new.apply(ir.TWICE, self._multiple(direction, base, 2, old, new, copied)[1])
            s1, c1 = self._multiple(direction, base, k - 2, old, new, copied)
            s0, c0 = self._multiple(direction, base, abs(k - 4), old, new, copied)
            if k < 4:
                s0 = new.apply(ir.NEG, s0)
            pair = (
                new.apply(ir.SUB, new.apply(ir.MUL, twice, s1), s0),
                new.apply(ir.SUB, new.apply(ir.MUL, twice, c1), c0),
            )
        self.made[key] = pair
        return pair

    def _fundamental_pair(self, base: Form, old: Program, new: Program, copied: dict[int, int]) -> tuple[int, int]:
        moving = {node: factor for node, factor in base.items() if old.levels[node] >= ir.LEVEL_TIME}
        fixed = {node: factor for node, factor in base.items() if node not in moving}
        key = tuple(sorted(moving.items()))
        if key not in self.master:
            self.master[key] = (base, fixed)
        if self.master[key][0] is base or self.master[key][0] == base:
            angle = _sum(base, new, copied)
            return new.apply(ir.SIN, angle), new.apply(ir.COS, angle)
        master_base, master_fixed = self.master[key]
        s, c = self._fundamental_pair(master_base, old, new, copied)
        shift = dict(fixed)
        for node, factor in master_fixed.items():
            shift[node] = shift.get(node, 0.0) - factor
        angle = _sum({node: factor for node, factor in shift.items() if factor}, new, copied)
        sin_shift, cos_shift = new.apply(ir.SIN, angle), new.apply(ir.COS, angle)
        mul = ir.MUL
        return (
            new.apply(ir.ADD, new.apply(mul, s, cos_shift), new.apply(mul, c, sin_shift)),
            new.apply(ir.SUB, new.apply(mul, c, cos_shift), new.apply(mul, s, sin_shift)),
        )


def _direction(form: Form) -> tuple[tuple[tuple[int, float], ...], float]:
    """Return the form divided by its first coefficient (exactly), and that coefficient."""
    items = sorted(form.items())
    first = items[0][1]
    return tuple((node, float(Fraction(factor) / Fraction(first))) for node, factor in items), first


def _sum(form: Form, new: Program, copied: dict[int, int]) -> int:
    total = new.constant(0.0)
    for node, factor in sorted(form.items()):
        total = new.apply(ir.ADD, total, new.apply(ir.MUL, new.constant(factor), copied[node]))
    return total
