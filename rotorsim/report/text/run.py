"""What is said of a run: peaks, harmonics of two-axis signals at constant speed, resonances of a run-up."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from rotorsim.errors import RotorsimError
from rotorsim.report.amplitudes import from_peak, shown_amplitudes
from rotorsim.report.text.table import counted, display_unit, rpm, table
from rotorsim.simulation.result import Result, flat_name

if TYPE_CHECKING:
    from rotorsim.model.compiled import Model
    from rotorsim.settled.result import Periodic
    from rotorsim.signals.spectrum import Harmonics


SETTLING_SAMPLES = 1500  # samples that tell whether the motion has settled
SETTLING_CHANGE = 0.01  # of the largest harmonic: what may still change
SLOWEST_RATIO = 0.95  # ratio of changes that is believed: beyond, noise and not decay makes it
OVER = 1e-4  # of a transient: it is over
ZERO_POLE = 1e-12  # of the largest pole: a pole at zero
SPEED_TOLERANCE = 1e-6  # relative change of speed below which it is constant


def two_axis_signals(result: Result) -> list[str]:
    """Return the signals [x, y] by name; of [node, xy] ones the node that moves most."""
    names = []
    for name, array in result.signals.items():
        if array.ndim == 2 and array.shape[1] == 2:
            names.append(name)
        elif array.ndim == 3 and array.shape[2] == 2 and len(array):
            late = array[len(array) // 2 :]
            names.append(flat_name(name, (int(np.argmax(np.ptp(late, axis=0).max(axis=1))),)))
    return names


def steady_speed(result: Result, angle: str) -> float | None:
    """Return the speed [rad/s] if it is constant and the shaft turned at least once, else None."""
    if angle not in result or len(result.time) < 8:
        return None
    theta, time = result[angle], result.time
    if theta.ndim != 1 or not np.isfinite(theta).all():
        return None
    ends = [0, len(time) // 2, -1]
    first, second = np.diff(theta[ends]) / np.diff(time[ends])
    whole = float((theta[-1] - theta[0]) / (time[-1] - time[0]))
    if abs(second - first) > SPEED_TOLERANCE * abs(whole) or abs(theta[-1] - theta[0]) < 2 * np.pi * (1 - 1e-9):
        return None
    return whole


def harmonics_of(result: Result, angle: str) -> list[Harmonics]:
    """Return the harmonics of every two-axis signal over the last whole turns, if it turns forward steadily.

    None of them where there are too few samples in a turn.
    """
    if result.status != "finished" or (steady_speed(result, angle) or 0.0) <= 0:
        return []
    from rotorsim.signals.spectrum import few_samples, harmonics, last_turns

    if few_samples(result, angle) is not None:
        return []
    window = last_turns(result, angle)
    return [harmonics(result, name, angle=angle, window=window) for name in two_axis_signals(result)]


def settled_motion(model: Model, result: Result, angle: str, harmonics: Sequence[Harmonics]) -> Periodic | None:
    """Return the motion that a linear machine settles on at the speed of a run; None where it is not known.

    It is asked for where a mode has more than OVER left at the end of the run: what decays faster is seen to.
    """
    speed = steady_speed(result, angle)
    if (
        speed is None
        or not harmonics
        or model.hidden
        or not model.linear
        or model.n_z
        or "speed" not in model.diagram.parameters
    ):
        return None
    p = model.p0
    A = np.array(model.jacobian(0.0, model.x0(p), model.z0(p), p))
    poles = np.linalg.eigvals(A) if np.isfinite(A).all() else np.zeros(0)
    decaying = poles.real[poles.real < -ZERO_POLE * np.abs(poles).max(initial=0.0)]
    if decaying.max(initial=-np.inf) * result.time[-1] < np.log(OVER):
        return None
    from rotorsim.settled.periodic import periodic

    try:
        settled = periodic(model, speeds=[speed], signals=[item.signal for item in harmonics], stability=False)
    except (RotorsimError, np.linalg.LinAlgError):
        return None
    return settled if settled.settled.all() else None


def motion(
    result: Result, angle: str, harmonics: Sequence[Harmonics], settled: Periodic | None = None
) -> dict[str, Any]:
    """Return speed, window of the harmonics, and whether the motion has settled; {} where nothing turns steadily.

    settled: what the machine settles on, where that is known. Else from harmonics R1, R2, R3 of three windows in a row:
    what changes as exp(-t / tau) has still |R3 - R2| q / (1 - q) to go, q = |R3 - R2| / |R2 - R1|. Settled: less than
    1 % of the largest harmonic.
    """
    speed = steady_speed(result, angle)
    if speed is None:
        return {}
    from rotorsim.signals.spectrum import LEAST_SAMPLES, few_samples, last_turns

    data: dict[str, Any] = {"speed": speed, "speed_rpm": rpm(speed), "settled": None}
    if not harmonics:
        if speed < 0:
            return data | {"backward": True}
        few = few_samples(result, angle)
        return data if few is None else data | {"samples_a_turn": few, "least_samples": LEAST_SAMPLES}
    start, stop = window = last_turns(result, angle)
    turns = max(round((stop - start) * speed / (2 * np.pi)), 1)
    data |= {"window": [start, stop], "turns": turns}
    if settled is not None:
        return data | _largest_change(_to_go(item, settled) for item in harmonics)
    if start - 2 * (stop - start) < -1e-9:
        return data
    try:
        return data | _largest_change(_decay(result, angle, item, window, turns) for item in harmonics)
    except RotorsimError:  # too few samples to tell the orders apart
        return data


Change = tuple[str, str, np.ndarray, np.ndarray, float]  # signal, unit, orders, what each has to go, largest amplitude


def _decay(result: Result, angle: str, item: Harmonics, window: tuple[float, float], turns: int) -> Change:
    """Return what harmonics have still to go by the decay of their changes over three windows."""
    from rotorsim.signals.spectrum import harmonics

    width = window[1] - window[0]
    samples = int(np.diff(np.searchsorted(result.time, window))[0])
    few = width * min(max(int(SETTLING_SAMPLES * turns / max(samples, 1)), 1), turns) / turns
    ends = [window[1] - k * width for k in (2, 1, 0)]
    values = [harmonics(result, item.signal, angle=angle, window=(end - few, end)).values for end in ends]
    before, after = np.abs(np.diff(values, axis=0))
    q = np.minimum(np.divide(after, before, out=np.ones_like(after), where=before > 0), SLOWEST_RATIO)
    largest = float(np.abs(item.values).max(initial=0.0))
    return item.signal, item.unit, np.asarray(item.orders), after * q / (1 - q), largest


def _to_go(item: Harmonics, settled: Periodic) -> Change:
    """Return how far harmonics are from those of the settled motion."""
    shared = [k for k, order in enumerate(item.orders) if np.isclose(settled.orders, order, atol=1e-9).any()]
    final = np.array([settled.harmonic(item.signal, item.orders[k])[0] for k in shared])
    left = np.abs(np.asarray(item.values)[shared] - final)
    return item.signal, item.unit, np.asarray(item.orders)[shared], left, float(np.abs(final).max(initial=0.0))


def _largest_change(changes: Iterable[Change]) -> dict[str, Any]:
    """Return what has most to go, as a share of the largest harmonic of its signal, and whether that is little."""
    worst: dict[str, Any] = {}
    for signal, unit, orders, left, largest in changes:
        if not len(left):
            continue
        k = int(np.argmax(left))
        share = float(left[k]) / largest if largest > 0 else 0.0
        if share > worst.get("share", -1.0):
            worst = {"signal": signal, "order": orders[k], "left": float(left[k]), "unit": unit, "share": share}
    return {"settled": worst.get("share", 0.0) <= SETTLING_CHANGE, "still_changes": worst}


def motion_line(motion: dict[str, Any]) -> str:
    """Return `motion` as text."""
    if not motion:
        return ""
    text = f"{motion['speed_rpm']:.6g} rpm ({motion['speed']:.6g} rad/s)"
    if "backward" in motion:
        return f"{text}, from y to x: harmonics are told of shafts that turn from x to y"
    if "samples_a_turn" in motion:
        text += f"; {motion['samples_a_turn']:.3g} samples a turn: harmonics need {motion['least_samples']}, "
        return text + "so a smaller step or record_every"
    if "window" in motion:
        start, stop = motion["window"]
        text += f"; harmonics over {start:.6g} .. {stop:.6g} s, {counted(motion['turns'], 'turn')}"
    if motion["settled"] is None:
        return text
    if motion["settled"]:
        return f"{text}; settled"
    change = motion["still_changes"]
    unit, scale = display_unit(change["unit"])
    size = from_peak(change["left"], change["order"]) * scale
    left = f"{size:.2g} {unit} ({100 * change['share']:.2g} % of the largest)"
    return f"{text}; not settled: order {change['order']:g} of {change['signal']} has about {left} still to go"


TURN_SIZES = {"0-peak": "peak", "peak-peak": "peak_to_peak", "rms": "rms"}  # of the largest turn, in `run_ups`


def run_ups(result: Result, angle: str, shown: Collection[str]) -> list[dict[str, Any]]:
    """Return speed and peak of the largest turn of both axes of two-axis signals in a run-up, and their resonances."""
    speed = f"{angle.removesuffix('.theta')}.speed"
    if not angle or result.status != "finished" or speed not in result or np.ptp(result[speed]) == 0.0:
        return []
    from rotorsim.signals.envelopes import run_up

    if not (np.diff(result[speed]) >= 0).all() or len(result.time) < 100:
        return []
    ports = {item.partition("[")[0] for item in shown}
    names = [name for name in two_axis_signals(result) if name.partition("[")[0] in ports]
    entries = {flat_name(name, (axis,)): result.units.get(name) for name in names for axis in (0, 1)}
    rows = [(entry, unit, run_up(result, entry, speed=speed)) for entry, unit in entries.items()]
    return [
        {
            "signal": entry,
            "unit": one.unit if unit is None else unit,
            "resonance": one.resonance,
            "resonance_rpm": rpm(one.resonance),
            "peak": one.peak,
            "peak_to_peak": float(one.spans[one.largest]),
            "rms": float(one.rms[one.largest]),
            "rises": one.rises,
            "orders": [
                {"order": at.order, "speed": at.speed, "speed_rpm": rpm(at.speed), "peak": at.peak}
                for at in one.resonances()
            ],
        }
        for entry, unit, one in rows
    ]


def run_up_table(rows: Sequence[dict[str, Any]]) -> str:
    """Return `run_ups` as text."""
    lines = []
    for row in rows:
        unit, scale = display_unit(row["unit"])
        largest = "largest turn, still rising" if row["rises"] else "largest turn"
        lines.append(
            (
                row["signal"],
                largest,
                f"{row['resonance_rpm']:.1f}",
                f"{row[TURN_SIZES[shown_amplitudes()]] * scale:.6g}",
                unit,
            )
        )
        lines += [
            ("", f"{one['order']}X", f"{one['speed_rpm']:.1f}", f"{from_peak(one['peak']) * scale:.6g}", unit)
            for one in row["orders"]
        ]
    header = ("run-up", "resonance of", "at [rpm]", shown_amplitudes(), "unit")
    return table(header, lines) if lines else ""


def peaks(result: Result) -> dict[str, dict[str, Any]]:
    """Return shape, unit, peak and rms of every entry of the signals."""
    return {name: _peaks(array, result.units.get(name, "")) for name, array in result.signals.items()}


def _peaks(array: np.ndarray, unit: str) -> dict[str, Any]:
    values, shape = np.asarray(array, float), array.shape[1:]
    data = {"unit": unit, "shape": list(shape)}
    if not len(values):
        return data | dict.fromkeys(("peak", "rms", "final"), np.full(shape, np.nan))
    with np.errstate(over="ignore", invalid="ignore"):  # a run that diverged ends with huge numbers
        peak = np.abs(values).max(axis=0)
        scale = np.where(peak > 0, peak, 1.0)  # squares would overflow, shares of the peak do not
        rms = scale * np.sqrt(np.mean((values / scale) ** 2, axis=0))
    return data | {"peak": peak, "rms": np.asarray(rms), "final": values[-1]}


def peaks_table(result: Result, angle: str) -> str:
    """Return peak and rms of every signal as text: of the entry with the largest peak, where there are several."""
    lines = []
    for name, data in peaks(result).items():
        peak, rms = np.ravel(data["peak"]), np.ravel(data["rms"])
        if name == angle or not peak.size:
            continue
        largest = int(np.nanargmax(peak)) if np.isfinite(peak).any() else 0
        entry = flat_name(name, tuple(map(int, np.unravel_index(largest, data["shape"]))))
        unit, scale = display_unit(data["unit"])
        lines.append((entry, f"{peak[largest] * scale:.6g}", f"{rms[largest] * scale:.6g}", unit))
    return table(("signal", "peak", "rms", "unit"), lines) if lines else ""


def run_line(result: Result) -> str:
    """Return one line on how the run was made."""
    counters, provenance = result.counters, result.provenance
    end = f"{result.time[-1]:.6g} s" if len(result.time) else "nothing"
    seconds = float(counters.get("run_cpu_seconds", 0.0))
    return (
        f"{provenance.get('diagram')}: {counters.get('steps', 0)} {provenance.get('method')} steps to {end}, "
        f"{seconds:.3g} s CPU, {provenance.get('path')}"
    )
