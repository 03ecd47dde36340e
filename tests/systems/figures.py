"""Figures of whole diagrams beside independent programs: tests judge them, benchmarks.evidence prints them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.signal import hilbert

from rotorsim.model.compiled import compile_diagram
from rotorsim.settled.periodic import periodic
from rotorsim.simulation.run import simulate
from tests.reference.excitation import RPM, harmonics
from tests.reference.jeffcott import Jeffcott
from tests.reference.published import TABLE_2_2
from tests.systems.shipped import document, load_document, shipped, variant

JEFFCOTT_SIGNALS = ("rotor.displacement", "controller.current")


def as_complex(signal: np.ndarray) -> np.ndarray:
    """Return x + iy of a signal (n, ..., 2)."""
    return np.asarray(signal[..., 0] + 1j * signal[..., 1])


def relative(found: np.ndarray, expected: np.ndarray) -> float:
    """Return the largest deviation relative to the peak of what is expected."""
    return float(np.abs(found - expected).max() / np.abs(expected).max())


def table_2_2(model: Any) -> list[tuple[str, int, float, float, float]]:
    """Return (signal, order, relative amplitude error, phase error [deg], amplitude) for every entry of Table 2-2."""
    result = simulate(model, stop=5.0)
    speed = 1500 * RPM
    window = (result.time >= 4.0 - 1e-9) & (result.time < 5.0 - 1e-9)
    rows = []
    for column, name in ((0, "rotor.displacement"), (2, "controller.current")):
        found = harmonics(result.time[window], as_complex(result[name][window]), speed, list(TABLE_2_2))
        for order, numbers in TABLE_2_2.items():
            amplitude, phase = numbers[column], numbers[column + 1]
            turn = np.exp(-1j * math.radians(phase))
            off = math.degrees(np.angle(found[order] * turn))
            rows.append((name, order, abs(found[order]) / amplitude - 1, off, abs(found[order])))
    return rows


def elementary(stop: float) -> float:
    """Return the largest relative difference of jeffcott_elementary and jeffcott over displacement and current."""
    one, other = simulate(shipped("jeffcott"), stop=stop), simulate(shipped("jeffcott_elementary"), stop=stop)
    return max(relative(as_complex(other[name]), as_complex(one[name])) for name in JEFFCOTT_SIGNALS)


def independent(stop: float, step: float) -> tuple[float, float]:
    """Return relative deviations of displacement and current of jeffcott from DOP853 at rtol 1e-11."""
    result = simulate(shipped("jeffcott"), stop=stop, step=step, record_every=round(1e-4 / step))
    reference = Jeffcott()
    y = reference.solve(result.time)
    return (
        relative(as_complex(result["rotor.displacement"]), y[:, 2] + 1j * y[:, 3]),
        relative(as_complex(result["controller.current"]), reference.current(y)),
    )


def orders(steps: Sequence[float], stop: float) -> list[float]:
    """Return the observed orders of RK4 between successive steps, on jeffcott against the exact solution."""
    errors = []
    for step in steps:
        result = simulate(shipped("jeffcott"), stop=stop, step=step)
        displacement, _ = Jeffcott().exact(result.time)
        errors.append(relative(as_complex(result["rotor.displacement"]), displacement))
    pairs = zip(steps[:-1], steps[1:], errors[:-1], errors[1:], strict=True)
    return [math.log(e1 / e2) / math.log(h1 / h2) for h1, h2, e1, e2 in pairs]


def power_of_time(power: int) -> Any:
    """Return a model of x' = t^power from elementary blocks; x is integrator.output."""
    blocks: dict[str, Any] = {
        "clock": {"type": "clock", "parameters": {"speed": 1.0}},
        "integral": {"type": "integrator"},
    }
    wires = []
    source = "clock.theta"
    for k in range(2, power + 1):
        blocks[f"power{k}"] = {"type": "product"}
        wires += [[source, f"power{k}.input1"], ["clock.theta", f"power{k}.input2"]]
        source = f"power{k}.output"
    wires.append([source, "integral.input"])
    return load_document(
        {
            "schema_version": 1,
            "name": f"power_{power}",
            "blocks": blocks,
            "wires": wires,
            "solver": {"method": "rk4", "step": 0.25, "stop": 2.0},
            "record": ["integral.output"],
        }
    )


