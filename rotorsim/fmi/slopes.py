"""The factors of an FMU that says that its equations are linear: x' = A(p) x + B(p) (u - u0) + f(t; p), y likewise."""

from __future__ import annotations

from collections import OrderedDict

import numpy as np

from rotorsim.errors import RotorsimError
from rotorsim.fmi.derivatives import CHECKED
from rotorsim.fmi.equations import KEPT_POINTS, FmuEquations

# Of the nominal value of a state, and of 1 of an input beside that with which it begins: nominal values are often
# guessed from units alone. A dead zone, or a limit, of a thousandth of it is met, and a cube that bends by a thousandth
# at a thousandfold.
PROBED = (1e-3, 1.0, 1e3)
CANCELLED = 1e-12  # of sums that cancel: rounding of 4500 terms


class Slopes:
    """The factors of states and inputs in x' and y, by the parameters."""

    def __init__(self, equations: FmuEquations) -> None:
        self.equations = equations
        self._known: OrderedDict[bytes, np.ndarray] = OrderedDict()
        self._most = KEPT_POINTS * (2 * equations.n_p + 2)
        self._is_checked = False

    def at(self, p: np.ndarray) -> np.ndarray:
        """Return the factors at parameters p (n_p,), (n_x + n_y, n_x + n_u).

        Raises FmuError where x' and y are not linear after all, or have a time event.
        """
        key = p.tobytes()
        if key not in self._known:
            if len(self._known) >= self._most:
                self._known.popitem(last=False)
            self._known[key] = self._found(p)
        return self._known[key]

    def _found(self, p: np.ndarray) -> np.ndarray:
        eq = self.equations
        due = eq.mode(p)[1]
        if np.isfinite(due):
            raise eq.at_work(p).event_refused(f"has a time event at t = {due:.6g} s", 0.0)
        J = eq.jacobian(0.0, np.zeros(eq.n_x), eq.idle, p, (False, True, True, False))
        J = J[:, 1 : 1 + eq.n_x + eq.n_u]
        if not self._is_checked:
            self._check(J, p)
        return J

    def _check(self, J: np.ndarray, p: np.ndarray) -> None:
        """Once: raise FmuError where the factors do not give x' and y, by each state and input alone and by all."""
        eq = self.equations
        rest = eq.both(0.0, np.zeros(eq.n_x), eq.idle, p)
        sizes = np.concatenate([eq.nominals, np.ones(eq.n_u)])
        for direction in (*np.eye(len(sizes)), np.where(np.arange(len(sizes)) % 2, -1.0, 1.0)):
            for size in PROBED:
                point = size * sizes * direction
                try:
                    found = eq.both(0.0, point[: eq.n_x], eq.idle + point[eq.n_x :], p)
                except RotorsimError:  # beyond what it is made for
                    continue
                off = np.abs(found - rest - J @ point)
                room = CHECKED * (np.abs(J) @ np.abs(point)) + CANCELLED * (np.abs(found) + np.abs(rest))
                if (off > room).any():
                    name = [*eq.description.derivatives, *eq.y_names][int((off - room).argmax())]
                    what = f"says that {name} is linear in states and inputs, and it is not"
                    hint = 'tell its maker; "linear": false takes its equations as they are'
                    raise eq.at_work(p).step_failed("-", what, "refused", 0.0, hint)
        self._is_checked = True
