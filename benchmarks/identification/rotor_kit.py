"""A measured run-up of a two-disc rotor kit: python -m benchmarks.identification.rotor_kit FOLDER.

With --figure FILE the Bode plot is drawn; --laws tries every law of the catalogue instead (minutes).

FOLDER holds recording.json (docs/runup.md) and the table, one row a turn. Is the "smaller resonance" behind the first
critical speed a second critical speed, or does the acceleration make one mode ring? Each hypothesis is fitted to the
same vectors, with slow roll; those that call the motion settled by the same equations at the speed of each row.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.images import save_png
from rotorsim.criteria import CRITERIA
from rotorsim.diagnosis.catalogue.finder import insertions
from rotorsim.diagnosis.catalogue.insertion import starts_of
from rotorsim.diagram.diagram import Diagram, Free
from rotorsim.identification.files import with_values
from rotorsim.identification.in_orders import order_estimate
from rotorsim.identification.waveform.estimate import TimeEstimate
from rotorsim.identification.waveform.order_tracking import (
    OrderSearch,
    TrackedOrders,
    order_noise,
    order_search,
    tracked_orders,
    vectors_of,
)
from rotorsim.linear.modes.eigenmodes import modes
from rotorsim.model.load import load
from rotorsim.model.matrix_function import MatrixFunction
from rotorsim.recordings.orders import OrderRecording, load_orders
from rotorsim.report.figures.bode import Curve, bode_figure

RPM = 30 / np.pi
MASS, GYROSCOPIC = 1.955, 0.0011552 * 5.27**2  # kg, of diagrams/rk4_first_mode.json
ONE_MODE = ("unbalance.eccentricity", "unbalance.phase", "rotor.stiffness", "rotor.viscous_damping")
TWO_PLANES = (*ONE_MODE, "support.stiffness[2]", "support.damping[2]")
DIRECTIONS = (30.0, 35.0, 40.0, 45.0, 50.0, 55.0, 60.0)  # deg, of the probe from the softer axis
LEVER = 0.719  # displacement of the probe over that of the discs
# rpm, in the plane of x and in that of y, where searches of two planes begin; the last are those that were read off
_LOW_HIGH = ((1500.0, 1700.0), (1570.0, 1660.0), (1640.0, 1650.0), (1648.0, 1750.0))
PAIRS = tuple(pair for low, high in _LOW_HIGH for pair in ((low, high), (high, low)))
BANDS = ((1030.0, 1450.0), (1450.0, 1700.0), (1700.0, 1870.0), (1870.0, 2620.0))  # rpm
BEATS = 5  # maxima behind the first that are larger than the noise by far
BUMP = (1735.0, 1806.0)  # rpm, between the minima beside the second maximum


@dataclass(frozen=True, eq=False)
class SettledSearch(OrderSearch):
    """The same search, each row taken for settled motion at its speed: (i W - A) x = b, derivatives by differences."""

    @cached_property
    def _rates(self) -> MatrixFunction:
        eq = self.systems[0].equations
        return MatrixFunction(eq.arguments, eq.f)

    def _vectors(self, theta: np.ndarray, r: int) -> np.ndarray:
        assert self.tracked is not None
        eq, W = self.systems[0].equations, self.tracked.tracks[r].source.speed
        p, none = eq.parameters(self.p[r], theta), np.zeros(eq.n)
        quarters = [np.array([np.full(len(W), angle), W, np.zeros(len(W))]) for angle in (0.0, np.pi / 2)]
        A, C = (matrix(0.0, none, quarters[0], p) for matrix in eq.matrices)
        cosine, sine = (self._rates(0.0, none, v, p)[:, :, 0] for v in quarters)
        x = np.linalg.solve(1j * W[:, None, None] * np.eye(eq.n) - A, (cosine - 1j * sine)[:, :, None])
        return np.asarray((C @ x)[:, list(self.tracked.places), 0])

    def simulated(
        self, unknowns: np.ndarray, k: int, r: int, sub: int, sensitivities: bool = True
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the settled vectors of a run (n, 2 c), and their derivatives by the unknowns."""
        theta = unknowns[: self.m]

        def parts(vectors: np.ndarray) -> np.ndarray:
            return np.stack([vectors.real, vectors.imag], axis=2).reshape(len(vectors), -1)

        y = parts(self._vectors(theta, r))
        derivatives = np.zeros((*y.shape, len(unknowns) if sensitivities else 0))
        for j in range(self.m if sensitivities else 0):
            step = np.zeros(self.m)
            step[j] = 1e-5 * max(abs(theta[j]), self.free[j].scale)
            ends = [parts(self._vectors(theta + sign * step, r)) for sign in (1, -1)]
            derivatives[:, :, j] = (ends[0] - ends[1]) / (2 * step[j])
        if sensitivities:
            derivatives[:, :, self.m :] = np.eye(y.shape[1], self.constants)
        return y + unknowns[self.m :], derivatives