def polynomial_error(power: int, step: float = 0.25) -> float:
    """Return the relative error of RK4 on x' = t^power at t = 2."""
    result = simulate(power_of_time(power), stop=2.0, step=step)
    exact = 2.0 ** (power + 1) / (power + 1)
    return float(abs(np.ravel(result["integral.output"][-1])[0] / exact - 1))


def run_up_peak(name: Any, signal: str = "rotor.displacement", node: int | None = None, **options: Any) -> float:
    """Return the speed [rpm] at the peak of the Hilbert envelope of the x displacement in a run-up.

    The speed is alpha t, as written in the diagram: the thesis reads its figures so.
    """
    model = shipped(name) if isinstance(name, str) else name
    result = simulate(model, record=[signal, "clock.speed"], **options)
    x = result[signal][:, 0] if node is None else result[signal][:, node - 1, 0]
    envelope = np.abs(hilbert(x - x.mean()))
    edge = len(x) // 100  # the transform is wrong at the ends
    peak = edge + int(np.argmax(envelope[edge:-edge]))
    return float(np.ravel(result["clock.speed"][peak])[0] / RPM)


def thesis_run_up() -> Any:
    """Return the run-up of jeffcott with the thesis' angle omega(t) t."""
    content = document("jeffcott_runup")
    content["blocks"]["clock"]["parameters"]["angle"] = "omega_t"
    return compile_diagram(load_document(content))


def series(harmonic: dict[int, complex], time: np.ndarray, speed: float) -> np.ndarray:
    """Return sum R_k exp(i k W t)."""
    return np.sum([value * np.exp(1j * k * speed * time) for k, value in harmonic.items()], axis=0)


QUICK_INTEGRAL = {"controller.KI": 2e5}  # A/(m s): the integral pole decays in 0.14 s instead of 13.9 s


def settled_difference(
    model: Any, signals: Sequence[str], stop: float, step: float, parameters: dict[str, float] | None = None
) -> dict[str, float]:
    """Return per signal the deviation of ``periodic`` from the last turns of a simulation from rest.

    Relative to the largest deflection. The last 0.1 s are compared, every 0.5 ms.
    """
    found = periodic(model, signals=list(signals), parameters=parameters)
    every = round(5e-4 / step)
    result = simulate(model, stop=stop, step=step, record=list(signals), record_every=every, parameters=parameters)
    assert result.status == "finished", result.message
    window = result.time >= stop - 0.1
    speed = float(found.speeds[0])
    turns = np.exp(1j * np.outer(result.time[window] * speed, found.orders))
    return {name: relative(turns @ found.harmonics[name][0], as_complex(result[name][window])) for name in signals}


UNDAMPED = {"rotor.mass_damping": 0.0, "rotor.stiffness_damping": 0.0}

# signals, stop [s], step [s]: from rest until the integral pole has decayed below 1e-8
SETTLED: dict[str, tuple[tuple[str, ...], float, float]] = {
    "jeffcott": (JEFFCOTT_SIGNALS, 280.0, 5e-5),
    "offset_disc": (JEFFCOTT_SIGNALS, 280.0, 5e-5),
    "fe_rigid": (("rotor.displacement[4]", "controller.current"), 280.0, 1e-5),
    "fe_flexible": (("rotor.displacement[4]", "controller.current"), 280.0, 1e-5),
}


def dof_of(rotor: Any, node: int) -> int:
    """Return the degree of freedom of a node's displacement (nodes count from 1) in a reference rotor."""
    pinned = rotor.size % 4 == 2  # ends pinned: their displacement is no degree of freedom
    return int(rotor.translations[node - 2 if pinned else node - 1])


NONLINEAR = ("nonlinear AMB", "breathing crack", "breathing crack with a hinge")


def nonlinear_model(name: str) -> Any:
    """Return jeffcott with one block replaced by its nonlinear kin."""
    if name == "nonlinear AMB":
        return compile_diagram(variant("jeffcott", {"amb": {"type": "amb_nonlinear"}}))
    crack: dict[str, Any] = {"type": "crack_breathing"}
    if name == "breathing crack with a hinge":
        crack["parameters"] = {"law": "hinge"}
    wire = ("rotor.displacement", "crack.displacement")
    return compile_diagram(variant("jeffcott", {"crack": crack}, (wire,)))
