"""The Reference FMUs as Model Exchange under `rotorsim run`, with every method, beside what is exact.

python -m benchmarks.fmi.reference FOLDER [--references FOLDER] [--methods rk4 radau ...]

FOLDER is searched, also below, for BouncingBall, Dahlquist, Feedthrough, Resource, Stair, StateSpace and VanDerPol of
modelica/Reference-FMUs, FMI 2.0 and 3.0 (how they are built: `python -m benchmarks.fmi.foreign --help`). They run in
this process. Deviations are the largest over a run, of the largest value of the signal, from:

  Dahlquist     x = exp(-k t), k = 1 and k = 5000 (stiff)
  VanDerPol     SciPy's Radau of the same equations, tolerance 1e-10, mu = 1 and mu = 1000 (stiff)
  BouncingBall  the times of its bounces [s], each by the speed in the flight behind it
  StateSpace    exp(t) times its start values (A = I)
  Stair         its steps, one a second, and that it ends itself at 9 s
  Feedthrough   a sine, from its continuous input to its output
  Resource      97

CSV: how far NAME_out.csv among the references is from the same, which is its own error: it is of Euler steps. A run may
differ from it by that much and its own target. Tolerances of adaptive methods: rtol 1e-9, atol 1e-12; their targets are
a thousand times that, what 1e-9 a step add up to over as many steps. RK4 has the error of its order, h^4 times the
length of the run. VanDerPol with mu = 1000 jumps within milliseconds, at times that errors move: there ten times what
the same method of SciPy leaves of the equations written down may be left, if that is more. Exit 1 where a target is
missed.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from benchmarks.fmi.foreign import files_in, reference_of
from benchmarks.markers import refuse, table_text
from rotorsim.diagram.solver import ADAPTIVE
from rotorsim.errors import RotorsimError
from rotorsim.fmi.runtime.slave import describe_fmu
from rotorsim.model.load import load
from rotorsim.simulation.result import Result
from rotorsim.simulation.run import simulate

METHODS = ("rk4", "dop853", "rk45", "radau", "bdf", "lsoda")
IMPLICIT = ("radau", "bdf", "lsoda")
RTOL, ATOL = 1e-9, 1e-12
ADDED_UP = 1e3  # times the tolerance
ROUNDING = 1e-12
JUMPS = 10.0  # times what SciPy itself leaves of a signal that jumps: when is wrong by more or less, with the steps
DROP, BOUNCE, LEAST, GRAVITY = 1.0, 0.7, 0.1, 9.81  # m, -, m/s, m/s^2: of BouncingBall
ENDED = "asks for the end of the simulation"


@dataclass(frozen=True)
class Case:
    """A run of an FMU: exact: signal -> values at times (n,); deviation: of a run, else the largest of all signals."""

    name: str
    step: float
    stop: float
    exact: dict[str, Callable[[np.ndarray], np.ndarray]]
    what: str = ""
    parameters: dict[str, float] = field(default_factory=dict)
    source: str = ""  # input of the FMU that a sine feeds
    methods: tuple[str, ...] = METHODS
    target: float | None = None  # None: of the method
    deviation: Callable[[Result], float] | None = None
    ends: float = 0.0  # s, where it ends itself
    mu: float = 0.0  # of VanDerPol where it jumps

    def target_of(self, method: str) -> float:
        """Return the deviation that a method may have."""
        if self.target is not None:
            return self.target
        target = self.stop * self.step**4 if method == "rk4" else ADDED_UP * RTOL
        if self.mu:
            t = np.arange(0.0, self.stop + self.step / 2, self.step)
            peer = van_der_pol(self.mu, self.stop, method, (RTOL, ATOL), self.step)
            target = max(target, JUMPS * off(self, t, {name: signal(t) for name, signal in peer.items()}))
        return target


def van_der_pol(
    mu: float,
    stop: float,
    method: str = "radau",
    tolerances: tuple[float, float] = (1e-10, 1e-13),
    step: float = np.inf,
) -> dict[str, Callable[[np.ndarray], np.ndarray]]:
    """Return both states by a method of SciPy."""

    def jacobian(_: float, x: np.ndarray) -> list[list[float]]:
        return [[0.0, 1.0], [-2 * mu * x[0] * x[1] - 1, mu * (1 - x[0] ** 2)]]

    def slope(_: float, x: np.ndarray) -> list[float]:
        return [x[1], mu * (1 - x[0] ** 2) * x[1] - x[0]]

    options: dict[str, Any] = {"jac": jacobian, "dense_output": True, "max_step": step, "method": ADAPTIVE[method]}
    found = solve_ivp(slope, (0.0, stop), [2.0, 0.0], rtol=tolerances[0], atol=tolerances[1], **options)
    return {f"x{k}": lambda t, k=k: found.sol(t)[k] for k in range(2)}


def bounces() -> tuple[np.ndarray, np.ndarray]:
    """Return the times of the bounces and the speeds behind them; the last is where it rests."""
    times, speeds = [np.sqrt(2 * DROP / GRAVITY)], [BOUNCE * np.sqrt(2 * DROP * GRAVITY)]
    while speeds[-1] >= LEAST:
        times.append(times[-1] + 2 * speeds[-1] / GRAVITY)
        speeds.append(BOUNCE * speeds[-1])
    speeds[-1] = 0.0
    return np.array(times), np.array(speeds)


def flight(which: str) -> Callable[[np.ndarray], np.ndarray]:
    """Return height ("h") or speed ("v") of the ball."""
    times, speeds = bounces()

    def values(t: np.ndarray) -> np.ndarray:
        k = np.searchsorted(times, t, side="right") - 1
        since, v = t - times[np.maximum(k, 0)], speeds[np.maximum(k, 0)]
        rests = k == len(times) - 1
        own = {"h": v * since - GRAVITY / 2 * since**2, "v": v - GRAVITY * since}[which]
        falls = {"h": DROP - GRAVITY / 2 * t**2, "v": -GRAVITY * t}[which]
        return np.where(k < 0, falls, np.where(rests, 0.0, own))

    return values


def off_bounces(found: Result) -> float:
    """Return how far the bounces are off [s], by speed and gravity; of flights in which a sample lies."""
    times, speeds = bounces()
    t, v = found.time, found["it.v"].ravel()
    off = [0.0]
    for k, (begun, ended) in enumerate(pairwise(times)):
        inside = (t > begun + 1e-6) & (t < ended - 1e-6)
        off += np.abs(t[inside] - (speeds[k] - v[inside]) / GRAVITY - begun).tolist()
    return max(max(off), float(np.abs(v[t > times[-1] + 1e-6]).max()) / GRAVITY)


def stairs(t: np.ndarray) -> np.ndarray:
    """Return the counter of Stair."""
    return 1 + np.floor(t + 1e-9)


def cases() -> list[Case]:
    """Return the runs."""
    start = np.array([1.0, 2.0, 3.0])
    mean = "bounces [s]"
    return [
        Case("Dahlquist", 0.1, 10.0, {"x": lambda t: np.exp(-t)}),
        Case("Dahlquist", 1e-4, 0.1, {"x": lambda t: np.exp(-5000 * t)}, "k = 5000", {"k": 5000.0}, methods=IMPLICIT),
        Case("VanDerPol", 0.01, 20.0, van_der_pol(1.0, 20.0)),
        Case(
            "VanDerPol",
            1.0,
            2000.0,
            van_der_pol(1000.0, 2000.0),
            "mu = 1000",
            {"mu": 1000.0},
            methods=IMPLICIT,
            mu=1000.0,
        ),
        Case("BouncingBall", 0.01, 3.0, {"h": flight("h"), "v": flight("v")}, mean, deviation=off_bounces, target=1e-6),
        Case("StateSpace", 0.1, 1.0, {"y": lambda t: np.exp(t)[:, None] * start}),
        Case("Stair", 0.2, 10.0, {"counter": stairs}, ends=9.0, target=0.0),
        Case(
            "Feedthrough",
            0.1,
            2.0,
            {"Float64_continuous_output": lambda t: np.sin(2 * np.pi * t)},
            "a sine",
            source="Float64_continuous_input",
            target=ROUNDING,
        ),
        Case("Resource", 0.1, 1.0, {"y": lambda t: np.full(len(t), 97.0)}, target=0.0),
    ]


def run(case: Case, file: Path, method: str) -> Result:
    """Return what `rotorsim run` computes."""
    more = {"sine": {"type": "sine", "parameters": {"frequency": "1 Hz"}}} if case.source else {}
    parameters = {"interface": "me", "in_process": True, **case.parameters}
    document = {
        "name": case.name,
        "blocks": {"it": {"type": "fmu", "file": str(file.resolve()), "parameters": parameters}, **more},
        "wires": [["sine.output", f"it.{case.source}"]] if case.source else [],
        "solver": {"step": case.step, "stop": case.stop, "rtol": RTOL, "atol": ATOL},
        "record": [f"it.{name}" for name in case.exact],
    }
    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore", RuntimeWarning
        )  # VanDerPol says of x0 and x1 that they do not follow the states
        return simulate(load(document, trust_blocks=True), method=method)


def off(case: Case, time: np.ndarray, values: dict[str, np.ndarray]) -> float:
    """Return the largest deviation of signals at times, of the largest value of each."""
    worst = 0.0
    for name in case.exact.keys() & values.keys():
        right = case.exact[name](time)
        scale = float(np.abs(right).max()) or 1.0
        worst = max(worst, float(np.abs(values[name].reshape(right.shape) - right).max()) / scale)
    return worst


def tried(case: Case, file: Path, version: str, references: Path | None) -> Iterator[list[str]]:
    """Yield a row for each method: FMU, version, method, deviation, of the CSV, steps, target, whether it is met."""
    known = {} if case.parameters or case.source else reference_of(file, references)
    own = ""
    if "time" in known and case.exact.keys() <= known.keys():
        keep = np.append(np.diff(known["time"]) > 0, True)  # of an instant twice there, what is behind its event
        own = f"{off(case, known['time'][keep], {key: value[keep] for key, value in known.items()}):.1e}"
    name = " ".join(filter(None, (case.name, case.what)))
    for method in case.methods:
        target = case.target_of(method)
        try:
            found = run(case, file, method)
        except RotorsimError as error:
            yield [name, version, method, error.problems[0].what[:80], own, "", f"{target:.0e}", "NOT"]
            continue
        ended = ENDED in found.message and case.ends and abs(found.time[-1] - case.ends) < ROUNDING
        if found.status != "finished" and not ended:
            yield [name, version, method, f"{found.status}: {found.message[:80]}", own, "", f"{target:.0e}", "NOT"]
            continue
        values = {key: found[f"it.{key}"] for key in case.exact}
        deviation = case.deviation(found) if case.deviation else off(case, found.time, values)
        good = deviation <= target and bool(ended) == bool(case.ends)
        steps = str(found.counters["steps"])
        yield [name, version, method, f"{deviation:.1e}", own, steps, f"{target:.0e}", "ok" if good else "NOT"]


def main() -> int:
    """Print the table, row by row on stderr."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--references", type=Path, help="folder of NAME_out.csv")
    parser.add_argument("--methods", nargs="+", default=METHODS, choices=METHODS, metavar="METHOD")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="of these FMUs")
    given = parser.parse_args()
    files: dict[tuple[str, str], Path] = {}
    for file in files_in(given.folder):
        with_name = [case for case in cases() if case.name == file.stem]
        description = describe_fmu(file) if with_name else None
        if description and "me" in description.kinds and "Reference FMUs" in description.tool:
            files.setdefault((file.stem, description.version), file)
    if not files:
        refuse(f"{given.folder} holds no Reference FMU for Model Exchange (see --help)")
    rows = []
    for case in cases():
        for version in ("2.0", "3.0"):
            file = files.get((case.name, version))
            if file is None or (given.only and case.name not in given.only):
                continue
            chosen = tuple(method for method in case.methods if method in given.methods)
            for row in tried(replace(case, methods=chosen), file, version, given.references):
                print(*row, file=sys.stderr, flush=True)
                rows.append(row)
    print(table_text(["FMU", "FMI", "method", "deviation", "CSV", "steps", "target", ""], rows))
    met = sum(row[-1] == "ok" for row in rows)
    print(f"\n{met} of {len(rows)} within their target")
    return int(met < len(rows))


if __name__ == "__main__":
    sys.exit(main())