@dataclass(frozen=True, eq=False)
class Fitted:
    """A hypothesis beside the data: its estimate and vectors (n,), complex, SI."""

    name: str
    estimate: TimeEstimate
    vectors: np.ndarray

    @property
    def values(self) -> dict[str, float]:
        """The parameters by name, SI."""
        return dict(zip((item.name for item in self.estimate.free), self.estimate.theta.tolist(), strict=True))

    @property
    def criterion(self) -> float:
        """n ln(misfit / n) + q ln n: the Bayesian information criterion of noise of unknown level."""
        n, q = self.estimate.rows, len(self.estimate.evaluation.unknowns)
        return float(n * np.log(self.estimate.misfit / n) + q * np.log(n))

    def ends(self, of: Callable[[dict[str, float]], float]) -> tuple[float, float]:
        """Return a figure that follows from the parameters, and the half width of its 90 % interval, to first order."""
        names, theta = [*self.values], self.estimate.theta
        slope = np.zeros(len(theta))
        for j, value in enumerate(theta):
            step = 1e-4 * max(abs(value), self.estimate.free[j].scale)
            unit = np.arange(len(theta)) == j
            above, below = (of(dict(zip(names, theta + sign * step * unit, strict=True))) for sign in (1, -1))
            slope[j] = (above - below) / (2 * step)
        return of(self.values), self.estimate.quantile * float(np.sqrt(slope @ self.estimate.covariance @ slope))


