"""Ensembles: CPU time per run beside plain C and beside single runs, both cores, ten thousand runs in one command.

``python -m benchmarks.engine.ensembles [--only NAME ...]`` prints every figure beside its target and exits 1 if one is
missed. The C baselines are those of `benchmarks.engine.speed`, one run after another, in the same process.
"""

from __future__ import annotations

import argparse
import re
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.engine import baselines
from benchmarks.engine.speed import loop, report
from benchmarks.harness import Line, at_least, at_most, medians, run_process
from rotorsim.jobs.jobs import Jobs, local_workers
from rotorsim.model.emit.toolchain import find_compiler, lane_width
from rotorsim.model.lanes import LaneLibrary, Lanes, Reduction
from rotorsim.simulation.ensemble.many import simulate_many
from tests.reference.rotor import fe_rigid
from tests.systems.shipped import shipped

RECORD = ["rotor.displacement", "controller.current"]
SPEEDS = "speed=600 rpm:24 rpm:2976 rpm"  # 100
GAINS = "controller.KP=9000:150:23850"  # 100
PROCESSOR = Path("/proc/cpuinfo")


def width() -> int:
    """Return the runs side by side on this machine."""
    compiler = find_compiler()
    assert compiler is not None
    return lane_width(compiler)


def lanes(name: str, steps: int, step: float, every: int, **kept: Any) -> Callable[[], Any]:
    """Return a function that takes steps of a shipped diagram at as many speeds as there are lanes."""
    model, compiler = shipped(name), find_compiler()
    assert compiler is not None
    library = LaneLibrary(model, [model.expression(signal) for signal in RECORD], compiler, lane_width(compiler))
    p = np.array([model.parameter_vector({"speed": 100.0 + 10.0 * k}) for k in range(library.width)])
    reduction = Reduction(library.n_y, np.array([steps // every + 1]), (0, steps // every + 1), **kept)
    starts = [model.initial(one) for one in p]

    def action() -> Any:
        at_work = Lanes(library, p, np.full(library.width, step), reduction)
        at_work.start(np.array([x for x, _ in starts]), np.array([z for _, z in starts]))
        return at_work.run(0, steps, every)

    return action


def many(name: str, runs: int, stop: float) -> Callable[[], Any]:
    """Return a function that simulates an ensemble in this process, every run judged."""
    model = shipped(name)
    speeds = np.linspace(100.0, 300.0, runs)
    return lambda: simulate_many(model, {"speed": speeds}, stop=stop, record=RECORD, scheduler="synchronous")


def jeffcott() -> list[Line]:
    """Per run: the loop with sums over rows, with all rows kept, and everything that `simulate_many` does."""
    steps, runs = 50_000, 32
    plain = {f"plain{k}": baselines.jeffcott(steps, 1e-4, flags=f) for k, f in enumerate(_FLAGS)}
    actions: dict[str, Callable[[], Any]] = {
        **plain,
        "one": loop("jeffcott", steps, 1e-4, RECORD),
        "sums": lanes("jeffcott", steps, 1e-4, 1),
        "rows": lanes("jeffcott", steps, 1e-4, 1, history=True),
        "many": many("jeffcott", runs, 5.0),
    }
    times = medians(actions, repeats=15)
    unit = min(times["plain0"], times["plain1"])
    target = {8: 0.02, 4: 0.03}.get(width(), 0.1)
    return [
        at_most(f"jeffcott, {width()} side by side, a run / plain C", times["sums"] / width() / unit, target),
        Line("   with all rows kept, in memory that is new", f"{times['rows'] / width() / unit:.3g}"),
        Line("   all of simulate_many, which judges every run", f"{times['many'] / runs / unit:.3g}"),
        Line("   one run by itself", f"{times['one'] / unit:.3g}"),
    ]


def beam() -> list[Line]:
    """The same of a beam of 42 states."""
    steps = 20_000
    rotor = fe_rigid(speed=float(shipped("fe_rigid").diagram.parameters["speed"]))
    actions: dict[str, Callable[[], Any]] = {
        f"plain{banded}{k}": baselines.fe_rigid(rotor, steps, 1e-5, 10, banded, flags)
        for banded in (False, True)
        for k, flags in enumerate(_FLAGS)
    }
    actions |= {"one": loop("fe_rigid", steps, 1e-5, RECORD), "sums": lanes("fe_rigid", steps, 1e-5, 10)}
    times = medians(actions)
    unit = min(seconds for name, seconds in times.items() if name.startswith("plain"))
    return [
        at_most(f"fe_rigid, {width()} side by side, a run / plain C", times["sums"] / width() / unit, 0.15),
        Line("   one run by itself", f"{times['one'] / unit:.3g}"),
    ]


def both_cores() -> list[Line]:
    """Wall time of the same ensemble with one and with two workers that are there already."""
    model, speeds = shipped("fe_rigid"), np.linspace(100.0, 300.0, 192)
    times = {}
    for workers in (1, 2):
        walls = []
        with local_workers(Jobs(workers)) as kept:
            for _ in range(6):
                begun = time.perf_counter()
                simulate_many(model, {"speed": speeds}, stop=1.0, record=RECORD, jobs=kept)
                walls.append(time.perf_counter() - begun)
        times[workers] = statistics.median(walls[1:])  # the first one starts and compiles
    return [
        at_least("fe_rigid, two workers beside one, wall time", times[1] / times[2], 1.9, also=f" ({times[2]:.2g} s)")
    ]


def ten_thousand() -> list[Line]:
    """10^4 runs of 5 s in one command, with progress."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "runs.h5"
        command = [str(Path(sys.executable).with_name("rotorsim")), "sweep", "jeffcott", "--vary", SPEEDS]
        done = run_process([*command, "--vary", GAINS, "--out", str(file), "--progress"])
        size = file.stat().st_size / 1e6 if file.exists() else 0.0
    counted = re.search(r"(\d+) runs", done.output)
    told = f"{counted[1] if counted else 'no'} runs, exit {done.code}, {done.wall:.0f} s, {done.cpu:.0f} CPU s"
    return [
        Line("10 000 runs of 5 s in one command", told, "exit 0", done.code == 0),
        at_most("   largest process", done.peak, 500, "{:.0f}", "MB", f" ({size:.1f} MB written)"),
    ]


_FLAGS = (baselines.PLAIN, baselines.SAME)
PARTS = {"jeffcott": jeffcott, "beam": beam, "both_cores": both_cores, "ten_thousand": ten_thousand}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="*", choices=list(PARTS))
    given = parser.parse_args()
    if PROCESSOR.exists():
        print(next((line.partition(":")[2].strip() for line in PROCESSOR.open() if line.startswith("model name")), ""))
    lines = report(PARTS, given.only)
    sys.exit(0 if all(line.ok is not False for line in lines) else 1)


if __name__ == "__main__":
    main()
