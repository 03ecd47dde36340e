"""Speed: ratios to hand-written C of the same run, growth with size, whole processes.

``python -m benchmarks.engine.speed [--out FILE] [--only NAME ...]`` prints every figure beside its target and
exits 1 if one is missed. The C baselines are compiled with -O3 by the product's compiler, with and without
the product's other flags, and the faster one counts. Times are CPU times, medians of 5 interleaved runs.
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.engine import baselines
from benchmarks.harness import ROOT, Line, at_least, at_most, cpu_seconds, medians, run_process, write
from rotorsim.model.instance import make_instance
from tests.reference.excitation import RPM
from tests.reference.rotor import fe_rigid
from tests.systems.shipped import document, load_document, runner, shipped

JEFFCOTT_STEPS, BEAM_STEPS = 50_000, 100_000
SIZES = (5, 10, 20, 50, 100, 200)
SLOW_POLE_DECAY = 1e-6


def jeffcott() -> list[Line]:
    """jeffcott and jeffcott_elementary against plain C, 50 000 steps, displacement and current at each."""
    record = ["rotor.displacement", "controller.current"]
    actions: dict[str, Callable[[], Any]] = {}
    for k, flags in enumerate((baselines.PLAIN, baselines.SAME)):
        actions[f"plain{k}"] = baselines.jeffcott(JEFFCOTT_STEPS, 1e-4, flags=flags)
        actions[f"hand{k}"] = baselines.jeffcott(JEFFCOTT_STEPS, 1e-4, by_hand=True, flags=flags)
    for name in ("jeffcott", "jeffcott_elementary"):
        actions[name] = runner(name, JEFFCOTT_STEPS, step=1e-4, record=record, record_every=1)
    actions["loop"] = loop("jeffcott", JEFFCOTT_STEPS, 1e-4, record)
    machine = runner("jeffcott", JEFFCOTT_STEPS, step=1e-4, record=record, record_every=1, use_compiler=False)
    times = {**medians(actions, repeats=15), **medians({"machine": machine}, repeats=3)}
    plain = min(times["plain0"], times["plain1"])
    hand = min(times["hand0"], times["hand1"])
    ratio, elementary = times["jeffcott"] / plain, times["jeffcott_elementary"] / times["jeffcott"]
    return [
        at_most("jeffcott, its steps, CPU time / plain C", times["loop"] / plain, 0.12),
        at_most(
            "jeffcott, simulate(), which checks the run, too, CPU time / plain C",
            ratio,
            0.42,
            also=f" ({plain * 1e3:.1f} ms C)",
        ),
        Line("   limit by hand (rotated vector, series by recurrence) / plain C", f"{hand / plain:.3g}"),
        at_most("jeffcott_elementary / jeffcott", elementary, 1.05, "{:.3f}"),
        Line("   without a compiler (CasADi's virtual machine) / plain C", f"{times['machine'] / plain:.3g}"),
    ]


def loop(name: str, steps: int, step: float, record: list[str]) -> Callable[[], Any]:
    """Return a function that takes steps of a shipped diagram, every row recorded."""
    model = shipped(name)
    instance = make_instance(model, record, model.p0)
    instance.start(0.0)
    begun, rows = instance.save(), np.empty((steps, instance.n_y))

    def action() -> Any:
        instance.restore(begun)
        return instance.run(0, steps, 0.0, step, 1, rows)

    return action


def beam() -> list[Line]:
    """fe_rigid against plain C with dense or banded matrices (the faster), 100 000 steps."""
    record = ["rotor.displacement", "controller.current"]
    rotor = fe_rigid(speed=float(shipped("fe_rigid").diagram.parameters["speed"]))
    actions: dict[str, Callable[[], Any]] = {
        f"{'banded' if banded else 'dense'}{k}": baselines.fe_rigid(rotor, BEAM_STEPS, 1e-5, 1, banded, flags)
        for banded in (False, True)
        for k, flags in enumerate((baselines.PLAIN, baselines.SAME))
    }
    actions["product"] = runner("fe_rigid", BEAM_STEPS, step=1e-5, record=record, record_every=1)
    times = medians(actions)
    best = min((seconds, name) for name, seconds in times.items() if name != "product")
    also = f" ({best[1].rstrip('01')}, {best[0] / BEAM_STEPS * 1e9:.0f} ns a step)"
    return [at_most("fe_rigid, simulate(), CPU time / plain C", times["product"] / best[0], 1.1, also=also)]


def sized_beam(elements: int) -> dict[str, Any]:
    """Return the JSON of fe_rigid with another number of elements; disc and AMB at 2/5, crack at 3/5 of the length."""
    content = document("fe_rigid")
    disc, crack, last = round(2 * elements / 5) + 1, round(3 * elements / 5) + 1, elements + 1
    places = {3: disc, 4: crack, 6: last}
    text = json.dumps(content["wires"])
    for old, new in places.items():
        text = text.replace(f"[{old}]", f"[@{new}]").replace(f"[{old},", f"[@{new},")
    content["wires"] = json.loads(text.replace("[@", "["))
    rotor = content["blocks"]["rotor"]["parameters"]
    rotor["elements"] = elements
    rotor["element_length"] = 0.5 / elements
    for key, value in rotor.items():
        if key.endswith(("node", "nodes", "pinned")):
            rotor[key] = [places.get(v, v) for v in value] if isinstance(value, list) else places.get(value, value)
    content["record"] = [f"rotor.displacement[{disc}]", "controller.current"]
    content["name"] = f"fe_{elements}"
    return content


def measure_size(elements: int) -> None:
    """Print time per step, memory and preparation of one size as JSON (run in a process of its own)."""
    from benchmarks.harness import own_peak, peak_since_reset, reset_peak
    from rotorsim.model.compiled import compile_diagram

    before = reset_peak()
    begun = time.perf_counter()
    model = compile_diagram(load_document(sized_beam(elements)))
    steps = max(200, 400_000 // elements)
    # from rest the far nodes hold denormal numbers for a while, which the processor handles slowly
    start = np.random.default_rng(1).normal(size=model.n_x) * 1e-6
    # Rayleigh damping makes the fastest mode of 200 elements decay at 1e11 1/s: so short a step for all sizes
    run = runner(model, steps, step=1e-13, initial=start)
    assert run().status == "finished"
    ready = time.perf_counter() - begun
    seconds = statistics.median(cpu_seconds(run) for _ in range(5))
    used = peak_since_reset() - before
    print(json.dumps({"step": seconds / steps, "peak": own_peak(), "used": used, "ready": ready, "n_x": model.n_x}))


def sizes() -> list[Line]:
    """Time per step and memory of FE rotors of 5 to 200 elements; exponent of n by least squares."""
    found = {}
    with tempfile.TemporaryDirectory() as cache:
        for n in SIZES:
            command = [sys.executable, "-m", "benchmarks.engine.speed", "--size", str(n)]
            done = run_process(command, {"ROTORSIM_CACHE": cache})
            try:
                found[n] = json.loads(done.output.strip().splitlines()[-1])
                found[n]["whole"] = done.peak
            except (ValueError, IndexError):
                return [Line(f"FE with {n} elements", f"failed: {done.output.strip()[-200:]}", "runs", False)]
    logs = np.log([[n, found[n]["step"]] for n in SIZES])
    exponent = float(np.polyfit(logs[:, 0], logs[:, 1], 1)[0])
    memory = np.array([found[n]["used"] for n in SIZES])
    last, first = (memory[-1] - memory[-2]) / 100, (memory[-2] - memory[-3]) / 50
    used = ", ".join(f"{n}: {found[n]['used']:.1f}" for n in SIZES)
    own = ", ".join(f"{n}: {found[n]['peak']:.0f}" for n in SIZES)
    whole = ", ".join(f"{n}: {found[n]['whole']:.0f}" for n in SIZES)
    per_step = ", ".join(f"{n}: {found[n]['step'] * 1e6:.3g}" for n in SIZES)
    ready = ", ".join(f"{n}: {found[n]['ready']:.2g}" for n in SIZES)
    return [
        at_most("FE with 5..200 elements: exponent of time per step", exponent, 1.3, "{:.2f}"),
        Line("   time per step [us]", per_step),
        at_most("FE: memory per element, 100..200 beside 50..100 (linear: 1)", last / max(first, 1e-9), 1.3, "{:.2f}"),
        Line("   memory to load, trace, compile and run [MB]", used),
        Line("   peak memory of the process [MB]", own),
        Line("   the larger of process and compiler [MB]", whole),
        Line("   to trace, compile and run first, cold [s]", ready),
    ]


def sixty_speeds() -> list[Line]:
    """``periodic`` for 60 speeds against simulating each until the integral pole has decayed to 1e-6.

    The pole of the integral action has the time constant (k - k_s + k_i K_P) / (k_i K_I) = 13.9 s, so that
    takes 13.9 ln(1e6) = 193 s of simulated time a speed. Every hundredth step is recorded.
    """
    from rotorsim.settled.periodic import periodic

    model = shipped("jeffcott")
    speeds = np.linspace(900, 6000, 60) * RPM
    pole = (7.6e5 - 105210.0 + 42.1 * 12200.0) / (42.1 * 2000.0)
    stop = pole * math.log(1 / SLOW_POLE_DECAY)
    calls = 20  # one call is too short to be timed alone
    actions = {
        "periodic": lambda: [periodic(model, speeds=speeds) for _ in range(calls)],
        "simulate": runner(model, round(stop / 1e-4), step=1e-4, record_every=100),
    }
    times = medians(actions)
    one = times["periodic"] / calls
    ratio = 60 * times["simulate"] / one
    also = f" ({one * 1e3:.2g} ms, {60 * times['simulate']:.2g} s)"
    return [at_least(f"periodic for 60 speeds: times faster than simulating {stop:.0f} s each", ratio, 2000, also=also)]


def command_line() -> list[Line]:
    """``rotorsim run diagrams/jeffcott.json`` as a whole process: cold with an empty cache, then warm."""
    command = [str(Path(sys.executable).with_name("rotorsim")), "run", "diagrams/jeffcott.json"]
    cold, warm = [], []
    for _ in range(5):
        with tempfile.TemporaryDirectory() as cache:
            environment = {"ROTORSIM_CACHE": cache}
            cold.append(run_process(command, environment))
            warm.append(run_process(command, environment))
    bad = next((p for p in cold + warm if p.code != 0), None)
    if bad is not None:
        return [Line("rotorsim run diagrams/jeffcott.json", f"exit {bad.code}: {bad.output[-200:]}", "exit 0", False)]
    lines = []
    for name, runs, limit in (("cold", cold, 2.5), ("warm", warm, 1.0)):
        wall, cpu = (statistics.median(getattr(p, key) for p in runs) for key in ("wall", "cpu"))
        what = f"rotorsim run diagrams/jeffcott.json, whole process, {name}"
        lines.append(at_most(what, wall, limit, "{:.2f}", "s", f" (CPU {cpu:.2f} s)"))
    lines.append(at_most("   peak memory, compiler included", max(p.peak for p in cold + warm), 200, "{:.0f}", "MB"))
    return lines


def many_blocks() -> list[Line]:
    """A diagram of 10 000 elementary blocks: ``rotorsim check`` as a whole process; compiles and runs."""
    from benchmarks.engine.ring import ring

    tool = str(Path(sys.executable).with_name("rotorsim"))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "ring.json"
        path.write_text(json.dumps(ring(10_000), indent=1), encoding="utf-8")
        environment = {"ROTORSIM_CACHE": str(Path(folder) / "cache")}
        check = statistics.median(_checked(tool, path, environment) for _ in range(5))
        ran = run_process([tool, "run", str(path)], environment)
    also = f" ({ran.output.strip()[-60:]})" if ran.code else ""
    figure = f"exit {ran.code}, {ran.wall:.1f} s, {ran.peak:.0f} MB{also}"
    return [
        at_most("10 000 elementary blocks: rotorsim check, whole process", check, 3.0, "{:.2f}", "s"),
        Line("10 000 elementary blocks: compiles and runs 1000 steps, cold", figure, "exit 0", ran.code == 0),
    ]


def _checked(tool: str, path: Path, environment: dict[str, str]) -> float:
    done = run_process([tool, "check", str(path)], environment)
    return done.wall if done.code == 0 else math.inf


PARTS: dict[str, Callable[[], list[Line]]] = {
    "jeffcott": jeffcott,
    "beam": beam,
    "sizes": sizes,
    "sixty_speeds": sixty_speeds,
    "command_line": command_line,
    "many_blocks": many_blocks,
}


def report(parts: dict[str, Callable[[], list[Line]]], only: list[str] | None = None) -> list[Line]:
    """Print and return the figures of all parts, or of the named ones; a part that fails is a line that says so."""
    lines: list[Line] = []
    for name, part in parts.items():
        if only and name not in only:
            continue
        try:
            found = part()
        except Exception as error:  # the other figures are still wanted
            found = [Line(name, f"{type(error).__name__}: {error}"[:160], "runs", False)]
        for line in found:
            print(line, flush=True)
        lines += found
    return lines


def main() -> None:
    """Measure, print, and write JSON and Markdown where asked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="*", choices=list(PARTS))
    parser.add_argument("--out", type=Path, help="write FILE.json and FILE.md")
    parser.add_argument("--size", type=int, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.size:
        measure_size(given.size)
        return
    lines = report(PARTS, given.only)
    if given.out:
        write(lines, given.out)
    sys.exit(0 if all(line.ok is not False for line in lines) else 1)


if __name__ == "__main__":
    assert ROOT
    main()
