"""Intervals and zones of measured margins: python -m benchmarks.identification.injected [MACHINES].

Rotors of chance in magnetic bearings, in closed form, with an injected test signal of five kinds, noise of the sensors,
unbalance at a steady speed and mains hum; peak of |S|, its zone, phase and delay margin as measured, beside the truth.
"""

from __future__ import annotations

import sys
import tempfile
import time as clock
from pathlib import Path

import numpy as np

from rotorsim.linear.control.margins import zone_of
from rotorsim.recordings.injection import load_injection
from rotorsim.signals.injection.measured_margins import MeasuredAxis, measured_margins
from tests.signals.injection.machine import Machine, chirp, measured, stepped, write

RATE, SECONDS, AMPLITUDE = 8000.0, 20.0, 1e-6
KINDS = ("linear sweep", "logarithmic sweep", "stepped sines", "noise", "both axes at once")
NOISE = (1e-8, 1e-7)  # m rms, of a sensor: 1 to 10 % of the test signal
FINE = np.unique(np.concatenate([np.geomspace(1, 2000, 200_001), np.arange(20, 400, 0.002)]))


def machine(random: np.random.Generator) -> Machine:
    """Return a stable machine of chance."""
    while True:
        made = Machine(
            gyroscopic=float(random.uniform(0, 300)),
            kd=float(random.uniform(3, 10)),
            kp=float(random.uniform(6000, 20000)),
            delay=float(random.uniform(0, 3e-4)),
            difference=float(random.uniform(0, 0.3)),
        )
        if made.is_stable() and np.abs(made.sensitivity(FINE[::20])[:, 0, 0]).max() < 12:
            return made


def excitation(kind: str, time: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Return a test signal (n,) of a kind."""
    if kind == "linear sweep":
        return AMPLITUDE * chirp(time, 2, 2200)
    if kind == "logarithmic sweep":
        return AMPLITUDE * chirp(time, 2, 2200, True)
    if kind == "stepped sines":
        return AMPLITUDE * stepped(time, 5, 2200, 160)
    return AMPLITUDE * random.standard_normal(len(time))


def record(one: Machine, kind: str, noise: float, random: np.random.Generator, folder: Path) -> Path:
    """Write what is measured of a machine."""
    time = np.arange(int(RATE * SECONDS)) / RATE
    speed = float(random.uniform(40, 180))
    runs = {}
    together = kind == "both axes at once"
    for k, name in enumerate(("both",) if together else ("x", "y")):
        test = np.zeros((len(time), 2))
        for axis in (0, 1) if together else (k,):
            test[:, axis] = excitation(kind, time, random)
        orbit = np.exp(2j * np.pi * speed * time)
        motion = 5e-6 * (orbit + 0.1 * orbit**2) + 5e-8 * np.exp(2j * np.pi * 49.98 * time)
        both = np.stack([motion.real, motion.imag], axis=1)
        after, before = measured(one, test, RATE, noise * random.standard_normal(test.shape), both)
        runs[name] = {"test": test, "before": before, "after": after}
    return write(folder, RATE, runs)


def truth(one: Machine, axis: int) -> dict[str, float]:
    """Return peak of |S_jj|, phase and delay margin of an axis, between 1 Hz and 2 kHz."""
    S = one.sensitivity(FINE)[:, axis, axis]
    G = 1 / S - 1
    crossed = np.flatnonzero(np.diff(np.sign(np.abs(G) - 1)))
    lag = np.degrees(np.angle(-G[crossed]))
    return {
        "peak": float(np.abs(S).max()),
        "phase": float(np.abs(lag).min()),
        "delay": float((lag % 360 / 360 / FINE[crossed]).min()),
    }


def covered(axis: MeasuredAxis, true: dict[str, float]) -> dict[str, bool]:
    """Return which intervals hold the truth, whether the zones do, and whether one zone is told."""
    found = {name: low <= true[name] <= high for name, (low, high) in axis.interval90.items() if name in true}
    return {**found, "zone": zone_of(true["peak"]) in axis.zones.split(" or "), "one zone": " " not in axis.zones}


def main(machines: int = 40) -> None:
    """Print coverage and errors of each kind of test signal."""
    print(f"{machines} machines of each kind, {SECONDS:.0f} s at {RATE:.0f} Hz; intervals of 90 %")
    print("kind               noise  peak   zone   one zone  phase  delay  error of peak, median  CPU [s]")
    for kind in KINDS:
        for noise in NOISE:
            results: list[dict[str, bool]] = []
            errors, took = [], []
            for seed in range(machines):
                random = np.random.default_rng([seed, KINDS.index(kind)])
                one = machine(random)
                with tempfile.TemporaryDirectory() as folder:
                    recording = load_injection(record(one, kind, noise, random, Path(folder)))
                begun = clock.process_time()
                (found,) = measured_margins(recording)
                took.append(clock.process_time() - begun)
                for k, axis in enumerate(found.axes):
                    true = truth(one, k)
                    results.append(covered(axis, true))
                    errors.append(abs(axis.best.peak / true["peak"] - 1))
            shares = [
                f"{100 * np.mean([own[name] for own in results if name in own]):3.0f} %"
                for name in ("peak", "zone", "one zone", "phase", "delay")
            ]
            numbers = f"{shares[0]:6} {shares[1]:6} {shares[2]:9} {shares[3]:6} {shares[4]:6}"
            error = f"{100 * np.median(errors):.2g} %"
            print(f"{kind:18} {100 * noise / AMPLITUDE:3.0f} %  {numbers} {error:22} {np.median(took):.2g}", flush=True)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
