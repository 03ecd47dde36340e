"""What `rotorsim run` says about a result: peaks, and harmonics of two-axis signals at constant speed."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from rotorsim.cli import common
from rotorsim.errors import RotorsimError

if TYPE_CHECKING:
    from rotorsim.model.compiled import Model
    from rotorsim.settled.result import Periodic
    from rotorsim.signals.spectrum import Harmonics
    from rotorsim.simulation.result import Result

__all__ = [
    "constant_speed",
    "harmonics_of",
    "motion",
    "motion_line",
    "peaks",
    "peaks_table",
    "run_line",
    "run_up_table",
    "run_ups",
    "settled_motion",
    "two_axis",
]

FEW = 1500  # samples that tell whether the motion has settled
SETTLED = 0.01  # of the largest harmonic: what may still change
SLOWEST = 0.95  # ratio of changes that is believed: beyond, noise and not decay makes it
OVER = 1e-4  # of a transient: it is over
ROUNDING = 1e-12  # of the largest pole: a pole at zero
CONSTANT = 1e-6  # relative change of speed below which it is constant


def two_axis(result: Result) -> list[str]:
    """Return the signals [x, y] by name; of [node, xy] ones the node that moves most."""
    found = []
    for name, array in result.signals.items():
        if array.ndim == 2 and array.shape[1] == 2:
            found.append(name)
        elif array.ndim == 3 and array.shape[2] == 2 and len(array):
            late = array[len(array) // 2 :]
            found.append(f"{name}[{int(np.argmax(np.ptp(late, axis=0).max(axis=1))) + 1}]")
    return found


def constant_speed(result: Result, angle: str) -> float | None:
    """Return the speed [rad/s] if it is constant, forward, and the shaft turned at least once, else None."""
    speed = _constant_speed(result, angle)
    return speed if speed is not None and speed > 0 else None


def _constant_speed(result: Result, angle: str) -> float | None:
    if angle not in result or len(result.time) < 8:
        return None
    theta, time = result[angle], result.time
    if theta.ndim != 1 or not np.isfinite(theta).all():
        return None
    middle = len(time) // 2
    first = (theta[middle] - theta[0]) / (time[middle] - time[0])
    second = (theta[-1] - theta[middle]) / (time[-1] - time[middle])
    whole = float((theta[-1] - theta[0]) / (time[-1] - time[0]))
    if abs(second - first) > CONSTANT * abs(whole) or abs(theta[-1] - theta[0]) < 2 * np.pi * (1 - 1e-9):
        return None
    return whole


def harmonics_of(result: Result, angle: str) -> list[Harmonics]:
    """Return the harmonics of every two-axis signal over the last whole turns, if the speed is constant.

    None of them where there are too few samples in a turn.
    """
    if result.status != "finished" or constant_speed(result, angle) is None:
        return []
    from rotorsim.signals.spectrum import few_samples, harmonics, last_turns

    if few_samples(result, angle) is not None:
        return []
    window = last_turns(result, angle)
    return [harmonics(result, name, angle=angle, window=window) for name in two_axis(result)]


def settled_motion(model: Model, result: Result, angle: str, found: Sequence[Harmonics]) -> Periodic | None:
    """Return the motion that a linear machine settles on at the speed of a run; None where it is not known.

    It is asked for where a mode has more than OVER left at the end of the run: what decays faster is seen to.
    """
    speed = constant_speed(result, angle)
    if speed is None or not found or not model.linear or model.n_z or "speed" not in model.diagram.parameters:
        return None
    p = model.p0
    A = np.array(model.jacobian(0.0, model.x0(p), model.z0(p), p))
    poles = np.linalg.eigvals(A) if np.isfinite(A).all() else np.zeros(0)
    decaying = poles.real[poles.real < -ROUNDING * np.abs(poles).max(initial=0.0)]
    if decaying.max(initial=-np.inf) * result.time[-1] < np.log(OVER):
        return None
    from rotorsim.settled.periodic import periodic

    try:
        made = periodic(model, speeds=[speed], signals=[item.signal for item in found], stability=False)
    except (RotorsimError, np.linalg.LinAlgError):
        return None
    return made if made.settled.all() else None


def motion(result: Result, angle: str, found: Sequence[Harmonics], settled: Periodic | None = None) -> dict[str, Any]:
    """Return speed, window of the harmonics, and whether the motion has settled; {} where nothing turns steadily.

    settled: what the machine settles on, where that is known. Else from harmonics R1, R2, R3 of three windows in a row:
    what changes as exp(-t / tau) has still |R3 - R2| q / (1 - q) to go, q = |R3 - R2| / |R2 - R1|. Settled: less than
    1 % of the largest harmonic.
    """
    speed = _constant_speed(result, angle)
    if speed is None:
        return {}
    from rotorsim.signals.spectrum import LEAST_SAMPLES, few_samples, harmonics, last_turns

    made: dict[str, Any] = {"speed": speed, "speed_rpm": common.rpm(speed), "settled": None}
    if not found:
        few = few_samples(result, angle)
        return made if few is None else made | {"samples_a_turn": few, "least_samples": LEAST_SAMPLES}
    start, stop = last_turns(result, angle)
    width = stop - start
    turns = max(round(width * speed / (2 * np.pi)), 1)
    made |= {"window": [start, stop], "turns": turns}
    if settled is not None:
        return made | _to_go(found, settled)
    samples = int(np.searchsorted(result.time, stop) - np.searchsorted(result.time, start))
    few = width * min(max(int(FEW * turns / max(samples, 1)), 1), turns) / turns
    if start - 2 * width < -1e-9:
        return made
    worst: tuple[float, dict[str, Any]] = (-1.0, {})
    for item in found:
        ends = [stop - k * width for k in (2, 1, 0)]
        try:
            first, then, last = (harmonics(result, item.signal, angle=angle, window=(e - few, e)).values for e in ends)
        except RotorsimError:  # too few samples to tell the orders apart
            return made
        one, two = np.abs(then - first), np.abs(last - then)
        q = np.minimum(np.divide(two, one, out=np.ones_like(two), where=one > 0), SLOWEST)
        left, largest = two * q / (1 - q), float(np.abs(item.values).max(initial=0.0))
        k = int(np.argmax(left))
        share = float(left[k]) / largest if largest > 0 else 0.0
        if share > worst[0]:
            at = {"signal": item.signal, "order": item.orders[k], "left": float(left[k]), "unit": item.unit}
            worst = (share, {**at, "share": share})
    return made | {"settled": worst[0] <= SETTLED, "still_changes": worst[1]}


def _to_go(found: Sequence[Harmonics], settled: Periodic) -> dict[str, Any]:
    """Return how far the harmonics of a run are from those of the settled motion, the one that has most to go."""
    worst: tuple[float, dict[str, Any]] = (-1.0, {})
    for item in found:
        shared = [k for k, order in enumerate(item.orders) if np.isclose(settled.orders, order, atol=1e-9).any()]
        final = np.array([settled.harmonic(item.signal, item.orders[k])[0] for k in shared])
        left, largest = np.abs(np.asarray(item.values)[shared] - final), float(np.abs(final).max(initial=0.0))
        if not len(left):
            continue
        k = int(np.argmax(left))
        share = float(left[k]) / largest if largest > 0 else 0.0
        if share > worst[0]:
            at = {"signal": item.signal, "order": item.orders[shared[k]], "left": float(left[k]), "unit": item.unit}
            worst = (share, {**at, "share": share})
    return {"settled": worst[0] <= SETTLED, "still_changes": worst[1]}


def motion_line(motion: dict[str, Any]) -> str:
    """Return `motion` as text."""
    if not motion:
        return ""
    text = f"{motion['speed_rpm']:.6g} rpm ({motion['speed']:.6g} rad/s)"
    if "samples_a_turn" in motion:
        text += f"; {motion['samples_a_turn']:.3g} samples a turn: harmonics need {motion['least_samples']}, "
        return text + "so a smaller step or record_every"
    if "window" in motion:
        start, stop = motion["window"]
        text += f"; harmonics over {start:.6g} .. {stop:.6g} s, {motion['turns']} turn{'s' * (motion['turns'] != 1)}"
    if motion["settled"]:
        return f"{text}; settled"
    if motion["settled"] is False:
        change = motion["still_changes"]
        unit, scale = common.display_unit(change["unit"])
        left = f"{change['left'] * scale:.2g} {unit} ({100 * change['share']:.2g} % of the largest)"
        return f"{text}; not settled: order {change['order']:g} of {change['signal']} has about {left} still to go"
    return text


def run_ups(result: Result, angle: str, shown: Collection[str]) -> list[dict[str, Any]]:
    """Return speed and peak of the largest turn of both axes of two-axis signals in a run-up, and their resonances."""
    speed = angle.replace(".theta", ".speed")
    if not angle or result.status != "finished" or speed not in result or np.ptp(result[speed]) == 0.0:
        return []
    from rotorsim.signals.envelopes import run_up

    if not (np.diff(result[speed]) >= 0).all() or len(result.time) < 100:
        return []
    rows = []
    for name in two_axis(result):
        if name.partition("[")[0] not in {item.partition("[")[0] for item in shown}:
            continue
        for axis in (1, 2):
            entry = f"{name[:-1]},{axis}]" if name.endswith("]") else f"{name}[{axis}]"
            found = run_up(result, entry, speed=speed)
            rows.append(
                {
                    "signal": entry,
                    "unit": result.units.get(name, found.unit),
                    "resonance": found.resonance,
                    "resonance_rpm": common.rpm(found.resonance),
                    "peak": found.peak,
                    "rises": found.rises,
                    "orders": [
                        {"order": one.order, "speed": one.speed, "speed_rpm": common.rpm(one.speed), "peak": one.peak}
                        for one in found.resonances()
                    ],
                }
            )
    return rows


def run_up_table(result: Result, angle: str, shown: Collection[str]) -> str:
    """Return `run_ups` as text."""
    lines = []
    for row in run_ups(result, angle, shown):
        unit, scale = common.display_unit(row["unit"])
        largest = "largest turn, still rising" if row["rises"] else "largest turn"
        lines.append((row["signal"], largest, f"{row['resonance_rpm']:.1f}", f"{row['peak'] * scale:.6g}", unit))
        lines += [
            ("", f"{one['order']}X", f"{one['speed_rpm']:.1f}", f"{one['peak'] * scale:.6g}", unit)
            for one in row["orders"]
        ]
    header = ("run-up", "resonance of", "at [rpm]", "0-peak", "unit")
    return common.table(header, lines) if lines else ""


def peaks(result: Result) -> dict[str, dict[str, Any]]:
    """Return shape, unit, peak and rms of every entry of the signals."""
    found = {}
    with np.errstate(over="ignore", invalid="ignore"):  # a run that diverged ends with huge numbers
        for name, array in result.signals.items():
            flat = np.asarray(array, float)
            empty = np.full(array.shape[1:], np.nan)
            found[name] = {
                "unit": result.units.get(name, ""),
                "shape": list(array.shape[1:]),
                "peak": np.abs(flat).max(axis=0) if len(flat) else empty,
                "rms": _rms(flat) if len(flat) else empty,
                "final": flat[-1] if len(flat) else empty,
            }
    return found


def _rms(columns: np.ndarray) -> np.ndarray:
    """Return the rms of every column; squares of a diverged run would overflow, shares of its peak do not."""
    peak = np.abs(columns).max(axis=0)
    scale = np.where(peak > 0, peak, 1.0)
    return np.asarray(scale * np.sqrt(np.mean((columns / scale) ** 2, axis=0)))


def peaks_table(result: Result, angle: str) -> str:
    """Return peak and rms of every signal as text: of the entry with the largest peak, where there are several."""
    lines = []
    for name, found in peaks(result).items():
        if name == angle:
            continue
        peak, rms = np.ravel(found["peak"]), np.ravel(found["rms"])
        if not peak.size:
            continue
        largest = int(np.nanargmax(peak)) if np.isfinite(peak).any() else 0
        index = np.unravel_index(largest, found["shape"]) if found["shape"] else ()
        inside = f"[{','.join(str(int(k) + 1) for k in index)}]" if index else ""
        base = f"{name[:-1]},{inside[1:]}" if name.endswith("]") and inside else name + inside
        unit, scale = common.display_unit(found["unit"])
        lines.append((base, f"{peak[largest] * scale:.6g}", f"{rms[largest] * scale:.6g}", unit))
    return common.table(("signal", "peak", "rms", "unit"), lines) if lines else ""


def run_line(result: Result) -> str:
    """Return one line on how the run was made."""
    counters, provenance = result.counters, result.provenance
    end = f"{result.time[-1]:.6g} s" if len(result.time) else "nothing"
    seconds = float(counters.get("run_cpu_seconds", 0.0))
    return (
        f"{provenance.get('diagram')}: {counters.get('steps', 0)} {provenance.get('method')} steps to {end}, "
        f"{seconds:.3g} s CPU, {provenance.get('path')}"
    )
