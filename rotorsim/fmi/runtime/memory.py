"""The block of numbers that an FMU and its user share: in one process, or between two.

64 whole numbers (who asks, what, what came of it), 16 numbers (time, step, ...), then u, its derivatives, y, x, its
derivative, event indicators and nominal values. Its layout follows from four sizes that both sides know.
"""

from __future__ import annotations

import contextlib
import ctypes
import mmap
from dataclasses import dataclass

_HEAD, _SCALARS = 64, 16


class Head:
    """Places in the head; what the two sides write lies on different cache lines."""

    REQUEST, OP, USER_SLEEPS = 0, 1, 2  # written by the user
    REPLY, STATUS, SAID, FUNCTION, FMU_SLEEPS, WARNED = 16, 17, 18, 19, 20, 21  # beside the FMU; STATUS is taken back


class Op:
    """What to do, in this order; bits."""

    TIME, X, U, DU, STEP, XDOT, Y, Z, COMPLETED, EVENT = (1 << k for k in range(10))
    COMMAND = -1


class Said:
    """What the FMU said; bits."""

    EVENT, TERMINATE, STATES, NOMINALS = (1 << k for k in range(4))
    UNTOLD, PENDING = -100, -101  # of a completed step, in C; other negative numbers are statuses


@dataclass(frozen=True)
class Sizes:
    """Numbers of scalars in all, states, event indicators; order: derivatives of inputs."""

    n: int
    n_x: int
    n_z: int
    order: int = 0

    @property
    def bytes(self) -> int:
        """How long the block is."""
        return 8 * (_HEAD + _SCALARS + self.n * (2 + self.order) + 3 * self.n_x + self.n_z)


class Block:
    """Views on a block: head (whole numbers), numbers, and the offsets of the vectors in numbers."""

    T, H, NEXT, LAST = (_HEAD + k for k in range(4))

    def __init__(self, memory: mmap.mmap, sizes: Sizes) -> None:
        self.sizes, self.memory = sizes, memory
        with memoryview(memory) as whole, whole[: sizes.bytes] as view:
            self.head = view.cast("q")
            self.numbers = view.cast("d")
        self.address = ctypes.addressof(ctypes.c_char.from_buffer(memory))
        self.u = _HEAD + _SCALARS
        self.du = self.u + sizes.n
        self.y = self.du + sizes.n * sizes.order
        self.x = self.y + sizes.n
        self.xdot = self.x + sizes.n_x
        self.nominals = self.xdot + sizes.n_x
        self.z = self.nominals + sizes.n_x

    def at(self, offset: int) -> int:
        """Return the address of a number."""
        return self.address + 8 * offset

    def close(self) -> None:
        """Give the memory back, once nobody has a view on it; nothing here can be used afterwards."""
        self.head.release()
        self.numbers.release()
        with contextlib.suppress(BufferError):
            self.memory.close()
