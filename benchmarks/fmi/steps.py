"""What a step of an FMU costs: in this process, in its own, in a loop of C, and in a loop written over FMPy.

``python -m benchmarks.fmi.steps [--steps 20000] [--repeats 5]``: the plant FMUs of the tests, one RK4 step of two
states at each call; wall time per step, medians of interleaved runs (a step of two processes is no CPU time of one),
and CPU time of this process. Masters: `rotorsim cosim` with the default master, over a pair.
"""

from __future__ import annotations

import argparse
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.harness import at_least, at_most
from rotorsim.cosim.cosimulation import cosimulate, open_coupling
from rotorsim.cosim.loop import FastLoop
from rotorsim.fmi.runtime.slave import Slave, open_fmu
from rotorsim.model.load import load

H = 1e-4
L = np.array([[0.0, -1.0], [1.0, 0.0]])  # the inputs of a coupled pair


def single(slave: Slave, steps: int) -> float:
    """Return the seconds that steps of one FMU take."""
    u = np.zeros(1)
    begun = time.perf_counter()
    for k in range(steps):
        slave.exchange(u, k * H, H)
    return time.perf_counter() - begun


def pair(slaves: list[Slave], steps: int, *, both: bool) -> float:
    """Return the seconds of a Jacobi loop in Python over a pair; both: they step at the same time."""
    y = [slave.exchange(None, 0.0) for slave in slaves]
    begun = time.perf_counter()
    for k in range(steps):
        if both:
            slaves[0].begin_exchange(-y[1], k * H, H)
            slaves[1].begin_exchange(y[0], k * H, H)
            y = [slaves[0].finish_exchange(), slaves[1].finish_exchange()]
        else:
            y = [slaves[0].exchange(-y[1], k * H, H), slaves[1].exchange(y[0], k * H, H)]
    return time.perf_counter() - begun


def fast(slaves: list[Slave], steps: int) -> float:
    """Return the seconds of the loop in C."""
    loop = FastLoop(slaves, L, np.zeros(2))
    begun = time.perf_counter()
    loop.run(0.0, H, steps)
    return time.perf_counter() - begun


def fmpy_pair(file: Path) -> Callable[[int], float]:
    """Return the same Jacobi loop, written over FMPy's low-level class as its users write it."""
    import fmpy
    from fmpy.fmi2 import FMU2Slave

    description = fmpy.read_model_description(str(file))
    folder = fmpy.extract(str(file), unzipdir=str(file.parent / "unpacked"))
    reference = {v.name: v.valueReference for v in description.modelVariables}
    made = []
    for k in range(2):
        fmu = FMU2Slave(guid=description.guid, unzipDirectory=folder, modelIdentifier="plant", instanceName=f"plant{k}")
        fmu.instantiate()
        fmu.setupExperiment(startTime=0.0)
        fmu.enterInitializationMode()
        fmu.exitInitializationMode()
        made.append(fmu)
    u, y = [reference["u"]], [reference["y"]]

    def run(steps: int) -> float:
        begun = time.perf_counter()
        for k in range(steps):
            a, b = made[0].getReal(y), made[1].getReal(y)
            made[0].setReal(u, [-b[0]])
            made[1].setReal(u, [a[0]])
            for fmu in made:
                fmu.doStep(currentCommunicationPoint=k * H, communicationStepSize=H)
        return time.perf_counter() - begun

    return run


def master(file: Path, *, here: bool) -> Callable[[int], float]:
    """Return a run of the default master over a pair."""
    block = {"type": "fmu", "file": file.name, "parameters": {"in_process": here}}
    wires = [["a.y", "b.u"], ["b.y", "a.u"]]
    document = {"blocks": {"a": block, "b": block}, "wires": wires, "record": ["a.y"]}
    diagram = load(document, folder=file.parent, trust_blocks=True)

    def run(steps: int) -> float:
        coupling = open_coupling(diagram, stop=steps * H)
        begun = time.perf_counter()
        found = cosimulate(coupling, diagram, step=H, stop=steps * H)
        taken = time.perf_counter() - begun
        coupling.close()
        assert found.status == "finished", found.message
        return taken

    return run


def main() -> int:
    """Measure and print."""
    from tests.fmi.plant import floats_only, make_fmu

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=20_000)
    parser.add_argument("--repeats", type=int, default=5)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        file, wired = (
            make_fmu(Path(folder, name), description=text)
            for name, text in (("plant.fmu", ""), ("wired.fmu", floats_only()))
        )
        with open_fmu(file, in_process=True) as here, open_fmu(file) as far:
            slaves = [fmu.instantiate("cs") for fmu in (here, here, far, far)]
            for slave in slaves:
                slave.setup(inputs=["u"], outputs=["y"])
            actions: dict[str, Callable[[int], float]] = {
                "one, in process": lambda n: single(slaves[0], n),
                "one, own process": lambda n: single(slaves[2], n),
                "pair, in process": lambda n: pair(slaves[:2], n, both=False),
                "pair, own processes": lambda n: pair(slaves[2:], n, both=True),
                "pair, loop in C": lambda n: fast(slaves[:2], n),
                "pair, loop over FMPy": fmpy_pair(file),
                "pair, master, in process": master(wired, here=True),
                "pair, master, own processes": master(wired, here=False),
            }
            times: dict[str, list[float]] = {name: [] for name in actions}
            used: dict[str, list[float]] = {name: [] for name in actions}
            for _ in range(given.repeats + 1):
                for name, action in actions.items():
                    begun = time.process_time()
                    times[name].append(1e6 * action(given.steps) / given.steps)
                    used[name].append(1e6 * (time.process_time() - begun) / given.steps)
    medians = {name: statistics.median(found[1:]) for name, found in times.items()}
    cpu = {name: statistics.median(found[1:]) for name, found in used.items()}
    for name, value in medians.items():
        print(f"{name:<28} {value:8.2f} us per step (best {min(times[name]):.2f}), CPU {cpu[name]:.2f} us")
    print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors")
    added = medians["one, own process"] - medians["one, in process"]
    gain = medians["pair, loop over FMPy"] / medians["pair, loop in C"]
    held = cpu["pair, master, in process"] / cpu["pair, loop over FMPy"]
    apart = medians["pair, master, own processes"]
    lines = [
        at_most("a pair: CPU of the master in process / of the loop over FMPy", held, 0.5, "{:.2f}"),
        at_most("a pair: a step of the master in own processes", apart, 15, "{:.1f}", "us"),
        at_most("a process of its own adds to a step", added, 20, "{:.1f}", "us"),
        at_least("a pair: loop over FMPy / loop in C", gain, 5, "{:.1f}"),
    ]
    print(*lines, sep="\n")
    return 0 if all(line.ok for line in lines) else 1


if __name__ == "__main__":
    sys.exit(main())
