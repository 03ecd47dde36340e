"""Every figure that issue 2 promises, beside its target, in one run.

``python -m benchmarks.evidence [--only NAME ...] [--out FILE]`` prints a line each: what, figure, target,
ok or NOT; exit 1 if one is missed. Takes several minutes: long runs with the thesis' own slow integral
action are here, not in the tests.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.engine import controllers, speed
from benchmarks.harness import ROOT, Line, at_most, run_process, within, write
from rotorsim.linear.modes.eigenmodes import modes
from tests.reference.excitation import RPM
from tests.reference.published import FE_RIGID_AT_3000_RPM, FE_RIGID_AT_REST, RUN_UP_RIGHT, RUN_UP_THESIS, as_printed
from tests.reference.rotor import fe_rigid
from tests.systems import figures
from tests.systems.shipped import document, shipped

TOOL = str(Path(sys.executable).with_name("rotorsim"))


def table() -> list[Line]:
    """Table 2-2, elementary blocks, independent integration."""
    lines = []
    for name in ("jeffcott", "jeffcott_elementary"):
        rows = figures.table_2_2(shipped(name))
        amplitude, phase = max(abs(r[2]) for r in rows), max(abs(r[3]) for r in rows)
        lines.append(at_most(f"Table 2-2 from {name}: largest amplitude error", 100 * amplitude, 0.2, "{:.3f}", "%"))
        lines.append(at_most(f"Table 2-2 from {name}: largest phase error", phase, 0.1, "{:.4f}", "deg"))
    lines.append(at_most("jeffcott_elementary against jeffcott, 5 s, relative to peak", figures.elementary(5.0), 1e-9))
    for step, limit in ((1e-4, None), (2e-5, 1e-8)):
        worst = max(figures.independent(stop=1.0, step=step))
        what = f"jeffcott, RK4 step {step:g} s, against DOP853 rtol 1e-11, 1 s"
        lines.append(Line(what, f"{worst:.3g}", "(step error)") if limit is None else at_most(what, worst, limit))
    return lines


def frequencies() -> list[Line]:
    """Natural frequencies of fe_rigid without AMB."""
    lines = []
    for rpm, printed in ((0.0, FE_RIGID_AT_REST), (3000.0, FE_RIGID_AT_3000_RPM)):
        found = modes(shipped("fe_rigid", without=("amb",)), parameters={"speed": rpm * RPM, **figures.UNDAMPED})
        hz = [mode.frequency_hz for mode in found.modes]
        independent = fe_rigid(a0=0.0, a1=0.0).at_speed(rpm * RPM).frequencies()
        off = float(np.max(np.abs(np.array(hz) / independent - 1)))
        shown = hz[::2] if rpm == 0.0 else hz
        print_error = max(abs(x / float(text) - 1) for x, text in zip(shown, printed, strict=False))
        what = f"fe_rigid without AMB, {rpm:.0f} rpm"
        lines.append(at_most(f"{what}: all frequencies, against the independent program", off, 1e-6))
        figure = ", ".join(f"{x:.6g}" for x in shown[: len(printed)])
        target = "as printed: " + ", ".join(printed)
        lines.append(
            Line(f"{what} [Hz] (largest deviation {print_error:.2g})", figure, target, as_printed(shown, printed))
        )
    return lines


def order() -> list[Line]:
    """Order of RK4 and polynomial exactness."""
    found = figures.orders([2e-4, 1e-4, 5e-5, 2.5e-5], stop=0.5)
    lines = [within("order of RK4, step halving from 0.2 ms, jeffcott", x, 4.0, 0.05, "{:.3f}") for x in found]
    worst = max(figures.polynomial_error(power) for power in (1, 2, 3))
    lines.append(at_most("x' = t, t^2, t^3 by RK4, step 0.25 s: relative error", worst, 8 * 4e-16))
    return lines


def run_ups() -> list[Line]:
    """Resonances of the run-up of S1 from the Hilbert envelope."""
    return [
        within(
            "S1 run-up, angle = integral of speed [rpm]",
            figures.run_up_peak("jeffcott_runup"),
            RUN_UP_RIGHT,
            0.01 * RUN_UP_RIGHT,
            "{:.0f}",
        ),
        within(
            "S1 run-up, the thesis' angle omega(t) t [rpm]",
            figures.run_up_peak(figures.thesis_run_up()),
            RUN_UP_THESIS,
            0.01 * RUN_UP_THESIS,
            "{:.0f}",
        ),
    ]


def settled() -> list[Line]:
    """``periodic`` against long simulations with the thesis' own integral gain (13.9 s time constant)."""
    lines = []
    for name, (signals, stop, step) in figures.SETTLED.items():
        found = figures.settled_difference(shipped(name), signals, stop, step)
        what = f"periodic against {stop:.0f} s of simulation, {name}"
        lines.append(at_most(what, max(found.values()), 1e-6))
    for name in figures.NONLINEAR:
        found = figures.settled_difference(figures.nonlinear_model(name), figures.JEFFCOTT_SIGNALS, 280.0, 1e-4)
        lines.append(at_most(f"periodic against 280 s of simulation, jeffcott with {name}", max(found.values()), 1e-4))
    return lines