def planes(values: dict[str, float]) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return stiffness and damping in the softer and in the stiffer plane."""
    k, c = values["rotor.stiffness"], values["rotor.viscous_damping"]
    other = k + values.get("support.stiffness[2]", 0.0), c + values.get("support.damping[2]", 0.0)
    return ((k, c), other) if k <= other[0] else (other, (k, c))


def critical(values: dict[str, float], which: int) -> float:
    """Return a speed [rpm] where an undamped rotor has no bound: (k_x - m W^2) (k_y - m W^2) = g^2 W^4.

    Of one isotropic mode it is W^2 = k / (m - g), where forward whirl meets the speed.
    """
    (k1, _), (k2, _) = planes(values)
    if k1 == k2:
        return float(np.sqrt(k1 / (MASS - GYROSCOPIC)) * RPM)
    squares = np.sort(np.roots([MASS**2 - GYROSCOPIC**2, -MASS * (k1 + k2), k1 * k2]).real)
    return float(np.sqrt(squares[which]) * RPM)


def damping(values: dict[str, float], which: int) -> float:
    """Return the damping ratio c / (2 sqrt(k m)) in the softer or the stiffer plane."""
    k, c = planes(values)[which]
    return c / (2 * float(np.sqrt(k * MASS)))


def fitted(
    name: str,
    diagram: Diagram,
    recording: OrderRecording,
    names: Sequence[str],
    kind: type[OrderSearch],
    pairs: Sequence[tuple[float, float]] = PAIRS,
) -> Fitted:
    """Fit a hypothesis to the first run: the best end of searches from several starts."""
    free = [item for item in diagram.free if item.name in names]
    tracked, variance = opened(diagram, recording, free)
    made = order_search(tracked, variance)
    search = kind(made.systems, made.runs, made.weights, tracked=tracked)
    starts = [search.first()]
    for pair in pairs if "support.stiffness[2]" in names else ():
        first, second = (MASS * (speed / RPM) ** 2 for speed in pair)
        start = search.first()
        start[[names.index("rotor.stiffness"), names.index("support.stiffness[2]")]] = first, second - first
        starts.append(start)
    evaluation = min((search.minimise(start) for start in starts), key=lambda found: found.cost)
    return Fitted(name, order_estimate(search, evaluation, variance), vectors_of(search, evaluation)[0][:, 0])


def opened(
    diagram: Diagram, recording: OrderRecording, free: Sequence[Free]
) -> tuple[TrackedOrders, dict[tuple[str, str], float]]:
    """Return the order vectors of a recording beside a diagram, and their noise."""
    tracked = tracked_orders(diagram, recording, recording.select("identify"), free)
    return tracked, order_noise(tracked, CRITERIA.resolution)


def laws(recording: OrderRecording) -> list[str]:
    """Return what every law of the catalogue that fits into the diagram leaves, put in beside hypothesis (d)."""
    diagram = load("rk4_first_mode")
    before = fitted("", diagram, recording, TWO_PLANES, OrderSearch, PAIRS[2:4])
    document = with_values(
        diagram, list(zip(before.estimate.free, before.estimate.theta.tolist(), strict=True))
    ).document
    amplitude = float(np.abs(next(iter(recording.runs[0].vectors.values()))).max()) / LEVER
    largest = {"displacement": amplitude, "velocity": amplitude * float(recording.runs[0].speed.mean())}
    found: list[tuple[float, float, str]] = []
    failed = []
    with TemporaryDirectory() as folder:
        file = Path(folder) / "diagram.json"
        file.write_text(json.dumps(document), encoding="utf-8")
        for item in insertions(load(str(file)), ["probe.output[1]"]):
            file.write_text(json.dumps(item.document(document)), encoding="utf-8")
            made = load(str(file))
            tracked, variance = opened(made, recording, made.free)
            search = order_search(tracked, variance)
            ends = []
            for start in starts_of(item, largest):
                named = {f"{item.name}.{key}": value for key, value in start.items()}
                point = search.started(search.first(), named, TWO_PLANES)
                ends += [] if point is None else [search.minimise(point)]
            ends = [end for end in ends if np.isfinite(end.cost)]
            if not ends:
                failed.append(item.key)
                continue
            end, n = min(ends, key=lambda one: one.cost), before.estimate.rows
            criterion = n * np.log(end.cost / n) + len(end.unknowns) * np.log(n)
            found.append((float(criterion) - before.criterion, end.cost / n, item.physics))
    best: dict[str, tuple[float, float]] = {}
    for more, share, physics in sorted(found, reverse=True):
        best[physics] = more, share
    rows = sorted((more, share, physics) for physics, (more, share) in best.items())[:5]
    lines = [f"{len(found)} laws of {len(best)} physics beside (d), the best:"]
    lines += [f"   {physics:25} misfit / n {share:6.2f}   BIC {more:6.1f}" for more, share, physics in rows]
    return [*lines, *(f"   no start: {key}" for key in failed)]


def published() -> list[str]:
    """Return what the data of the kit's authors say of its modes."""
    diagram = load("rk4")

    def lowest(speed: float, disc: float = 0.8, bearing: float = 1e6) -> list[tuple[str, float, np.ndarray]]:
        given = {f"bearing{k}.stiffness": [bearing, bearing] for k in (1, 2)}
        given |= {f"bearing{k}.damping": [0.0, 0.0] for k in (1, 2)}
        found = modes(diagram, parameters={**given, "speed": speed, "rotor.disc_mass": [disc, disc]}).modes[:4]
        return [(mode.whirl, 2 * np.pi * mode.natural_frequency_hz, mode.shape) for mode in found]

    def forward(number: int, bearing: float = 1e6) -> float:
        speed = 170.0
        for _ in range(20):
            speed = [w for whirl, w, _ in lowest(speed, bearing=bearing) if whirl == "forward"][number]
        return speed

    first = forward(0)
    split = [w for _, w, _ in lowest(first)][:2]
    light, heavy = (lowest(1e-3, disc=mass)[0][1] for mass in (0.8, 0.801))
    mass = 2 * 1e-3 / ((light / heavy) ** 2 - 1)
    shape = np.abs(lowest(first)[1][2])
    lever = shape[4] / shape[6]
    soft, stiff = (forward(0, bearing) * RPM for bearing in (2e5, 1e9))
    return [
        f"first critical speed, bearings 1e6 N/m           {first * RPM:8.1f} rpm",
        f"   bearings 2e5 N/m, 1e9 N/m                     {soft:8.1f}, {stiff:.1f} rpm",
        f"second critical speed                            {forward(1) * RPM:8.1f} rpm",
        f"modal mass of the first mode, at the discs       {mass:8.3f} kg",
        f"gyroscopic coefficient                           {mass * (split[1] - split[0]) / first:8.4f} kg",
        f"probe over discs                                 {lever:8.3f}",
    ]


