"""Machines integrated by scipy from equations of their own, as recordings in time."""

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from rotorsim.errors import Place
from rotorsim.recordings.recording import Channel, Recording, Run

MASS, DAMPING, STIFFNESS, CUBIC = 1.0, 2.0, 1000.0, 2e4
RATE = 50.0  # Hz; the oscillator is at 5 Hz
NOISE = 0.01  # of the signal
CARRIAGE, VISCOUS, COULOMB, OFFSET = 80.0, 150.0, 25.0, -4.0
POSITION_GAIN, VELOCITY_GAIN, LAG, DRIVE = 120.0, 200.0, 2e-3, 30.0
SHARP = 1e-4  # m/s, of the change of sign of friction


def multisine(seed: int, rate: float = RATE, size: float = 40.0):
    """Return a force of 60 lines up to 0.3 of the sample rate with phases of chance."""
    rng = np.random.default_rng(seed)
    frequency = np.arange(1, 61) * 0.005 * rate
    phase = rng.uniform(0, 2 * np.pi, len(frequency))
    rates = 2 * np.pi * frequency
    return lambda t: size / 8 * np.sin(np.multiply.outer(t, rates) + phase).sum(axis=-1)


@cache
def oscillator(
    seed: int, law: float | Callable[[float, float], float], samples: int = 900, noise: float = NOISE
) -> dict[str, np.ndarray]:
    """Return samples of m q'' + c q' + k q + f = u from a start of its own; f: k3 q^3, or any law of q and q'."""
    force = multisine(seed)
    more = law if callable(law) else lambda q, v: law * q**3

    def rates(t, x):
        return x[1], (force(t) - DAMPING * x[1] - STIFFNESS * x[0] - more(x[0], x[1])) / MASS

    t = np.arange(samples) / RATE
    q = solve_ivp(rates, (0, t[-1]), [0.01, -0.1], method="DOP853", t_eval=t, rtol=1e-8, atol=1e-10).y[0]
    rng = np.random.default_rng(seed + 100)
    return {"u": force(t), "y": q + noise * q.std() * rng.normal(size=samples)}


def carriage(friction: float, samples: int = 2400, noise: float = 5e-4, seed: int = 5) -> dict[str, np.ndarray]:
    """Return samples of a carriage under a cascade controller that follows a sum of sines."""
    rate = 500.0
    rng = np.random.default_rng(seed)

    def wanted(t):
        return 0.05 * (np.sin(2 * np.pi * 0.4 * t) + 0.5 * (np.sin(2 * np.pi * 0.9 * t + 1.0) - np.sin(1.0)))

    def voltage(t, x):
        return VELOCITY_GAIN * (POSITION_GAIN * (wanted(t) - x[0]) - x[2])

    def rates(t, x):
        dry = friction * (COULOMB * np.tanh(x[1] / SHARP) + OFFSET)
        return x[1], (DRIVE * voltage(t, x) - VISCOUS * x[1] - dry) / CARRIAGE, (x[1] - x[2]) / LAG

    t = np.arange(samples) / rate
    x = solve_ivp(rates, (0, t[-1]), [0.0, 0.0, 0.0], t_eval=t, method="LSODA", rtol=1e-7, atol=1e-10).y
    u = voltage(t, x)
    error = noise * rng.normal(size=(2, samples))
    lagging = (wanted(t) - x[0]).std()
    return {"r": wanted(t), "q": x[0] + error[0] * lagging, "u": u + error[1] * u.std()}


def recording(
    runs: Sequence[tuple[Mapping[str, np.ndarray], str]], signals: Mapping[str, tuple[str, str]], rate: float
) -> Recording:
    """Return a recording of (samples, use); signals: column -> (signal, unit)."""
    channels = {c: Channel(c, signal, None, None, None, unit) for c, (signal, unit) in signals.items()}
    made = []
    for k, (values, use) in enumerate(runs):
        time = np.arange(len(next(iter(values.values())))) / rate
        place = Place("recording.json")
        made.append(Run(f"run{k}", f"run{k}.csv", time, values, None, None, {}, use, place, rate))
    return Recording("made", "scipy", Path("."), channels, tuple(made))


def oscillator_recording(
    law: float | Callable[[float, float], float], noise: float = NOISE, units: tuple[str, str] = ("N", "m")
) -> Recording:
    """Return a run to identify from and one held out."""
    runs = [(oscillator(1, law, noise=noise), "identify"), (oscillator(2, law, noise=noise), "hold_out")]
    return recording(runs, {"u": ("drive.output", units[0]), "y": ("oscillator.displacement", units[1])}, RATE)


def carriage_recording(friction: float, **options: float) -> Recording:
    """Return one run to identify from."""
    signals = {"r": ("reference.output", "m"), "q": ("carriage.displacement", "m"), "u": ("controller.voltage", "V")}
    return recording([(carriage(friction, **options), "identify")], signals, 500.0)


OSCILLATOR = {
    "name": "oscillator",
    "schema_version": 1,
    "blocks": {
        "drive": {"type": "recorded", "parameters": {"interpolation": "band_limited"}},
        "oscillator": {"type": "oscillator", "parameters": {"mass": 1.3, "damping": 3.0, "stiffness": 900.0}},
    },
    "wires": [["drive.output", "oscillator.force"]],
    "identify": {"oscillator.mass": {}, "oscillator.damping": {}, "oscillator.stiffness": {}},
    "solver": {"step": "1e-3 s", "stop": "1 s"},
    "record": ["oscillator.displacement"],
}
POSITIONER = {
    "name": "positioner",
    "schema_version": 1,
    "blocks": {
        "reference": {"type": "recorded", "parameters": {"interpolation": "band_limited"}},
        "controller": {
            "type": "cascade_controller",
            "parameters": {"position_gain": 100.0, "velocity_gain": 150.0, "velocity_lag": 1e-3},
        },
        "drive": {"type": "gain", "parameters": {"gain": f"{DRIVE} N/V"}},
        "carriage": {"type": "carriage", "parameters": {"mass": 100.0, "viscous_friction": 100.0}},
    },
    "wires": [
        ["reference.output", "controller.reference"],
        ["carriage.displacement", "controller.displacement"],
        ["carriage.velocity", "controller.velocity"],
        ["controller.voltage", "drive.input"],
        ["drive.output", "carriage.force"],
    ],
    "identify": {
        "controller.position_gain": {},
        "controller.velocity_gain": {},
        "controller.velocity_lag": {},
        "carriage.mass": {},
        "carriage.viscous_friction": {},
    },
    "solver": {"step": "1e-3 s", "stop": "1 s"},
    "record": ["carriage.displacement"],
}