def swapping() -> list[Line]:
    """Swapping controllers: the diagram runs, all levitate."""
    with tempfile.TemporaryDirectory() as folder:
        path = str(Path(folder) / "swapped.json")
        swap = run_process([TOOL, "swap", "diagrams/jeffcott.json", "controller", "state_feedback", "-o", path])
        done = run_process([TOOL, "run", path])
        figure = f"exit {swap.code}, {done.code}"
    ok = swap.code == done.code == 0
    lines = [Line("rotorsim swap jeffcott controller state_feedback, then run", figure, "exit 0, 0", ok)]
    for model, rows in controllers.measure().items():
        up = [row.controller for row in rows if row.levitates]
        down = [f"{row.controller} ({row.note or row.peak})" for row in rows if not row.levitates]
        figure = f"{len(up)} of {len(rows)}" + (": not " + ", ".join(down) if down else "")
        lines.append(Line(f"controllers that levitate {model}", figure, "all", not down))
        peaks = ", ".join(f"{row.controller} {row.sensitivity:.2f} {row.zone}" for row in rows)
        lines.append(Line(f"   ISO 14839-3 sensitivity peak and zone, {model}", peaks))
    return lines


def bad_input() -> list[Line]:
    """Wrong files, wrong values, divergence, interruption: messages and exit codes of the command line."""
    lines = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for what, content in _bad_files(folder):
            begun = time.perf_counter()
            done = run_process([TOOL, "check", str(content)])
            taken = time.perf_counter() - begun
            ok = done.code == 2 and "Traceback" not in done.output and str(content.name) in done.output
            figure = f"exit {done.code}, {taken:.1f} s"
            lines.append(Line(f"check of {what}: no traceback, place named", figure, "exit 2", ok))
        lines += _diverging(folder)
        lines.append(_interrupted(folder))
    return lines


def _bad_files(folder: Path) -> list[tuple[str, Path]]:
    def write_text(name: str, text: str) -> Path:
        path = folder / name
        path.write_text(text, encoding="utf-8")
        return path

    good = document("jeffcott")
    misspelt = json.loads(json.dumps(good).replace('"rotor_2dof"', '"rotor_2dofs"'))
    outside = json.loads(json.dumps(good))
    outside["blocks"]["rotor"] = {"type": "diagram", "file": "../../etc/passwd"}
    code = {**good, "blocks": {**good["blocks"], "rotor": {"type": "__import__('os').system('true')"}}}
    huge = folder / "huge.json"
    with huge.open("w", encoding="utf-8") as file:
        file.write('{"name": "')
        for _ in range(100):
            file.write("x" * 1_000_000)
        file.write('"}')
    return [
        ("a misspelt block type", write_text("misspelt.json", json.dumps(misspelt))),
        ("NaN", write_text("nan.json", json.dumps(good).replace('"2 kg"', "NaN", 1))),
        ("a file cut short", write_text("short.json", json.dumps(good)[:200])),
        ("nesting 100 000 deep", write_text("deep.json", '{"blocks": ' + "[" * 100_000 + "]" * 100_000 + "}")),
        ("a file of 100 MB", huge),
        ("a sub-diagram outside its folder", write_text("outside.json", json.dumps(outside))),
        ("a block type that is Python code", write_text("code.json", json.dumps(code))),
    ]


def _diverging(folder: Path) -> list[Line]:
    out = folder / "diverged.csv"
    done = run_process([TOOL, "run", "diagrams/jeffcott.json", "--set", "controller.KD=-30", "--out", str(out)])
    rows = len(out.read_text(encoding="utf-8").splitlines()) - 1 if out.exists() else 0
    named = "rotor" in done.output and " s" in done.output
    ok = done.code == 1 and rows > 0 and named and "Traceback" not in done.output
    figure = f"exit {done.code}, {rows} rows kept"
    return [Line("a diverging run: time and block named, rows kept", figure, "exit 1", ok)]


def _interrupted(folder: Path) -> Line:
    """Kill ``rotorsim run --out`` at many moments: the file is whole or absent."""
    out = folder / "killed.csv"
    command = [TOOL, "run", "diagrams/jeffcott.json", "--out", str(out)]
    taken = run_process(command).wall
    whole = out.read_bytes()
    found = {"absent": 0, "whole": 0, "half": 0}
    for delay in np.linspace(0.3, 1.05, 40) * taken:
        out.unlink(missing_ok=True)
        process = subprocess.Popen(
            command, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
        )
        time.sleep(float(delay))
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        found["absent" if not out.exists() else "whole" if out.read_bytes() == whole else "half"] += 1
    figure = ", ".join(f"{count} {state}" for state, count in found.items())
    return Line("run --out killed at 40 moments: files left", figure, "0 half", found["half"] == 0)


PARTS: dict[str, Callable[[], list[Line]]] = {
    "table": table,
    "frequencies": frequencies,
    "order": order,
    "run_ups": run_ups,
    "settled": settled,
    "swapping": swapping,
    "bad_input": bad_input,
}


def main() -> None:
    """Measure, print, and write JSON and Markdown where asked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="*", choices=[*PARTS, *speed.PARTS])
    parser.add_argument("--out", type=Path, help="write FILE.json and FILE.md")
    given = parser.parse_args()
    lines = speed.report({**PARTS, **speed.PARTS}, given.only)
    if given.out:
        write(lines, given.out)
    bad = [line for line in lines if line.ok is False]
    print(f"{sum(line.ok is True for line in lines)} ok, {len(bad)} NOT", flush=True)
    sys.exit(1 if bad else 0)


if __name__ == "__main__":
    main()
