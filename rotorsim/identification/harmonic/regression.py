"""The thesis' regression: the residual forces of the equations of motion at the measured places.

At harmonic k the measured motion Y_k and the measured inputs V_k (currents) ask for an equivalent force
w_k = Z_k [Y_k - Y_k(V_k; theta)] at the measured places, with Z_k the dynamic stiffness condensed exactly to these
places at this very frequency. Least squares of w over harmonics, runs and places gives the parameters; their
columns are derivatives of the traced equations. No weights, as in the thesis.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy

import numpy as np

from rotorsim.diagram.diagram import Diagram, Free
from rotorsim.errors import Problem, RotorsimError
from rotorsim.identification.harmonic.experiment import Experiment, open_experiment
from rotorsim.identification.harmonic.likelihood import Evaluation
from rotorsim.identification.harmonic.reduction import conjugates_of, reduced
from rotorsim.linear.linearisation import can_move, entry_names, flat_names
from rotorsim.model.compiled import Model, compile_diagram
from rotorsim.recordings.recording import ANGLE, TACHO, Recording, Run
from rotorsim.signals.harmonics import RunHarmonics

THESIS_ORDERS = (0, 1, 2, 3, 5, 7, -1, -3, -5)  # eq. (2.64), Table 2-2
REDUCTIONS = ("exact", "central")


class Regression:
    """Equivalent forces at the measured places as residuals, with their derivatives; same use as `Likelihood`.

    orders: harmonics of x + i y that count, negative ones whirl backward. reduction: "exact", or "central" for the
    thesis' dynamic condensation at the mean speed of all runs, eq. (3.31)-(3.42), (4.25)-(4.29).
    """

    absolute = False  # the residual is not in units of the noise

    def __init__(
        self,
        experiment: Experiment,
        forces: Sequence[tuple[str, str]],
        orders: Sequence[int] = THESIS_ORDERS,
        reduction: str = "exact",
    ) -> None:
        self.experiment, self.reduction = experiment, reduction
        self.orders = [k for k in orders if abs(k) <= experiment.motion.K]
        if not self.orders:
            hint = f"the runs carry orders up to {experiment.motion.K}"
            raise RotorsimError(Problem("no order is left for the regression", experiment.recording.name, hint=hint))
        self.K = max(abs(k) for k in self.orders)
        self.c, self.V = len(experiment.predicted), len(experiment.given)
        external = experiment.model.trace.external.values()
        self.force_entries = np.array([_entry(experiment.model, flat) for _, flat in forces])
        places = [flat for signal in external for flat in entry_names(signal.name, signal.shape)]
        self.given_entries = np.array([places.index(name) for name in experiment.given], int)
        self.n_v = len(places)
        self.data = experiment.measured(self.K)
        # a mean that slow states have not let settle obeys no equation of balance
        settled = not any(len(slow) for slow in experiment.linear.slow_states(experiment.theta0))
        use_mean = experiment.use_mean[: self.c] & experiment.use_mean[self.c :].all() & settled
        self.rows = _selection(experiment.predicted, self.orders, use_mean)
        if not len(self.rows[0]):
            raise RotorsimError(Problem("no equation is left for the regression", experiment.recording.name))
        self._condensed = reduced(experiment, self.force_entries) if reduction == "central" else None

    def again(self, experiment: Experiment) -> Regression:
        """Return the regression of the same experiment `again`."""
        other = copy(self)
        other.experiment = experiment
        other.data = experiment.measured(self.K)
        if self._condensed is not None and experiment.motion is not self.experiment.motion:
            other._condensed = self._condensed.again(experiment)
        return other

    def evaluate(self, theta: np.ndarray) -> Evaluation:
        """Return the equivalent forces [N] and their derivatives at theta (m,)."""
        if self._condensed is not None:
            w, jacobian = self._condensed.forces(theta, self.data[:, :, : self.c], self._inputs())
        else:
            w, jacobian = self._exact(theta)
        residual = self._chosen(w)
        columns = self._chosen(jacobian).reshape(-1, jacobian.shape[-1])
        misfit = (residual**2).sum(axis=(1, 2))
        return Evaluation(residual.ravel(), columns, misfit, self.data[:, :, : self.c], residual.size)

    def _chosen(self, w: np.ndarray) -> np.ndarray:
        """Return the equations that count of forces (R, K+1, c, ...), real and imaginary part, (R, rows, 2, ...).

        x + i y at order k > 0 is the forward part; its conjugate components make the backward part at -k.
        """
        orders, x, y = self.rows
        a = w[:, np.abs(orders), x]
        b = w[:, np.abs(orders), y]
        shape = (1, -1, *([1] * (w.ndim - 3)))
        forward = (orders >= 0).reshape(shape)
        single = (x == y).reshape(shape)
        two = np.where(forward, a + 1j * b, a.conj() + 1j * b.conj())
        value = np.where(single, a, two)
        return np.stack([value.real, value.imag], axis=2)

    def _inputs(self) -> np.ndarray:
        inputs = np.zeros((*self.data.shape[:2], self.n_v), complex)
        inputs[:, :, self.given_entries] = self.data[:, :, self.c :]
        return inputs

    def _exact(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        response = self.experiment.linear.response(theta, self.K)
        inputs = self._inputs()
        Y = response.outputs(response.states(inputs), inputs)
        compliance = response.transfer()[..., self.force_entries]
        stiffness = np.linalg.inv(compliance)
        w = np.einsum("rkij,rkj->rki", stiffness, self.data[:, :, : self.c] - Y)
        inputs[:, :, self.force_entries] += w
        jacobian = response.sensitivity(response.states(inputs), inputs)
        return w, -stiffness @ jacobian


def open_regression(
    diagram: Diagram,
    recording: Recording,
    *,
    runs: Sequence[Run] | None = None,
    free: Sequence[Free] | None = None,
    orders: Sequence[int] = THESIS_ORDERS,
    reduction: str = "exact",
    harmonics: Sequence[RunHarmonics] | None = None,
) -> Regression:
    """Return the regression of a diagram on a recording.

    Measured outputs at which a force can act (they are the `conjugate` of an additive input) are where the
    equations are written; every other port that was measured whole is taken as a measured input.
    Raises RotorsimError when there is no such place, and what `open_experiment` raises.
    """
    if reduction not in REDUCTIONS:
        raise RotorsimError(Problem(f"no reduction '{reduction}'", hint=f"one of {', '.join(REDUCTIONS)}"))
    model = compile_diagram(diagram)
    conjugates = conjugates_of(diagram)
    angle = (ANGLE, TACHO)
    measured = [c.name for c in recording.channels.values() if c.signal in model.signals and c.signal not in angle]
    places = [
        (name, name.replace(base, conjugates[base], 1))
        for name in measured
        if (base := name.partition("[")[0]) in conjugates
    ]
    places = [pair for pair in places if can_move(model, pair[0])]
    if not places:
        hint = "the thesis' method needs the displacement where forces act; --method likelihood needs not"
        raise RotorsimError(Problem("no place was measured at which a force can act", recording.name, hint=hint))
    ports = dict.fromkeys(name.partition("[")[0] for name in measured)
    given = [p for p in ports if p not in conjugates and set(flat_names(model, p)) <= set(measured)]
    inject = list(dict.fromkeys(force.partition("[")[0] for _, force in places))
    if reduction == "central":
        blocks = {port.rpartition(".")[0] for port in inject}
        inject = [force for force in dict.fromkeys(conjugates.values()) if force.rpartition(".")[0] in blocks]
    dropped = [name for name in measured if name.partition("[")[0] not in given and name not in dict(places)]
    experiment = open_experiment(
        diagram, recording, runs=runs, given=given, inject=inject, free=free, harmonics=harmonics, drop=dropped
    )
    return Regression(experiment, places, orders, reduction)


def _entry(model: Model, flat: str) -> int:
    """Return where an entry of an external input lies in v."""
    signal = model.trace.external[flat.partition("[")[0]]
    return int(signal.part.start) + entry_names(signal.name, signal.shape).index(flat)


def _selection(
    predicted: Sequence[str], orders: Sequence[int], use_mean: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the equations that count: signed orders, entries of x, entries of y (that of x for a single axis)."""
    rows: list[tuple[int, int, int]] = []
    seen: set[int] = set()
    for k, name in enumerate(predicted):
        if k in seen:
            continue
        partner = None
        if name.endswith("1]"):
            other = name[:-2] + "2]"
            partner = predicted.index(other) if other in predicted else None
        elif name.endswith("2]") and name[:-2] + "1]" in predicted:
            continue
        seen.add(k)
        wanted = orders if partner is not None else sorted({abs(order) for order in orders})
        last = k if partner is None else partner
        rows += [(order, k, last) for order in wanted if order or (use_mean[k] and use_mean[last])]
    table = np.array(rows, int).reshape(-1, 3)
    return table[:, 0], table[:, 1], table[:, 2]