def report(recording: OrderRecording) -> tuple[list[str], list[Fitted], float]:
    """Return the page's figures, the hypotheses, and the noise [m]."""
    diagram, run = load("rk4_first_mode"), recording.runs[0]
    alike = load("rk4_first_mode", set={"support.stiffness": [0.0, 0.0], "support.damping": [0.0, 0.0]})
    _, variance = opened(diagram, recording, diagram.free)
    [noise] = np.sqrt([*variance.values()])
    time = np.cumsum(2 * np.pi / run.speed)
    slope = np.polyfit(time, run.speed, 1)[0]
    measured = next(iter(run.vectors.values()))
    lines = [
        "The table",
        *(f"   {text}" for text in _table(run.speed, time, slope, measured, noise)),
        "",
        "The rotor as published",
    ]
    lines += [f"   {text}" for text in published()]
    found = [
        fitted("(a) one mode, settled", alike, recording, ONE_MODE, SettledSearch),
        fitted("(b) one mode, run-up", alike, recording, ONE_MODE, OrderSearch),
        fitted("(c) two planes, settled", diagram, recording, TWO_PLANES, SettledSearch),
        fitted("(d) two planes, run-up", diagram, recording, TWO_PLANES, OrderSearch),
    ]
    least = min(item.criterion for item in found)
    lines += ["", "Hypotheses, with slow roll", f"   {'':25}{'misfit / n':>11}{'error':>9}{'BIC':>9}   second maximum"]
    lines += [f"   {'measured':25}{'':>29}   {_bump(run.speed, measured)}"]
    for item in found:
        error = np.sqrt(
            np.mean(np.abs(item.vectors - measured) ** 2) / np.mean(np.abs(measured - measured.mean()) ** 2)
        )
        share, more = item.estimate.misfit / item.estimate.rows, item.criterion - least
        lines.append(
            f"   {item.name:25}{share:11.2f}{100 * error:7.1f} %{more:9.1f}   {_bump(run.speed, item.vectors)}"
        )
    lines += ["", "Critical speeds and damping ratios, 90 % intervals"]
    for item in found:
        planes = range(2 if "support.stiffness[2]" in item.values else 1)
        texts = []
        for which in planes:
            speed, ratio = item.ends(lambda v, w=which: critical(v, w)), item.ends(lambda v, w=which: damping(v, w))
            texts.append(f"{speed[0]:.0f} +- {speed[1]:.0f} rpm, {ratio[0]:.4f} +- {ratio[1]:.4f}")
        lines.append(f"   {item.name:25} {';  '.join(texts)}")
    best = found[-1]
    lines += ["", "Maxima [rpm]"]
    pairs = (("measured", measured), (best.name, best.vectors))
    lines += [f"   {name:25} {_maxima(run.speed, vectors)}" for name, vectors in pairs]
    lines += ["", "What (d) leaves, rms"]
    for low, high in BANDS:
        inside = (run.speed * RPM > low) & (run.speed * RPM <= high)
        left = np.sqrt(np.mean(np.abs(best.vectors - measured)[inside] ** 2))
        lines.append(f"   {low:.0f} to {high:.0f} rpm   {left * 1e6:5.2f} um")
    lines += ["", "(d) by the direction of the probe from the softer axis"]
    for angle in DIRECTIONS:
        gain = [[LEVER * float(np.cos(np.radians(angle))), LEVER * float(np.sin(np.radians(angle)))]]
        turned = fitted(
            "", load("rk4_first_mode", set={"probe.gain": gain}), recording, TWO_PLANES, OrderSearch, PAIRS[2:4]
        )
        speeds = ", ".join(f"{critical(turned.values, which):.0f}" for which in (0, 1))
        side = angle if turned.values["support.stiffness[2]"] > 0 else angle - 90.0
        share = turned.estimate.misfit / turned.estimate.rows
        lines.append(f"   {side:3.0f} deg   misfit / n {share:6.2f}   {speeds} rpm")
    return lines, found, float(noise)


