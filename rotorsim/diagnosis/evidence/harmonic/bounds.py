"""Lower bounds of the misfit: a diagram with free harmonics of a force, or of a sensor error, at a place.

A force of any law at a node is one set of harmonics in each run. With all of them free, beside one step of the
diagram's own parameters, the misfit is the least that any fault candidate can reach there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from rotorsim.block import In
from rotorsim.diagnosis.catalogue.insertion import Insertion
from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.evidence.evidence import Promise
from rotorsim.diagnosis.evidence.fit import FAILURES, Fit
from rotorsim.diagnosis.evidence.harmonic.projection import basis_of, with_delay
from rotorsim.diagnosis.evidence.harmonic.runs import HarmonicRuns
from rotorsim.diagram.diagram import Diagram
from rotorsim.identification.harmonic.likelihood import Likelihood
from rotorsim.linear.linearisation import entry_names
from rotorsim.signals.covariance import real_vector


class LowerBounds:
    """Bounds on the misfit for every place where something may act on a fitted linear diagram."""

    by_law, sure = False, True
    classes, deviance = (), np.inf
    carried: Mapping[str, float] = {}

    def __init__(self, likelihood: Likelihood, theta: np.ndarray, targets: list[str]) -> None:
        self.likelihood = likelihood
        self.found = likelihood.evaluate(theta)
        self.predicted = likelihood.experiment.motion.predict(theta)
        self.transfer = self.predicted.by_inputs()
        self.others = likelihood.nuisances(self.predicted, self.found.Y)
        self.places = {name: k for k, name in enumerate(targets)}
        self._known: dict[tuple[str, ...], float] = {}

    def bound(self, item: Insertion) -> float | None:
        """Return the least misfit that an insertion can leave over, None where nothing is known of it."""
        key = self.entries(item)
        return None if key is None else self._bound(key)

    def promises(self, items: Sequence[Insertion]) -> list[Promise | None]:
        """Return the bounds of insertions; a place says nothing of the parameters of a law."""
        return [None if (bound := self.bound(item)) is None else Promise(bound) for item in items]

    def least(self, item: Insertion) -> list[tuple[float, float]] | None:
        """Return of each run the least misfit that an insertion can leave, and the equations that are left then."""
        key = self.entries(item)
        return None if key is None else self.free(*key)

    def free(self, kind: str, *names: str) -> list[tuple[float, float]]:
        """Return of each run misfit and equations with free harmonics of inputs ("force") or channels ("reading")."""
        return self._rests(kind == "force", names)

    def entries(self, item: Insertion) -> tuple[str, ...] | None:
        """Return "force" and the inputs where an insertion acts, or "reading" and the channels that it falsifies."""
        if item.fault.enters == "force":
            names = [target.replace(" ", "") for runs, target in item.wires if runs.startswith(f"{item.name}.")]
            inside = [name for name in self.places if any(_within(name, target) for target in names)]
            return ("force", *inside) if inside else None
        if item.measured and not item.cut and item.fault.enters in ("reading", "wire"):
            read = [n for n in self.likelihood.experiment.predicted if any(_within(n, m) for m in item.measured)]
            return ("reading", *read) if read else None
        return None

    def _bound(self, key: tuple[str, ...]) -> float:
        if key not in self._known:
            self._known[key] = sum(misfit for misfit, _ in self._rests(key[0] == "force", key[1:]))
        return self._known[key]

    def _rests(self, force: bool, names: tuple[str, ...]) -> list[tuple[float, float]]:
        """Return of each run misfit and equations with free harmonics of some inputs, or of what some channels read."""
        likelihood, orders = self.likelihood, self.likelihood.orders
        rests, jacobians, counts = [], [], []
        residual, jacobian = with_delay(self.found)
        at = 0
        for r, white in enumerate(likelihood.whiteners):
            size = len(white.keep)
            part = slice(at, at + size)
            e, J = residual[part], jacobian[part]
            at += size
            effects = self._effects(r, force, names)
            columns = np.zeros((effects.shape[2] * (2 * orders - 1), orders, likelihood.c), complex)
            row = 0
            for k in range(orders):
                for v in range(effects.shape[2]):
                    for phase in (1.0, 1j) if k else (1.0,):
                        columns[row, k] = effects[k, :, v] * phase
                        row += 1
            q = basis_of(np.hstack([self.others[r], white.apply(real_vector(columns).T)]))
            rests.append(e - q @ (q.T @ e))
            jacobians.append(J - q @ (q.T @ J))
            counts.append(size - q.shape[1])
        rest, J = (np.concatenate([*parts, whole[at:]]) for parts, whole in ((rests, residual), (jacobians, jacobian)))
        q = basis_of(J)
        rest = rest - q @ (q.T @ rest)
        ends = np.cumsum([len(part) for part in rests])[:-1]
        share = q.shape[1] / len(rests)
        parts = zip(np.split(rest[: int(sum(map(len, rests)))], ends), counts, strict=True)
        return [(float(part @ part), count - share) for part, count in parts]

    def _effects(self, r: int, force: bool, names: tuple[str, ...]) -> np.ndarray:
        """Return what unit harmonics change in the predicted channels of a run, (orders, c, number)."""
        if force:
            return np.asarray(self.transfer[r][:, :, [self.places[name] for name in names]])
        predicted = self.likelihood.experiment.predicted
        unit = np.zeros((self.likelihood.orders, len(predicted), len(names)), complex)
        for v, name in enumerate(names):
            unit[:, predicted.index(name), v] = 1.0
        return unit


def _within(name: str, port: str) -> bool:
    """Return whether a flat name ("rotor.force[3,1]") is an entry of a port or of a part of it ("rotor.force[3]")."""
    return name == port or name.startswith(f"{port.removesuffix(']')}," if port.endswith("]") else f"{port}[")


def open_bounds(fit: Fit, runs: HarmonicRuns) -> LowerBounds | None:
    """Return the lower bounds beside a fit on some runs, None where it has none (it is not linear)."""
    try:
        diagram = runs.load(values_in(fit.document, fit.values))
        targets = additive_inputs(diagram)
        experiment = runs.open(diagram, inject=targets)
        if not targets or not experiment.motion.is_linear:
            return None
        ports = {target: diagram.nodes[target.split(".")[0]].inputs[target.split(".")[1]] for target in targets}
        entries = [name for target, port in ports.items() for name in entry_names(target, port.shape)]
        return LowerBounds(Likelihood(experiment), experiment.theta0, entries)
    except FAILURES:
        return None


def additive_inputs(diagram: Diagram) -> list[str]:
    """Return the inputs "block.port" where a further force or signal can be added."""
    return [
        f"{block}.{port.name}"
        for block, node in diagram.nodes.items()
        for port in node.inputs.values()
        if isinstance(port.declaration, In) and port.declaration.additive
    ]
