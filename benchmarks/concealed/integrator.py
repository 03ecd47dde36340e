"""Variation of constants with Radau collocation of the forces: the generator's own time integration.

X' = A X + B f(t, C X) is taken in the eigenvectors of A, so that one step of length h is

w(h) = e^{lambda h} w(0) + int_0^h e^{lambda (h - s)} b p(s) ds

with p the polynomial through f at the s right Radau points of the step. The linear machine is exact, whatever
its stiffness; the order is s, at the ends of the steps higher, and a force that depends on the motion is solved at
each step: by iteration, by Newton's method if that is slow. Steps on which p does not follow the force (contact,
saturation) are halved, for the lanes concerned. A lane is one run.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

Array = NDArray[Any]
Forces = Callable[["Nodes", Array], Array]  # (nodes, outputs (L, p, s)) -> inputs (L, m, s)

DEEPEST = 16
FIXED_POINT, NEWTON = 25, 12
EXACT = 1e-18  # change of an output, in its scale, at which forces count as solved
FAR = 1.0  # output, in its scale, of a motion that does not come back: its steps would be halved without end


def radau(points: int) -> Array:
    """Return the right Radau points on (0, 1]: roots of P_{s-1} - P_s on [-1, 1], the right end among them."""
    coefficients = np.zeros(points + 1)
    coefficients[-2:] = 1.0, -1.0
    x = np.sort(legendre.legroots(coefficients).real)
    for _ in range(3):
        x = x - legendre.legval(x, coefficients) / legendre.legval(x, legendre.legder(coefficients))
    c = (x + 1) / 2
    c[-1] = 1.0
    return c


def lagrange(c: Array, at: Array) -> Array:
    """Return the Lagrange polynomials of nodes c, l (at, nodes)."""
    out = np.ones((len(at), len(c)))
    for j, cj in enumerate(c):
        for k, ck in enumerate(c):
            if k != j:
                out[:, j] *= (at - ck) / (cj - ck)
    return out


def weights(z: Array, c: Array, ends: Array) -> Array:
    """Return a[..., i, l] = int_0^{e_i} e^{(e_i - s) z} l_l(s) ds, l_l of nodes c, by quadrature graded towards e_i."""
    gauss, gauss_weights = np.polynomial.legendre.leggauss(20)
    panels = max(1, int(np.ceil(np.log2(max(np.abs(z).max(), 1.0))))) + 1
    edges = np.concatenate([[0.0], 0.5 ** np.arange(panels - 1, -1, -1.0)])
    width = np.diff(edges)
    points = (edges[:-1, None] + width[:, None] * (gauss + 1) / 2).ravel()
    w = (width[:, None] * gauss_weights / 2).ravel()
    flat = np.asarray(z, complex).ravel()
    out = np.empty((len(flat), len(ends), len(c)), complex)
    for i, end in enumerate(ends):
        out[:, i] = np.exp(flat[:, None] * (end * points)) @ (w[:, None] * end * lagrange(c, end * (1 - points)))
    return out.reshape(*np.shape(z), len(ends), len(c))


@dataclass
class Nodes:
    """Times and angles at the Radau points of a step, all (L, s) or (L, 1)."""

    t: Array
    theta: Array
    rate: Array
    speed: Array
    past: Array | None = None  # outputs one delay ago (L, p, s)

    def part(self, lanes: Array, interpolate: Array, timed: bool) -> Nodes:
        """Return the nodes of a part of the step, for some lanes; without times where no force wants them."""
        if not timed:
            return Nodes(self.t, self.theta, self.rate, self.speed[lanes])
        t = np.broadcast_to(self.t, self.theta.shape)
        inner = [np.ascontiguousarray(v[lanes] @ interpolate.T) for v in (t, self.theta, self.rate)]
        return Nodes(inner[0], inner[1], inner[2], self.speed[lanes])


@dataclass
class Table:
    """What a step of one length needs: matrices over lanes."""

    free: Array  # (L, S, n)     e^{lambda h} at the S samples of the step, the last at its end
    outputs: Array  # (L, p s, n)   C e^{lambda c h}
    reply: Array  # (L, p s, m s) outputs for inputs at the nodes
    drive: Array  # (L, S n, m s) the samples for inputs at the nodes
    reach: Array  # (L, m)        largest output, in units of their scales, for a unit input at a node

    def lanes(self, which: Array) -> Table:
        """Return the table for some lanes."""
        return Table(*(v[which] for v in (self.free, self.outputs, self.reply, self.drive, self.reach)))


class Stepper:
    """Steps of many lanes at once. lam (L, n), B (L, n, m) and C (L, p, n) are in eigenvectors of A."""

    def __init__(
        self,
        lam: Array,
        B: Array,
        C: Array,
        step: float,
        forces: Forces | None = None,
        scales: Array | None = None,
        rough: float | None = None,
        points: int = 7,
        samples: int = 1,
        timed: bool = True,
        paired: bool = False,
    ) -> None:
        self.lam, self.B, self.C, self.step, self.forces, self.points = lam, B, C, step, forces, points
        self.timed = timed  # the forces depend on time or angle
        self.paired = paired  # the second half of the inputs are the conjugates of the first
        self.samples = samples  # equidistant, in one step
        self.scales = np.ones(C.shape[1]) if scales is None else scales  # sizes of the outputs
        self.rough = rough  # error of an output, in its scale, allowed in one step where forces are not smooth
        self.c = radau(points)
        self.tables: dict[int, Table] = {}
        self.extrapolate = lagrange(self.c, 1 + self.c)
        self.halves = (lagrange(self.c, self.c / 2), lagrange(self.c, (1 + self.c) / 2))
        gaps = np.concatenate([[0.0], self.c])
        between = (gaps[:-1, None] + np.diff(gaps)[:, None] * np.array([0.0, 1 / 3, 2 / 3])).ravel()
        self.between = lagrange(self.c, between)

    def table(self, level: int) -> Table:
        """Return the matrices of a step halved `level` times."""
        if level not in self.tables:
            h = self.step / 2**level
            z = self.lam * h
            ends = np.arange(1, self.samples + 1) / self.samples if level == 0 else np.ones(1)
            a = h * weights(z, self.c, self.c)  # (L, n, s, s)
            lanes, n, m = self.B.shape
            p, s = self.C.shape[1], self.points
            outputs = np.einsum("lpn,lni->lpin", self.C, np.exp(self.lam[..., None] * h * self.c))
            reply = np.einsum("lpn,lnik,lnm->lpimk", self.C, a, self.B, optimize=True)
            drive = h * np.einsum("lnm,lnek->lenmk", self.B, weights(z, self.c, ends))
            reach = (np.abs(reply).max(axis=(2, 4)) / self.scales[:, None]).max(axis=1)
            self.tables[level] = Table(
                np.exp(z[:, None] * ends[:, None]),
                outputs.reshape(lanes, p * s, n),
                np.ascontiguousarray(reply.reshape(lanes, p * s, m * s)),
                drive.reshape(lanes, len(ends) * n, m * s),
                reach,
            )
        return self.tables[level]

    def free_run(self, w: Array, known: Array) -> Array:
        """Step through known inputs (L, N, m, s); return the states (N S, L, n) at the samples."""
        table = self.table(0)
        lanes, count = known.shape[:2]
        push = known.reshape(lanes, count, -1) @ np.swapaxes(table.drive, 1, 2)
        states = np.ascontiguousarray(np.moveaxis(push.reshape(lanes, count, self.samples, -1), 0, 2))
        for k in range(count):
            states[k] += np.swapaxes(table.free * w[:, None], 0, 1)
            w = states[k, -1]
        return states.reshape(-1, *w.shape)

    def forced_run(self, w: Array, known: Array, nodes: Callable[[int], Nodes], history: History) -> Array:
        """Step with forces that depend on the motion; return the states (N S, L, n) at the samples.

        Raises:
            ArithmeticError: the forces of a step cannot be solved, or the motion grows without bound
        """
        lanes, count, m, s = known.shape
        flat = known.reshape(lanes, count, m * s, 1)
        table = self.table(0)
        states = np.empty((count, self.samples, *w.shape), complex)
        guess = np.zeros((lanes, m, s), complex) if history.guess is None else history.guess
        for k in range(count):
            now = nodes(k)
            now.past = history.past()
            ends, f, y = self.advance(w, flat[:, k], now, guess, table, 0)
            if not (np.abs(y[..., -1]) <= FAR * self.scales).all():  # not a number, too
                raise ArithmeticError("the motion grows without bound")
            history.keep(y)
            guess = f @ self.extrapolate.T if self.rough is None else f[..., -1:] + np.zeros(s)
            states[k] = np.swapaxes(ends, 0, 1)
            w = ends[:, -1]
        history.guess = guess
        return states.reshape(-1, *w.shape)

    def advance(
        self, w: Array, known: Array, nodes: Nodes, guess: Array, table: Table, level: int, lanes: Array | None = None
    ) -> tuple[Array, Array, Array]:
        """Take one step; return states (L, S, n) at its samples, inputs (L, m, s), outputs (L, p, s) at its nodes."""
        shape = guess.shape
        base = table.outputs @ w[..., None] + table.reply @ known
        f, y, good = self._solve(base, table, nodes, guess)
        bad = np.empty(0, int)
        if self.rough is not None and level < DEEPEST:
            error = self._defect(nodes, f, y, table)
            bad = np.flatnonzero((error > self.rough) | ~good)
        elif not good.all():
            raise ArithmeticError("the forces of a step did not converge")
        ends = table.free * w[:, None] + (table.drive @ (known + f.reshape(shape[0], -1, 1))).reshape(table.free.shape)
        if len(bad):
            whole = bad if lanes is None else lanes[bad]
            smaller = self.table(level + 1).lanes(whole)
            part, inner = w[bad], guess[bad]
            for half in self.halves:
                here = (known.reshape(shape)[bad] @ half.T).reshape(len(bad), -1, 1)
                start = inner[..., -1:] + np.zeros(self.points)
                states, inner, last = self.advance(
                    part, here, nodes.part(bad, half, self.timed), start, smaller, level + 1, whole
                )
                part = states[:, -1]
            ends[bad, -1] = part
            f[bad, :, -1], y[bad, :, -1] = inner[..., -1], last[..., -1]
        return ends, f, y

    def _defect(self, nodes: Nodes, f: Array, y: Array, table: Table) -> Array:
        """Return (L,) how far the polynomial is from the forces between its nodes, as an error of the outputs."""
        forces = self.forces
        assert forces is not None
        every = np.arange(len(f))
        wrong = f @ self.between.T - forces(nodes.part(every, self.between, self.timed), y @ self.between.T)
        return np.asarray((np.abs(wrong).max(axis=2) * table.reach).max(axis=1))

    def _solve(self, base: Array, table: Table, nodes: Nodes, guess: Array) -> tuple[Array, Array, Array]:
        """Solve f = F(base + reply f); return f, the outputs, and which lanes converged."""
        forces = self.forces
        assert forces is not None
        lanes, _, s = guess.shape
        f, last = guess, np.inf
        enough = EXACT if self.rough is None else 1e-3 * self.rough
        patience = 4 if self.paired else 1  # a step of Newton's method costs more there
        for k in range(FIXED_POINT):
            y = (base + table.reply @ f.reshape(lanes, -1, 1)).reshape(lanes, -1, s)
            new = forces(nodes, y)
            change = (np.abs(new - f).max(axis=2) * table.reach).max()
            f = new
            if change <= enough:
                return f, y, np.ones(lanes, bool)
            if change > 0.6 * last and k > patience:
                break
            last = change
        return self._newton(base, table, nodes, f)

    def _newton(self, base: Array, table: Table, nodes: Nodes, f: Array) -> tuple[Array, Array, Array]:
        """Solve by Newton's method with numerical derivatives of the forces, which are local in time.

        dF = alike dy + other conj(dy),   dy = reply df  or, of paired inputs,  reply_1 df + reply_2 conj(df)
        """
        forces = self.forces
        assert forces is not None
        lanes, _, s = f.shape
        m = f.shape[1] // 2 if self.paired else f.shape[1]
        size, reply = m * s, table.reply
        good = np.zeros(lanes, bool)
        enough = EXACT if self.rough is None else 1e-3 * self.rough
        for _ in range(NEWTON):
            y = (base + reply @ f.reshape(lanes, -1, 1)).reshape(lanes, -1, s)
            here = forces(nodes, y)
            residual = f - here
            good = (np.abs(residual).max(axis=2) * table.reach).max(axis=1) <= enough
            if good.all():
                break
            here, residual = here[:, :m], residual[:, :m]
            straight = np.zeros((lanes, size, size), complex)
            turned = np.zeros((lanes, size, size), complex)
            for j in range(y.shape[1]):
                small = 1e-7 * np.abs(y[:, j]).max() + 1e-16
                derivatives = []
                for way in (1.0, 1j):
                    moved = y.copy()
                    moved[:, j] += small * way
                    derivatives.append((forces(nodes, moved)[:, :m] - here) / small)
                blocks = reply.reshape(lanes, y.shape[1], s, -1)[:, j]  # (L, s, inputs)
                block, conjugate = blocks[..., :size], blocks[..., size:]
                alike = (derivatives[0] - 1j * derivatives[1]) / 2
                other = (derivatives[0] + 1j * derivatives[1]) / 2
                straight += (alike[..., None] * block[:, None]).reshape(lanes, size, size)
                turned += (other[..., None] * block.conj()[:, None]).reshape(lanes, size, size)
                if self.paired:
                    straight += (other[..., None] * conjugate.conj()[:, None]).reshape(lanes, size, size)
                    turned += (alike[..., None] * conjugate[:, None]).reshape(lanes, size, size)
            J = np.empty((lanes, 2 * size, 2 * size))
            J[:, :size, :size] = np.eye(size) - straight.real - turned.real
            J[:, :size, size:] = straight.imag - turned.imag
            J[:, size:, :size] = -straight.imag - turned.imag
            J[:, size:, size:] = np.eye(size) - straight.real + turned.real
            r = residual.reshape(lanes, -1)
            move = np.linalg.solve(J, np.concatenate([r.real, r.imag], axis=1)[..., None])[..., 0]
            part = f[:, :m] - (move[:, :size] + 1j * move[:, size:]).reshape(lanes, m, s)
            f = np.concatenate([part, part.conj()], axis=1) if self.paired else part
        return f, y, good


class History:
    """The outputs of the last steps, for forces that come late by a whole number of steps."""

    def __init__(self, steps: int = 0) -> None:
        self.steps = steps
        self.kept: list[Array] = []
        self.guess: Array | None = None  # of the forces in the next step

    def keep(self, y: Array) -> None:
        """Remember the outputs at the nodes of a step."""
        if self.steps:
            self.kept.append(y)

    def past(self) -> Array | None:
        """Return the outputs of `steps` steps ago, or None if that was before the start."""
        return self.kept.pop(0) if self.steps and len(self.kept) >= self.steps else None