def _table(speed: np.ndarray, time: np.ndarray, slope: float, measured: np.ndarray, noise: float) -> list[str]:
    at = int(np.argmax(np.abs(measured)))
    return [
        f"{len(speed)} turns in {time[-1]:.2f} s, {speed[0] * RPM:.0f} to {speed[-1] * RPM:.0f} rpm",
        f"acceleration {slope * RPM:.0f} rpm/s ({slope:.1f} rad/s^2)",
        f"largest amplitude {np.abs(measured[at]) * 1e6:.1f} um at {speed[at] * RPM:.0f} rpm",
        f"second maximum {_bump(speed, measured)}",
        f"noise of the real parts, from row to row: {noise * 1e6:.2f} um",
    ]


def _maxima(speed: np.ndarray, vectors: np.ndarray) -> str:
    """Return the speeds [rpm] of the largest amplitude and of the `BEATS` maxima behind it."""
    size = np.abs(vectors)
    inner = 1 + np.flatnonzero((size[1:-1] > size[:-2]) & (size[1:-1] > size[2:]))
    return "".join(f"{at:6.0f}" for at in (speed * RPM)[inner[inner >= np.argmax(size)]][: 1 + BEATS])


def _bump(speed: np.ndarray, vectors: np.ndarray) -> str:
    """Return the largest amplitude between the speeds of `BUMP`, or that there is no maximum."""
    inside = (speed * RPM > BUMP[0]) & (speed * RPM < BUMP[1])
    size = np.where(inside, np.abs(vectors), 0.0)
    at = int(np.argmax(size))
    if not inside[at - 1] or not inside[at + 1]:
        return "none"
    return f"{size[at] * 1e6:.1f} um at {speed[at] * RPM:.0f} rpm"


def draw(recording: OrderRecording, found: Sequence[Fitted], noise: float, file: Path) -> None:
    """Write the Bode plot of all hypotheses."""
    run = recording.runs[0]
    lines = ("--", "-", "--", "-")
    curves = [Curve(item.name, run.speed, item.vectors, line) for item, line in zip(found, lines, strict=True)]
    measured = Curve("measured, 1X of one probe", run.speed, next(iter(run.vectors.values())))
    save_png(
        bode_figure(measured, curves, "Run-up of a two-disc rotor kit and four hypotheses", "um", noise), file, 100
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Print every figure of docs/runup.md."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--figure", type=Path)
    parser.add_argument("--laws", action="store_true", help="try every law of the catalogue beside (d) instead")
    given = parser.parse_args(arguments)
    recording = load_orders(given.folder)
    if given.laws:
        print("\n".join(laws(recording)))
        return 0
    lines, found, noise = report(recording)
    print("\n".join(lines))
    if given.figure is not None:
        draw(recording, found, noise, given.figure)
    return 0


if __name__ == "__main__":
    sys.exit(main())
